"""Boxes of voxels: their first voxels, wider ones, which of them meet, what two share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Box

Corner = tuple[int, int, int]


def corner_of(box: Box) -> Corner:
    """First voxel of a box."""
    return box[0].start, box[1].start, box[2].start


def widened(box: Box, shape: tuple[int, int, int], room: tuple[int, int, int]) -> Box:
    """A box with so many voxels more to either side of each axis, as far as the grid goes."""
    a, b, c = (
        slice(max(s.start - m, 0), min(s.stop + m, n)) for s, n, m in zip(box, shape, room, strict=True)
    )
    return a, b, c


def meeting(low: NDArray[np.integer], high: NDArray[np.integer]) -> list[list[int]]:
    """For each of some boxes, given by their first voxels (n, 3) and those after their last, which others it meets.

    Examples
    --------
    >>> meeting(np.array([[0, 0, 0], [2, 0, 0], [5, 0, 0]]), np.array([[3, 3, 3], [5, 1, 1], [6, 1, 1]]))
    [[1], [0], []]
    """
    out = []
    for i in range(len(low)):
        meets = ((low < high[i]) & (high > low[i])).all(axis=1)
        meets[i] = False
        out.append([int(j) for j in np.flatnonzero(meets)])
    return out


def shared(
    corner: Corner, shape: tuple[int, ...], other: Corner, other_shape: tuple[int, ...]
) -> tuple[Box, Box]:
    """Voxels that two boxes that meet share, as each counts them.

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
