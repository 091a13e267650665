"""Frame: what is drawn of one step, copied, so that the solver may go on while somebody draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.evolution.records import Step, StepRecord
from accelsurf.flows import Flow
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import bounding_box, corner_of
from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet

#: What the surface can be coloured by; ``plain`` is one colour.
COLORS = ("plain", "speed", "force", "density")

Floats = NDArray[np.float64]


class OnBand(NamedTuple):
    """A quantity on the band: ``cells`` (n,), raveled on the grid of the level, in raster order; ``values`` (n,)."""

    cells: NDArray[np.int64]
    values: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Frame:
    """What is drawn of one step; nothing in it changes when the run goes on.

    Attributes
    ----------
    row : Row
        The line of the trace; ``row.step`` is the step's number.
    grid : Level
        The grid that the step was made on, the image's own or a coarser one.
    offset : (int, int, int)
        Index (z, y, x) on ``grid`` of the first voxel of ``psi``.
    step : int
        Voxels of ``grid`` from one voxel of ``psi`` to the next, along each axis of more than one voxel.
    psi : ndarray, float32
        psi, mm, negative inside, in a box around the band; of shape (0, 0, 0) when there is no surface.
    quantities : mapping of str to OnBand
        What the surface can be coloured by besides ``plain``: ``speed`` (mm per unit of flow time) and ``force``
        along the *outward* normal, so that above 0 the surface grows, as the last step on this grid had them;
        ``density`` for a flow that has one. Empty before the first step.
    first : (int, int, int)
        Index (z, y, x) in the image of the first voxel of the finest grid: other than 0 where the run sees a region of
        interest only.
    """

    row: StepRecord
    grid: pyramid.Level
    offset: tuple[int, int, int]
    step: int
    psi: NDArray[np.float32]
    quantities: Mapping[str, OnBand] = field(default_factory=dict)
    first: tuple[int, int, int] = (0, 0, 0)

    @classmethod
    def of(
        cls, step: Step, geometry: Geometry, flow: Flow | None = None, most_voxels: int | None = None,
        first: tuple[int, int, int] = (0, 0, 0),
    ) -> Frame:
        """The frame of a step that the loop yielded; call it before the loop goes on.

        Costs O(band) and a copy of the box around it, and changes nothing.

        Parameters
        ----------
        step : Step
        geometry : Geometry
            Of the image, or of the region of interest.
        flow : Flow, optional
            Of the run, for its density.
        most_voxels : int, optional
            If the box has more voxels, psi is taken at every second one along each axis, or third, ...: pictures of a
            large volume while it runs. Parts thinner than that may be missing from them.
        first : (int, int, int), optional
            Index (z, y, x) in the image of the region's first voxel.

        Examples
        --------
        >>> import accelsurf
        >>> image = np.zeros((24, 24, 24))
        >>> image[6:18, 6:18, 6:18] = 1
        >>> volume = accelsurf.Volume.from_array(image)
        >>> for step in accelsurf.evolve(volume, start="ball:11,11,11,4", max_steps=2):
        ...     frame = Frame.of(step, volume.geometry)
        >>> frame.row.step, frame.psi.shape, sorted(frame.quantities)
        (2, (18, 18, 18), ['force', 'speed'])
        """
        surface, row = step.surface, step.row
        grid = pyramid.levels(geometry.shape, geometry.spacing, row.level + 1)[row.level]
        quantities = {}
        if step.step_fields is not None:
            quantities["speed"] = OnBand(step.step_fields.cells, -step.step_fields.speed)
            quantities["force"] = OnBand(step.step_fields.cells, -np.asarray(step.step_fields.force, np.float32))
        density = getattr(flow, "density", None)
        if density is not None and density.size == surface.size:
            quantities["density"] = OnBand(surface.band.cells, density.copy())
        ranges = _box(surface)
        if ranges is None:
            return cls(row, grid, (0, 0, 0), 1, np.zeros((0, 0, 0), np.float32), quantities, first)
        stride = 1
        if most_voxels is not None:
            while math.prod(-(-(b - a) // stride) for a, b in ranges) > most_voxels:
                stride += 1
        psi = surface.psi[tuple(slice(a, b, stride) for a, b in ranges)].copy()
        return cls(row, grid, (ranges[0][0], ranges[1][0], ranges[2][0]), stride, psi, quantities, first)

    @classmethod
    def of_psi(cls, psi: NDArray[np.float32], geometry: Geometry, row: StepRecord) -> Frame:
        """The frame of a run that has ended, of its last ``row`` and psi (nz, ny, nx) on the image's grid."""
        grid = pyramid.levels(geometry.shape, geometry.spacing, 1)[0]
        inside = psi < 0
        box = bounding_box(inside, 2)
        if box is None or inside.all():
            return cls(row, grid, (0, 0, 0), 1, np.zeros((0, 0, 0), np.float32))
        return cls(row, grid, corner_of(box), 1, psi[box].copy())

    @property
    def has_surface(self) -> bool:
        """Whether there is something to draw."""
        return self.psi.size > 0

    def to_image(self, places: ArrayLike) -> Floats:
        """Where (continuous) indices (z, y, x) of ``psi`` lie in the image, as indices of its voxels, (..., 3)."""
        factors = np.array(self.grid.factors, float)
        on_grid = np.asarray(self.offset) + self.step * np.asarray(places, float)
        return np.asarray(on_grid * factors + 0.5 * (factors - 1.0) + np.asarray(self.first))

    def from_image(self, indices: ArrayLike) -> Floats:
        """The inverse of `to_image`."""
        factors = np.array(self.grid.factors, float)
        on_grid = (np.asarray(indices, float) - np.asarray(self.first) - 0.5 * (factors - 1.0)) / factors
        return np.asarray((on_grid - np.asarray(self.offset)) / self.step)

    def middle(self) -> Floats:
        """Index (z, y, x) in the image of the middle of what is inside; where no voxel is, of the box."""
        inside = self.psi < 0
        if not inside.any():
            return self.to_image(0.5 * (np.array(self.psi.shape) - 1.0))
        counts = [inside.sum(axis=tuple(other for other in range(3) if other != axis)) for axis in range(3)]
        return self.to_image([np.average(np.arange(len(c)), weights=c) for c in counts])

    def dice(self, labels: NDArray[np.bool_], voxels: int) -> float:
        """Dice of what is inside and ``labels`` (nz, ny, nx) on the image's grid, ``voxels`` of which are true.

        A frame of a coarser level, or with not all voxels, counts its own, each for those that it stands for.
        """
        inside = self.psi < 0
        places = [
            np.clip(np.rint(self.to_image(np.stack([np.arange(m)] * 3, axis=-1))[:, axis]), 0, n - 1).astype(int)
            for axis, (m, n) in enumerate(zip(self.psi.shape, labels.shape, strict=True))
        ]
        each = math.prod(self.grid.factors) * math.prod(self.step if n > 1 else 1 for n in self.grid.shape)
        common = each * int((inside & labels[np.ix_(*places)]).sum())
        total = each * int(inside.sum()) + voxels
        return 2.0 * common / total if total else 1.0

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
        shape = np.array(self.grid.shape)
        at = np.clip(np.asarray(self.offset) + self.step * places, 0, shape - 1)
        # A corner lies on an edge: along two axes it is at a voxel, but for rounding.
        low = np.floor(at + 1e-4).astype(np.int64)
        high = np.minimum(np.ceil(at - 1e-4).astype(np.int64), shape - 1)
        share = np.clip((at - low).max(axis=1), 0.0, 1.0).astype(np.float32)
        total, weights = np.zeros(len(at), np.float32), np.zeros(len(at), np.float32)
        for corner, weight in ((low, 1.0 - share), (high, share)):
            raveled = np.ravel_multi_index((corner[:, 0], corner[:, 1], corner[:, 2]), self.grid.shape)
            slot = np.minimum(np.searchsorted(cells, raveled), cells.size - 1)
            weight = np.where(cells[slot] == raveled, weight + np.float32(1e-6), np.float32(0.0))
            total += weight * values[slot]
            weights += weight
        return np.divide(total, weights, out=np.zeros_like(total), where=weights > 0)


def _box(surface: LevelSet) -> list[tuple[int, int]] | None:
    """First and one past the last index along z, y, x of the band, and a voxel around it; None without a surface."""
    cells = surface.band.cells
    if cells.size == 0:
        return None
    _, ny, nx = surface.shape
    # Raster order: the planes of the first and the last cell; the other two axes have to be looked at.
    row = cells // nx
    column, line = cells - row * nx, row % ny
    ends = [(cells[0] // (ny * nx), cells[-1] // (ny * nx)), (line.min(), line.max()), (column.min(), column.max())]
    return [(max(int(a) - 1, 0), min(int(b) + 2, n)) for (a, b), n in zip(ends, surface.shape, strict=True)]
