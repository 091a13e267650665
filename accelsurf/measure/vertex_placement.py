"""Placement of the vertices of a mesh or a contour: on the surface, then so that it encloses the surface's volume.

Marching cubes puts vertices where psi, linear along an edge of the grid, is 0, and joins them by flat triangles. Both
cut convex surfaces: the mesh of an exact ball of radius R loses 0.59 (h/R)^2 of its volume, 15 % at R = 2 h. Two steps
mend that:

1. `on_edges`: the zero along the edge of the cubic through its four nodes. Where the second differences at the two
   ends disagree, as at a ridge of psi between two walls, of the parabola with the smaller of the two, or 0.
2. `balanced`: a triangle inscribed in a surface of curvature tensor K lies below it by the sum of e . K e / 24 over its
   edges e, on average; the segments of a contour in an image of one slice by e . K e / 12. Each vertex moves outwards
   by the mean of that over its triangles, weighted by their areas: to leading order the mesh then encloses what the
   surface does. Along an edge K e is the change of the normal.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

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
#: A part is small where psi on its side stays within so many voxels of the coarsest axis.
THICK = 2.0
#: Cosine between the normals of psi at the ends of a side below which a face needs more than its curvature, ...
TURNED = 0.8
#: ... if that between the normals of the mesh is below this. The walls of a thin sheet, where psi is flat as well, have
#: what they need, and beside the ridge between them the cubic errs.
BENT = 0.97
#: Least slope of psi over a voxel along the normal, on one side: else psi is no distance there.
SMALL_MIN_SLOPE = 0.7
#: Largest slope between two voxels.
MAX_SLOPE = 1.1
#: Steps, each by the mean of what is left.
STEPS = 4
#: Rounds in which a step is averaged among neighbours, so that single vertices do not stick out.
SMALL_ROUNDS = 1
#: Longest way of a vertex, parts of a voxel's size along the normal.
MAX_WAY = 0.7
#: Points whose psi is interpolated at a time: their arrays then stay in the cache.
AT_A_TIME = 1 << 14


def on_edges(
    zyx: Floats, psi: NDArray[np.float32], spacing: tuple[float, float, float], margin: float
) -> Floats:
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
        if which.size:
            placed[which, axis] = _zeros_along(zyx[which], axis, psi, spacing[axis], margin)
    return placed


def _zeros_along(zyx: Floats, axis: int, psi: NDArray[np.float32], h: float, margin: float) -> Floats:
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


def _nearest(zyx: Floats, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Index of the voxel nearest to each position, within the volume."""
    return np.clip(np.rint(zyx).astype(np.int64), 0, np.array(shape) - 1)


def _on_cap(zyx: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Test which coordinates lie on the volume's outer faces, (n, 3)."""
    return (zyx == -0.5) | (zyx == np.array(shape) - 0.5)


def balanced(
    zyx: Floats,
    faces: NDArray[np.integer],
    psi: NDArray[np.float32],
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
    h = np.array(spacing)
    on_cap = _on_cap(zyx, psi.shape)
    normals, known = _normals(zyx, on_cap, psi, h)
    if across is not None:
        normals, known = _within(normals, known, across)
    # The surface meets the outer faces at a right angle, as psi is continued there: its rim moves on the face.
    normals[on_cap] = 0.0
    corners, corner_normals = (zyx * h)[faces], normals[faces]
    edges, turns = np.roll(corners, -1, axis=1) - corners, np.roll(corner_normals, -1, axis=1) - corner_normals
    size = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]) if faces.shape[1] == 3 else edges[:, 0], axis=1)
    # The one edge of a segment counts twice here.
    gap = np.einsum("mij,mij->m", edges, turns) / 24
    # Around an edge or a corner of the object no curvature says where the surface is.
    cosine = least_cosine(corner_normals)
    smooth = known[faces].all(axis=1) & (cosine > MIN_COSINE)
    # The thickness of a slice does not count.
    moving = (step for a, (step, n) in enumerate(zip(spacing, psi.shape, strict=True)) if n > 1 and a != across)
    most = MAX_GAP * min(moving, default=h.min())
    gap = np.clip(np.where(smooth, gap, 0.0), -most, most)
    # Caps are flat, and have no share in the rim's displacement.
    is_cap = on_cap[faces].all(axis=1).any(axis=1)
    size[is_cap] = 0.0

    around = np.maximum(_per_vertex(faces, size, len(zyx)), 1e-300)
    distance = np.zeros(len(zyx))
    for _ in range(1 + ROUNDS):
        distance = _per_vertex(faces, size * gap, len(zyx)) / around
        gap = distance[faces].mean(axis=1)
    placed = np.asarray(zyx + distance[:, None] * normals / h)
    # In the slice of a volume psi is no distance from the contour.
    rough = ~known[faces].all(axis=1) | (cosine < TURNED)
    return placed if across is not None else with_zero_means(placed, faces[~is_cap], rough[~is_cap], psi, h, normals)


def _within(normals: Floats, known: NDArray[np.bool_], across: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Normals of the curve in which a slice cuts the surface; where the slice all but touches it they say nothing."""
    inside = normals.copy()
    inside[:, across] = 0.0
    length = np.linalg.norm(inside, axis=1)
    return inside / np.maximum(length, MIN_IN_PLANE)[:, None], known & (length >= MIN_IN_PLANE)


def _per_vertex(faces: NDArray[np.integer], values: Floats, n: int) -> Floats:
    """Sum over the faces around each of the ``n`` vertices."""
    return np.asarray(sum(np.bincount(faces[:, k], values, n) for k in range(faces.shape[1])))


def _normals(
    zyx: Floats, on_cap: NDArray[np.bool_], psi: NDArray[np.float32], h: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Outward unit normals (n, 3) by centred differences, linear between the two nodes of an edge; where known (n,)."""
    low = np.clip(np.floor(np.where(on_cap, np.rint(zyx), zyx)).astype(np.int64), 0, np.array(psi.shape) - 1)
    part = np.where(on_cap, 0.0, zyx - low).max(axis=1)
    high = np.clip(np.ceil(np.where(on_cap, low, zyx)).astype(np.int64), 0, np.array(psi.shape) - 1)
    gradient = np.empty(zyx.shape)
    for axis, n in enumerate(psi.shape):
        ends = []
        for node in (low, high):
            at = [node[:, a] for a in range(3)]
            before, after = np.maximum(at[axis] - 1, 0), np.minimum(at[axis] + 1, n - 1)
            difference = psi[(*at[:axis], after, *at[axis + 1 :])] - psi[(*at[:axis], before, *at[axis + 1 :])]
            ends.append(difference / (np.maximum(after - before, 1) * h[axis]))
        gradient[:, axis] = (1 - part) * ends[0] + part * ends[1]
    norm = np.linalg.norm(gradient, axis=1)
    known = norm >= MIN_SLOPE
    return gradient / np.maximum(norm, MIN_SLOPE)[:, None], known


def with_zero_means(
    zyx: Floats, faces: NDArray[np.integer], rough: NDArray[np.bool_], psi: NDArray[np.float32], h: Floats,
    outward: Floats,
) -> Floats:
    """Move vertices of the ``rough`` faces of small parts along the mesh's normals until psi is 0 on average there.

    Parameters
    ----------
    zyx : ndarray, shape (n, 3)
        Index positions.
    faces : ndarray, shape (m, 3) or (m, 2)
        Triangles or segments, of either orientation.
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
    normals, turned = _mesh_normals(zyx * h, faces, outward), faces[rough]
    small = np.unique(turned[least_cosine(normals[turned]) < BENT])
    small = small[_is_small(zyx[small], psi, h)]
    active = np.zeros(len(zyx), np.bool_)
    active[small] = True
    active[active] = _is_distance(zyx[active], normals[active], psi, h)
    around = faces[active[faces].any(axis=1)]
    if not len(around):
        return zyx
    numbers, local = np.unique(around, return_inverse=True)
    local = local.reshape(around.shape)
    sides, side_of = _sides(local)
    start, along, free = zyx[numbers], normals[numbers], active[numbers]
    most = MAX_WAY * np.linalg.norm(along * h, axis=1)
    way = np.zeros(len(numbers))
    for _ in range(STEPS):
        at = start + way[:, None] * along / h
        size = _sizes((at * h)[local])
        total = np.maximum(_per_vertex(local, size, len(at)), 1e-300)
        gap = -_means(psi, at, local, sides, side_of)
        for _ in range(1 + SMALL_ROUNDS):
            step = _per_vertex(local, size * gap, len(at)) / total
            gap = step[local].mean(axis=1)
        way = np.clip(way + np.where(free, step, 0.0), -most, most)
    out = zyx.copy()
    out[numbers] = start + way[:, None] * along / h
    return out


def _means(
    psi: NDArray[np.float32], at: Floats, faces: NDArray[np.integer], sides: NDArray[np.integer],
    side_of: NDArray[np.integer],
) -> Floats:
    """Mean of psi over each face, exact for quadratic functions; ``sides`` and ``side_of`` as `_sides` gives them."""
    means = cubic_at(psi, at[sides].mean(axis=1))[side_of].mean(axis=1)
    if faces.shape[1] == 2:
        # Simpson's rule: the ends count too.
        means = 2 / 3 * means + cubic_at(psi, at)[faces].mean(axis=1) / 3
    return means


def _sides(faces: NDArray[np.integer]) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Vertex numbers of each side of the faces once (k, 2), and which of these sides a face has (m, 3) or (m, 1)."""
    if faces.shape[1] == 2:
        return faces, np.arange(len(faces))[:, None]
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = ends.min(axis=1), ends.max(axis=1)
    _, first, which = np.unique(low * (high.max() + 1) + high, return_index=True, return_inverse=True)
    return ends[first], which.reshape(-1, 3)


def cubic_at(psi: NDArray[np.float32], at: Floats) -> Floats:
    """Interpolate psi at index positions (n, 3) by the cubic of four nodes per axis; beyond the border it is mirrored.

    Along an axis of one slice psi does not vary.
    """
    flat, value = np.ascontiguousarray(psi).ravel(), np.zeros(len(at))
    for start in range(0, len(at), AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        (z, wz), (y, wy), (x, wx) = (_four_nodes(at[some, a], n) for a, n in enumerate(psi.shape))
        for plane, of_plane in zip(z, wz, strict=True):
            for line, of_line in zip(y, wy, strict=True):
                row = (plane * psi.shape[1] + line) * psi.shape[2]
                along = sum(w * flat.take(row + k) for k, w in zip(x, wx, strict=True))
                value[some] += of_plane * of_line * along
    return value


def _four_nodes(p: Floats, n: int) -> tuple[list[NDArray[np.int64]], list[Floats]]:
    """Indices of the four nodes around positions ``p`` on an axis of ``n``, or of its one slice, and their weights."""
    first = np.floor(p).astype(np.int64)
    if n == 1:
        return [np.zeros_like(first)], [np.ones_like(p)]
    u = p - first
    before, after = u * (u - 1), (u + 1) * (u - 2)
    weights = [-before * (u - 2) / 6, after * (u - 1) / 2, -after * u / 2, before * (u + 1) / 6]
    return [_mirrored(first + k, n) for k in range(-1, 3)], weights


def _mirrored(index: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Indices, those beyond the border mirrored at the outer face of its voxels."""
    index = np.where(index < 0, -1 - index, index)
    return np.clip(np.where(index >= n, 2 * n - 1 - index, index), 0, n - 1)


def _is_small(zyx: Floats, psi: NDArray[np.float32], h: Floats) -> NDArray[np.bool_]:
    """Test if the object, or the space around it, is small at each vertex, (n,): see `THICK`.

    From the voxel of the vertex on the way leads to the deepest of the voxels around, one by one. Not where psi changes
    by more than a distance between them.
    """
    steps = [step for step, n in zip(h, psi.shape, strict=True) if n > 1] or [float(h.max())]
    enough = THICK * max(steps)
    cells = np.clip(np.rint(zyx).astype(np.int64), 0, np.array(psi.shape) - 1)
    cells, of_vertex = np.unique(cells, axis=0, return_inverse=True)
    small, steep = np.zeros((2, len(cells)), np.bool_)
    for side in (-1, 1):
        deepest, depth = cells, side * psi[tuple(cells.T)]
        for _ in range(int(np.ceil(enough / min(steps))) + 1):
            here, level = deepest, depth
            for shift in itertools.product((-1, 0, 1), repeat=3):
                other = np.clip(here + shift, 0, np.array(psi.shape) - 1)
                value = side * psi[tuple(other.T)]
                steep |= np.abs(value - level) > MAX_SLOPE * np.linalg.norm(shift * h)
                deeper = value > depth
                deepest, depth = np.where(deeper[:, None], other, deepest), np.where(deeper, value, depth)
        small |= depth < enough
    return (small & ~steep)[of_vertex.ravel()]


def _is_distance(zyx: Floats, normals: Floats, psi: NDArray[np.float32], h: Floats) -> NDArray[np.bool_]:
    """Test if psi rises as a distance does along the normal of each vertex, outside or inside, (n,)."""
    voxel = np.linalg.norm(normals * h, axis=1)
    way = voxel[:, None] * normals / h
    here = cubic_at(psi, zyx)
    most = np.maximum(cubic_at(psi, zyx + way) - here, here - cubic_at(psi, zyx - way))
    return np.asarray(most >= SMALL_MIN_SLOPE * voxel)


def _mesh_normals(at: Floats, faces: NDArray[np.integer], outward: Floats) -> Floats:
    """Outward unit normals of the mesh at its vertices (n, 3), by the sizes of the faces around each."""
    corners = at[faces]
    if faces.shape[1] == 3:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    else:
        along = corners[:, 1] - corners[:, 0]
        # Within the slice: the axis along which no segment goes.
        flat = int(np.ptp(at, axis=0).argmin())
        across = np.cross(along, np.eye(3)[flat])
    normals = np.stack([_per_vertex(faces, across[:, a], len(at)) for a in range(3)], axis=1)
    normals[outward == 0.0] = 0.0
    normals *= np.sign((normals * outward).sum()) or 1.0
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None])


def least_cosine(normals: Floats) -> Floats:
    """Smallest cosine between the unit normals (m, 3, 3) or (m, 2, 3) at the corners of each face, (m,)."""
    return np.asarray((normals * np.roll(normals, -1, axis=1)).sum(axis=2).min(axis=1))


def _sizes(corners: Floats) -> Floats:
    """Area or length of each face."""
    along = corners[:, 1] - corners[:, 0]
    if corners.shape[1] == 2:
        return np.linalg.norm(along, axis=1)
    return np.linalg.norm(np.cross(along, corners[:, 2] - corners[:, 0]), axis=1)
