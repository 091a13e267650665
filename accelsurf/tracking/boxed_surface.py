"""A surface on a box of the frames' grid that goes with it; the box may extend beyond the grid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from accelsurf.grid.boxes import Corner
from accelsurf.grid.geometry import Geometry
from accelsurf.kernels import point_sampling
from accelsurf.levelset import LevelSet, Workers, extent_of
from accelsurf.tracking.records import SurfacePiece

Floats = NDArray[np.float64]
#: Voxels between the band and the edge of its box after the box was laid out, and the fewest before a step.
MARGIN, GUARD = 4, 2
#: Surface that was not there before has the mean of so many cells of the front nearest to it.
NEIGHBOURS = 16


class BoxedSurface(NamedTuple):
    """A surface on its box.

    ``surface``; ``corner`` (z, y, x), the first voxel of the box on the frames' grid, which may be below 0;
    ``geometry`` of the frames.
    """

    surface: LevelSet
    corner: Corner
    geometry: Geometry

    @property
    def spacing(self) -> Floats:
        """(hz, hy, hx), mm, as the kernels have it: a single slice is as fine as the other axes."""
        grid = self.surface.grid
        return np.array([grid.hz, grid.hy, grid.hx])

    @property
    def wide(self) -> NDArray[np.bool_]:
        """Axes of the frame with more than one voxel, (3,)."""
        return np.array(self.geometry.shape) > 1

    @property
    def is_cut(self) -> bool:
        """Whether an edge of the box cuts the object: at the border of the frames."""
        return bool((self._cut_sides() & self.wide).any())

    def centroid(self) -> Floats:
        """Centroid of the volume (3,), mm along the grid's axes from the frames' first voxel."""
        surface = self.surface
        share = (surface.dense.psi < 0).astype(np.float64)
        share[surface.band.cells] = surface.fraction_and_area()[0]
        share = share.reshape(surface.shape)
        totals = [share.sum(axis=tuple(b for b in range(3) if b != a)) for a in range(3)]
        volume = max(float(share.sum()), 1e-300)
        index = np.array([float((t * np.arange(t.size)).sum()) / volume for t in totals])
        return np.asarray((index + np.array(self.corner)) * self.spacing)

    def closest_points(self) -> Floats:
        """Closest point (n, 3) of every cell of the band: mm along the grid's axes from its first voxel, z y x."""
        index = np.stack(np.unravel_index(self.surface.band.cells, self.surface.shape), axis=1) + np.array(self.corner)
        return np.asarray(index * self.spacing + self.surface.band.to_closest)

    def index_on_box(self, points: Floats) -> Floats:
        """Points (m, 3), mm along the grid's axes, as indices of the box."""
        return np.ascontiguousarray(points / self.spacing - np.array(self.corner))

    def shifted(self, voxels: Sequence[int]) -> BoxedSurface:
        """The same surface, whole voxels further along z, y, x."""
        z, y, x = (c + int(n) for c, n in zip(self.corner, voxels, strict=True))
        return self._replace(corner=(z, y, x))

    def is_tight(self) -> bool:
        """Whether the band comes near an edge of the box beyond which it could go on."""
        low, high = extent_of(self.surface)
        box, beyond = np.array(self.surface.shape), ~self._cut_sides() & self.wide
        near = np.array([low < GUARD, high > box - GUARD])
        return self.surface.size > 0 and bool((near & beyond).any())

    def _cut_sides(self) -> NDArray[np.bool_]:
        """At which ends (2) of which axes (3) the box cuts the object."""
        psi = self.surface.psi
        return np.array([[bool((psi.take(end, axis) < 0).any()) for axis in range(3)] for end in (0, -1)])

    def with_room(self, room: Sequence[int] | NDArray[np.int64]) -> BoxedSurface:
        """The surface on a box with at least ``room`` (z, y, x) voxels and a margin around its band; itself if it is.

        Where the box cuts the object it has the border of the grid there, or what has come in over it: the surface
        is continued straight up to the border.
        """
        shape, corner = np.array(self.surface.shape), np.array(self.corner)
        if not self.surface.size:
            return self
        low, high = extent_of(self.surface)
        around = np.array(room) + MARGIN
        first, last = corner + low - around, corner + high + around
        cut = self._cut_sides()
        first = np.where(cut[0], np.minimum(corner, 0), first)
        last = np.where(cut[1], np.maximum(corner + shape, self.geometry.shape), last)
        first, last = np.where(self.wide, first, 0), np.where(self.wide, last, 1)
        if (first >= corner).all() and (last <= corner + shape).all():
            return self
        psi = on_larger_box(self.surface.psi, corner, first, last)
        at = int(first[0]), int(first[1]), int(first[2])
        return self._replace(surface=self._made(psi, self.surface.requested_half_width), corner=at)

    def widened(self, half_width: float) -> BoxedSurface:
        """The surface with a band of another half width (voxels), on a box with room for it."""
        room = np.where(self.wide, int(np.ceil(half_width)), 0).astype(np.int64)
        larger = self.with_room(room)
        return larger._replace(surface=self._made(larger.surface.psi, half_width))

    def _made(self, psi: NDArray[np.float32], half_width: float) -> LevelSet:
        return LevelSet(psi, self.geometry.spacing, half_width, self.surface.workers)

    def on_frame(self) -> SurfacePiece:
        """The surface on the frame's grid; a box of no voxels where it has left."""
        corner, shape, frame = np.array(self.corner), np.array(self.surface.shape), np.array(self.geometry.shape)
        cut = self._cut_sides()
        first = np.where(cut[0], 0, np.maximum(corner, 0))
        last = np.where(cut[1], frame, np.minimum(corner + shape, frame))
        if (first >= last).any() or not self.surface.size:
            return SurfacePiece((0, 0, 0), np.ones((0, 0, 0), np.float32))
        psi = on_larger_box(self.surface.psi, corner, first, last)
        return SurfacePiece((int(first[0]), int(first[1]), int(first[2])), psi)


def boxed(
    psi: NDArray[np.float32], corner: Corner, geometry: Geometry, half_width: float, workers: Workers
) -> BoxedSurface:
    """A surface on a box of the frames' grid, with a band of its own."""
    surface = LevelSet(psi, geometry.spacing, half_width, workers)
    return BoxedSurface(surface, corner, geometry).with_room((0, 0, 0))


def on_larger_box(
    psi: NDArray[np.float32], corner: NDArray[np.int64], first: NDArray[np.int64], last: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Psi of a box from ``corner`` on the box from ``first`` to ``last``: beyond its edge it is that of the edge."""
    index = [
        np.clip(np.arange(a, b) - c, 0, n - 1) for a, b, c, n in zip(first, last, corner, psi.shape, strict=True)
    ]
    return np.ascontiguousarray(psi[np.ix_(*index)], np.float32)


def sample_fields(on: BoxedSurface, fields: Sequence[np.ndarray], points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Fields (n,) of a band at points (m, 3), mm along the grid's axes: values (m, k), and where they are known.

    Where the band is not, it is the mean of the nearest cells of the front.
    """
    surface = on.surface
    values = np.stack([np.asarray(field, np.float32) for field in fields], axis=1)
    out, known = np.empty((len(points), values.shape[1])), np.empty(len(points), np.bool_)
    index = on.index_on_box(points)
    surface.workers.parallel(
        point_sampling.fields_at_points, len(points), surface.dense.slot, surface.grid, values, index, out, known
    )
    if not known.all() and surface.size:
        front = np.flatnonzero(surface.front())
        count = min(NEIGHBOURS, front.size)
        _, near = cKDTree(on.closest_points()[front]).query(points[~known], count)
        out[~known] = values[front[near.reshape(-1, count)]].mean(axis=1, dtype=np.float64)
    return out, known


def transferred(old: BoxedSurface, fields: Sequence[np.ndarray], new: BoxedSurface) -> list[np.ndarray]:
    """Fields (n,) of a band on the band of the same surface on another box: the same numbers in the same cells."""
    if new is old:
        return list(fields)
    values, _ = sample_fields(old, fields, new.closest_points())
    index = np.stack(np.unravel_index(new.surface.band.cells, new.surface.shape))
    place = index + (np.array(new.corner) - np.array(old.corner))[:, None]
    inside = ((place >= 0) & (place < np.array(old.surface.shape)[:, None])).all(axis=0)
    slot = np.full(new.surface.size, -1, np.int64)
    slot[inside] = old.surface.dense.slot[np.ravel_multi_index(tuple(place[:, inside]), old.surface.shape)]
    same = slot >= 0
    out = []
    for c, field in enumerate(fields):
        column = values[:, c].astype(np.float32)
        column[same] = field[slot[same]]
        out.append(column)
    return out
