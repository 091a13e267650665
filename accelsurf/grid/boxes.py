"""Boxes of voxels: around a mask, made larger, the overlap of two; slabs of an array; connected pieces of a mask."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Voxels of a box within a grid, (z, y, x).
Box = tuple[slice, slice, slice]
#: First voxel of a box, (z, y, x).
Corner = tuple[int, int, int]
#: Voxels of a slab.
SLAB_VOXELS = 1 << 20


def bounding_box(mask: NDArray[np.bool_], margin: int = 0) -> Box | None:
    """Return the smallest box with all voxels of a mask; None when the mask is empty.

    Parameters
    ----------
    mask : ndarray (nz, ny, nx) of bool
    margin : int, optional
        Voxels added to either side of each axis, as far as the grid goes.

    Examples
    --------
    >>> mask = np.zeros((4, 5, 6), bool)
    >>> mask[1:3, 2, 4:] = True
    >>> bounding_box(mask)
    (slice(1, 3, None), slice(2, 3, None), slice(4, 6, None))
    >>> bounding_box(mask, 1)
    (slice(0, 4, None), slice(1, 4, None), slice(3, 6, None))
    """
    shape, box = mask.shape, []
    for axis in range(3):
        occupied = np.flatnonzero(
            mask.any(axis=tuple(other for other in range(3) if other != axis))
        )
        if not occupied.size:
            return None
        box.append(slice(int(occupied[0]), int(occupied[-1]) + 1))
        mask = mask[(slice(None),) * axis + (box[-1],)]  # the other axes need this range only
    return widened((box[0], box[1], box[2]), shape, (margin, margin, margin))


def tightened(box: Box, mask: NDArray[np.bool_]) -> tuple[Box, NDArray[np.bool_]] | None:
    """Return the box that just holds a mask on a box, and the mask on it; None where it has no voxel."""
    inner = bounding_box(mask)
    return (
        None
        if inner is None
        else (placed_at(inner, corner_of(box)), np.ascontiguousarray(mask[inner]))
    )


def whole_box(shape: Sequence[int]) -> Box:
    """Return the box of all voxels of a grid.

    Examples
    --------
    >>> whole_box((4, 5, 6))
    (slice(0, 4, None), slice(0, 5, None), slice(0, 6, None))
    """
    return box_at((0, 0, 0), shape)


def box_at(corner: Corner, shape: Sequence[int]) -> Box:
    """Return the box of ``shape`` voxels whose first voxel is ``corner``.

    Examples
    --------
    >>> box_at((1, 0, 2), (4, 5, 6))
    (slice(1, 5, None), slice(0, 5, None), slice(2, 8, None))
    """
    z, y, x = (slice(first, first + n) for first, n in zip(corner, shape, strict=True))
    return z, y, x


def as_corner(places: Iterable[Any]) -> Corner:
    """Return three whole numbers, of whatever type, as the first voxel of a box or as a shape.

    Examples
    --------
    >>> as_corner(np.array([1, 2, 3]))
    (1, 2, 3)
    """
    z, y, x = (int(place) for place in places)
    return z, y, x


def corner_of(box: Box) -> Corner:
    """Return the first voxel of a box."""
    return box[0].start, box[1].start, box[2].start


def widened(box: Box, shape: Sequence[int], margin: Sequence[int]) -> Box:
    """Return a box with ``margin`` (z, y, x) more voxels on either side, as far as a grid of ``shape`` goes.

    Examples
    --------
    >>> widened((slice(1, 3), slice(0, 4), slice(5, 6)), (4, 5, 6), (1, 2, 0))
    (slice(0, 4, None), slice(0, 5, None), slice(5, 6, None))
    """
    z, y, x = (
        slice(max(s.start - m, 0), min(s.stop + m, n))
        for s, n, m in zip(box, shape, margin, strict=True)
    )
    return z, y, x


def nearest_places(box: Box, shape: Sequence[int]) -> list[NDArray[np.int64]]:
    """Return the places of a box along each axis (z, y, x), those beyond a grid of ``shape`` as the nearest on it.

    Examples
    --------
    >>> [places.tolist() for places in nearest_places((slice(-1, 2), slice(0, 1), slice(2, 5)), (3, 3, 4))]
    [[0, 0, 1], [0], [2, 3, 3]]
    """
    return [
        np.clip(np.arange(side.start, side.stop), 0, count - 1)
        for side, count in zip(box, shape, strict=True)
    ]


def enclosing(first: Box, second: Box) -> Box:
    """Return the smallest box that holds two.

    Examples
    --------
    >>> enclosing((slice(1, 3), slice(0, 4), slice(5, 6)), (slice(2, 5), slice(1, 2), slice(0, 1)))
    (slice(1, 5, None), slice(0, 4, None), slice(0, 6, None))
    """
    z, y, x = (
        slice(min(a.start, b.start), max(a.stop, b.stop))
        for a, b in zip(first, second, strict=True)
    )
    return z, y, x


def counted_from(box: Box, corner: Corner) -> Box:
    """Return a box counted from another first voxel."""
    z, y, x = (slice(s.start - c, s.stop - c) for s, c in zip(box, corner, strict=True))
    return z, y, x


def with_halo(
    made: Callable[[Box], NDArray[Any]], box: Box, shape: Sequence[int], halo: Sequence[int]
) -> NDArray[Any]:
    """Return the values that are made of a box, a view of the values of a box ``halo`` (z, y, x) voxels wider.

    Parameters
    ----------
    made : callable
        Returns the values of a box of the grid; near faces of the box that are none of the grid they may be wrong.
    box : tuple of slice
    shape, halo : sequence of 3 ints
        Of the grid; how far from these faces they may be wrong.

    Examples
    --------
    >>> grid = np.arange(12).reshape(1, 3, 4)
    >>> with_halo(lambda wide: grid[wide], (slice(0, 1), slice(2, 3), slice(1, 3)), grid.shape, (0, 1, 1)).tolist()
    [[[9, 10]]]
    """
    around = widened(box, shape, halo)
    return made(around)[counted_from(box, corner_of(around))]


def placed_at(box: Box, corner: Corner) -> Box:
    """Return a box of an array counted as its first voxel, ``corner``, is; the inverse of `counted_from`.

    Examples
    --------
    >>> placed_at((slice(0, 2), slice(1, 3), slice(0, 1)), (5, 0, 7))
    (slice(5, 7, None), slice(1, 3, None), slice(7, 8, None))
    """
    z, y, x = (slice(s.start + c, s.stop + c) for s, c in zip(box, corner, strict=True))
    return z, y, x


def meeting(low: NDArray[np.integer], high: NDArray[np.integer]) -> list[list[int]]:
    """Return for each of some boxes the numbers of the others that it overlaps.

    Parameters
    ----------
    low, high : ndarray (n, 3) of int
        First voxel of each box, and the one after its last.

    Examples
    --------
    >>> meeting(np.array([[0, 0, 0], [2, 0, 0], [5, 0, 0]]), np.array([[3, 3, 3], [5, 1, 1], [6, 1, 1]]))
    [[1], [0], []]
    """
    if not len(low):
        return []
    # Along the axis on which they lie farthest apart, a box may only overlap those that begin before it ends.
    axis = int(np.argmax(np.ptp(low, axis=0)))
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    found: list[list[int]] = [[] for _ in order]
    for i, end in enumerate(np.searchsorted(low[:, axis], high[:, axis])):
        later = slice(i + 1, max(int(end), i + 1))
        touch = ((low[later] < high[i]) & (high[later] > low[i])).all(axis=1)
        for j in order[later][touch].tolist():
            found[order[i]].append(j)
            found[j].append(int(order[i]))
    return [sorted(others) for others in found]


def overlap(first: Box, second: Box) -> bool:
    """Test if two boxes have a voxel in common."""
    (a, b, c), (d, e, f) = first, second  # of many objects each looks at all others
    low_meets = a.start < d.stop and b.start < e.stop and c.start < f.stop
    return low_meets and d.start < a.stop and e.start < b.stop and f.start < c.stop


def common(first: Box, second: Box) -> Box:
    """Return the voxels that two overlapping boxes have in common.

    Examples
    --------
    >>> common((slice(1, 3), slice(0, 4), slice(5, 9)), (slice(2, 5), slice(1, 2), slice(0, 6)))
    (slice(2, 3, None), slice(1, 2, None), slice(5, 6, None))
    """
    z, y, x = (
        slice(max(a.start, b.start), min(a.stop, b.stop))
        for a, b in zip(first, second, strict=True)
    )
    return z, y, x


def shared(
    corner: Corner, shape: Sequence[int], other: Corner, other_shape: Sequence[int]
) -> tuple[Box, Box]:
    """Return the voxels that two overlapping boxes share, counted from the first voxel of each.

    Examples
    --------
    >>> shared((0, 0, 0), (4, 4, 4), (3, 0, 0), (2, 4, 4))[0]
    (slice(3, 4, None), slice(0, 4, None), slice(0, 4, None))
    """
    mine, theirs = [], []
    for a, n, b, m in zip(corner, shape, other, other_shape, strict=True):
        low, high = max(a, b), min(a + n, b + m)
        mine.append(slice(low - a, high - a))
        theirs.append(slice(low - b, high - b))
    return (mine[0], mine[1], mine[2]), (theirs[0], theirs[1], theirs[2])


def on_box(values: NDArray[Any], source: Box, box: Box, beyond: float) -> NDArray[Any]:
    """Return values of one box on another of the same grid; ``beyond`` where the first has none.

    Examples
    --------
    >>> line, rest = np.array([[[1, 2, 3]]]), slice(0, 1)
    >>> on_box(line, (rest, rest, slice(4, 7)), (rest, rest, slice(5, 9)), 0).tolist()
    [[[2, 3, 0, 0]]]
    """
    out = np.full([s.stop - s.start for s in box], beyond, values.dtype)
    mine, theirs = shared(corner_of(box), out.shape, corner_of(source), values.shape)
    if all(s.start < s.stop for s in mine):
        out[mine] = values[theirs]
    return out


def slabs(shape: Sequence[int], multiple: int = 1, at_least: int = 1) -> Iterator[slice]:
    """Yield runs of planes (along the first axis) of about `SLAB_VOXELS` voxels that cover a grid.

    Parameters
    ----------
    shape : sequence of 3 ints
        (nz, ny, nx).
    multiple : int, optional
        Each run but the last has a multiple of this number of planes.
    at_least : int, optional
        Each run but the last has at least this number of planes.

    Examples
    --------
    >>> list(slabs((5, 1024, 512)))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    >>> list(slabs((5, 1024, 512), at_least=4))
    [slice(0, 4, None), slice(4, 5, None)]
    """
    voxels = max(1, shape[1] * shape[2])  # 0 of an empty array
    planes = max(multiple * max(1, SLAB_VOXELS // (multiple * voxels)), at_least)
    for begin in range(0, shape[0], planes):
        yield slice(begin, min(begin + planes, shape[0]))


def sum_in_order(rows: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The sum of rows (m,), one added after the other: rows of 0 before, between and after them do not change it.

    Examples
    --------
    >>> sum_in_order(np.array([[0.0], [0.1], [0.0], [0.2], [0.3]]))
    array([0.6])
    """
    total: NDArray[np.float64] | None = None
    for row in rows:
        total = np.array(row, np.float64) if total is None else total + row
    if total is None:
        raise ValueError("no rows to add")
    return total


def runs(size: int) -> Iterator[slice]:
    """Yield runs of at most `SLAB_VOXELS` cells that cover a raveled array of ``size`` cells.

    Examples
    --------
    >>> list(runs(3))
    [slice(0, 3, None)]
    """
    for begin in range(0, size, SLAB_VOXELS):
        yield slice(begin, min(begin + SLAB_VOXELS, size))


def connected_to(mask: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pieces of a mask that have a voxel of ``seeds``; both (nz, ny, nx) of bool.

    Examples
    --------
    >>> row = np.array([[[True, True, False, True]]])
    >>> connected_to(row, np.array([[[True, False, True, False]]]))
    array([[[ True,  True, False, False]]])
    """
    out = np.zeros(mask.shape, np.bool_)
    box = bounding_box(mask)
    if box is None:
        return out
    from scipy import ndimage  # here: a look at an image does without it

    labels, count = ndimage.label(mask[box])
    is_seeded = np.zeros(count + 1, np.bool_)
    is_seeded[labels[seeds[box]]] = True
    is_seeded[0] = False
    out[box] = is_seeded[labels]
    return out


def holes_filled(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (nz, ny, nx) with the voxels that it encloses: those connected to no face of the grid.

    In an image of one slice nothing is enclosed: all of it lies at a face.

    Examples
    --------
    >>> shell = np.ones((3, 3, 3), bool)
    >>> shell[1, 1, 1] = False
    >>> bool(holes_filled(shell).all())
    True
    """
    out = np.array(mask, np.bool_)
    box = bounding_box(out)
    if box is None:
        return out
    from scipy import ndimage  # here: a look at an image does without it

    # One layer around is all of the outside, which has the first label then: it has the first voxel.
    labels, _ = ndimage.label(np.pad(~out[box], 1, constant_values=True))
    out[box] = labels[1:-1, 1:-1, 1:-1] != 1
    return out
