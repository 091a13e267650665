"""Rasterizes a triangle mesh: no window, no graphics driver, the same pixels everywhere.

Each triangle is sampled at points less than a pixel apart, which go into a depth buffer (orthographic view). The
triangles of marching cubes cover a few pixels, so this is as sharp as filling them and much simpler.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.output.pictures.kernels import raster

Floats = NDArray[np.float64]

#: Direction from the object to the viewer in LPS: from the front, the patient's left and above.
VIEW = (0.55, -0.90, 0.50)
#: Depths are quantized to so many steps over their range.
_DEPTH_STEPS = 2**30
_KEY, _TO_VIEWER = np.array([-0.45, 0.65, 0.61]), np.array([0.0, 0.0, 1.0])
_HALF = (_KEY + _TO_VIEWER) / np.linalg.norm(_KEY + _TO_VIEWER)
#: Directions to two lights, the first above left, and halfway between the first and the viewer; right, up, towards him.
LIGHTS = tuple(_KEY.tolist()), (0.7, -0.1, 0.7), tuple(_HALF.tolist())


@dataclass(frozen=True, eq=False)
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
    frame = _frame()
    shown = (points if box is None else np.asarray(box, dtype=np.float64)) @ frame.T
    fine = 2 * size  # drawn at twice the resolution and averaged, which smooths the edges
    if not len(shown):
        return Picture(np.zeros((size, size, 4), np.float32), 1.0, frame[:2].T.copy())
    low, high = shown[:, :2].min(0), shown[:, :2].max(0)
    scale = 0.94 * fine / max(float((high - low).max()), 1e-9)
    projected = points @ frame.T
    projected[:, :2] = (projected[:, :2] - (low + high) / 2) * scale + fine / 2
    # A copy: a view that is not to be written is another type to a kernel.
    normals = np.zeros_like(points)
    colors = np.array(np.broadcast_to(np.asarray(color, np.float64), points.shape), order="C")
    raster.area_vectors(points, triangles, normals)
    normals = _unit(normals) @ frame.T
    nearest, nearest_triangles, depths = _fill(projected, triangles, fine)
    covered = np.flatnonzero(nearest >= 0)
    depth = np.asarray(depths.low + depths.step * (nearest.ravel()[covered] >> 32), np.float64)
    rims = _rims(covered, depth, fine, scale)
    pixels = np.zeros((fine * fine, 4))
    raster.paint(covered, nearest_triangles, triangles, (normals, colors), rims, LIGHTS, pixels)
    pixels = _halve(pixels.reshape(fine, fine, 4)[::-1])
    return Picture(pixels.astype(np.float32), 2.0 / scale, frame[:2].T.copy())


def _frame() -> Floats:
    """Return rows: right, up and towards the viewer, orthonormal; up is as vertical (z) as the view allows."""
    toward = np.array(VIEW) / np.linalg.norm(VIEW)
    right = np.cross((0.0, 0.0, 1.0), toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30))


class _Depths(NamedTuple):
    """Depths as whole numbers 0 to ``most``: (depth - low)/step."""

    low: float
    step: float
    most: float


def _fill(
    projected: Floats, triangles: NDArray[np.intp], fine: int
) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], Floats], _Depths]:
    """The depth buffer, and of each pixel what is nearest; see `kernels.raster.fill_depths`."""
    levels = np.empty(len(triangles), np.int64)
    raster.sample_levels(projected, triangles, levels)
    order = np.argsort(levels, kind="stable")[
        np.count_nonzero(levels == 0) :
    ]  # the rest face away, behind these
    low, high = float(projected[:, 2].min()), float(projected[:, 2].max())
    depths = _Depths(low, (high - low) / _DEPTH_STEPS or 1.0, float(_DEPTH_STEPS))
    nearest = np.full((fine, fine), -1, np.int64)
    shown = np.zeros((fine, fine), np.int64), np.zeros((fine, fine, 3))
    raster.fill_depths(projected, triangles, order, levels, tuple(depths), nearest, shown)
    return nearest, shown, depths


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
