"""segment_objects(): several objects of one image at once, each with its own surface, none inside of another."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.analysis.surface_mesh import Surface
from accelsurf.errors import UsageError
from accelsurf.evolution.loop import StepRecord, Stop
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.initialization import object_starts
from accelsurf.io.channels import read_further
from accelsurf.segmentation.api import Result, as_channel, as_volume, resolved, resolved_settings_of
from accelsurf.segmentation.objects import Objects
from accelsurf.segmentation.preprocessing import PreprocessedInput, cropped
from accelsurf.segmentation.run import available_cores, seeded
from accelsurf.settings.run_config import RunConfig

#: Reasons that are told of the whole run if they are any object's, the worst first.
WORST = ("interrupted", "diverged", "leaked", "stalled", "max-steps", "filled")
#: Voxels around an object's grid in what is kept of it.
AROUND = 2
#: Columns of the history that are summed over objects, and those of which the largest is told.
SUMMED = (
    "potential", "kinetic", "mass_potential", "friction_work", "smoothing_work", "noise_work", "mass", "volume_mm3",
    "area_mm2", "band_cells", "cells_visited", "seconds",
)
LARGEST = ("mass_correction", "clamped_fraction", "motion_voxels", "limited_fraction")


@dataclass(frozen=True, eq=False)
class ObjectsResult:
    """What a run of several objects left.

    Attributes
    ----------
    labels : ndarray (nz, ny, nx), uint8, uint16 or uint32
        The id of the object that a voxel's centre is inside of, 0 of none.
    objects : dict of int to Result
        By id, in order: each object on its own part of the grid (``result.geometry``), as `accelsurf.segment` gives it.
    boxes : dict of int to tuple of slice
        Which part of the whole grid that is.
    image : ndarray (nz, ny, nx), float32
        As energies saw it.
    geometry : Geometry
    config : RunConfig
    energy : str
    volume : Volume
        The input.
    seconds, kernels : dict of str to float
        Wall time of the parts ``start`` and ``evolve``; seconds in each kernel, over all threads.
    warnings : list of str
    terms : list of dict
        The terms of the energy with their settings; "by object" where objects have learned others.
    resolved_settings : dict
        What was taken for settings that image and grid decide.
    """

    labels: NDArray[np.unsignedinteger[Any]]
    objects: dict[int, Result]
    boxes: dict[int, Box]
    image: NDArray[np.float32]
    geometry: Geometry
    config: RunConfig
    energy: str
    volume: Volume
    seconds: dict[str, float]
    kernels: dict[str, float]
    warnings: list[str] = field(default_factory=list)
    terms: list[dict[str, Any]] = field(default_factory=list)
    start: NDArray[np.float32] | None = None
    resolved_settings: dict[str, Any] = field(default_factory=dict)
    #: Several objects run on the image's own grid, and each has its own quality.
    levels: ClassVar[list[LevelSummary]] = []
    quality: ClassVar[None] = None
    edits_done: ClassVar[int] = 0

    @cached_property
    def stop(self) -> Stop:
        """How they ended: ``converged`` if all that are left did, ``vanished`` if none is left, else the worst."""
        counts: Counter[str] = Counter(one.stop.reason for one in self.objects.values())
        worst = next((reason for reason in WORST if counts[reason]), None)
        left = "converged" if counts["converged"] else "vanished"
        message = ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items()))
        steps = max(one.stop.steps for one in self.objects.values())
        longest = max(one.stop.time for one in self.objects.values())
        return Stop(worst or left, steps, longest, f"of {len(self.objects)} objects {message}")  # type: ignore[arg-type]

    @cached_property
    def history(self) -> list[StepRecord]:
        """Energies, mass, volume and area of all objects together by step, those that have stopped as they are.

        Of `LARGEST` it is the largest value of any; the other columns are those of the first object.
        """
        histories = [one.history for one in self.objects.values() if one.history]
        rows = []
        for step in range(max(map(len, histories))):
            now = [rows[min(step, len(rows) - 1)] for rows in histories]
            sums = {key: sum(getattr(row, key) for row in now) for key in SUMMED}
            most = {key: max((getattr(row, key) for row in now), key=abs) for key in LARGEST}
            rows.append(now[0]._replace(step=step, restarted=False, **sums, **most))
        return rows

    @cached_property
    def psi(self) -> NDArray[np.float32]:
        """The smallest psi of all objects, mm, negative inside of any; a constant away from all."""
        far = max(float(np.abs(one.psi).max()) for one in self.objects.values())
        out = np.full(self.geometry.shape, far, np.float32)
        for own, one in self.objects.items():
            np.minimum(out[self.boxes[own]], one.psi, out=out[self.boxes[own]])
        return out

    @cached_property
    def surface(self) -> Surface | None:
        """All meshes as one; None when all objects have vanished."""
        meshes = [one.surface for one in self.objects.values() if one.labels.any()]
        if not meshes:
            return None
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
        return Surface(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))

    @property
    def volume_mm3(self) -> float:
        """Volume of all objects, mm3."""
        return sum(one.volume_mm3 for one in self.objects.values())

    @property
    def area_mm2(self) -> float:
        """Area of their surfaces, mm2; where two touch, it counts for both."""
        return sum(one.area_mm2 for one in self.objects.values())

    @property
    def enclosed_mm2(self) -> float | None:
        """Area of all objects in an image of one slice, mm2; None for a volume."""
        flat = self.geometry.slice_axis is not None
        return sum(one.enclosed_mm2 or 0.0 for one in self.objects.values()) if flat else None

    @property
    def length_mm(self) -> float | None:
        """Length of all contours in an image of one slice, mm; None for a volume."""
        flat = self.geometry.slice_axis is not None
        return sum(one.length_mm or 0.0 for one in self.objects.values()) if flat else None

    @property
    def components(self) -> int:
        """Number of 6-connected parts of all objects."""
        return sum(one.components for one in self.objects.values())

    @property
    def touches_border(self) -> bool:
        """Whether any object lies on the volume's border."""
        return any(one.touches_border for one in self.objects.values())

    def labels_volume(self) -> Volume:
        """The labels on the input's grid with its header."""
        return self.volume.with_array(self.labels)

    @property
    def report(self) -> dict[str, Any]:
        """The run as the JSON report has it, without files."""
        # By its public name: what is told of a result lies above it.
        import accelsurf

        described: dict[str, Any] = accelsurf.report_of(self)
        return described


def segment_objects(
    volume: Volume | NDArray[Any],
    objects: str | Volume | NDArray[Any] | None = None,
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    on_step: Callable[[StepRecord, int], bool | None] | None = None,
    **options: Any,
) -> ObjectsResult:
    """Segment several objects that do not overlap.

    Parameters
    ----------
    volume : Volume or ndarray (nz, ny, nx)
        The image; never modified.
    objects : str, Volume or ndarray, optional
        Their first voxels: a label map, or a file as for ``--objects``. By default that of ``config``.
    spacing : float or (hz, hy, hx), optional
        mm, for an array only; 1 by default.
    channels : sequence of Volume or ndarray, optional
        Further channels of the image, on the same grid.
    config : RunConfig, optional
        Settings of each object; the defaults otherwise. ``max_steps`` and ``max_volume`` count for each by itself.
    on_step : callable, optional
        Called with each `StepRecord` and the id of its object; a true return value ends the run.
    **options
        Settings by name, over those of ``config``.

    Returns
    -------
    ObjectsResult

    Raises
    ------
    UsageError
        When no objects are given, an option is unknown, or an energy lacks something.
    InputError
        As `accelsurf.segment`, and when the starts are no good.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((20, 20, 36)) - np.array([9.5, 9.5, 0])[:, None, None, None]
    >>> image = (z**2 + y**2 + np.minimum(abs(x - 10), abs(x - 25))**2 < 7**2) * 100.0
    >>> starts = np.zeros(image.shape, int)
    >>> starts[8:12, 8:12, 8:12], starts[8:12, 8:12, 24:28] = 3, 700
    >>> result = segment_objects(image, starts)
    >>> {own: one.stop.reason for own, one in result.objects.items()}, result.labels.dtype
    ({3: 'converged', 700: 'converged'}, dtype('uint16'))
    """
    began = time.perf_counter()
    first = as_volume(volume, spacing)
    if isinstance(objects, str):
        options, objects = {**options, "objects": objects}, None
    settings = seeded(resolved(config, None, options)[0])
    given = settings.objects if objects is None else objects
    if given is None:
        raise UsageError("objects: nothing was given, expected a label map or a table of balls", "or use segment")
    starts = object_starts.read(given, first.geometry, AROUND)
    union = np.full(first.geometry.shape, np.float32(0.5 * min(first.geometry.steps)), np.float32)
    for one in starts:
        box = tuple(slice(c, c + n) for c, n in zip(one.corner, one.psi.shape, strict=True))
        np.minimum(union[box], one.psi, out=union[box])
    more = [*(as_channel(one, first) for one in channels), *read_further(settings.channel)]
    prepared = PreprocessedInput(first, more, settings, union)
    del union, prepared.psi
    threads = available_cores() if settings.threads == "auto" else settings.threads
    with Objects(starts, prepared, settings, threads) as run:
        ready = time.perf_counter()
        for own, row in run:
            if on_step is not None and on_step(row, own):
                run.ask_to_stop()
        seconds = {"start": ready - began, "evolve": time.perf_counter() - ready}
        return _result(run, prepared, first, settings, seconds)


def _result(
    run: Objects, prepared: PreprocessedInput, volume: Volume, config: RunConfig, seconds: dict[str, float]
) -> ObjectsResult:
    """Put together what the objects left."""
    image, geometry = prepared.shown(), volume.geometry
    labels = np.zeros(geometry.shape, io.label_type(max(one.id for one in run.objects)))
    objects, boxes = {}, {}
    for one, psi in zip(run.objects, run.apart(), strict=True):
        corner = [c + s.start for c, s in zip(one.corner, prepared.box, strict=True)]
        low = [max(c - AROUND, 0) for c in corner]
        high = [min(c + n + AROUND, m) for c, n, m in zip(corner, psi.shape, geometry.shape, strict=True)]
        # What the region of interest cuts ends half a voxel beyond it.
        before = [(c - a, b - c - n) for a, b, c, n in zip(low, high, corner, psi.shape, strict=True)]
        around = np.abs(np.pad(psi, before, mode="edge"))
        around[tuple(slice(k, k + n) for (k, _), n in zip(before, psi.shape, strict=True))] = psi
        z, y, x = (slice(a, b) for a, b in zip(low, high, strict=True))
        boxes[one.id] = box = (z, y, x)
        part = cropped(geometry, box)
        inside = around < 0
        labels[box][inside] = one.id
        objects[one.id] = Result(
            labels=inside.astype(np.uint8),
            psi=around,
            image=image[box],
            geometry=part,
            config=config,
            energy=config.energy,
            history=one.history,
            stop=one.stop,
            seconds={},
            volume=Volume(volume.array[box], part),
            terms=one.context.terms,
            learned=prepared.learned_by(one.context),
        )
    terms = common([one.terms for one in objects.values()])
    unused = [
        f"{key} was given, but means nothing to flow {config.flow} with energy {config.energy}"
        for key in config.unused()
    ]
    return ObjectsResult(
        labels, objects, boxes, image, geometry, config, config.energy, volume, seconds, run.kernels, unused, terms,
        prepared.start, resolved_settings_of(prepared, config, 1),
    )


def common(terms: Sequence[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """The terms of all objects; "by object" for what is not the same.

    Examples
    --------
    >>> common([[{"name": "threshold", "LO": 3}], [{"name": "threshold", "LO": 4}]])
    [{'name': 'threshold', 'LO': 'by object'}]
    """
    return [
        {key: value if all(one[key] == value for one in same) else "by object" for key, value in same[0].items()}
        for same in zip(*terms, strict=True)
    ]
