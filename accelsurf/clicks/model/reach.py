"""Reach of a later click: how far it may change an object, in mm, by the click and by the object before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.arrays import Mask, Spacing
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    connected_to,
    corner_of,
    enclosing,
    on_box,
    placed_at,
    widened,
)
from accelsurf.grid.clicks import Click, Side
from accelsurf.grid.geometry import axis_steps

#: A click reaches this number of its radii, and of its depths in the error; at least this number of the
#: smallest spacings, and one of the largest. A person's ball is about half as wide as the error in whose middle it is,
#: and an error is longer than it is deep. Voxels taken away by mistake were right before, so an outside click
#: reaches less far. Mean Dice after 2, 3, 5 clicks of 26 drawn scenes: .721 .756 .796 without a bound, .695 .741 .784
#: with these numbers, .648 .687 .734 with half of all of them.
OF_RADIUS: dict[Side, float] = {"inside": 12.0, "outside": 8.0}
OF_DEPTH: dict[Side, float] = {"inside": 6.0, "outside": 4.0}
LEAST = 4.0
#: Beyond the least reach it moves at most this share of the object's voxels, or the ball of this number of its radii.
SHARE: dict[Side, float] = {"inside": 1.0, "outside": 0.5}
CORE_OF = 6.0
#: First half width, voxels, of the box in which the other side is searched around a click.
_FIRST_SEARCH = 8


class ClickReach(NamedTuple):
    """Reach of a click, and the voxels that it left.

    Attributes
    ----------
    mm : float
        No voxel farther from the click has changed.
    wanted : int
        Number of voxels that it would have changed without a bound.
    left : int
        Number of them that stayed as they were.
    farthest_mm : float
        How far from the click the farthest of them is.
    """

    mm: float
    wanted: int = 0
    left: int = 0
    farthest_mm: float = 0.0


def least_reach(shape: tuple[int, ...], spacing: Spacing) -> float:
    """Return the smallest reach of a click, mm."""
    steps = axis_steps(shape, spacing)
    return max(LEAST * min(steps), max(steps))


def radius_of(click: Click, shape: tuple[int, ...], spacing: Spacing) -> float:
    """Return the radius of a click, mm: the largest distance of its voxels from others."""
    padded = np.pad(click.mask, [(1, 1) if n > 1 else (0, 0) for n in shape])
    return float(ndimage.distance_transform_edt(padded, sampling=spacing).max())


def reach_of(
    click: Click, inside_on: Callable[[Box], Mask], shape: tuple[int, int, int], spacing: Spacing
) -> float:
    """Return how far a click reaches, mm, by its radius and its depth in the error of the object before.

    Parameters
    ----------
    click : Click
    inside_on : callable
        The object before, on a box of the grid.
    shape : (nz, ny, nx)
        Of the grid.
    spacing : (hz, hy, hx)
        mm.
    """
    depth = depth_in_wrong(click, inside_on, shape, spacing)
    of_radius = OF_RADIUS[click.side] * radius_of(click, shape, spacing)
    return max(of_radius, OF_DEPTH[click.side] * depth, least_reach(shape, spacing))


def depth_in_wrong(
    click: Click, inside_on: Callable[[Box], Mask], shape: tuple[int, int, int], spacing: Spacing
) -> float:
    """Return the largest distance, mm, of a voxel of a click on the wrong side from the nearest that is not.

    0 where none is; where nothing of the click's side is on the grid, the extent of the grid. Parameters as of
    `reach_of`.
    """
    is_inside = click.side == "inside"
    wrong = click.mask & (inside_on(click.box) != is_inside)
    if not wrong.any():
        return 0.0
    search = _FIRST_SEARCH
    while True:
        box = widened(click.box, shape, (search, search, search))
        side = inside_on(box) == is_inside
        at = tuple(
            slice(c.start - b.start, c.stop - b.start) for c, b in zip(click.box, box, strict=True)
        )
        covers_all = all(s.stop - s.start == n for s, n in zip(box, shape, strict=True))
        if side.any():
            farthest = float(ndimage.distance_transform_edt(~side, spacing)[at][wrong].max())
            # Beyond the box another voxel may be nearer than those found in its corners.
            if covers_all or farthest <= search * min(axis_steps(shape, spacing)):
                return farthest
        elif covers_all:
            return float(max(n * h for n, h in zip(shape, spacing, strict=True)))
        search *= 2


def separate_part(click: Click, box: Box, inside: Mask, held: Mask) -> Mask | None:
    """Return the part of an object that a click lies in, where it holds no inside click and is less than the rest.

    Parameters
    ----------
    click : Click
    box : tuple of slice
    inside : ndarray (nz, ny, nx) of bool
        The object on that box.
    held : ndarray (nz, ny, nx) of bool
        Voxels of the inside clicks.
    """
    part = connected_to(inside, click.mask_on(box))
    count = int(np.count_nonzero(part))
    is_main = 2 * count >= int(np.count_nonzero(inside)) or bool((part & held).any())
    return None if not count or is_main else part


def distances_from(click: Click, box: Box, spacing: Spacing) -> NDArray[np.float32]:
    """Return the distance, mm, of each voxel of a box from the voxels of a click."""
    whole = enclosing(box, click.box)
    far = ndimage.distance_transform_edt(~click.mask_on(whole), sampling=spacing)
    return np.asarray(on_box(far.astype(np.float32), whole, box, 0.0))


def farthest_from(clicks: Sequence[Click], box: Box, changed: Mask, spacing: Spacing) -> float:
    """Return the largest distance, mm, of a voxel of a mask on a box from the nearest of some clicks; 0 of none."""
    tight = bounding_box(changed)
    if tight is None:
        return 0.0
    part, here = placed_at(tight, corner_of(box)), changed[tight]
    nearest = np.min([distances_from(click, part, spacing)[here] for click in clicks], axis=0)
    return float(nearest.max())


def most_voxels(side: Side, radius: float, count: int, spacing: Spacing, is_flat: bool) -> int:
    """Return how many voxels a click changes at most: a share of the object's, or the ball of which it is the core.

    Parameters
    ----------
    side : {"inside", "outside"}
    radius : float
        Of the click, mm.
    count : int
        Voxels of the object before.
    spacing : (hz, hy, hx)
        mm.
    is_flat : bool
        The image is one slice.
    """
    core = CORE_OF * radius / float(np.prod(spacing)) ** (1 / 3)
    if is_flat:
        core = CORE_OF * radius / float(np.sqrt(np.prod(spacing[1:])))
    ball = np.pi * core**2 if is_flat else 4.0 / 3.0 * np.pi * core**3
    return int(max(SHARE[side] * count, ball))


def bounded_by_count(
    distances: NDArray[np.float32], reach: float, most: int, least: float
) -> float:
    """Return a reach within which a click changes at most a number of voxels, or the least reach.

    Parameters
    ----------
    distances : ndarray (n,)
        Of the voxels that it would change from the click, mm.
    reach : float
        By its radius and depth, mm.
    most : int
    least : float
        mm.

    Examples
    --------
    >>> bounded_by_count(np.arange(10, dtype=np.float32), 8.0, 4, 2.0)
    3.0
    >>> bounded_by_count(np.arange(10, dtype=np.float32), 8.0, 50, 2.0)
    8.0
    """
    within = np.sort(distances[distances <= reach])
    if len(within) <= most:
        return reach
    closer = within[within < within[most]]
    return max(float(closer[-1]) if len(closer) else 0.0, least)
