"""Where the vertices of a mesh or a contour lie: on the surface, then so that it encloses the surface's volume.

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

import numpy as np
from numpy.typing import NDArray

from accelsurf.analysis.small_parts import TURNED, least_cosine, settled

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
    """Which coordinates lie on the volume's outer faces, (n, 3)."""
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
    return placed if across is not None else settled(placed, faces[~is_cap], rough[~is_cap], psi, h, normals)


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
