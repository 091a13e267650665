"""segment(): from an image and a rough start to labels, a mesh and the story of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.analysis import contours
from accelsurf.analysis.contours import Contours
from accelsurf.analysis.quality import Quality, assess
from accelsurf.analysis.surface_mesh import Surface, extract
from accelsurf.errors import InputError
from accelsurf.evolution.loop import Step, StepRecord, Stop
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.run import EnergyLike, Run
from accelsurf.segmentation.solver_setup import half_width, stop_rule
from accelsurf.settings.run_config import RunConfig

__all__ = ["EnergyLike", "Result", "Run", "evolve", "result_of", "segment"]


@dataclass(frozen=True, eq=False)
class Result:
    """What a run left.

    Attributes
    ----------
    labels : ndarray (nz, ny, nx), uint8
        1 where a voxel's centre is inside.
    psi : ndarray (nz, ny, nx), float32
        Signed distance in the band, mm, negative inside; +-gamma outside it.
    image : ndarray (nz, ny, nx), float32
        The image as the energy saw it: presmoothed, 0 and 1 at its `preprocessing.SCALE_PERCENTILES`.
    geometry : Geometry
    config : RunConfig
    energy : str
        Name of the energy: that of ``config``, or ``custom: ClassName``.
    history : list of Row
        One row per step; the last records the final state.
    stop : Stop
        Why the run ended.
    levels : list of Passed
        The grids that it ran on, coarsest first, with the steps made on each; the last is the image's own.
    kernels : dict of str to float
        Seconds in each kernel while it evolved.
    seconds : dict of str to float
        Wall time of the parts ``start`` and ``evolve``.
    warnings : list of str
    volume : Volume
        The input.
    start : ndarray or None
        psi of the start, for an image of one slice; None for volumes, where it would cost memory.
    edits_done : int
        How many of the edits of ``config`` the run came to.
    terms : list of dict
        The terms of the energy with every setting as it was in the run; empty for an energy of one's own.
    resolved_settings : dict
        What the run took for settings that image and grid decide: see `document.describe_result`.
    learned : (float, float) or None
        Values, on the scale of ``image``, between which those of the object should lie by what it was learned from.
    """

    labels: NDArray[np.uint8]
    psi: NDArray[np.float32]
    image: NDArray[np.float32]
    geometry: Geometry
    config: RunConfig
    energy: str
    history: list[StepRecord]
    stop: Stop
    seconds: dict[str, float]
    volume: Volume
    levels: list[LevelSummary] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    start: NDArray[np.float32] | None = None
    edits_done: int = 0
    kernels: dict[str, float] = field(default_factory=dict)
    terms: list[dict[str, Any]] = field(default_factory=list)
    resolved_settings: dict[str, Any] = field(default_factory=dict)
    learned: tuple[float, float] | None = None

    @cached_property
    def surface(self) -> Surface:
        """The surface as a closed mesh in world mm (LPS), normals outward; extracted once."""
        return extract(self.psi, self.geometry)

    @cached_property
    def contours(self) -> Contours:
        """The contours of an image of one slice, in world mm (LPS), the object on their left; extracted once.

        Raises
        ------
        InputError
            For a volume: it has a `surface`.
        """
        return contours.extract(self.psi, self.geometry)

    def labels_volume(self) -> Volume:
        """The labels on the input's grid with its header."""
        return self.volume.with_array(self.labels)

    @property
    def volume_mm3(self) -> float:
        """Volume of the object, mm3, sub-voxel."""
        return self.history[-1].volume_mm3

    @property
    def area_mm2(self) -> float:
        """Area of its surface, mm2: the mesh's, with the caps where the volume's border cuts the object.

        In one slice, where caps would be all of it: the contour's length times the thickness of the slice.
        """
        if not self.labels.any():
            return 0.0
        if self.length_mm is not None and self._thickness is not None:
            return self.length_mm * self._thickness
        return self.surface.area

    @property
    def length_mm(self) -> float | None:
        """Length of the contours of an image of one slice, mm, with what runs along its border; None for a volume."""
        if self._thickness is None:
            return None
        return self.contours.length if self.labels.any() else 0.0

    @property
    def enclosed_mm2(self) -> float | None:
        """Area of the object in an image of one slice, mm2, sub-pixel; None for a volume."""
        return None if self._thickness is None else self.volume_mm3 / self._thickness

    @property
    def _thickness(self) -> float | None:
        axis = self.geometry.slice_axis
        return None if axis is None else self.geometry.spacing[axis]

    @cached_property
    def components(self) -> int:
        """Number of 6-connected parts of the label map."""
        return int(ndimage.label(self.labels)[1])

    @cached_property
    def touches_border(self) -> bool:
        """Whether a voxel of the object lies on the volume's border (axes with one slice do not count)."""
        axes = [axis for axis, n in enumerate(self.labels.shape) if n > 1]
        return any(bool(np.take(self.labels, end, axis=axis).any()) for axis in axes for end in (0, -1))

    def plot(self, **options: Any) -> Any:
        """Show the result in a notebook or a window, or write a picture or a page; options as of `accelsurf.show`."""
        # By its public name: this module does not know the viewer, and loads it for those who ask for pictures only.
        import accelsurf

        return accelsurf.show(self, **options)

    @cached_property
    def quality(self) -> Quality:
        """What tells, without a reference, whether to trust the result."""
        return assess(self.labels, self.image, self.geometry.spacing, self.history, self.stop, self.learned)

    @property
    def report(self) -> dict[str, Any]:
        """The run as the JSON report has it, without files."""
        # By its public name: what is told of a result lies above it.
        import accelsurf

        described: dict[str, Any] = accelsurf.report_of(self)
        return described


def segment(
    volume: Volume | NDArray[Any],
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: Callable[[StepRecord], bool | None] | None = None,
    **options: Any,
) -> Result:
    """Segment one object.

    Parameters
    ----------
    volume : Volume or ndarray (nz, ny, nx)
        The image; never modified. From `accelsurf.read`, or an array with ``spacing``.
    spacing : float or (hz, hy, hx), optional
        mm, for an array only; 1 by default.
    channels : sequence of Volume or ndarray, optional
        Further channels of the image, on the same grid.
    config : RunConfig, optional
        Settings; the defaults otherwise.
    energy : str or Energy or callable, optional
        A name, over that of ``config``; or an energy of your own (`accelsurf.energies.Energy`); or a class or function
        that makes one of ``(image, spacing)``: the image as the named energies see it (`Result.image`) and
        (hz, hy, hx) in mm. Settings of the named energies, such as ``smoothness``, are then refused.
    on_step : callable, optional
        Called with each `StepRecord`; a true return value ends the run with the reason ``interrupted``.
    **options
        Settings by name, over those of ``config``: ``start="ball:x,y,z,r"``, ``flow="gradient"``, ...

    Returns
    -------
    Result

    Raises
    ------
    UsageError
        When an option is unknown or out of bounds, a start cannot be parsed, or an energy lacks something.
    InputError
        When the image has NaN or infinite voxels or is constant, the start is outside, empty or full, or an energy of
        your own returns something else than numbers of the right shape.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = (x**2 + y**2 + z**2 < 8**2) * 100.0
    >>> result = segment(image, start="ball:9,9,9,4vox", max_steps=200)
    >>> result.stop.reason, result.components, bool((result.labels == (image > 50)).mean() > 0.99)
    ('converged', 1, True)
    """
    first = as_volume(volume, spacing)
    run = Run(first, *resolved(config, energy, options), [as_channel(one, first) for one in channels])
    with run.workers:
        for step in run:
            if on_step is not None and on_step(step.row):
                run.evolution.ask_to_stop()
    return result_of(run)


def evolve(
    volume: Volume | NDArray[Any],
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    **options: Any,
) -> Iterator[Step]:
    """Run as `segment` does, yielding each step; leave the loop to end the run.

    Parameters
    ----------
    volume, spacing, channels, config, energy, **options
        As for `segment`.

    Yields
    ------
    Step
        ``step.row`` is the line of the trace; ``step.surface`` the surface now (``.psi``, ``.labels``): copy what is
        to be kept, the next step moves it. While ``step.row.level`` is above 0 it lies on a coarser grid than the
        image; with ``levels=1`` it never does.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = (x**2 + y**2 + z**2 < 8**2) * 100.0
    >>> for step in evolve(image, start="ball:9,9,9,4vox"):
    ...     if step.row.volume_mm3 > 1000:
    ...         break
    >>> step.surface.labels.shape
    (24, 24, 24)
    """
    first = as_volume(volume, spacing)
    run = Run(first, *resolved(config, energy, options), [as_channel(one, first) for one in channels])
    with run.workers:
        yield from run


def as_volume(volume: Volume | NDArray[Any], spacing: float | tuple[float, float, float] | None) -> Volume:
    if isinstance(volume, Volume):
        if spacing is not None:
            raise InputError("spacing given together with a Volume, which has its own", "leave spacing out")
        return volume
    return Volume.from_array(volume, 1.0 if spacing is None else spacing)


def as_channel(volume: Volume | NDArray[Any], first: Volume) -> Volume:
    if isinstance(volume, Volume):
        return volume
    array = np.asarray(volume)
    return Volume(array[np.newaxis] if array.ndim == 2 else array, first.geometry)


def resolved(
    config: RunConfig | None, energy: EnergyLike | None, options: dict[str, Any]
) -> tuple[RunConfig, EnergyLike | None]:
    """The configuration, and the energy if it is not one with a name."""
    if isinstance(energy, str):
        options, energy = {**options, "energy": energy}, None
    return (config or RunConfig()).replace(**options) if options else config or RunConfig(), energy


def result_of(run: Run) -> Result:
    """Return what a run left, or has reached between two steps: then with the reason ``interrupted``.

    The history is a copy; ``psi`` may be a view of the surface, which goes on if the run does.
    """
    stop, history = run.stop, list(run.evolution.history)
    if stop is None:
        row = run.look().row
        history.append(row)
        stop = Stop("interrupted", row.step, row.t, f"looked at after {row.step} steps")
    missed = run.config.edit[run.edits_done :]
    prepared = run.prepared
    psi = prepared.finished(run.evolution.surface.psi)
    return Result(
        labels=(psi < 0).view(np.uint8),
        psi=psi,
        image=prepared.shown(),
        geometry=run.volume.geometry,
        config=run.config,
        energy=run.energy_name,
        history=history,
        stop=stop,
        levels=run.evolution.level_summaries,
        seconds={"start": run.start_seconds, "evolve": time.perf_counter() - run.began},
        volume=run.volume,
        start=prepared.start,
        resolved_settings=resolved_settings_of(prepared, run.config, len(run.evolution.level_summaries)),
        learned=prepared.learned,
        terms=run.terms,
        kernels=dict(run.workers.seconds),
        edits_done=run.edits_done,
        warnings=run.evolution.warnings
        + [
            f"{key} was given, but means nothing to flow {run.config.flow} with energy {run.energy_name}"
            for key in run.config.unused()
        ]
        + [f"edit at step {edit.step} was not made: the run ended after {stop.steps} steps" for edit in missed],
    )


def resolved_settings_of(prepared: PreprocessedInput, config: RunConfig, levels: int) -> dict[str, Any]:
    """Return what a run on so many levels took for settings that image and grid decide."""
    diffusion = config.diffusion
    if diffusion == "auto":
        diffusion = "free" if config.flow in ("constant-density", "flowable-mass") else 0.0
    rule = stop_rule(config, levels)
    return {
        "presmooth_mm": prepared.presmooth,
        "scale": [{"at_0": low, "at_1": low + width} for low, width in prepared.context.scales],
        "step_voxels": config.cfl,
        "limiter_percentile": config.percentile,
        "diffusion": diffusion,
        "stop": {"voxels": rule.motion, "steps": rule.window},
        "half_width_voxels": half_width(config),
        "levels": levels,
    }
