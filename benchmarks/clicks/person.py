"""A simulated person: clicks where a result is most wrong, a ball of half the depth there; boxes and strokes at first.

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
from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry

Mask = NDArray[np.bool_]
#: A ball's radius: this part of the depth, at least this part of the largest spacing, at most so many of the smallest.
PART, LEAST_SPACINGS, MOST_SPACINGS = 0.5, 0.5, 8.0
#: Depths that differ by less than this part of the smallest spacing count as equal: spacings in files are rounded.
TIE = 1e-4
#: A jittered click falls anywhere where the depth is above this part of the largest.
JITTER = 0.5


class PersonClick(NamedTuple):
    """A click: "inside" or "outside", the voxel (z, y, x), its centre in the world (x, y, z, mm), radius in mm.

    ``line``: for a stroke the voxels (z, y, x) that it goes through, with the same radius everywhere.
    """

    side: str
    index: tuple[int, int, int]
    centre: tuple[float, float, float]
    radius: float
    line: tuple[tuple[int, int, int], ...] = ()


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
    sides = [
        _deep(wrong[box] & (truth[box] == side), box, truth.shape, geometry.spacing)
        for side in (True, False)
    ]
    index, depth = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    step = TIE * min(geometry.spacing)
    if random is None:
        deepest = index[depth > depth.max() - step]
        at = int(deepest.min())
    else:
        at = int(random.choice(np.sort(index[depth > JITTER * depth.max()])))
    side = "inside" if truth.flat[at] else "outside"
    return _click(side, at, float(depth[index == at][0]), truth, geometry)


def first_stroke(truth: Mask, geometry: Geometry) -> PersonClick:
    """Stroke along the middle of an object, in the slice with most of it.

    The slice is across the axis of the largest spacing (of equal ones the first). The line is the longest way along
    the slice's medial axis, without a tenth at either end; the pen is a ball of half the least depth along it, with the
    bounds of a click.
    """
    axis = int(np.argmax(geometry.spacing))
    counts = truth.sum(axis=tuple(i for i in range(3) if i != axis))
    at = int(np.argmax(counts))
    flat = np.take(truth, at, axis=axis)
    path = _longest_way(flat)
    cut = len(path) // 10
    line = [tuple(np.insert(place, axis, at)) for place in path[cut : len(path) - cut]]
    where = [(int(z), int(y), int(x)) for z, y, x in line]
    box = bounding_box(truth, 1)
    assert box is not None  # an object has voxels
    depth = ndimage.distance_transform_edt(truth[box], sampling=geometry.spacing)
    least = min(
        float(depth[tuple(i - side.start for i, side in zip(place, box, strict=True))])
        for place in where
    )
    middle = where[len(where) // 2]
    click = _click("inside", int(np.ravel_multi_index(middle, truth.shape)), least, truth, geometry)
    click = click._replace(line=tuple(where))
    spot, ball = ball_voxels(click, geometry)
    if np.any(~truth[spot][ball]):
        click = click._replace(radius=0.5 * min(geometry.spacing))
    return click


def _longest_way(flat: Mask) -> NDArray[np.int64]:
    """Pixels (rows and columns) of the longest of the shortest ways along the medial axis of the largest part."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra
    from skimage.morphology import skeletonize

    parts, count = ndimage.label(flat, np.ones((3, 3)))
    if count > 1:
        flat = parts == np.argmax(np.bincount(parts.ravel())[1:]) + 1
    pixels = np.argwhere(skeletonize(flat))
    number = np.full(flat.shape, -1)
    number[tuple(pixels.T)] = np.arange(len(pixels))
    starts = []
    stops = []
    lengths = []
    for step in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = pixels + step
        held = np.flatnonzero(((there >= 0) & (there < flat.shape)).all(axis=1))
        to = number[tuple(there[held].T)]
        starts.append(held[to >= 0])
        stops.append(to[to >= 0])
        lengths.append(np.full(stops[-1].size, np.hypot(*step)))
    links = coo_matrix(
        (np.concatenate(lengths), (np.concatenate(starts), np.concatenate(stops))),
        (len(pixels), len(pixels)),
    )
    end = int(np.argmax(_finite(dijkstra(links, directed=False, indices=0))))
    far, before = dijkstra(links, directed=False, indices=end, return_predecessors=True)
    way = [int(np.argmax(_finite(far)))]
    while way[-1] != end:
        way.append(int(before[way[-1]]))
    return np.asarray(pixels[way])


def _finite(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isfinite(distance), distance, -1.0)


def drawn_box(truth: Mask) -> Box:
    """Tight box around an object."""
    box = bounding_box(truth)
    assert box is not None  # an object has voxels
    return box


def click_in_box(truth: Mask, geometry: Geometry) -> PersonClick:
    """Inside click of a person who has drawn the tight box: of the deep places the one nearest to the box's middle.

    Deep is a place where the depth is above half the largest.
    """
    box = bounding_box(truth, 1)
    assert box is not None  # an object has voxels
    index, depth = _deep(truth[box], box, truth.shape, geometry.spacing)
    middle = np.array([0.5 * (side.start + side.stop - 1) for side in box])
    places = np.stack(np.unravel_index(index, truth.shape), axis=1)
    far = (((places - middle) * geometry.spacing) ** 2).sum(axis=1)
    nearest = int(np.lexsort((index, np.round(far, 6)))[0])
    return _click("inside", int(index[nearest]), float(depth[nearest]), truth, geometry)


def click_of_challenge(truth: Mask, labels: Mask | None, geometry: Geometry) -> PersonClick | None:
    """Next click by the protocol of the CVPR 2025 challenge on interactive segmentation; None where nothing is wrong.

    One voxel, at the deepest place of the largest part (by its voxels) of what is missing or too much.
    """
    wrong = truth if labels is None else truth ^ labels
    box = bounding_box(wrong, 1)
    if box is None:
        return None
    largest, most = None, 0
    for side in (True, False):
        parts, count = ndimage.label(wrong[box] & (truth[box] == side), np.ones((3, 3, 3)))
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        if count and sizes.max() > most:
            largest, most = parts == np.argmax(sizes) + 1, int(sizes.max())
    assert largest is not None  # something is wrong
    index, depth = _deep(largest, box, truth.shape, geometry.spacing)
    at = int(index[depth > depth.max() - TIE * min(geometry.spacing)].min())
    side_name = "inside" if truth.flat[at] else "outside"
    return _click(side_name, at, 0.0, truth, geometry)._replace(radius=0.5 * min(geometry.spacing))


def voxels_of(click: PersonClick, geometry: Geometry) -> Click:
    """A click as its voxels."""
    return Click("inside" if click.side == "inside" else "outside", *ball_voxels(click, geometry))


def ball_voxels(click: PersonClick, geometry: Geometry) -> tuple[Box, Mask]:
    """The box around a click's ball or a stroke, and the voxels in it whose centres are in the ball or stroke.

    Examples
    --------
    >>> click = PersonClick("inside", (2, 2, 2), (2.0, 2.0, 2.0), 1.0)
    >>> box, mask = ball_voxels(click, Geometry((5, 5, 5), (1.0, 1.0, 1.0)))
    >>> box, int(mask.sum())
    ((slice(1, 4, None), slice(1, 4, None), slice(1, 4, None)), 7)
    """
    if click.line:
        return _stroke_voxels(click, geometry)
    reach = [int(click.radius / h) + 1 for h in geometry.spacing]
    low = [max(i - n, 0) for i, n in zip(click.index, reach, strict=True)]
    high = [
        min(i + n + 1, size) for i, n, size in zip(click.index, reach, geometry.shape, strict=True)
    ]
    axes = [
        (np.arange(a, b) - i) * h
        for a, b, i, h in zip(low, high, click.index, geometry.spacing, strict=True)
    ]
    squares = (
        axes[0][:, None, None] ** 2 + axes[1][None, :, None] ** 2 + axes[2][None, None, :] ** 2
    )
    inside = squares <= click.radius**2 * (1 + 1e-9)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    tight = bounding_box(inside)
    assert tight is not None  # the centre is in it
    moved = (slice(box[i].start + tight[i].start, box[i].start + tight[i].stop) for i in range(3))
    return (next(moved), next(moved), next(moved)), inside[tight]


def _stroke_voxels(click: PersonClick, geometry: Geometry) -> tuple[Box, Mask]:
    """The box around a stroke, and the voxels in it that one of its balls holds."""
    balls = [ball_voxels(click._replace(index=place, line=()), geometry) for place in click.line]
    starts = [min(box[i].start for box, _ in balls) for i in range(3)]
    stops = [max(box[i].stop for box, _ in balls) for i in range(3)]
    out = np.zeros([b - a for a, b in zip(starts, stops, strict=True)], bool)
    for box, ball in balls:
        out[
            tuple(slice(side.start - a, side.stop - a) for side, a in zip(box, starts, strict=True))
        ] |= ball
    return (slice(starts[0], stops[0]), slice(starts[1], stops[1]), slice(starts[2], stops[2])), out


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
