"""Placement of the vertices of a mesh or a contour: on the surface, then so that it encloses the surface's volume.

Marching cubes puts vertices where psi, linear along an edge of the grid, is 0, and joins them by flat triangles. Both
cut convex surfaces: the mesh of an exact ball of radius R loses 0.59 (h/R)^2 of its volume, 15 % at R = 2 h. Two steps
mend that:

1. `on_edges`: the zero along the edge of the cubic through its four nodes. Where the second differences at the two
   ends disagree, as at a ridge of psi between two walls, of the parabola with the smaller of the two, or 0.
2. `balanced`: a triangle inscribed in a surface of curvature tensor K lies below it by the sum of e . K e / 24 over its
   edges e, on average; the segments of a contour in an image of one slice by e . K e / 12. Each vertex moves outwards
   by the mean of that over its triangles, weighted by their areas: to leading order the mesh then encloses the
   surface's volume. Along an edge K e is the change of the normal.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats, Mask, Psi

Numbers = NDArray[np.intp]

#: The cubic is used where the second differences at both ends have one sign, and the smaller at least this part of the
#: larger: on a ball of radius 2 voxels they do.
MIN_RATIO = 0.25
#: Halvings of an edge: until 1e-7 of it.
HALVINGS = 24
#: Rounds in which the displacements are averaged among neighbours: they then differ little within a sliver.
ROUNDS = 4
#: Largest displacement of a triangle, parts of the smallest spacing.
MAX_GAP = 0.5
#: |grad psi| by centred differences from which on there is one normal: less is a ridge of psi, as inside an edge of the
#: object.
MIN_SLOPE = 0.8
#: Part of a unit normal within a slice from which on it says how the slice's contour is curved.
MIN_IN_PLANE = 0.2
#: Cosine between the normals at the ends of an edge up to which there is a curvature: a surface of radius 1 voxel, or
#: an edge of the object, turns by more.
MIN_COSINE = 0.5
#: A part is small where psi on its side stays within this number of voxels of the coarsest axis.
THICK = 2.0
#: Cosine between the normals of psi at the ends of a side below which a face needs more than its curvature, ...
TURNED = 0.8
#: ... if that between the normals of the mesh is below this. The walls of a thin sheet, where psi is flat as well, need
#: no more, and beside the ridge between them the cubic errs.
BENT = 0.97
#: Least slope of psi over a voxel along the normal, on one side: else psi is no distance there.
SMALL_MIN_SLOPE = 0.7
#: Largest slope between two voxels.
MAX_SLOPE = 1.1
#: Steps, each by the mean of the remainder.
STEPS = 4
#: Rounds in which a step is averaged among neighbours, so that single vertices do not stick out.
SMALL_ROUNDS = 1
#: Longest way of a vertex, parts of a voxel's size along the normal.
MAX_WAY = 0.7
#: Points whose psi is interpolated at a time: their arrays then stay in the cache.
AT_A_TIME = 1 << 14


def on_edges(zyx: Floats, psi: Psi, spacing: tuple[float, float, float], margin: float) -> Floats:
    """Move vertices along their edges of the grid to the zero of psi there.

    Parameters
    ----------
    zyx : ndarray, shape (n, 3)
        Index positions where psi, linear along the edges, is 0.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm.
    spacing : (hz, hy, hx)
        mm.
    margin : float
        Values of psi closer to 0 count as so far from it.

    Returns
    -------
    ndarray, shape (n, 3)
        Vertices that lie on no edge are where they were.
    """
    on_cap = _on_cap(zyx, psi.shape)
    between = (zyx > np.floor(zyx)) & ~on_cap
    on_edge = between.sum(axis=1) == 1
    placed = zyx.copy()
    for axis in range(3):
        which = np.flatnonzero(on_edge & between[:, axis])
        for some in _chunks(which.size):
            placed[which[some], axis] = _zeros_along(
                zyx[which[some]], axis, psi, spacing[axis], margin
            )
    return placed


def in_cells(zyx: Floats, faces: NDArray[np.integer], shape: tuple[int, ...]) -> Floats:
    """Move vertices within a cell, on no edge of the grid, to the mean of their neighbours, which lie on edges.

    Marching cubes puts one into some cells, at the mean in single precision from the corner of its box: without this it
    would depend by rounding on where the rest of the object ends, and so would all vertices around it.
    """
    between = (zyx > np.floor(zyx)) & ~_on_cap(zyx, shape)
    inner = between.sum(axis=1) > 1
    if not inner.any():
        return zyx
    corners = faces[inner[faces].any(axis=1)].T.astype(np.intp)
    others = zip(corners, np.roll(corners, -1, axis=0), np.roll(corners, 1, axis=0), strict=True)
    total, count = np.zeros(zyx.shape), np.zeros(len(zyx))
    for corner, *beside in others:
        for other in beside:
            count += np.bincount(corner, minlength=len(zyx))
            for axis in range(3):
                total[:, axis] += np.bincount(corner, zyx[other, axis], len(zyx))
    placed = zyx.copy()
    placed[inner] = total[inner] / count[inner, None]
    return placed


def _zeros_along(zyx: Floats, axis: int, psi: Psi, h: float, margin: float) -> Floats:
    """Positions along ``axis``, of spacing ``h``, of the zeros between the nodes around each vertex."""
    n = psi.shape[axis]
    index = _nearest(zyx, psi.shape)
    first = np.floor(zyx[:, axis]).astype(np.int64)

    def node(k: int) -> Floats:
        # Beyond the border psi is mirrored at the outer face of its voxels.
        at = [index[:, a] for a in range(3)]
        at[axis] = np.clip(first + k, 0, n - 1)
        return psi[tuple(at)].astype(np.float64)

    below, a, b, above = (node(k) for k in (-1, 0, 1, 2))
    a, b = (np.where(np.abs(v) < margin, np.where(v < 0, -margin, margin), v) for v in (a, b))
    low, high = below - 2 * a + b, a - 2 * b + above
    # Second differences of a distance are at most 2 h: else psi is none, as where a region of interest cuts the object.
    agree = (low * high > 0) & (np.maximum(np.abs(low), np.abs(high)) <= 2.01 * h)
    smaller = np.where(np.abs(low) < np.abs(high), low, high)
    cubic = agree & (np.abs(smaller) >= MIN_RATIO * np.maximum(np.abs(low), np.abs(high)))
    limited = np.where(agree, smaller, 0.0)
    low, high = np.where(cubic, low, limited), np.where(cubic, high, limited)

    left, right = np.zeros_like(a), np.ones_like(a)
    for _ in range(HALVINGS):
        t = 0.5 * (left + right)
        # The cubic through four nodes, by its second differences at the two inner ones.
        value = a + (b - a) * t - t * (1 - t) * ((2 - t) * low + (1 + t) * high) / 6
        same = (value < 0) == (a < 0)
        left, right = np.where(same, t, left), np.where(same, right, t)
    return first + 0.5 * (left + right)


def _nearest(zyx: Floats, shape: tuple[int, ...]) -> Numbers:
    """Index of the voxel nearest to each position, within the volume."""
    return np.clip(np.rint(zyx).astype(np.int64), 0, np.array(shape) - 1)


def _on_cap(zyx: Floats, shape: tuple[int, ...]) -> Mask:
    """Test which coordinates lie on the volume's outer faces, (n, 3)."""
    return (zyx == -0.5) | (zyx == np.array(shape) - 0.5)


def balanced(
    zyx: Floats,
    faces: NDArray[np.integer],
    psi: Psi,
    spacing: tuple[float, float, float],
    across: int | None = None,
) -> Floats:
    """Move vertices along the normals so that they enclose the volume (area) of the surface (curve) that they lie on.

    Parameters
    ----------
    zyx : ndarray, shape (n, 3)
        Index positions on the surface. Those on the volume's outer faces stay on them.
    faces : ndarray, shape (m, 3) or (m, 2)
        Vertex numbers of the triangles or the segments, of either orientation.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm: its gradient gives the normals.
    spacing : (hz, hy, hx)
        mm.
    across : int, optional
        Axis along which the vertices do not move: that of the slice which a contour lies in.

    Returns
    -------
    ndarray, shape (n, 3)
        Index positions.
    """
    h, corners = np.array(spacing), faces.T.astype(np.intp)
    on_cap = _on_cap(zyx, psi.shape)
    normals, known = _normals(zyx, on_cap, psi, h)
    if across is not None:
        normals, known = _within(normals, known, across)
    # The surface meets the outer faces at a right angle, as psi is continued there: its rim moves on the face.
    normals[on_cap] = 0.0
    size, gap, cosine = _gaps(zyx * h, normals, corners)
    is_known = known[corners].all(axis=0)
    # The thickness of a slice does not count.
    moving = (
        step
        for a, (step, n) in enumerate(zip(spacing, psi.shape, strict=True))
        if n > 1 and a != across
    )
    most = MAX_GAP * min(moving, default=h.min())
    # Around an edge or a corner of the object no curvature says where the surface is.
    gap = np.clip(np.where(is_known & (cosine > MIN_COSINE), gap, 0.0), -most, most)
    # Caps are flat, and have no share in the rim's displacement.
    free = ~on_cap.T.take(corners, axis=1).all(axis=1).any(axis=0)
    size[~free] = 0.0

    around = np.maximum(_per_vertex(corners, size, len(zyx)), 1e-300)
    distance = _per_vertex(corners, size * gap, len(zyx)) / around
    for _ in range(ROUNDS):
        distance = _per_vertex(corners, size * distance[corners].mean(axis=0), len(zyx)) / around
    placed = np.asarray(zyx + distance[:, None] * normals / h)
    # In the slice of a volume psi is no distance from the contour.
    rough = ~is_known | (cosine < TURNED)
    return (
        placed
        if across is not None
        else with_zero_means(placed, corners[:, free], rough[free], psi, h, normals)
    )


def _chunks(count: int) -> Iterator[slice]:
    """Cut a range into parts of `AT_A_TIME`."""
    return (slice(start, start + AT_A_TIME) for start in range(0, count, AT_A_TIME))


def _gaps(at: Floats, normals: Floats, corners: Numbers) -> tuple[Floats, Floats, Floats]:
    """Size of each face, how far the surface is from it on average, and the least cosine between its normals."""
    found = np.empty((3, corners.shape[1]))
    at = _by_axis(at)
    normals = _by_axis(normals)
    for some in _chunks(corners.shape[1]):
        places, directions = (vectors.take(corners[:, some], axis=1) for vectors in (at, normals))
        edges, turns = (
            np.roll(places, -1, axis=1) - places,
            np.roll(directions, -1, axis=1) - directions,
        )
        found[0, some] = _lengths(
            _cross(edges[:, 0], edges[:, 1]) if len(corners) == 3 else edges[:, 0]
        )
        # The one edge of a segment counts twice here.
        found[1, some] = np.einsum("mij,mij->m", edges.T.copy(), turns.T.copy()) / 24
        found[2, some] = _least_cosine(directions)
    return found[0], found[1], found[2]


def _within(normals: Floats, known: Mask, across: int) -> tuple[Floats, Mask]:
    """Normals of the curve in which a slice cuts the surface; where the slice all but touches it they say nothing."""
    inside = normals.copy()
    inside[:, across] = 0.0
    length = np.linalg.norm(inside, axis=1)
    return inside / np.maximum(length, MIN_IN_PLANE)[:, None], known & (length >= MIN_IN_PLANE)


def _per_vertex(corners: Numbers, values: Floats, n: int) -> Floats:
    """Sum over the faces around each of the ``n`` vertices."""
    return np.asarray(sum(np.bincount(vertex, values, n) for vertex in corners))


def _normals(zyx: Floats, on_cap: Mask, psi: Psi, h: Floats) -> tuple[Floats, Mask]:
    """Outward unit normals (n, 3) by centred differences, linear between the two nodes of an edge; where known (n,)."""
    flat = np.ascontiguousarray(psi).ravel()
    last = np.array(psi.shape) - 1
    gradient = np.empty(zyx.shape)
    for some in _chunks(len(zyx)):
        at, is_capped = zyx[some], on_cap[some]
        low = np.clip(np.floor(np.where(is_capped, np.rint(at), at)).astype(np.int64), 0, last)
        part = np.where(is_capped, 0.0, at - low).max(axis=1)
        high = np.clip(np.ceil(np.where(is_capped, low, at)).astype(np.int64), 0, last)
        for axis, ends in enumerate(
            zip(*(_slopes(flat, node.T, psi.shape, h) for node in (low, high)), strict=True)
        ):
            gradient[some, axis] = (1 - part) * ends[0] + part * ends[1]
    norm = np.linalg.norm(gradient, axis=1)
    known = norm >= MIN_SLOPE
    return gradient / np.maximum(norm, MIN_SLOPE)[:, None], known


def _slopes(flat: Psi, nodes: Numbers, shape: tuple[int, ...], h: Floats) -> Iterator[Floats]:
    """Centred differences along each axis at nodes (3, n) of a raveled volume, one-sided on the border."""
    index, stride = np.ravel_multi_index(tuple(nodes), shape), flat.size
    for place, n, step in zip(nodes, shape, h, strict=True):
        stride //= n
        before, after = (place > 0).astype(np.int64), (place < n - 1).astype(np.int64)
        difference = flat[index + after * stride] - flat[index - before * stride]
        yield difference / (np.maximum(before + after, 1) * step)


def with_zero_means(
    zyx: Floats, corners: Numbers, rough: Mask, psi: Psi, h: Floats, outward: Floats
) -> Floats:
    """Move vertices of the ``rough`` faces of small parts along the mesh's normals until psi is 0 on average there.

    Parameters
    ----------
    zyx : ndarray, shape (n, 3)
        Index positions.
    corners : ndarray, shape (3, m) or (2, m)
        Vertex numbers of the triangles or the segments, of either orientation.
    rough : ndarray, shape (m,), bool
        Which faces may turn by too much for their curvature to tell the surface between their corners.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm.
    h : ndarray, shape (3,)
        Spacing, mm.
    outward : ndarray, shape (n, 3)
        Roughly outward vectors; 0 along axes along which a vertex must not move.

    Returns
    -------
    ndarray, shape (n, 3)
        Index positions.
    """
    if not rough.any():
        return zyx
    normals, turned = _mesh_normals(zyx * h, corners, outward), corners[:, rough]
    bent = turned[:, _least_cosine(_by_axis(normals).take(turned, axis=1)) < BENT]
    small = np.flatnonzero(np.bincount(bent.ravel()))
    small = small[_is_small(zyx[small], psi, h)]
    active = np.zeros(len(zyx), np.bool_)
    active[small[_is_distance(zyx[small], normals[small], psi, h)]] = True
    around = corners[:, active[corners].any(axis=0)]
    if not around.size:
        return zyx
    is_used = np.bincount(around.ravel(), minlength=len(zyx)) > 0
    numbers, local = np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[around]
    sides, side_of = _sides(local)
    start = zyx[numbers]
    along = normals[numbers]
    free = active[numbers]
    most = MAX_WAY * np.linalg.norm(along * h, axis=1)
    way = np.zeros(len(numbers))
    for _ in range(STEPS):
        at = start + way[:, None] * along / h
        size = _lengths(_area_vectors(at * h, local))
        total = np.maximum(_per_vertex(local, size, len(at)), 1e-300)
        gap = -_means(psi, at, local, sides, side_of)
        for _ in range(1 + SMALL_ROUNDS):
            step = _per_vertex(local, size * gap, len(at)) / total
            gap = step[local].mean(axis=0)
        way = np.clip(way + np.where(free, step, 0.0), -most, most)
    out = zyx.copy()
    out[numbers] = start + way[:, None] * along / h
    return out


def _means(psi: Psi, at: Floats, corners: Numbers, sides: Numbers, side_of: Numbers) -> Floats:
    """Mean of psi over each face, exact for quadratic functions; ``sides`` and ``side_of`` as `_sides` gives them."""
    means = cubic_at(psi, (at[sides[0]] + at[sides[1]]) / 2)[side_of].mean(axis=0)
    if len(corners) == 2:
        # Simpson's rule: the ends count too.
        means = 2 / 3 * means + cubic_at(psi, at)[corners].mean(axis=0) / 3
    return np.asarray(means)


def _sides(corners: Numbers) -> tuple[Numbers, Numbers]:
    """Vertex numbers of each side of the faces once (2, k), and which of these sides a face has (3, m) or (1, m)."""
    if len(corners) == 2:
        return corners, np.arange(corners.shape[1])[None]
    others, count = np.roll(corners, -1, axis=0), corners.max() + 1
    keys, which = np.unique(
        np.minimum(corners, others) * count + np.maximum(corners, others), return_inverse=True
    )
    return np.stack(np.divmod(keys, count)), which.reshape(corners.shape)


def cubic_at(psi: Psi, at: Floats) -> Floats:
    """Interpolate psi at index positions (n, 3) by the cubic of four nodes per axis; beyond the border it is mirrored.

    Along an axis of one slice psi does not vary.
    """
    value = np.zeros(len(at))
    at = _by_axis(at)
    shape = psi.shape
    if not value.size:
        return value
    first = np.zeros(at.shape, np.int64)
    begin = np.zeros(3, np.int64)
    end = np.array(psi.shape)
    for axis, n in enumerate(psi.shape):
        if n > 1:
            first[axis] = np.floor(at[axis]) - 1.0
            begin[axis], end[axis] = first[axis].min(), first[axis].max() + 4
    if (begin < 0).any() or (end > psi.shape).any():
        for axis, n in enumerate(psi.shape):
            psi = psi.take(_mirrored(np.arange(begin[axis], end[axis]), n), axis)
    else:
        begin[:] = 0
    flat, strides = (
        np.ascontiguousarray(psi).ravel(),
        (psi.shape[1] * psi.shape[2], psi.shape[2], 1),
    )
    for some in _chunks(len(value)):
        nodes = sum((first[a, some] - begin[a]) * strides[a] for a in range(3))
        of_planes, of_lines, of_places = (
            _weights(at[a, some] - (first[a, some] + 1), n) for a, n in enumerate(shape)
        )
        for (plane, of_plane), (line, of_line) in itertools.product(
            enumerate(of_planes), enumerate(of_lines)
        ):
            row = flat[plane * strides[0] + line * strides[1] :]
            along = sum(w * row[k:].take(nodes, mode="clip") for k, w in enumerate(of_places))
            value[some] += of_plane * of_line * along
    return value


def _weights(u: Floats, n: int) -> list[Floats]:
    """Weights of four nodes at positions ``u`` from the second on, or of the one of an axis of ``n`` = 1."""
    if n == 1:
        return [np.ones_like(u)]
    before, after = u * (u - 1), (u + 1) * (u - 2)
    return [-before * (u - 2) / 6, after * (u - 1) / 2, -after * u / 2, before * (u + 1) / 6]


def _mirrored(index: Numbers, n: int) -> Numbers:
    """Indices, those beyond the border mirrored at the outer face of its voxels."""
    index = np.where(index < 0, -1 - index, index)
    return np.clip(np.where(index >= n, 2 * n - 1 - index, index), 0, n - 1)


def _is_small(zyx: Floats, psi: Psi, h: Floats) -> Mask:
    """Test if the object, or the space around it, is small at each vertex, (n,): see `THICK`.

    From the voxel of the vertex on the way leads to the deepest of the voxels around, one by one. Not where psi changes
    by more than a distance between them.
    """
    steps = [step for step, n in zip(h, psi.shape, strict=True) if n > 1] or [float(h.max())]
    enough, flat = THICK * max(steps), np.ascontiguousarray(psi).ravel()
    nearest = np.ravel_multi_index(tuple(_nearest(zyx, psi.shape).T), psi.shape)
    cells, of_vertex = np.unique(nearest, return_inverse=True)
    small, steep = np.zeros((2, len(cells)), np.bool_)
    for side in (-1, 1):
        deepest, moving = cells.copy(), np.arange(len(cells))
        for _ in range(int(np.ceil(enough / min(steps))) + 1):
            here = deepest[moving]
            deepest[moving], is_steep = _deepest_around(here, side, flat, psi.shape, h)
            steep[moving] |= is_steep
            moving = moving[deepest[moving] != here]
        small |= side * flat[deepest] < enough
    return (small & ~steep)[of_vertex]


def _deepest_around(
    cells: Numbers, side: int, flat: Psi, shape: tuple[int, ...], h: Floats
) -> tuple[Numbers, Mask]:
    """Return which of a cell and those around it is deepest on a side, and if psi changes by too much between them."""
    deepest, steep = cells.copy(), np.zeros(cells.shape, np.bool_)
    for some in _chunks(cells.size):
        here = cells[some]
        stride = flat.size
        steps = []
        for place, n in zip(np.unravel_index(here, shape), shape, strict=True):
            stride //= n
            steps.append(
                [(np.clip(place + shift, 0, n - 1) - place) * stride for shift in (-1, 0, 1)]
            )
        level = depth = side * flat[here]
        for shift in itertools.product((-1, 0, 1), repeat=3):
            other = here + sum(steps[axis][k + 1] for axis, k in enumerate(shift))
            value = side * flat.take(other)
            steep[some] |= np.abs(value - level) > MAX_SLOPE * np.linalg.norm(shift * h)
            deeper = value > depth
            np.copyto(deepest[some], other, where=deeper)
            depth = np.where(deeper, value, depth)
    return deepest, steep


def _is_distance(zyx: Floats, normals: Floats, psi: Psi, h: Floats) -> Mask:
    """Test if psi rises as a distance does along the normal of each vertex, outside or inside, (n,)."""
    voxel = np.linalg.norm(normals * h, axis=1)
    way = voxel[:, None] * normals / h
    here = cubic_at(psi, zyx)
    most = np.maximum(cubic_at(psi, zyx + way) - here, here - cubic_at(psi, zyx - way))
    return np.asarray(most >= SMALL_MIN_SLOPE * voxel)


def _mesh_normals(at: Floats, corners: Numbers, outward: Floats) -> Floats:
    """Outward unit normals of the mesh at its vertices (n, 3), by the sizes of the faces around each."""
    normals = np.stack(
        [_per_vertex(corners, across, len(at)) for across in _area_vectors(at, corners)], axis=1
    )
    normals[outward == 0.0] = 0.0
    normals *= np.sign((normals * outward).sum()) or 1.0
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None])


def _by_axis(vectors: Floats) -> Floats:
    """Vectors (n, 3) as (3, n), to be taken at corners (k, m) as (3, k, m): sums then run along the memory."""
    return np.ascontiguousarray(vectors.T)


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products of vectors (3, m)."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _lengths(vectors: Floats) -> Floats:
    """Lengths of vectors (3, m)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=0)))


def _least_cosine(normals: Floats) -> Floats:
    """Smallest cosine between the unit normals (3, k, m) at the corners of each face."""
    return np.asarray((normals * np.roll(normals, -1, axis=1)).sum(axis=0).min(axis=0))


def _area_vectors(at: Floats, corners: Numbers) -> Floats:
    """Vectors across the faces (3, m): as long as twice a triangle's area; within the slice, as a segment is long."""
    found, at = np.empty((3, corners.shape[1])), _by_axis(at)
    # The axis along which no segment goes.
    flat = np.eye(3)[int(np.ptp(at, axis=1).argmin())][:, None]
    for some in _chunks(corners.shape[1]):
        places = at.take(corners[:, some], axis=1)
        along = places[:, 1:] - places[:, :1]
        found[:, some] = _cross(along[:, 0], along[:, 1] if len(corners) == 3 else flat)
    return found
