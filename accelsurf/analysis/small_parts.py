"""Vertices around parts of an object a few voxels across: moved until psi is 0 on average over the triangles there.

What `vertex_placement.balanced` adds to a triangle is of second order in its size. Where a triangle turns by more than
the surface's curvature tells, as on a ball of radius 1 voxel, that is not enough: such a mesh lacks up to half of the
volume. Psi is a distance, so its mean over a triangle is how far the triangle lies below the surface on average,
whatever its size. The cubic interpolant of four nodes per axis has errors of both signs on small round parts, which
cancel in the mean: 3 % of the volume of a ball of radius 1 voxel, 0.2 % at 1.5.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: A part is small where psi on its side stays within so many voxels of the coarsest axis.
THICK = 2.0
#: Cosine between the normals of psi at the ends of a side below which a face needs more than its curvature, ...
TURNED = 0.8
#: ... if that between the normals of the mesh is below this. The walls of a thin sheet, where psi is flat as well, have
#: what they need, and beside the ridge between them the cubic errs.
BENT = 0.97
#: Least slope of psi over a voxel along the normal, on one side: else psi is no distance there.
MIN_SLOPE = 0.7
#: Largest slope between two voxels.
MAX_SLOPE = 1.1
#: Steps, each by the mean of what is left.
STEPS = 4
#: Rounds in which a step is averaged among neighbours, so that single vertices do not stick out.
ROUNDS = 1
#: Longest way of a vertex, parts of a voxel's size along the normal.
MAX_WAY = 0.7
#: Points whose psi is interpolated at a time: their arrays then stay in the cache.
AT_A_TIME = 1 << 14


def settled(
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
    small = np.unique(faces[rough])
    small = small[_is_small(zyx[small], psi, h)]
    if not len(small):
        return zyx
    normals = _mesh_normals(zyx * h, faces, outward)
    active = np.zeros(len(zyx), np.bool_)
    active[small] = True
    turned = np.zeros(len(zyx), np.bool_)
    turned[faces[rough & active[faces].any(axis=1) & (least_cosine(normals[faces]) < BENT)].ravel()] = True
    active &= turned
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
        for _ in range(1 + ROUNDS):
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
    """Whether the object, or what surrounds it, is small at each vertex, (n,): see `THICK`.

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
    """Whether psi rises as a distance does along the normal of each vertex, outside or inside, (n,)."""
    voxel = np.linalg.norm(normals * h, axis=1)
    way = voxel[:, None] * normals / h
    here = cubic_at(psi, zyx)
    most = np.maximum(cubic_at(psi, zyx + way) - here, here - cubic_at(psi, zyx - way))
    return np.asarray(most >= MIN_SLOPE * voxel)


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


def _per_vertex(faces: NDArray[np.integer], values: Floats, n: int) -> Floats:
    """Sum over the faces around each of the ``n`` vertices."""
    return np.asarray(sum(np.bincount(faces[:, k], values, n) for k in range(faces.shape[1])))
