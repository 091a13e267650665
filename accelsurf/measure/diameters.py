"""The longest lines of an object: its largest diameter, the one across, and both in an axial slice as RECIST has them.

All are between corners of voxels, in world mm, so that a box of voxels has the length of its edges, on oblique grids
too. A diameter is the longest line between two points. The diameter across is the longest line at right angles to it
between two points of the convex hull. RECIST 1.1 (Eisenhauer et al., Eur J Cancer 45, 2009) measures in one axial
slice: the long axis is the longest diameter there, the short axis the longest line at right angles to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation

#: Points whose distances to all others are computed together.
BATCH = 512


class Diameters(NamedTuple):
    """The ends (2, 3) of four lines, (x, y, z) in world mm, LPS.

    Attributes
    ----------
    longest : ndarray
        Between the two points that are farthest apart.
    across : ndarray
        The longest at right angles to it, in the convex hull.
    axial : ndarray
        The longest within one axial slice, through its middle: RECIST's long axis.
    axial_across : ndarray
        The longest at right angles to that in the same slice, in the hull there: RECIST's short axis.
    """

    longest: Floats
    across: Floats
    axial: Floats
    axial_across: Floats


def diameters(inside: NDArray[np.bool_], corner: tuple[int, ...], geometry: Geometry) -> Diameters:
    """Return the longest lines of an object.

    Parameters
    ----------
    inside : ndarray (nz, ny, nx)
        Its voxels, at least one.
    corner : (int, int, int)
        Index (z, y, x) of the first voxel of ``inside`` on the grid.
    geometry : Geometry
        Of the grid; the slices of an image of one slice have no thickness.
    """
    axial, flat = DisplayOrientation.of(geometry).order[0], geometry.slice_axis
    axial = axial if flat is None else flat  # the slice that there is, whatever its direction
    order = [axial, *(axis for axis in range(3) if axis != axial)]
    ends = _row_ends(inside.transpose(order))[:, np.argsort(order)] + np.asarray(corner)
    longest, across = _longest(_corners(ends, geometry))
    return Diameters(
        longest, across, *_longest(_corners(_widest_slice(ends, axial, geometry), geometry, axial))
    )


def longest_line(points: Floats) -> Floats:
    """Return the two of points (n, 3) that are farthest apart."""
    return _longest(points[_far_enough(points)], with_across=False)[0]


def _widest_slice(ends: NDArray[np.int64], axial: int, geometry: Geometry) -> NDArray[np.int64]:
    """The voxels of the slice that has the longest line; slices that are too small for it are not searched."""
    order = np.argsort(ends[:, axial], kind="stable")
    first = np.flatnonzero(np.diff(ends[order, axial], prepend=-1))
    slices = np.split(ends[order], first[1:])
    spacing = np.array(geometry.spacing) * [axis != axial for axis in range(3)]
    # No line is longer than twice the largest distance from one place.
    bounds = [_width_bound(voxels * spacing) + float(np.linalg.norm(spacing)) for voxels in slices]
    best, longest = slices[0], -1.0
    for place in np.argsort(bounds)[::-1]:
        if bounds[place] <= longest:
            break
        length = _length(_longest(_corners(slices[place], geometry, axial), with_across=False)[0])
        if length > longest:
            best, longest = slices[place], length
    return best


def _width_bound(points: Floats) -> float:
    """Twice the largest distance from the middle of their box: no two points (n, k) are farther apart."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return 2.0 * float(np.sqrt(((points - middle) ** 2).sum(axis=1).max()))


def _length(line: Floats) -> float:
    return float(np.linalg.norm(line[1] - line[0]))


def _row_ends(inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices (n, 3) of the first and the last voxel of each row: no other can be one of the farthest two."""
    rows = np.argwhere(inside.any(axis=2))
    filled = inside[rows[:, 0], rows[:, 1]]
    begin, end = filled.argmax(axis=1), inside.shape[2] - 1 - filled[:, ::-1].argmax(axis=1)
    return np.concatenate([np.column_stack([rows, begin]), np.column_stack([rows, end])])


def _corners(voxels: NDArray[np.int64], geometry: Geometry, flat_axis: int | None = None) -> Floats:
    """The corners of voxels in world mm, each once; flat for an image of one slice, or along an axis."""
    thick = [n > 1 and axis != flat_axis for axis, n in enumerate(geometry.shape)]
    signs = (
        np.array(np.meshgrid(*[(-1, 1) if wide else (0,) for wide in thick], indexing="ij"))
        .reshape(3, -1)
        .T
    )
    doubled = (2 * voxels[:, None, :] + signs).reshape(-1, 3)
    size = tuple(2 * n + 1 for n in geometry.shape)
    once = (
        np.stack(
            np.unravel_index(np.unique(np.ravel_multi_index(tuple((doubled + 1).T), size)), size),
            axis=1,
        )
        - 1
    )
    return np.asarray(geometry.index_to_world(0.5 * once))


def _longest(points: Floats, with_across: bool = True) -> tuple[Floats, Floats]:
    """The longest line between points (n, 3), and the longest across it in their convex hull; both (2, 3)."""
    # Not with the module: the viewer draws its first picture without, and this loads half of SciPy.
    from scipy.spatial import ConvexHull

    middle = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - middle, full_matrices=False)
    rank = int((sizes > 1e-9 * max(float(sizes[0]), 1e-300)).sum())
    within = (points - middle) @ axes[:rank].T
    if rank < 2:  # a line or a point
        ends = [int(within.argmin()), int(within.argmax())] if rank else [0, 0]
        return points[ends], points[[ends[0]] * 2]
    hull = ConvexHull(within)
    line = _farthest(within[hull.vertices])
    across = (
        _longest_across(within, hull.simplices, line) if with_across else line[:1].repeat(2, axis=0)
    )
    return middle + line @ axes[:rank], middle + across @ axes[:rank]


def _farthest(points: Floats) -> Floats:
    """The two points that are farthest apart; distances are computed in batches, to bound the memory."""
    from scipy.spatial.distance import cdist

    points = points[_far_enough(points)]
    best, longest = points[[0, 0]], -1.0
    for first in range(0, len(points), BATCH):
        distances = cdist(points[first : first + BATCH], points[first:], "sqeuclidean")
        near_end, far_end = np.unravel_index(int(distances.argmax()), distances.shape)
        if distances[near_end, far_end] > longest:
            best, longest = (
                points[[first + near_end, first + far_end]],
                float(distances[near_end, far_end]),
            )
    return best


def _far_enough(points: Floats) -> NDArray[np.bool_]:
    """True for points (n, 3) that may be one of the two farthest apart: others are too near the middle."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radii = np.sqrt(((points - middle) ** 2).sum(axis=1))
    start = points[radii.argmax()]
    least = float(np.sqrt(((points - start) ** 2).sum(axis=1).max()))
    return np.asarray(radii >= (least - radii.max()) * (1 - 1e-12))


def _longest_across(points: Floats, facets: NDArray[np.int32], line: Floats) -> Floats:
    """The longest line of a convex hull at right angles to a line.

    Between two vertices, along the line, a section of the hull is a mean of the sections there, and its width in each
    direction is linear; so the longest line lies at the height of a vertex.
    """
    axis = (line[1] - line[0]) / max(_length(line), 1e-300)
    edges = _edges(facets)
    heights, near = points @ axis, 1e-9 * _length(line)
    levels, middle = np.unique(heights[np.unique(edges)]), float(line.mean(axis=0) @ axis)
    low, high = heights[edges].min(axis=1) - near, heights[edges].max(axis=1) + near
    best, longest = line[:1].repeat(2, axis=0), 0.0
    for place in np.argsort(
        np.abs(levels - middle), kind="stable"
    ):  # the widest are near the middle
        height = levels[place]
        met = edges[(low <= height) & (height <= high)]
        a, b = points[met[:, 0]], points[met[:, 1]]
        from_a, rise = height - a @ axis, (b - a) @ axis
        flat = np.abs(rise) <= near
        share = np.clip(from_a / np.where(flat, 1.0, rise), 0.0, 1.0)
        found = np.concatenate([a + share[:, None] * (b - a), b[flat]])
        found = found - np.outer(found @ axis - height, axis)
        if len(found) < 2 or _width_bound(found) <= longest:
            continue
        candidate = _farthest(found)
        if _length(candidate) > longest:
            best, longest = candidate, _length(candidate)
    return best


def _edges(facets: NDArray[np.int32]) -> NDArray[np.int32]:
    """The edges (n, 2) of facets, each once."""
    count = facets.shape[1]
    edges = np.concatenate([facets[:, [a, b]] for a in range(count) for b in range(a + 1, count)])
    return np.asarray(np.unique(np.sort(edges, axis=1), axis=0))
