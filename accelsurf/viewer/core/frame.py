"""Frame: the drawn part of one step, copied, so that the solver can continue while it is drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.clicks import on_image
from accelsurf.evolution import StepFields, StepRecord
from accelsurf.grid import pyramid
from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import Box, bounding_box, box_at, corner_of, placed_at, widened
from accelsurf.output import ClickMark, marks_of

if TYPE_CHECKING:
    from accelsurf.flows import Flow
    from accelsurf.levelset import LevelSet
    from accelsurf.measure import Interval
    from accelsurf.run import Result, Run, SegmentedObject

#: Quantities that can colour the surface; ``plain`` is one colour.
COLORS = ("plain", "speed", "force", "density")
#: Voxels of the largest image in which intervals are measured, in some tenths of a second: of larger ones
#: they are in the report alone.
MAX_MEASURED = 1 << 21

Index = tuple[int, int, int]


class ObjectState(NamedTuple):
    """State of an object for a frame.

    Attributes
    ----------
    id : int
        Its label.
    record : StepRecord
        Of the step.
    surface : LevelSet
        On a grid of its own, a box of the level's grid.
    corner : (int, int, int)
        Index (z, y, x) on the level's grid of the first voxel of the surface's grid.
    fields : StepFields or None
        Of the last step; None before the first step on this grid.
    flow : Flow or None
        Moves the surface; a density is shown if the flow has one.
    """

    id: int
    record: StepRecord
    surface: LevelSet
    corner: Index
    fields: StepFields | None = None
    flow: Flow | None = None


class BandQuantity(NamedTuple):
    """A quantity on the band: ``cells`` (n,), raveled on the surface's grid, in raster order; ``values`` (n,)."""

    cells: NDArray[np.int64]
    values: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SurfaceFrame:
    """Drawn state of one object.

    Attributes
    ----------
    id : int
        The object's label.
    record : StepRecord
        Of the step.
    level : Level
        The grid that the step was made on, that of the region of interest or a coarser one.
    psi : ndarray, float32
        psi, mm, negative inside, in a box around the band; of shape (0, 0, 0) when there is no surface.
    offset : (int, int, int)
        Index (z, y, x) on ``level`` of the first voxel of ``psi``.
    stride : int
        Voxels of ``level`` from one voxel of ``psi`` to the next, along each axis of more than one voxel.
    corner, shape : (int, int, int)
        First voxel, an index (z, y, x) on ``level``, and size of the surface's grid, on which the cells of
        ``quantities`` are raveled.
    quantities : mapping of str to BandQuantity
        Quantities that can colour it besides ``plain``: ``speed`` (mm per unit of flow time) and ``force``
        along the *outward* normal, so that above 0 the surface grows, as the last step on this level had them;
        ``density`` for a flow that has one. Empty before the first step.
    first : (int, int, int)
        Index (z, y, x) in the image of the first voxel of the region of interest.
    """

    id: int
    record: StepRecord
    level: pyramid.Level
    psi: NDArray[np.float32]
    offset: Index
    stride: int
    corner: Index
    shape: Index
    quantities: Mapping[str, BandQuantity] = field(default_factory=dict)
    first: Index = (0, 0, 0)

    @classmethod
    def of(
        cls, state: ObjectState, level: pyramid.Level, max_voxels: int | None, first: Index
    ) -> SurfaceFrame:
        """Copy the drawn part of an object; parameters as of `Frame.of`."""
        surface, corner = state.surface, state.corner
        made = cls(
            state.id,
            state.record,
            level,
            np.zeros((0, 0, 0), np.float32),
            corner,
            1,
            corner,
            surface.shape,
            _quantities(state),
            first,
        )
        box = _band_box(surface)
        if box is None:
            return made
        made = made._shown(surface.psi, box)
        made = made if max_voxels is None else made.coarser(max_voxels)
        return replace(made, psi=made.psi.copy())

    @classmethod
    def of_result(cls, segmented: SegmentedObject, level: pyramid.Level) -> SurfaceFrame:
        """Copy the drawn part of an object of a result; ``level`` is the image's grid."""
        corner, nothing = corner_of(segmented.box), np.zeros((0, 0, 0), np.float32)
        shape, record = segmented.psi.shape, segmented.history[-1]
        made = cls(segmented.id, record, level, nothing, corner, 1, corner, shape)
        inside = segmented.psi < 0
        box = bounding_box(inside, 2)
        if box is None or inside.all():
            return made
        made = made._shown(segmented.psi, box)
        return replace(made, psi=made.psi.copy())

    def _shown(self, psi: NDArray[np.float32], box: Box) -> SurfaceFrame:
        """Return the same with a box of the surface's grid, a view of all of its psi."""
        return replace(self, psi=psi[box], offset=corner_of(placed_at(box, self.corner)))

    @property
    def has_surface(self) -> bool:
        """True if there is something to draw."""
        return self.psi.size > 0

    def coarser(self, max_voxels: int) -> SurfaceFrame:
        """Return the same with psi at every second voxel along each axis, or third, ..., so that it has at most
        ``max_voxels`` voxels; itself where it has no more.
        """
        step = 1
        while math.prod(-(-n // step) for n in self.psi.shape) > max_voxels:
            step += 1
        if step == 1:
            return self
        part = slice(None, None, step)
        return replace(
            self, psi=np.ascontiguousarray(self.psi[part, part, part]), stride=self.stride * step
        )

    def to_image(self, places: ArrayLike) -> Floats:
        """Return indices of the image's voxels, (..., 3), of (continuous) indices (z, y, x) of ``psi``."""
        on_level = np.asarray(self.offset) + self.stride * np.asarray(places, float)
        return np.asarray(
            on_level * self.level.factors + np.asarray(self.level.first) + np.asarray(self.first)
        )

    def from_image(self, indices: ArrayLike) -> Floats:
        """The inverse of `to_image`."""
        factors = np.array(self.level.factors, float)
        on_level = (
            np.asarray(indices, float) - np.asarray(self.first) - np.asarray(self.level.first)
        ) / factors
        return np.asarray((on_level - np.asarray(self.offset)) / self.stride)

    def middle(self) -> Floats:
        """Index (z, y, x) in the image of the centroid of the object; of the box's centre if no voxel is inside."""
        inside = self.psi < 0
        if not inside.any():
            return self.to_image(0.5 * (np.array(self.psi.shape) - 1.0))
        counts = [
            inside.sum(axis=tuple(other for other in range(3) if other != axis))
            for axis in range(3)
        ]
        return self.to_image([np.average(np.arange(len(c)), weights=c) for c in counts])

    def contains(self, index: ArrayLike) -> bool:
        """Return True if the voxel of the image at this index (z, y, x) is inside."""
        place = np.rint(self.from_image(index)).astype(int)
        is_there = (place >= 0).all() and (place < self.psi.shape).all()
        return bool(is_there and self.psi[tuple(place)] < 0)

    def inside(self, box: Box) -> NDArray[np.bool_]:
        """Return the mask of the voxels inside, of a box of the image with the steps of its slices."""
        ranges = [np.arange(side.start, side.stop, side.step or 1) for side in box]
        axes = [
            np.rint(self.from_image(np.stack([at] * 3, -1))[:, axis]).astype(int)
            for axis, at in enumerate(ranges)
        ]
        valid = [(at >= 0) & (at < n) for at, n in zip(axes, self.psi.shape, strict=True)]
        inside = np.zeros([len(at) for at in axes], bool)
        here = [at[part] for at, part in zip(axes, valid, strict=True)]
        inside[np.ix_(*valid)] = self.psi[np.ix_(*here)] < 0
        return inside

    @property
    def _stands_for(self) -> int:
        """Voxels of the image that one of psi stands for."""
        return math.prod(self.level.factors) * math.prod(
            self.stride if n > 1 else 1 for n in self.level.shape
        )

    @property
    def voxels(self) -> int:
        """Voxels of the image that the object has, see `overlap`."""
        return self._stands_for * int(np.count_nonzero(self.psi < 0))

    def overlap(self, labels: NDArray[np.bool_]) -> tuple[int, int]:
        """Voxels of the image that the object has in common with ``labels`` (nz, ny, nx), and its voxels.

        A voxel of a coarser level, or of a psi with a stride, counts as all those that it stands for.
        """
        inside = self.psi < 0
        places = [
            np.clip(
                np.rint(self.to_image(np.stack([np.arange(m)] * 3, axis=-1))[:, axis]), 0, n - 1
            ).astype(int)
            for axis, (m, n) in enumerate(zip(self.psi.shape, labels.shape, strict=True))
        ]
        return self._stands_for * int((inside & labels[np.ix_(*places)]).sum()), self.voxels

    def sample(self, name: str, places: ArrayLike) -> NDArray[np.float32]:
        """A quantity at places on the surface.

        Parameters
        ----------
        name : str
            One of ``quantities``.
        places : array_like (m, 3)
            Indices (z, y, x) of ``psi``, each on an edge between two of its voxels, as the corners of an isosurface.

        Returns
        -------
        ndarray (m,), float32
            Linear between the two band cells around each place; 0 where there is neither.
        """
        cells, values = self.quantities[name]
        places = np.asarray(places, float)
        if cells.size == 0:
            return np.zeros(len(places), np.float32)
        last = np.array(self.shape) - 1
        at = np.clip(
            np.asarray(self.offset) - np.asarray(self.corner) + self.stride * places, 0, last
        )
        # A corner of the isosurface lies on an edge: along two axes it is at a voxel, but for rounding.
        low = np.floor(at + 1e-4).astype(np.int64)
        high = np.minimum(np.ceil(at - 1e-4).astype(np.int64), last)
        share = np.clip((at - low).max(axis=1), 0.0, 1.0).astype(np.float32)
        total, weights = np.zeros(len(at), np.float32), np.zeros(len(at), np.float32)
        for end, weight in ((low, 1.0 - share), (high, share)):
            raveled = np.ravel_multi_index((end[:, 0], end[:, 1], end[:, 2]), self.shape)
            slot = np.minimum(np.searchsorted(cells, raveled), cells.size - 1)
            weight = np.where(cells[slot] == raveled, weight + np.float32(1e-6), np.float32(0.0))
            total += weight * values[slot]
            weights += weight
        return np.divide(total, weights, out=np.zeros_like(total), where=weights > 0)


class VolumeEstimate(NamedTuple):
    """Best estimate of a volume, and the interval around it; None where its error cannot be told."""

    best_mm3: float
    interval_mm3: Interval | None


@dataclass(frozen=True, eq=False)
class Frame:
    """Drawn state of one step; it does not change when the run continues.

    Attributes
    ----------
    surfaces : tuple of SurfaceFrame
        One for each object, in order of ids; at least one of a run, perhaps none of a frame of a sequence.
    clicks : tuple of ClickMark
        Clicks of a person, on the image's grid.
    predicted : tuple of SurfaceFrame
        Where tracked objects were expected before they were corrected.
    paths : tuple of ndarray (n, 3)
        World mm, the way that each tracked object has come; by ``surfaces``.
    said : str
        Frame and time of a sequence, in place of the step; empty of a run.
    corrected_at : int or None
        The step with which the run ended, after which the surfaces were corrected; None where they were not.
    estimated : VolumeEstimate or None
        The volume of one object, once its run has ended and before it is corrected.
    """

    surfaces: tuple[SurfaceFrame, ...]
    clicks: tuple[ClickMark, ...] = ()
    predicted: tuple[SurfaceFrame, ...] = ()
    paths: tuple[Floats, ...] = ()
    said: str = ""
    corrected_at: int | None = None
    estimated: VolumeEstimate | None = None

    @classmethod
    def of(
        cls,
        states: Iterable[ObjectState],
        level: pyramid.Level,
        max_voxels: int | None = None,
        first: Index = (0, 0, 0),
    ) -> Frame:
        """The frame of the present state of some objects; call it between two steps.

        Costs O(band) and a copy of the box around it for each object, and changes nothing.

        Parameters
        ----------
        states : iterable of ObjectState
            At least one, in order of ids.
        level : Level
            The grid that they are on.
        max_voxels : int, optional
            If an object's box has more voxels, psi is taken at every second one along each axis, or third, ...:
            pictures of a large volume while it runs. Parts thinner than that may be missing from them.
        first : (int, int, int), optional
            Index (z, y, x) in the image of the first voxel of the grid's region of interest.
        """
        return cls(tuple(SurfaceFrame.of(state, level, max_voxels, first) for state in states))

    @classmethod
    def of_run(
        cls, run: Run, records: Sequence[StepRecord] = (), max_voxels: int | None = None
    ) -> Frame:
        """The frame of the present state of a run.

        Parameters
        ----------
        run : Run
            Between two steps.
        records : sequence of StepRecord, optional
            One of each object; the record of its last step unless given.
        max_voxels : int, optional
            As for `of`.

        Examples
        --------
        >>> from accelsurf import Volume
        >>> from accelsurf.run.run import Run
        >>> from accelsurf.settings.run_config import RunConfig
        >>> image = np.zeros((24, 24, 24))
        >>> image[6:18, 6:18, 6:18] = 1
        >>> with Run(Volume.from_array(image), RunConfig(start="ball:11,11,11,4", max_steps=2, threads=1)) as run:
        ...     for step in run:
        ...         frame = Frame.of_run(run)
        >>> surface = frame.surfaces[0]
        >>> frame.step, surface.psi.shape, sorted(surface.quantities)
        (2, (18, 18, 18), ['force', 'speed'])
        """
        records = records or [evolving.evolution.history[-1] for evolving in run.objects]
        states = (
            ObjectState(
                evolving.id,
                record,
                evolving.surface,
                evolving.corner,
                evolving.evolution.state.fields,
                evolving.flow,
            )
            for evolving, record in zip(run.objects, records, strict=True)
        )
        made = cls.of(states, run.grid, max_voxels, run.prepared.first)
        clicks = on_image(run.prepared.clicks, run.prepared.first, run.volume.geometry.shape)
        return (
            made
            if clicks is None
            else replace(made, clicks=marks_of(clicks.clicks, run.geometry.spacing))
        )

    @classmethod
    def of_result(cls, result: Result) -> Frame:
        """The frame of the final state of a run that has ended."""
        level = pyramid.levels(result.geometry.shape, result.geometry.spacing, 1)[0]
        clicks = (
            () if result.clicks is None else marks_of(result.clicks.clicks, result.geometry.spacing)
        )
        return cls(
            tuple(SurfaceFrame.of_result(segmented, level) for segmented in result.objects), clicks
        )

    @property
    def step(self) -> int:
        """Number of the run's step; of several objects, that of those that moved longest. Corrections make none."""
        made = (surface.record.step for surface in self.surfaces)
        return max(made, default=0) if self.corrected_at is None else self.corrected_at

    @property
    def level(self) -> int:
        """Number of the level that the step was made on; 0 is the finest."""
        return self.surfaces[0].level.number if self.surfaces else 0

    @property
    def volume_mm3(self) -> float:
        """Volume of all objects, mm3."""
        return sum(surface.record.volume_mm3 for surface in self.surfaces)

    @property
    def has_surface(self) -> bool:
        """True if there is something to draw."""
        return any(surface.has_surface for surface in self.surfaces)

    def middle(self) -> Floats:
        """Index (z, y, x) in the image of the centroid of the first object that has a surface."""
        return next((s for s in self.surfaces if s.has_surface), self.surfaces[0]).middle()

    def dice(self, labels: NDArray[np.bool_], voxels: int) -> float:
        """Dice of all objects and ``labels`` (nz, ny, nx) on the image's grid, ``voxels`` of which are true."""
        parts = [surface.overlap(labels) for surface in self.surfaces]
        total = sum(voxels_of for _, voxels_of in parts) + voxels
        return 2.0 * sum(common for common, _ in parts) / total if total else 1.0


def volume_estimate(result: Result) -> VolumeEstimate | None:
    """Return the estimate of the volume of a result; None for several objects, without an edge, of a large image."""
    intervals = result.intervals if result.image.size <= MAX_MEASURED else None
    if intervals is None:
        return None
    return VolumeEstimate(result.estimates.volume_mm3, intervals.volume_mm3)


def histories_of_run(
    run: Run, present: Sequence[StepRecord] = ()
) -> tuple[tuple[StepRecord, ...], ...]:
    """Return the records so far of each object of a run, as copies.

    Parameters
    ----------
    run : Run
    present : sequence of StepRecord, optional
        A record of each object as it is now, added to the history of those that have not ended.
    """
    histories = [tuple(evolving.evolution.history) for evolving in run.objects]
    if not present:
        return tuple(histories)
    return tuple(
        history if evolving.stop is not None else (*history, record)
        for evolving, history, record in zip(run.objects, histories, present, strict=True)
    )


def _quantities(state: ObjectState) -> dict[str, BandQuantity]:
    """Copies of the quantities that can colour the surface."""
    # Not with the module: frames are known before the solver is loaded, which who has a state has done.
    from accelsurf.flows import FlowableMass

    quantities = {}
    fields = state.fields
    flow = state.flow
    if fields is not None:
        quantities["speed"] = BandQuantity(fields.cells, -fields.speed)
        quantities["force"] = BandQuantity(fields.cells, -np.asarray(fields.force, np.float32))
    # Between two grids the flow's density may still be that of the other band.
    if isinstance(flow, FlowableMass) and flow.density.size == state.surface.size:
        quantities["density"] = BandQuantity(state.surface.band.cells, flow.density.copy())
    return quantities


def _band_box(surface: LevelSet) -> Box | None:
    """Return the box of the band, and a voxel around it; None without a surface."""
    cells = surface.band.cells
    if cells.size == 0:
        return None
    index = np.stack(np.unravel_index(cells, surface.shape))
    low, high = index.min(axis=1).tolist(), index.max(axis=1).tolist()
    sides = [last - first + 1 for first, last in zip(low, high, strict=True)]
    return widened(box_at(low, sides), surface.shape, (1, 1, 1))
