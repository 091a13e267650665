"""A surface on a box of the frames' grid that goes with it, also beyond the grid; parts and contacts of surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import Corner, as_corner, box_at, nearest_places
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import part_of
from accelsurf.grid.pyramid import Level, prolong
from accelsurf.image.volume import Volume
from accelsurf.kernels import point_sampling
from accelsurf.levelset import LevelSet, Workers
from accelsurf.track.records import SurfacePiece

#: Values on a box of a grid, by its first voxel and its shape.
OnBox = Callable[[Corner, Corner], NDArray[Any]]
#: Voxels between the band and the edge of its box after the box was laid out, and the fewest before a step.
MARGIN = 4
GUARD = 2
#: Surface that was not there before has the mean of this number of cells of the front nearest to it.
NEIGHBOURS = 16
#: A part is an object of its own from this part of the largest one's volume on; smaller ones are left out.
OWN_PART = 0.2
#: Two objects become one where they touch along at least this part of the surface of the smaller one.
TOUCHING_PART = 0.1


class Halving(NamedTuple):
    """The frames' grid ``frame``, and one with ``geometry`` whose voxels are ``factors`` (3,) as large: blocks of the
    frames' voxels, the last of which may reach beyond the frame.
    """

    frame: Geometry
    geometry: Geometry
    factors: NDArray[np.int64]

    @property
    def offset(self) -> Floats:
        """The first voxel of the coarse grid (3,), mm along the axes from that of the frames'."""
        return np.asarray(0.5 * (self.factors - 1) * self.frame.spacing)

    def on_coarse(self, values: OnBox) -> OnBox:
        """The means on the coarse grid of values on the frames'."""

        def means(corner: Corner, shape: Corner) -> NDArray[Any]:
            fine = as_corner(np.multiply(shape, self.factors))
            blocks = np.stack([shape, self.factors], axis=1).ravel().tolist()
            found = values(as_corner(np.multiply(corner, self.factors)), fine)
            return np.asarray(found.reshape(blocks).mean(axis=(1, 3, 5)), np.float32)

        return means

    def coarser(self, piece: SurfacePiece) -> SurfacePiece:
        """A surface of the frames' grid on the coarse one."""

        def psi_on(first: Corner, shape: Corner) -> NDArray[np.float32]:
            return on_larger_box(
                piece.psi, np.array(piece.corner), np.array(first), np.add(first, shape)
            )

        corner = as_corner(np.array(piece.corner) // self.factors)
        end = -(-np.add(piece.corner, piece.psi.shape) // self.factors)
        return SurfacePiece(corner, self.on_coarse(psi_on)(corner, as_corner(end - corner)))

    def finer(self, piece: SurfacePiece) -> SurfacePiece:
        """A surface of the coarse grid, within it, on the frames' one."""
        corner = as_corner(np.multiply(piece.corner, self.factors))
        whole = np.multiply(piece.psi.shape, self.factors)
        shape = as_corner(np.minimum(whole, np.subtract(self.frame.shape, corner)))
        fine = Level(0, (1, 1, 1), shape, self.frame.spacing)
        factors = as_corner(self.factors)
        first = 0.5 * (factors[0] - 1), 0.5 * (factors[1] - 1), 0.5 * (factors[2] - 1)
        here = Level(1, factors, self.geometry.shape, self.geometry.spacing, first)
        return SurfacePiece(corner, prolong(piece.psi, here, fine))


def halving_of(frame: Geometry) -> Halving | None:
    """The frames' grid and one half as fine along its finest axes; None for planes."""
    if min(frame.shape) == 1:
        return None
    factors = np.where(np.array(frame.spacing) < 2.0 * min(frame.spacing), 2, 1)
    shape = as_corner(-(-np.array(frame.shape) // factors))
    hz, hy, hx = np.multiply(frame.spacing, factors).tolist()
    x, y, z = frame.index_to_world(0.5 * (factors - 1)).tolist()
    return Halving(frame, part_of(frame, shape, (x, y, z), (hz, hy, hx)), factors)


class BoxedSurface(NamedTuple):
    """A surface on its box.

    ``surface``; ``corner`` (z, y, x), the first voxel of the box on its grid, which may be below 0; ``geometry`` of
    this grid; ``halving``: None where it is the frames' grid, else how it lies in that.
    """

    surface: LevelSet
    corner: Corner
    geometry: Geometry
    halving: Halving | None = None

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
        """True if an edge of the box cuts the object: at the border of the frames."""
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
        index = np.stack(
            np.unravel_index(self.surface.band.cells, self.surface.shape), axis=1
        ) + np.array(self.corner)
        return np.asarray(index * self.spacing + self.surface.band.to_closest)

    def index_on_box(self, points: Floats) -> Floats:
        """Points (m, 3), mm along the grid's axes, as indices of the box."""
        return np.ascontiguousarray(points / self.spacing - np.array(self.corner))

    def shifted(self, voxels: Sequence[int]) -> BoxedSurface:
        """The same surface, whole voxels further along z, y, x."""
        return self._replace(corner=as_corner(np.add(self.corner, voxels)))

    def is_tight(self) -> bool:
        """Test if the band comes near an edge of the box beyond which it could go on."""
        low, high = self.surface.extent()
        box, beyond = np.array(self.surface.shape), ~self._cut_sides() & self.wide
        near = np.array([low < GUARD, high > box - GUARD])
        return self.surface.size > 0 and bool((near & beyond).any())

    def _cut_sides(self) -> NDArray[np.bool_]:
        """At which ends (2) of which axes (3) the box cuts the object."""
        psi = self.surface.psi
        return np.array(
            [[bool((psi.take(end, axis) < 0).any()) for axis in range(3)] for end in (0, -1)]
        )

    def with_room(self, room: Sequence[int] | NDArray[np.int64]) -> BoxedSurface:
        """The surface on a box with at least ``room`` (z, y, x) voxels and a margin around its band; itself if it is.

        Where the box cuts the object it has the border of the grid there, or the part that has come in over it: the
        surface is continued straight up to the border.
        """
        shape, corner = np.array(self.surface.shape), np.array(self.corner)
        if not self.surface.size:
            return self
        low, high = self.surface.extent()
        around = np.array(room) + MARGIN
        first, last = corner + low - around, corner + high + around
        cut = self._cut_sides()
        first = np.where(cut[0], np.minimum(corner, 0), first)
        last = np.where(cut[1], np.maximum(corner + shape, self.geometry.shape), last)
        first, last = np.where(self.wide, first, 0), np.where(self.wide, last, 1)
        if (first >= corner).all() and (last <= corner + shape).all():
            return self
        psi = on_larger_box(self.surface.psi, corner, first, last)
        surface = self._made(psi, self.surface.requested_half_width)
        return self._replace(surface=surface, corner=as_corner(first))

    def widened(self, half_width: float) -> BoxedSurface:
        """The surface with a band of another half width (voxels), on a box with room for it."""
        room = np.where(self.wide, int(np.ceil(half_width)), 0).astype(np.int64)
        larger = self.with_room(room)
        return larger._replace(surface=self._made(larger.surface.psi, half_width))

    def _made(self, psi: NDArray[np.float32], half_width: float) -> LevelSet:
        return LevelSet(psi, self.geometry.spacing, half_width, self.surface.workers)

    def on_frame(self) -> SurfacePiece:
        """The surface on the frame's grid; a box of no voxels where it has left."""
        corner = np.array(self.corner)
        shape = np.array(self.surface.shape)
        frame = np.array(self.geometry.shape)
        cut = self._cut_sides()
        first = np.where(cut[0], 0, np.maximum(corner, 0))
        last = np.where(cut[1], frame, np.minimum(corner + shape, frame))
        if (first >= last).any() or not self.surface.size:
            return SurfacePiece((0, 0, 0), np.ones((0, 0, 0), np.float32))
        psi = on_larger_box(self.surface.psi, corner, first, last)
        piece = SurfacePiece(as_corner(first), psi)
        return piece if self.halving is None else self.halving.finer(piece)


def boxed_surface(
    psi: NDArray[np.float32],
    corner: Corner,
    geometry: Geometry,
    half_width: float,
    workers: Workers,
    halving: Halving | None = None,
) -> BoxedSurface:
    """A surface on a box of a grid, with a band of its own."""
    surface = LevelSet(psi, geometry.spacing, half_width, workers)
    return BoxedSurface(surface, corner, geometry, halving).with_room((0, 0, 0))


def boxed_piece(
    piece: SurfacePiece,
    frame: Geometry,
    half_width: float,
    workers: Workers,
    halving: Halving | None = None,
) -> BoxedSurface:
    """A surface of the frames' grid on a box of that grid or of the coarser one."""
    if halving is not None:
        piece, frame = halving.coarser(piece), halving.geometry
    return boxed_surface(piece.psi, piece.corner, frame, half_width, workers, halving)


def on_larger_box(
    psi: NDArray[np.float32],
    corner: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Psi of a box from ``corner`` on the box from ``first`` to ``last``: beyond its edge it is that of the edge."""
    index = nearest_places(box_at(as_corner(first - corner), as_corner(last - first)), psi.shape)
    return np.ascontiguousarray(psi[np.ix_(*index)], np.float32)


def sample_fields(
    boxed: BoxedSurface, fields: Sequence[np.ndarray], points: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Fields (n,) of a band at points (m, 3), mm along the grid's axes: values (m, k), and where they are known.

    Where the band is not, it is the mean of the nearest cells of the front.
    """
    surface = boxed.surface
    values = np.stack([np.asarray(field, np.float32) for field in fields], axis=1)
    out, known = np.empty((len(points), values.shape[1])), np.empty(len(points), np.bool_)
    index = boxed.index_on_box(points)
    surface.workers.parallel(
        point_sampling.fields_at_points,
        len(points),
        surface.dense.slot,
        surface.grid,
        values,
        index,
        out,
        known,
    )
    if not known.all() and surface.size:
        front = np.flatnonzero(surface.front())
        count = min(NEIGHBOURS, front.size)
        _, near = cKDTree(boxed.closest_points()[front]).query(points[~known], count)
        out[~known] = values[front[near.reshape(-1, count)]].mean(axis=1, dtype=np.float64)
    return out, known


def transferred(
    old: BoxedSurface, fields: Sequence[np.ndarray], new: BoxedSurface
) -> list[np.ndarray]:
    """Fields (n,) of a band on the band of the same surface on another box: the same numbers in the same cells."""
    if new is old:
        return list(fields)
    values, _ = sample_fields(old, fields, new.closest_points())
    index = np.stack(np.unravel_index(new.surface.band.cells, new.surface.shape))
    place = index + (np.array(new.corner) - np.array(old.corner))[:, None]
    inside = ((place >= 0) & (place < np.array(old.surface.shape)[:, None])).all(axis=0)
    slot = np.full(new.surface.size, -1, np.int64)
    slot[inside] = old.surface.dense.slot[
        np.ravel_multi_index(tuple(place[:, inside]), old.surface.shape)
    ]
    same = slot >= 0
    out = []
    for c, field in enumerate(fields):
        column = values[:, c].astype(np.float32)
        column[same] = field[slot[same]]
        out.append(column)
    return out


def separate_parts(surface: SurfacePiece) -> list[SurfacePiece]:
    """The parts of a surface that are connected by faces of voxels, the largest first, without small ones.

    Parameters
    ----------
    surface : SurfacePiece

    Returns
    -------
    list of SurfacePiece
        Of none where nothing is inside; of the surface itself where it is one.
    """
    labels, count = ndimage.label(surface.psi < 0)
    if count == 0:
        return []
    if count == 1:
        return [surface]
    sizes = np.bincount(labels.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")
    large = [int(i) + 1 for i in order if sizes[i] >= OWN_PART * sizes.max()]
    return [
        surface._replace(psi=np.where(labels == n, surface.psi, np.abs(surface.psi))).tight()
        for n in large
    ]


def touching(surfaces: Sequence[SurfacePiece], image: Volume, edge: float) -> list[tuple[int, int]]:
    """Pairs of surfaces that have become one, as positions in the list, rising.

    They touch along enough of the smaller one's surface, and the image has no edge between them: its mean there is on
    the object's side of ``edge``.

    Parameters
    ----------
    surfaces : sequence of SurfacePiece
    image : Volume
        The frame.
    edge : float
        Value half-way between objects and their surroundings.
    """
    labels = np.zeros(image.geometry.shape, np.int32)
    for place, surface in enumerate(surfaces, start=1):
        labels[surface.box][surface.psi < 0] = place
    inner = float(np.mean(image.array[labels > 0])) if labels.any() else edge
    faces, between = np.zeros(len(surfaces) + 1, np.int64), dict[tuple[int, int], list[float]]()
    for axis, n in enumerate(labels.shape):
        low, high = _layers(labels, axis, 0, n - 1), _layers(labels, axis, 1, n)
        differs = low != high
        a, b = low[differs], high[differs]
        faces += np.bincount(a, minlength=faces.size) + np.bincount(b, minlength=faces.size)
        values = 0.5 * (
            _layers(image.array, axis, 0, n - 1)[differs]
            + _layers(image.array, axis, 1, n)[differs]
        )
        for i, j, value in zip(a.tolist(), b.tolist(), values.tolist(), strict=True):
            if i and j:
                between.setdefault((min(i, j), max(i, j)), []).append(value)
    out = []
    for (i, j), there in sorted(between.items()):
        enough = len(there) >= TOUCHING_PART * min(int(faces[i]), int(faces[j]))
        if enough and (float(np.mean(there)) - edge) * (inner - edge) > 0:
            out.append((i - 1, j - 1))
    return out


def _layers(array: NDArray[Any], axis: int, first: int, end: int) -> NDArray[Any]:
    return array[(slice(None),) * axis + (slice(first, end),)]


def groups_of(pairs: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Positions that pairs connect, in groups.

    Examples
    --------
    >>> groups_of([(0, 2), (2, 5), (3, 4)])
    [[0, 2, 5], [3, 4]]
    """
    found: list[set[int]] = []
    for pair in pairs:
        joined = set(pair).union(*(group for group in found if group & set(pair)))
        found = [group for group in found if not group & joined] + [joined]
    return sorted(sorted(group) for group in found)
