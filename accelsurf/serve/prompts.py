"""Prompts into clicks: the voxels that a point, a rectangle, a stroke or a lasso covers, and the clicks that follow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import accelsurf
from accelsurf.errors import InputError

#: Radius of the ball that a point covers, in the smallest spacings: as wide as viewers draw it.
POINT = 4.0
#: An object in an outline is taken to be as deep as it; people click balls of half an object's depth.
HALF = 0.5
#: Largest radius of the ball in an outline, in the smallest spacings: as large as people click.
LARGEST = 7.4
#: The ball of a point that corrects ends at this part of the way to the nearest voxel on the other side.
JUST_TO = 0.99
#: Voxels across the rim around an outline.
RIM = 2

Side = Literal["inside", "outside"]
Box = tuple[slice, slice, slice]
Mask = NDArray[np.bool_]


class Voxel(NamedTuple):
    """Index of a voxel, in the client's order of axes."""

    first: int
    second: int
    third: int


class Grid(NamedTuple):
    """Grid of an image in the client's order of axes: its ``shape``, and the ``spacing`` in mm."""

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]

    @property
    def step(self) -> float:
        """Smallest spacing along an axis with more than one voxel, mm."""
        return min(
            (h for h, n in zip(self.spacing, self.shape, strict=True) if n > 1),
            default=self.spacing[0],
        )

    def box_around(self, voxel: Sequence[int], reach: float) -> Box:
        """Return the box around a voxel with all voxels within a reach, in the smallest spacings."""
        box = []
        for at, h, n in zip(voxel, self.spacing, self.shape, strict=True):
            voxels = math.ceil(reach * self.step / h)
            box.append(slice(max(at - voxels, 0), min(at + voxels + 1, n)))
        return box[0], box[1], box[2]

    def ball(self, voxel: Sequence[int], radius: float, side: Side) -> accelsurf.Click:
        """Return a click of the voxels within a radius of one, in the smallest spacings."""
        box = self.box_around(voxel, radius)
        axes = np.ogrid[box]
        apart = sum(
            ((axis - at) * h) ** 2 for axis, at, h in zip(axes, voxel, self.spacing, strict=True)
        )
        return _click(side, box, np.asarray(apart <= (radius * self.step) ** 2))


def voxel_of(place: Sequence[float], shape: Sequence[int]) -> Voxel:
    """Return the voxel in which a place, an index, lies.

    Raises
    ------
    InputError
        When it lies outside of the image.
    """
    first, second, third = (math.floor(value + 0.5) for value in place)
    voxel = Voxel(first, second, third)
    if not all(0 <= at < n for at, n in zip(voxel, shape, strict=True)):
        raise InputError(
            f"point: {_listed(place)} lies outside of the image, whose shape is {_listed(shape)}"
        )
    return voxel


def point(
    grid: Grid, voxel: Voxel, side: Side, labels: NDArray[np.uint8], around: Box
) -> accelsurf.Click:
    """Return the click of a point.

    A ball, which does not reach beyond the surface that the point corrects: a small mistake can be corrected too.

    Parameters
    ----------
    grid : Grid
    voxel : Voxel
    side : {"inside", "outside"}
    labels : ndarray of uint8
        The object so far, on the box ``around``.
    around : tuple of slice
    """
    here = tuple(at - part.start for at, part in zip(voxel, around, strict=True))
    beyond = labels != labels[here]
    radius = POINT
    if beyond.any():
        depth = ndimage.distance_transform_edt(~beyond, sampling=grid.spacing)
        radius = min(JUST_TO * float(depth[here]) / grid.step, POINT)
    return grid.ball(voxel, radius, side)


def rectangle(ends: Sequence[Sequence[float]], shape: Sequence[int]) -> accelsurf.Click:
    """Return the voxels of a rectangle in a slice, cut at the image; with the side inside.

    Raises
    ------
    InputError
        When it has no voxel there.
    """
    low = [max(math.floor(first + 0.5), 0) for first, _ in ends]
    high = [min(math.floor(last + 0.5), n) for (_, last), n in zip(ends, shape, strict=True)]
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise InputError(
            "rectangle: no voxel of the image is in it", "from, and to before, along each axis"
        )
    first, second, third = (slice(a, b) for a, b in zip(low, high, strict=True))
    mask = np.ones([b - a for a, b in zip(low, high, strict=True)], np.bool_)
    return accelsurf.Click("inside", (first, second, third), mask)


def voxels(
    mask: NDArray[Any],
    ends: Sequence[Sequence[int]] | None,
    shape: Sequence[int],
    side: Side = "inside",
) -> accelsurf.Click:
    """Return the voxels of a stroke or a lasso: not 0 in an array, which lies on a box of the image or is as large.

    Raises
    ------
    InputError
        When the array does not fit, or is empty.
    """
    given = (
        [(0, n) for n in shape] if ends is None else [(int(low), int(high)) for low, high in ends]
    )
    if mask.shape != tuple(high - low for low, high in given) or any(
        high > n for (_, high), n in zip(given, shape, strict=True)
    ):
        raise InputError(
            f"stroke: an array of shape {_listed(mask.shape)} was sent, for the box {_listed(given)} of an image of "
            f"shape {_listed(shape)}"
        )
    first, second, third = (slice(low, high) for low, high in given)
    return _click(side, (first, second, third), mask != 0)


def outline(grid: Grid, drawn: accelsurf.Click, side: Side) -> list[accelsurf.Click]:
    """Return the clicks of an outline in a slice.

    With the side inside the object about fills it, and lies nowhere else in the slice: a ball around its deepest place
    is inside, the rim around it is outside, and so is the rest of the slice. The rim is a click by itself, for the
    model learns more from near voxels. With the side outside nothing of it is the object's.

    Parameters
    ----------
    grid : Grid
    drawn : Click
        The voxels in the outline.
    side : {"inside", "outside"}

    Raises
    ------
    InputError
        When it lies in more than one slice.
    """
    thin = [axis for axis, n in enumerate(drawn.mask.shape) if n == 1]
    if not thin:
        raise InputError(
            f"outline: {_listed(drawn.mask.shape)} voxels were sent, expected a single slice",
            "draw in one slice",
        )
    if side == "outside":
        return [drawn._replace(side="outside")]
    axis = next((axis for axis in thin if grid.shape[axis] == 1), thin[0])
    spacing = tuple(h for place, h in enumerate(grid.spacing) if place != axis)
    depth = ndimage.distance_transform_edt(
        np.pad(np.squeeze(drawn.mask, axis), 1), sampling=spacing
    )[1:-1, 1:-1]
    deepest = np.argwhere(depth >= (1 - 1e-6) * depth.max())
    middle = deepest[np.argmin(((deepest - deepest.mean(axis=0)) ** 2).sum(axis=1))]
    voxel = [
        int(at) + part.start for at, part in zip(np.insert(middle, axis, 0), drawn.box, strict=True)
    ]
    clicks = [grid.ball(voxel, min(HALF * float(depth.max()) / grid.step, LARGEST), "inside")]
    beyond = np.ones([1 if place == axis else n for place, n in enumerate(grid.shape)], np.bool_)
    here = tuple(slice(None) if place == axis else part for place, part in enumerate(drawn.box))
    beyond[here] &= ~drawn.mask
    wide = [1 if place == axis else 2 * RIM + 1 for place in range(3)]
    near = beyond & (ndimage.maximum_filter(~beyond, wide))
    ends = [
        drawn.box[place] if place == axis else slice(0, n) for place, n in enumerate(grid.shape)
    ]
    for mask in (near, beyond & ~near):
        if mask.any():
            clicks.append(_click("outside", (ends[0], ends[1], ends[2]), mask))
    return clicks


def _click(side: Side, box: Box, mask: Mask) -> accelsurf.Click:
    """Return a click of the voxels in a mask on a box, without empty margins.

    Raises
    ------
    InputError
        When there is none.
    """
    if not mask.any():
        raise InputError("prompt: no voxel is in it", "draw at least one")
    ends = []
    for axis in range(3):
        places = np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis)))
        ends.append(slice(int(places[0]), int(places[-1]) + 1))
    first, second, third = (
        slice(part.start + end.start, part.start + end.stop)
        for part, end in zip(box, ends, strict=True)
    )
    return accelsurf.Click(side, (first, second, third), np.ascontiguousarray(mask[tuple(ends)]))


def _listed(values: Sequence[Any]) -> str:
    return ", ".join(str(value) for value in values)
