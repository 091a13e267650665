"""segment(): from an image and a rough start to labels, a mesh and the story of the run."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import contours, expression, pyramid, report
from accelsurf.channels import chosen as read_channels
from accelsurf.coarse_to_fine import CoarseToFine, Passed
from accelsurf.config import RunConfig
from accelsurf.contours import Contours
from accelsurf.energies import Energy
from accelsurf.errors import InputError, UsageError
from accelsurf.evolution import Restart, Row, Step, Stop
from accelsurf.flows import Limits
from accelsurf.geometry import Geometry
from accelsurf.levelset import Workers
from accelsurf.preparation import SCALE_PERCENTILES, Prepared, presmoothed, scale
from accelsurf.quality import Quality, assess
from accelsurf.surface import Surface, extract
from accelsurf.systems import half_width, is_maker, make_energy, make_flow, own_energy, stop_rule
from accelsurf.volume import Volume

__all__ = ["SCALE_PERCENTILES", "Result", "Run", "evolve", "presmoothed", "scale", "segment"]

#: What `segment` takes for an energy: a name, an energy, or what makes one of the image, (nz, ny, nx) float32 as in
#: `Result.image`, and the spacing, (hz, hy, hx) mm.
EnergyLike = str | Energy | Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]


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
        The image as the energy saw it: presmoothed, 0 and 1 at its `SCALE_PERCENTILES`.
    geometry : Geometry
    config : RunConfig
    energy : str
        Name of the energy: that of ``config``, or ``custom: ClassName``.
    ledger : list of Row
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
    terms : list of dict
        The terms of the energy with every setting as it was in the run; empty for an energy of one's own.
    chosen : dict
        What the run took for settings that image and grid decide: see `report.describe_result`.
    learned : (float, float) or None
        Values, on the scale of ``image``, between which those of the object should lie by what it was learned from.
    """

    labels: NDArray[np.uint8]
    psi: NDArray[np.float32]
    image: NDArray[np.float32]
    geometry: Geometry
    config: RunConfig
    energy: str
    ledger: list[Row]
    stop: Stop
    seconds: dict[str, float]
    volume: Volume
    levels: list[Passed] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    start: NDArray[np.float32] | None = None
    kernels: dict[str, float] = field(default_factory=dict)
    terms: list[dict[str, Any]] = field(default_factory=list)
    chosen: dict[str, Any] = field(default_factory=dict)
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
        return self.ledger[-1].volume_mm3

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

    @cached_property
    def quality(self) -> Quality:
        """What tells, without a reference, whether to trust the result."""
        return assess(self.labels, self.image, self.geometry.spacing, self.ledger, self.stop, self.learned)

    @property
    def report(self) -> dict[str, Any]:
        """The run as the JSON report has it, without files."""
        interrupted = self.stop.reason == "interrupted"
        return report.build(
            status="interrupted" if interrupted else "ok",
            exit_code=130 if interrupted else 0,
            config=self.config,
            result=self,
        )


def segment(
    volume: Volume | NDArray[Any],
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: Callable[[Row], bool | None] | None = None,
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
        Called with each `Row`; a true return value ends the run with the reason ``interrupted``.
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
    first = _as_volume(volume, spacing)
    run = Run(first, *_resolved(config, energy, options), [_as_channel(one, first) for one in channels])
    with run.workers:
        for step in run:
            if on_step is not None and on_step(step.row):
                run.evolution.ask_to_stop()
    return run.result()


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
    first = _as_volume(volume, spacing)
    run = Run(first, *_resolved(config, energy, options), [_as_channel(one, first) for one in channels])
    with run.workers:
        yield from run


def _as_volume(volume: Volume | NDArray[Any], spacing: float | tuple[float, float, float] | None) -> Volume:
    if isinstance(volume, Volume):
        if spacing is not None:
            raise InputError("spacing given together with a Volume, which has its own", "leave spacing out")
        return volume
    return Volume.from_array(volume, 1.0 if spacing is None else spacing)


def _as_channel(volume: Volume | NDArray[Any], first: Volume) -> Volume:
    if isinstance(volume, Volume):
        return volume
    array = np.asarray(volume)
    return Volume(array[np.newaxis] if array.ndim == 2 else array, first.geometry)


def _resolved(
    config: RunConfig | None, energy: EnergyLike | None, options: dict[str, Any]
) -> tuple[RunConfig, EnergyLike | None]:
    """The configuration, and the energy if it is not one with a name."""
    if isinstance(energy, str):
        options, energy = {**options, "energy": energy}, None
    return (config or RunConfig()).replace(**options) if options else config or RunConfig(), energy


class Run:
    """A run made ready: image prepared, start built, flow chosen.

    Parameters
    ----------
    volume : Volume
    config : RunConfig
    energy : Energy or callable, optional
        In place of the energy that ``config`` names; see `segment`.
    channels : sequence of Volume, optional
        Further channels, before those that ``config`` names.
    """

    def __init__(
        self,
        volume: Volume,
        config: RunConfig,
        energy: EnergyLike | None = None,
        channels: Sequence[Volume] = (),
    ) -> None:
        began = time.perf_counter()
        if config.noise > 0 and config.seed is None:
            # Drawn once and kept: the report's settings then repeat the run.
            config = config.replace(seed=secrets.randbelow(2**31))
        self.volume, self.config = volume, config
        self._prepared = Prepared(volume, [*channels, *read_channels(config.channel)], config)
        self.leaked = False
        self.workers = Workers(available_cores() if config.threads == "auto" else config.threads)
        psi = self._prepared.psi
        grids = self._grids(psi, energy)
        self.evolution = CoarseToFine(
            grids,
            self._prepared.image,
            psi,
            self._energy_maker(energy, len(grids)),
            make_flow(config),
            Limits(config.cfl, config.percentile),
            config.max_steps,
            Restart() if config.restart == "auto" else None,
            stop_rule(config, len(grids)),
            half_width(config),
            self.workers,
        )
        # The evolution uses its memory up.
        del self._prepared.psi
        self._start_seconds = time.perf_counter() - began
        self.workers.seconds.clear()
        self._began = time.perf_counter()

    def _grids(self, psi: NDArray[np.float32], energy: EnergyLike | None) -> list[pyramid.Level]:
        """The levels that the configuration asks for; see record 0015 for what ``auto`` is."""
        geometry, wanted = self._prepared.geometry, self.config.levels
        shape, spacing = geometry.shape, geometry.spacing
        if wanted == "auto":
            if energy is not None or any(term.name == "geodesic" for term in expression.parse(self.config.energy)):
                return pyramid.levels(shape, spacing, 1)
            grids = pyramid.levels(shape, spacing, fewest=pyramid.AUTO_FEWEST)
            return grids[: pyramid.resolved(grids, psi)]
        grids = pyramid.levels(shape, spacing, wanted)
        if len(grids) < wanted:
            raise UsageError(
                f"levels: {wanted} was given, expected at most {len(grids)} for this image",
                f"the coarsest grid has at least {pyramid.FEWEST} voxels along an axis that is halved",
            )
        return grids

    def _energy_maker(
        self, energy: EnergyLike | None, levels: int
    ) -> Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]:
        """What makes the energy of each level; an energy that is made already is only for one."""
        config = self.config
        self.energy_name: str = config.energy
        prepared = self._prepared
        if energy is None or isinstance(energy, str):
            return lambda image, spacing: prepared.fenced(
                make_energy(config, image, spacing, prepared.facts), image.shape
            )
        if levels > 1 and not is_maker(energy):
            raise UsageError(
                f"levels: {levels} was given, expected 1: the energy has one image, and each level needs its own",
                "give a class or function that makes the energy of (image, spacing), or levels=1",
            )

        def made(image: NDArray[np.float32], spacing: tuple[float, float, float]) -> Energy:
            own = own_energy(energy, config, image, spacing)
            self.energy_name = own.name
            return prepared.fenced(own, image.shape)

        return made

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding each step; ended when the object is larger than it may be."""
        most = self.config.max_volume
        for step in self.evolution:
            if most is not None and step.row.volume_mm3 > most and not self.leaked:
                self.leaked = True
                self.evolution.ask_to_stop()
            yield step

    def _chosen(self) -> dict[str, Any]:
        """What the run took for settings that image and grid decide."""
        config, levels = self.config, len(self.evolution.passed)
        diffusion = config.diffusion
        if diffusion == "auto":
            diffusion = "free" if config.flow in ("constant-density", "flowable-mass") else 0.0
        rule = stop_rule(config, levels)
        return {
            "presmooth_mm": self._prepared.presmooth,
            "scale": [{"at_0": low, "at_1": low + width} for low, width in self._prepared.facts.scales],
            "step_voxels": config.cfl,
            "limiter_percentile": config.percentile,
            "diffusion": diffusion,
            "stop": {"voxels": rule.motion, "steps": rule.window},
            "half_width_voxels": half_width(config),
            "levels": levels,
        }

    def result(self) -> Result:
        """What the run left, once its evolution has stopped."""
        surface, stop = self.evolution.surface, self.evolution.stop
        assert stop is not None
        if self.leaked and stop.reason == "interrupted":
            message = f"the object grew beyond {self.config.max_volume:g} mm3, the largest volume it may have"
            stop = stop._replace(reason="leaked", message=message)
        psi = self._prepared.finished(surface.psi)
        return Result(
            labels=(psi < 0).astype(np.uint8),
            psi=psi,
            image=self._prepared.shown(),
            geometry=self.volume.geometry,
            config=self.config,
            energy=self.energy_name,
            ledger=self.evolution.ledger,
            stop=stop,
            levels=self.evolution.passed,
            seconds={"start": self._start_seconds, "evolve": time.perf_counter() - self._began},
            volume=self.volume,
            start=self._prepared.start,
            chosen=self._chosen(),
            learned=self._prepared.learned,
            terms=[self._prepared.facts.chosen[place] for place in sorted(self._prepared.facts.chosen)],
            kernels=dict(self.workers.seconds),
            warnings=self.evolution.warnings
            + [
                f"{key} was given, but means nothing to flow {self.config.flow} with energy {self.energy_name}"
                for key in self.config.unused()
            ],
        )


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
