"""Rasterizes a triangle mesh with numpy alone: no window, no graphics driver, the same pixels everywhere.

Each triangle is sampled at points less than a pixel apart, which go into a depth buffer (orthographic view). The
triangles of marching cubes cover a few pixels, so this is as sharp as filling them and much simpler.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

#: Direction from the object to the viewer in LPS: from the front, the patient's left and above.
VIEW = (0.55, -0.90, 0.50)
_BATCH_SAMPLES = 2_000_000
#: Depths are quantized to so many steps over their range.
_DEPTH_STEPS = 2**30


@dataclass(frozen=True)
class Picture:
    """A rendered mesh.

    Attributes
    ----------
    pixels : ndarray, shape (n, n, 4), float32
        Red, green, blue, opacity in 0..1; the first row is the top.
    mm_per_pixel : float
        Size of a pixel.
    axes : ndarray, shape (3, 2), float64
        Where the world's x, y and z axes (unit vectors) point in the picture: (right, up).
    """

    pixels: NDArray[np.float32]
    mm_per_pixel: float
    axes: Floats


def render(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    size: int = 480,
    color: ArrayLike = (0.34, 0.71, 0.91),
    view: tuple[float, float, float] = VIEW,
    box: ArrayLike | None = None,
) -> Picture:
    """Draw a mesh with shading, orthographic. Triangles that face away are not drawn: the mesh should be closed.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        World positions (x, y, z) in mm.
    faces : array_like, shape (m, 3)
        Vertex numbers, counter-clockwise seen from outside.
    size : int, optional
        Edge of the square picture in pixels.
    color : array_like, shape (3,) or (n, 3), optional
        Red, green, blue of the surface in 0..1, or of each of its vertices.
    view : tuple of float, optional
        Direction from the object to the viewer; not vertical.
    box : array_like, shape (k, 3), optional
        Points that the picture has to show, mm; the vertices by default. The same points give several meshes the same
        scale.

    Examples
    --------
    >>> picture = render([[0, 0, 0], [9, 0, 0], [0, 0, 9]], [[0, 1, 2]], size=32)
    >>> picture.pixels.shape, bool(picture.pixels[..., 3].any())
    ((32, 32, 4), True)
    """
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(faces, dtype=np.intp).reshape(-1, 3)
    frame = _frame(view)
    shown = (points if box is None else np.asarray(box, dtype=np.float64)) @ frame.T
    fine = 2 * size  # drawn at twice the resolution and averaged, which smooths the edges
    if not len(shown):
        return Picture(np.zeros((size, size, 4), np.float32), 1.0, frame[:2].T.copy())
    low, high = shown[:, :2].min(0), shown[:, :2].max(0)
    scale = 0.94 * fine / max(float((high - low).max()), 1e-9)
    projected = points @ frame.T
    projected[:, :2] = (projected[:, :2] - (low + high) / 2) * scale + fine / 2
    paint = np.broadcast_to(np.asarray(color, np.float64), points.shape)
    at_vertices = np.concatenate([_vertex_normals(points, triangles) @ frame.T, paint], axis=1)
    covered, depth, values = _fill(projected, triangles, at_vertices, fine)
    pixels = np.zeros((fine * fine, 4))
    rims = _rims(covered, depth, fine, scale)
    pixels[covered, :3], pixels[covered, 3] = _shade(values[:, :3], values[:, 3:], rims), 1.0
    pixels = _halve(pixels.reshape(fine, fine, 4)[::-1])
    return Picture(pixels.astype(np.float32), 2.0 / scale, frame[:2].T.copy())


def _frame(view: tuple[float, float, float]) -> Floats:
    """Rows: right, up and towards the viewer, orthonormal; up is as vertical (z) as the view allows."""
    toward = np.asarray(view, dtype=np.float64)
    toward = toward / np.linalg.norm(toward)
    right = np.cross((0.0, 0.0, 1.0), toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def _vertex_normals(points: Floats, triangles: NDArray[np.intp]) -> Floats:
    """Outward unit normals: each vertex takes the area-weighted mean of its triangles'."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    flat = triangles.ravel()
    normals = np.stack([np.bincount(flat, np.repeat(area[:, i], 3), len(points)) for i in range(3)], axis=1)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def _fill(
    projected: Floats, triangles: NDArray[np.intp], values: Floats, fine: int
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """The pixels that are covered, flat and in order; of each the depth, and the vertices' values (n, k) there."""
    corners = projected[triangles]
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    front = side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0] > 0  # the rest face away, behind these
    triangles, corners = triangles[front], corners[front]
    edges = np.abs(corners[:, [1, 2, 0], :2] - corners[:, :, :2]).max(axis=(1, 2), initial=0.0)
    levels = np.clip(np.ceil(edges * 1.1), 1, None).astype(np.intp)
    low, high = projected[:, 2].min(), projected[:, 2].max()
    depths = _Depths(low, (high - low) / _DEPTH_STEPS or 1.0)
    # Per pixel the depth of the nearest point, and in the lower half of the bits which point that is.
    nearest = np.full(fine * fine, -1, np.int64)
    count, batches = 0, []
    for level in np.unique(levels):
        weights = _subtriangle_centres(int(level))
        members = np.flatnonzero(levels == level)
        chunk = max(1, _BATCH_SAMPLES // len(weights))
        for first in range(0, len(members), chunk):
            some = members[first : first + chunk]
            _rasterize_points(nearest, (weights @ corners[some]).reshape(-1, 3), depths, count, fine)
            batches.append((count, weights, triangles[some]))
            count += len(some) * len(weights)
    covered = np.flatnonzero(nearest >= 0)
    nearest = nearest[covered]
    point, shown = nearest & 0xFFFFFFFF, np.zeros((len(covered), values.shape[1]))
    for begin, weights, some in batches:
        at = np.flatnonzero((point >= begin) & (point < begin + len(some) * len(weights)))
        which, sample = np.divmod(point[at] - begin, len(weights))
        shown[at] = np.einsum("pi,pic->pc", weights[sample], values[some[which]])
    return covered, depths.mm(nearest >> 32), shown


class _Depths(NamedTuple):
    """Depths as whole numbers 0 .. `_DEPTH_STEPS`."""

    low: float
    step: float

    def whole(self, mm: Floats) -> NDArray[np.int64]:
        return np.asarray(np.clip((mm - self.low) / self.step, 0, _DEPTH_STEPS), np.int64)

    def mm(self, whole: NDArray[np.int64]) -> Floats:
        return np.asarray(self.low + self.step * whole, np.float64)


def _subtriangle_centres(level: int) -> Floats:
    """Barycentric coordinates (n, 3) of the centres of the `level`^2 triangles that a triangle is divided into."""
    i, j, up = (a.ravel() for a in np.meshgrid(np.arange(level), np.arange(level), (1, 2), indexing="ij"))
    valid = i + j + up <= level
    a, b = (3 * i + up)[valid], (3 * j + up)[valid]
    return np.stack([a, b, 3 * level - a - b], axis=1) / (3.0 * level)


def _rasterize_points(nearest: NDArray[np.int64], points: Floats, depths: _Depths, first: int, fine: int) -> None:
    """Enter points, numbered from ``first`` on, into the depth buffer ``nearest``."""
    column, row = points[:, 0].astype(np.intp), points[:, 1].astype(np.intp)
    inside = np.flatnonzero((column >= 0) & (column < fine) & (row >= 0) & (row < fine))
    key = (depths.whole(points[inside, 2]) << 32) + first + inside
    np.maximum.at(nearest, row[inside] * fine + column[inside], key)


def _shade(normals: Floats, color: Floats, rims: Floats) -> Floats:
    """Colours (n, 3) of covered pixels: soft light from above left, a small highlight, darker ``rims``, a factor."""
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    n[n[:, 2] < 0] *= -1.0  # interpolated normals may point away at the rim
    key, fill = np.array([-0.45, 0.65, 0.61]), np.array([0.7, -0.1, 0.7])
    light = 0.36 + 0.60 * np.clip(n @ key, 0, None) + 0.16 * np.clip(n @ fill, 0, None)
    half = (key + (0, 0, 1)) / np.linalg.norm(key + (0, 0, 1))
    shine = 0.18 * np.clip(n @ half, 0, None) ** 30
    return np.asarray(np.clip((light * rims)[:, None] * color + shine[:, None], 0, 1))


def _rims(covered: NDArray[np.intp], depth: Floats, fine: int, scale: float) -> Floats:
    """Factor that darkens pixels lying well behind a neighbour, so that what is in front stands out."""
    if not len(covered):
        return np.ones(0)
    flat = np.full(fine * fine, depth.min() * scale)  # in pixels
    flat[covered] = depth * scale
    z = flat.reshape(fine, fine)
    front = z.copy()
    for step in (1, 2):
        for near, behind in ((front, z), (front.T, z.T)):
            np.maximum(near[step:], behind[:-step], out=near[step:])
            np.maximum(near[:-step], behind[step:], out=near[:-step])
            # Beyond an end of the picture is its other end.
            np.maximum(near[:step], behind[-step:], out=near[:step])
            np.maximum(near[-step:], behind[:step], out=near[-step:])
    return np.where((front - z).ravel()[covered] > 14.0, 0.8, 1.0)


def _halve(pixels: Floats) -> Floats:
    """Average 2 x 2 pixels that are opaque, or 0; colours are weighted by opacity, so that rims do not darken."""
    upper, lower = pixels[0::2], pixels[1::2]
    mean = (upper[:, 0::2] + upper[:, 1::2] + lower[:, 0::2] + lower[:, 1::2]) / 4.0
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-9)
    return np.asarray(mean)
