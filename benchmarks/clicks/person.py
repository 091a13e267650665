"""A simulated person: clicks where a result is most wrong, a ball of half the depth there.

The rules are fixed (record 0023). Click 1 goes inside the object, at its deepest point. Click k goes to the deepest
point of all that is wrong: what is missing gets an inside click, what is too much an outside click. Depth is the
Euclidean distance (mm) to the nearest voxel centre that is not part of the region; the scan's border is no end of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box, bounding_box
from accelsurf.grid.geometry import Geometry

Mask = NDArray[np.bool_]
#: A ball's radius: this part of the depth, at least this part of the largest spacing, at most so many of the smallest.
PART, LEAST_SPACINGS, MOST_SPACINGS = 0.5, 0.5, 8.0
#: Depths that differ by less than this part of the smallest spacing count as equal: spacings in files are rounded.
TIE = 1e-4
#: A jittered click falls anywhere where the depth is above this part of the largest.
JITTER = 0.5


class PersonClick(NamedTuple):
    """A click: "inside" or "outside", the voxel (z, y, x), its centre in the world (x, y, z, mm), radius in mm."""

    side: str
    index: tuple[int, int, int]
    centre: tuple[float, float, float]
    radius: float


def next_click(
    truth: Mask, labels: Mask | None, geometry: Geometry, random: np.random.Generator | None = None
) -> PersonClick | None:
    """Where a person clicks next.

    Parameters
    ----------
    truth : ndarray of bool, shape (nz, ny, nx)
        The object.
    labels : ndarray of bool, shape (nz, ny, nx), or None
        What has been found so far; None before the first click.
    geometry : Geometry
        Of both.
    random : numpy.random.Generator, optional
        With it the click is jittered: any voxel where the depth is above half the largest, each as likely.

    Returns
    -------
    PersonClick or None
        None where nothing is wrong.
    """
    wrong = truth if labels is None else truth ^ labels
    # What is outside the box is no nearer than what lies at its edge: one voxel more on each side is exact.
    box = bounding_box(wrong, 1)
    if box is None:
        return None
    sides = [_deep(wrong[box] & (truth[box] == side), box, truth.shape, geometry.spacing) for side in (True, False)]
    index, depth = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    step = TIE * min(geometry.spacing)
    if random is None:
        deepest = index[depth > depth.max() - step]
        at = int(deepest.min())
    else:
        at = int(random.choice(np.sort(index[depth > JITTER * depth.max()])))
    side = "inside" if truth.flat[at] else "outside"
    return _click(side, at, float(depth[index == at][0]), truth, geometry)


def ball_voxels(click: PersonClick, geometry: Geometry) -> tuple[Box, Mask]:
    """The box around a click's ball, and the voxels in it whose centres are in the ball.

    Examples
    --------
    >>> click = PersonClick("inside", (2, 2, 2), (2.0, 2.0, 2.0), 1.0)
    >>> box, mask = ball_voxels(click, Geometry((5, 5, 5), (1.0, 1.0, 1.0)))
    >>> box, int(mask.sum())
    ((slice(1, 4, None), slice(1, 4, None), slice(1, 4, None)), 7)
    """
    reach = [int(click.radius / h) + 1 for h in geometry.spacing]
    low = [max(i - n, 0) for i, n in zip(click.index, reach, strict=True)]
    high = [min(i + n + 1, size) for i, n, size in zip(click.index, reach, geometry.shape, strict=True)]
    axes = [
        (np.arange(a, b) - i) * h for a, b, i, h in zip(low, high, click.index, geometry.spacing, strict=True)
    ]
    squares = axes[0][:, None, None] ** 2 + axes[1][None, :, None] ** 2 + axes[2][None, None, :] ** 2
    inside = squares <= click.radius**2 * (1 + 1e-9)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    tight = bounding_box(inside)
    assert tight is not None  # the centre is in it
    moved = (slice(box[i].start + tight[i].start, box[i].start + tight[i].stop) for i in range(3))
    return (next(moved), next(moved), next(moved)), inside[tight]


def _deep(
    part: Mask, box: Box, shape: tuple[int, ...], spacing: tuple[float, float, float]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Voxels of a region (flat indices of the whole grid) at more than half of its largest depth, and depths (mm)."""
    if not part.any():
        return np.zeros(0, np.int64), np.zeros(0)
    depth = ndimage.distance_transform_edt(part, sampling=spacing)
    if part.all():
        # Everything is wrong, and nothing says how deep: all points are alike.
        depth = np.full(part.shape, max(n * h for n, h in zip(part.shape, spacing, strict=True)))
    where = np.nonzero(depth > JITTER * depth.max())
    moved = tuple(axis + side.start for axis, side in zip(where, box, strict=True))
    return np.ravel_multi_index(moved, shape).astype(np.int64), depth[where]


def _click(side: str, at: int, depth: float, truth: Mask, geometry: Geometry) -> PersonClick:
    index = tuple(int(i) for i in np.unravel_index(at, truth.shape))
    where = (index[0], index[1], index[2])
    x, y, z = (float(value) for value in geometry.index_to_world(where))
    bounds = LEAST_SPACINGS * max(geometry.spacing), MOST_SPACINGS * min(geometry.spacing)
    click = PersonClick(side, where, (x, y, z), max(min(PART * depth, bounds[1]), bounds[0]))
    box, ball = ball_voxels(click, geometry)
    if np.any(truth[box][ball] != (side == "inside")):
        # The least ball is wider than the region is deep: a person clicks one voxel, and does not paint over the edge.
        click = click._replace(radius=0.5 * min(geometry.spacing))
    return click
