"""Meshes and textures for VTK: surfaces and paths in world mm, contours in a slice; no plotter here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkFiltersCore import vtkFlyingEdges2D
from vtkmodules.vtkRenderingCore import vtkPolyDataMapper, vtkTexture

from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.core.frame import SurfaceFrame

#: Standard deviation, voxels, of the Gaussian that turns a label map into something with a smooth surface.
SMOOTH_LABELS = 0.8


def isosurface(surface: SurfaceFrame, geometry: Geometry, color: str = "plain") -> pv.PolyData:
    """The surface of an object.

    Parameters
    ----------
    surface : SurfaceFrame
    geometry : Geometry
        Of the image.
    color : str, optional
        A quantity of the surface to put on the points; one that it lacks is left out.

    Returns
    -------
    pyvista.PolyData
        In world mm (LPS), closed at the volume's border, with normals, which point outward; empty without a surface.
    """
    mesh = closed_surface(surface.psi)
    if mesh.n_points == 0:
        return mesh
    places = np.asarray(mesh.points, float)[:, ::-1]
    if color in surface.quantities:
        mesh.point_data[color] = surface.sample(color, places)
        mesh.set_active_scalars(color)
    steps = np.array(surface.level.factors) * surface.stride * np.array(geometry.spacing)
    _to_world(mesh, geometry.index_to_world(surface.to_image(places)), geometry, steps)
    return mesh


def label_surface(labels: NDArray[np.bool_], geometry: Geometry) -> pv.PolyData:
    """The surface of a label map in world mm (LPS), with the stair steps of its voxels smoothed away."""
    # Not with the module: the first picture has a label map only where one was asked for.
    from scipy import ndimage

    inside = np.argwhere(labels)
    if not len(inside):
        return pv.PolyData()
    low, high = (
        np.maximum(inside.min(axis=0) - 3, 0),
        np.minimum(inside.max(axis=0) + 4, labels.shape),
    )
    box = labels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].astype(np.float32)
    # Voxels beyond the border count as outside, as in the label map.
    soft = ndimage.gaussian_filter(
        box, [SMOOTH_LABELS if n > 1 else 0.0 for n in labels.shape], mode="nearest"
    )
    mesh = closed_surface(np.float32(0.5) - soft)
    if mesh.n_points:
        places = np.asarray(mesh.points, float)[:, ::-1] + low
        _to_world(mesh, geometry.index_to_world(places), geometry, np.array(geometry.spacing))
    return mesh


def closed_surface(psi: NDArray[np.float32]) -> pv.PolyData:
    """The zero level by flying edges, points (x, y, z) in voxels of ``psi``, normals along its gradient.

    Where the box cuts the object it is closed half a voxel further out.
    """
    if psi.size == 0 or not (psi < 0).any():
        return pv.PolyData()
    padded = np.pad(psi, 1, mode="edge")
    for axis in range(3):
        for end in (0, -1):
            side = padded[(slice(None),) * axis + (end,)]
            np.abs(side, out=side)
    grid = pv.ImageData(dimensions=padded.shape[::-1], origin=(-1.0, -1.0, -1.0))
    grid.point_data["psi"] = padded.ravel()
    mesh = grid.contour(
        [0.0], "psi", compute_normals=True, compute_scalars=False, method="flying_edges"
    )
    if "Normals" in mesh.point_data:
        mesh.point_data.active_normals_name = "Normals"
    return mesh


def contour(plane: NDArray[np.float32]) -> NDArray[np.float64]:
    """The zero level in a slice as line segments, (n, 2, 2), each end (row, column) in voxels."""
    if min(plane.shape) < 2 or not (plane < 0).any() or not (plane >= 0).any():
        return np.zeros((0, 2, 2))
    grid = pv.ImageData(dimensions=(plane.shape[1], plane.shape[0], 1))
    grid.point_data["psi"] = np.ascontiguousarray(plane).ravel()
    filter_ = vtkFlyingEdges2D(input_data=grid)
    filter_.SetValue(0, 0.0)
    filter_.Update()
    lines = pv.wrap(filter_.GetOutput())
    if lines.n_cells == 0:
        return np.zeros((0, 2, 2))
    ends = np.asarray(lines.lines).reshape(-1, 3)[:, 1:]
    return np.asarray(lines.points, float)[ends][:, :, 1::-1]


def slice_of(surface: SurfaceFrame, axis: int, index: float) -> NDArray[np.float32] | None:
    """The plane of psi at an image ``index`` along an array axis, linear between planes; None beside the box."""
    n = surface.psi.shape[axis]
    if n == 0:
        return None
    at = np.zeros(3)
    at[axis] = index
    place = float(surface.from_image(at)[axis])
    if not -0.5 <= place <= n - 0.5:
        return None
    place = min(max(place, 0.0), n - 1.0)
    low = min(int(place), max(n - 2, 0))
    share = np.float32(place - low)
    first = surface.psi.take(low, axis=axis)
    if share == 0:
        return np.asarray(first)
    return np.asarray((1 - share) * first + share * surface.psi.take(low + 1, axis=axis))


def box_edges(geometry: Geometry) -> pv.PolyData:
    """Return the edges of an image, along the outer faces of its border voxels, in world mm."""
    ends = np.stack([np.full(3, -0.5), np.array(geometry.shape) - 0.5], axis=1)
    corners = np.array([[z, y, x] for z in ends[0] for y in ends[1] for x in ends[2]])
    edges = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
    lines = np.array([(2, a, b) for a, b in edges])
    return pv.PolyData(geometry.index_to_world(corners).astype(np.float32), lines=lines.ravel())


def polygon(
    corners: NDArray[np.float64], extent: tuple[float, float, float, float], depth: float = 0.0
) -> pv.PolyData:
    """A convex polygon, corners (n, 2) around, that shows its part of a picture from left to right, bottom to top."""
    if len(corners) < 3:
        return pv.PolyData()
    left, right, bottom, top = extent
    points = np.column_stack([corners, np.full(len(corners), depth)])
    mesh = pv.PolyData(points, faces=[len(points), *range(len(points))])
    mesh.active_texture_coordinates = (corners - [left, bottom]) / [right - left, top - bottom]
    return mesh


class Texture:
    """A picture for a polygon; ``texture`` is VTK's.

    Parameters
    ----------
    is_smooth : bool
        Drawn smoothly between voxels; otherwise each voxel is a rectangle.
    """

    def __init__(self, is_smooth: bool) -> None:
        self.texture = vtkTexture()
        self.texture.SetInterpolate(is_smooth)
        self.texture.SetColorModeToDirectScalars()
        self.show(np.zeros((2, 2, 4), np.uint8))

    def show(self, rows: NDArray[np.uint8]) -> None:
        """Show grey values (rows, columns), or colours with opacities (rows, columns, 4), the first row lowest."""
        rows = np.repeat(rows[..., None], 3, axis=2) if rows.ndim == 2 else rows
        image = pv.ImageData(dimensions=(rows.shape[1], rows.shape[0], 1))
        image.point_data["colors"] = rows.reshape(-1, rows.shape[2])
        self.texture.SetInputData(image)


def add_actor(
    renderer: pv.Renderer, mesh: pv.PolyData, color: str, opacity: float = 1.0, is_lit: bool = False
) -> pv.Actor:
    """Draw a mesh in a renderer; the camera stays as it is."""
    mapper = vtkPolyDataMapper(input_data=mesh, scalar_visibility=False)
    style = pv.Property(color=color, opacity=opacity, lighting=is_lit)
    actor = pv.Actor(mapper=mapper, prop=style)
    renderer.add_actor(actor, reset_camera=False, render=False)
    return actor


def _to_world(
    mesh: pv.PolyData, points: NDArray[np.float64], geometry: Geometry, steps: NDArray[np.float64]
) -> None:
    """Move points and normals from indices to the world; ``steps`` (hz, hy, hx) is the mm per index."""
    normals = mesh.point_data.active_normals
    mesh.points = points.astype(np.float32)
    # The order of corners must agree with the normals, or triangles are lit from behind; a left-handed grid flips it.
    corners = np.asarray(mesh.faces).reshape(-1, 4)
    if np.linalg.det(geometry.direction) > 0:
        corners = corners[:, [0, 1, 3, 2]]
        mesh.faces = corners.ravel()
    if normals is not None:
        # A gradient per index becomes one per mm by division.
        turned = -(np.asarray(normals, float) / steps[::-1]) @ np.asarray(geometry.direction).T
        turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
        mesh.point_data["Normals"] = turned.astype(np.float32)
        mesh.point_data.active_normals_name = "Normals"


#: Dashes around a closed line, and how opaque a predicted surface is.
DASHES = 24
TRANSLUCENT = 0.25


def dashed(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every second part of the segments (n, 2, 2) of a closed line, by their direction from its middle."""
    if not len(lines):
        return lines
    away = lines.mean(axis=1) - lines.mean(axis=(0, 1))
    part = np.floor((np.arctan2(away[:, 1], away[:, 0]) / (2.0 * np.pi) + 0.5) * 2 * DASHES)
    return lines[part.astype(int) % 2 == 0]


def path_lines(paths: Sequence[NDArray[np.float64]]) -> pv.PolyData:
    """Return paths (n, 3), world mm, as lines; empty without one of two places."""
    ends = [
        np.stack([path[:-1], path[1:]], axis=1).reshape(-1, 3) for path in paths if len(path) > 1
    ]
    return pv.line_segments_from_points(np.concatenate(ends)) if ends else pv.PolyData()
