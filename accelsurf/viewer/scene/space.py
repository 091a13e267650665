"""The tile in 3D: the surfaces in world mm, slices on request, the scale, the directions; picking.

A pick reads psi along the line of sight: a cell picker looks at each triangle, 35 ms on half a million with each motion
of the mouse.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.core.frame import Frame, SurfaceFrame
from accelsurf.viewer.scene.colors import (
    CURSOR,
    MARK,
    REFERENCE,
    SHADES,
    SURFACE,
    Theme,
    color_range,
)
from accelsurf.viewer.scene.legend import color_scale
from accelsurf.viewer.scene.overlay import EDGE, Label, Pixels, ScaleBar, orientation_cube
from accelsurf.viewer.scene.redraw import TileContext
from accelsurf.viewer.scene.shapes import (
    TRANSLUCENT,
    Texture,
    add_actor,
    box_edges,
    isosurface,
    path_lines,
)


class Picked(NamedTuple):
    """Result of a pick at a pixel: the ``tile`` (space, axial, coronal, sagittal, energies), and the ``world`` point
    (x, y, z), mm, in a slice or on a surface; None beside them.
    """

    tile: str
    world: NDArray[np.float64] | None


def place_in_renderer(
    renderer: pv.Renderer, x: float, y: float, beside: bool = False
) -> tuple[float, float] | None:
    """Return the place of a pixel of the window in a renderer, each coordinate from 0 to 1.

    None outside it, unless places ``beside`` it are wanted too; None where the renderer is not shown.
    """
    width, height = renderer.GetRenderWindow().GetSize()
    left, bottom, right, top = renderer.GetViewport()
    if right <= left or top <= bottom:
        return None
    place = ((x / width - left) / (right - left), (y / height - bottom) / (top - bottom))
    return place if beside or all(0 <= part < 1 for part in place) else None


#: Places along the line for each voxel of psi.
FINE = 2.0


def first_met(
    surfaces: Iterable[SurfaceFrame], geometry: Geometry, start: Floats, end: Floats
) -> Floats | None:
    """Return the point (x, y, z), world mm, where the line from start to end enters the first surface; None beside all.

    Parameters
    ----------
    surfaces : iterable of SurfaceFrame
    geometry : Geometry
        Of the image.
    start, end : ndarray (3,)
        World mm.
    """
    ends = geometry.world_to_index(np.stack([start, end]))
    shares = [share for surface in surfaces if (share := _share(surface, ends)) is not None]
    return None if not shares else np.asarray(start + min(shares) * (end - start))


def _share(surface: SurfaceFrame, ends: Floats) -> float | None:
    """Return the part of the line, 0 to 1, after which it enters an object."""
    if not surface.has_surface:
        return None
    # Not with the module: the first picture has no surface yet, and the solver, which makes one, has loaded this.
    from scipy import ndimage

    first, last = surface.from_image(ends)
    span = _clipped(first, last, surface.psi.shape)
    if span is None:
        return None
    count = int(FINE * np.abs(last - first).max() * (span[1] - span[0])) + 2
    shares = np.linspace(*span, count)
    places = first + shares[:, None] * (last - first)
    psi = ndimage.map_coordinates(surface.psi, places.T, order=1, mode="nearest")
    inside = np.flatnonzero(psi < 0)
    if not inside.size:
        return None
    at = int(inside[0])
    if at == 0:
        return float(shares[0])
    part = psi[at - 1] / (psi[at - 1] - psi[at])
    return float(shares[at - 1] + part * (shares[at] - shares[at - 1]))


def _clipped(first: Floats, last: Floats, shape: tuple[int, ...]) -> tuple[float, float] | None:
    """The part of a line, from 0 to 1, within a box of voxels and half a voxel around it."""
    low, high = 0.0, 1.0
    for a, b, n in zip(first, last, shape, strict=True):
        if a == b:
            if not -0.5 <= a <= n - 0.5:
                return None
            continue
        enters, leaves = sorted(((-0.5 - a) / (b - a), (n - 0.5 - a) / (b - a)))
        low, high = max(low, enters), min(high, leaves)
    return (low, high) if low < high else None


#: Width of the edges of the volume, of the ways of tracked objects, pixels of a usual screen.
BOX = 1.0
WAY = 2.0
#: Voxels of psi from which a surface is drawn coarsely.
COARSE_VOXELS = 400_000
#: Where the camera is, as a direction (x, y, z) in LPS, and which direction is up; it begins at `corner`.
VIEWS = {
    "corner": ((0.55, -1.0, 0.5), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "back": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "left": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "right": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "bottom": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
}
#: A slice: a polygon in world mm with the coordinates of its texture, and the texture's picture.
PlanePicture = tuple[pv.PolyData, NDArray[np.uint8]]


class SpaceTile:
    """The renderer that shows the surfaces.

    Parameters
    ----------
    plotter : pyvista.Plotter
        Its active renderer is the tile's.
    geometry : Geometry
        Of the image.
    context : TileContext
    """

    def __init__(self, plotter: pv.Plotter, geometry: Geometry, context: TileContext) -> None:
        self.renderer = plotter.renderer
        self._context = context
        theme = context.theme
        self._geometry = geometry
        #: The surfaces drawn now, of each object, world mm.
        self.meshes: list[pv.PolyData] = []
        self._frame: Frame | None = None
        self.is_coarse = False  # whether fewer triangles are drawn than the frame has
        self._wanted = self._color = "plain"
        self.surfaces = [self._add_surface()]
        #: Edges of the volume; the reference's surface, None without one; both world mm.
        self.box = box_edges(geometry)
        self.reference: pv.PolyData | None = None
        self._reference_actor: Any = None
        self._box = add_actor(self.renderer, self.box, theme.lines)
        self._ball: pv.Actor | None = None
        self._places: pv.Actor | None = None
        #: Actors of the predictions and of the ways of tracked objects.
        self._tracks: tuple[pv.Actor, pv.Actor] | None = None
        self._planes: list[tuple[pv.Actor, Texture]] = []
        #: Whether the three slices are drawn.
        self.shows_planes = False
        self._table = pv.LookupTable()
        self._scale = color_scale(self.renderer)
        self._quantity = Label(self.renderer, theme.ink, (0.5, 0.135))
        # VTK's own labels come to lie on the colours in a picture that is drawn once.
        self._ends = [
            Label(self.renderer, theme.ink, (right, 0.095), top=True) for right in (0.2, 0.5, 0.8)
        ]
        self.title = Label(self.renderer, theme.ink, (0.015, 0.985), top=True)
        self._bar = ScaleBar(self.renderer, theme.ink, context.unit)
        self._cube = orientation_cube(context.anatomical)
        plotter.add_orientation_widget(self._cube, interactive=False, viewport=(0, 0, 0.17, 0.17))
        self.look_from()

    # -- the surface --------------------------------------------------------------------------------------

    def show(self, frame: Frame, color: str, coarse: bool = False) -> None:
        """Draw a frame coloured by a quantity, plain where it lacks that; ``coarse``: fewer triangles, much sooner."""
        self._frame, self._wanted = frame, color
        drawn = (
            tuple(surface.coarser(COARSE_VOXELS) for surface in frame.surfaces)
            if coarse
            else frame.surfaces
        )
        self.is_coarse = any(
            shown is not fine for shown, fine in zip(drawn, frame.surfaces, strict=True)
        )
        self.meshes = [isosurface(surface, self._geometry, color) for surface in drawn]
        while len(self.surfaces) < len(self.meshes):
            self.surfaces.append(self._add_surface())
        for actor in self.surfaces[len(self.meshes) :]:
            actor.SetVisibility(False)
        for actor, mesh in zip(self.surfaces, self.meshes, strict=False):
            actor.mapper.SetInputData(mesh)
            actor.mapper.SetScalarVisibility(color in mesh.point_data)
        self.restyle()
        self._show_scale(color)
        self._show_tracks(frame)

    def _show_tracks(self, frame: Frame) -> None:
        """Draw tracked objects as they were predicted, translucent, and their paths."""
        if self._tracks is None:
            if not frame.predicted and not frame.paths:
                return
            self._tracks = (
                add_actor(self.renderer, pv.PolyData(), REFERENCE, TRANSLUCENT, is_lit=True),
                add_actor(self.renderer, pv.PolyData(), CURSOR),
            )
        meshes = [isosurface(surface, self._geometry) for surface in frame.predicted]
        meshes = [mesh for mesh in meshes if mesh.n_points]
        for actor, mesh in zip(
            self._tracks,
            (pv.merge(meshes) if meshes else pv.PolyData(), path_lines(frame.paths)),
            strict=True,
        ):
            actor.mapper.SetInputData(mesh)
            actor.SetVisibility(mesh.n_points > 0)

    def restyle(self) -> None:
        """Draw each surface in its style."""
        for actor, mesh, style in zip(
            self.surfaces, self.meshes, self._context.styles.of(self._frame), strict=False
        ):
            actor.prop.color, actor.prop.opacity = style.color, style.opacity
            actor.SetVisibility(mesh.n_points > 0 and style.visible)
        self.mark()

    def mark(self) -> None:
        """Have the tile drawn anew."""
        self._context.redraw.mark(self.renderer)

    def coarsen(self, on: bool) -> bool:
        """Draw the same coarsely, or in full; returns whether that is a change."""
        if self._frame is None or self.is_coarse == on:
            return False
        self.show(self._frame, self._wanted, on)
        return self.is_coarse == on

    def _show_scale(self, color: str) -> None:
        """Colour the surfaces that have this quantity on a common scale, and draw the scale."""
        values = [
            np.asarray(mesh.point_data[color]) for mesh in self.meshes if color in mesh.point_data
        ]
        self._scale.SetVisibility(bool(values))
        self._quantity.text = SHADES[color].title if values else ""
        if not values:
            for label in self._ends:
                label.text = ""
            return
        shade = SHADES[color]
        if color != self._color:
            self._table.apply_cmap(shade.cmap, 256)
            self._color = color
        low, high = color_range(np.concatenate(values), shade.signed)
        self._table.scalar_range = low, high
        for label, value in zip(self._ends, (low, 0.5 * (low + high), high), strict=True):
            label.text = f"{value:.3g}"
        for actor in self.surfaces:
            actor.mapper.SetLookupTable(self._table)
            actor.mapper.SetScalarModeToUsePointData()
            actor.mapper.SetUseLookupTableScalarRange(True)
        self._scale.SetLookupTable(self._table)

    @property
    def color(self) -> str:
        """The quantity that colours the surfaces drawn now, or ``plain``."""
        return (
            self._color if any(self._color in mesh.point_data for mesh in self.meshes) else "plain"
        )

    def show_reference(self, mesh: pv.PolyData) -> None:
        """Draw a second surface, translucent."""
        if self._reference_actor is not None:
            self.renderer.RemoveActor(self._reference_actor)
        self.reference, self._reference_actor = (
            mesh,
            add_actor(self.renderer, mesh, REFERENCE, 0.35, is_lit=True),
        )

    def mark_ball(self, center: NDArray[np.float64] | None, radius: float) -> None:
        """Draw a translucent ball (world mm); nothing for None."""
        if center is None and (self._ball is None or not self._ball.GetVisibility()):
            return
        self.mark()
        if self._ball is None:
            sphere = pv.Sphere(radius=1.0, theta_resolution=48, phi_resolution=32)
            self._ball = add_actor(self.renderer, sphere, MARK, 0.55, is_lit=True)
        self._ball.SetVisibility(center is not None)
        if center is not None:
            self._ball.position = tuple(center)
            self._ball.scale = (radius, radius, radius)

    @property
    def smallest(self) -> float:
        """Radius, mm, that a ball must have to be seen."""
        return 0.006 * float(max(self._geometry.extent_mm))

    def mark_places(self, places: NDArray[np.float64]) -> None:
        """Draw a diamond at each of these points (x, y, z), world mm, (n, 3)."""
        if self._places is None:
            self._places = add_actor(self.renderer, pv.PolyData(), CURSOR)
        diamonds = [pv.Octahedron(radius=2.5 * self.smallest, center=place) for place in places]
        self._places.mapper.SetInputData(pv.merge(diamonds) if diamonds else pv.PolyData())
        self._places.SetVisibility(bool(diamonds))
        self.mark()

    # -- the image ----------------------------------------------------------------------------------------

    def show_planes(self, slices: Iterable[PlanePicture] | None) -> None:
        """Draw slices, each a polygon in world mm and its picture, in place of those before; None: no slices."""
        self.shows_planes = slices is not None
        for number, (mesh, grey) in enumerate(slices or ()):
            if number == len(self._planes):
                texture = Texture(is_smooth=True)
                actor = add_actor(self.renderer, mesh, "white")
                actor.SetTexture(texture.texture)
                self._planes.append((actor, texture))
            self._planes[number][0].mapper.SetInputData(mesh)
            self._planes[number][1].show(grey)
        for actor, _ in self._planes:
            actor.SetVisibility(self.shows_planes)
        self.mark()

    # -- camera -------------------------------------------------------------------------------------------

    def look_from(self, view: str = "corner") -> None:
        """Look at the whole image from one of `VIEWS`."""
        toward, upright = VIEWS[view]
        camera = self.renderer.camera
        middle, corners = self._geometry.center_world(), self._geometry.corners_world()
        radius = float(np.linalg.norm(corners - middle, axis=1).max()) or 1.0
        camera.parallel_projection = True
        camera.focal_point = tuple(middle)
        camera.position = tuple(middle + 4.0 * radius * np.array(toward) / np.linalg.norm(toward))
        camera.up = upright
        camera.parallel_scale = self.fitted_scale()
        self.renderer.camera_set = True
        self._show_moved()

    def _show_moved(self) -> None:
        """Draw the view of a camera that was moved."""
        self.renderer.ResetCameraClippingRange()
        self.mark()

    def orbit(self, degrees: float) -> None:
        """Turn the camera around the vertical axis."""
        self.renderer.camera.Azimuth(degrees)
        self._show_moved()

    def fitted_scale(self) -> float:
        """Half the mm that the tile must be high for the whole image to be seen from where the camera is."""
        camera = self.renderer.camera
        toward = np.array(camera.position) - np.array(camera.focal_point)
        side = np.cross(camera.up, toward)
        corners = self._geometry.corners_world() - self._geometry.center_world()
        wide, high = (
            float(np.abs(corners @ (axis / max(float(np.linalg.norm(axis)), 1e-30))).max())
            for axis in (side, np.cross(toward, side))
        )
        width, height = self.renderer.GetSize()
        return 1.12 * (max(high, wide * height / width if width else wide) or 1.0)

    def turn(self, degrees: float, up: float) -> None:
        """Turn the camera around the middle, sideways and up."""
        camera = self.renderer.camera
        camera.Azimuth(degrees)
        camera.Elevation(up)
        camera.OrthogonalizeViewUp()
        self._show_moved()

    def mm_per_pixel(self) -> float:
        """Return the mm that a pixel of the picture is wide."""
        return 2.0 * float(self.renderer.camera.parallel_scale) / max(self.renderer.GetSize()[1], 1)

    def zoom(self, factor: float, right: float = 0.5, up: float = 0.5) -> None:
        """Enlarge by a factor, within limits; the point at this place of the tile, each from 0 to 1, stays there."""
        before, (width, height) = self.mm_per_pixel(), self.renderer.GetSize()
        camera, diagonal = self.renderer.camera, float(np.linalg.norm(self._geometry.extent_mm))
        camera.parallel_scale = float(
            np.clip(camera.parallel_scale / factor, 1e-3 * diagonal, 10.0 * diagonal)
        )
        grown = 1.0 - before / self.mm_per_pixel()
        self.shift((right - 0.5) * width * grown, (up - 0.5) * height * grown)

    def shift(self, right: float, up: float) -> None:
        """Shift the picture by pixels."""
        camera, mm = self.renderer.camera, self.mm_per_pixel()
        position, focus, upward = (
            np.array(v) for v in (camera.position, camera.focal_point, camera.up)
        )
        side = np.cross(focus - position, upward)
        side /= max(float(np.linalg.norm(side)), 1e-30)
        upward = np.cross(side, focus - position)
        upward /= max(float(np.linalg.norm(upward)), 1e-30)
        shift = -mm * (right * side + up * upward)
        # Never so far that the image is out of sight.
        distance = np.linalg.norm(focus + shift - self._geometry.center_world())
        if distance < 3.0 * np.linalg.norm(self._geometry.extent_mm):
            camera.focal_point, camera.position = tuple(focus + shift), tuple(position + shift)
        self._show_moved()

    def pick(self, x: float, y: float) -> NDArray[np.float64] | None:
        """Point (x, y, z) of a surface under a pixel of the window; None beside them."""
        inside = place_in_renderer(self.renderer, x, y)
        if inside is None:
            return None
        ends = []
        for depth in (0.0, 1.0):
            self.renderer.SetViewPoint(2.0 * inside[0] - 1.0, 2.0 * inside[1] - 1.0, depth)
            self.renderer.ViewToWorld()
            ends.append(np.array(self.renderer.GetWorldPoint()[:3]))
        return first_met(() if self._frame is None else self._frame.surfaces, self._geometry, *ends)

    def place_cube(self, on: bool) -> None:
        """Draw the cube of directions where the tile lies now, or not."""
        widget = self.renderer.axes_widget
        widget.SetEnabled(False)
        if on:
            widget.SetEnabled(True)
            widget.InteractiveOff()

    # -- theme and size -----------------------------------------------------------------------------------

    def fit(self, pixels: Pixels) -> None:
        """Make text readable, and the bar as long as the camera's scale asks for."""
        self.title.fit(pixels)
        self._bar.fit(pixels)
        self._box.prop.line_width = BOX * pixels.ratio
        self._cube.GetTextEdgesProperty().SetLineWidth(EDGE * pixels.ratio)
        if self._tracks is not None:
            self._tracks[1].prop.line_width = WAY * pixels.ratio
        for label in (self._quantity, *self._ends):
            label.fit(pixels)

    def paint(self, theme: Theme) -> None:
        """Use a theme."""
        for label in (self.title, self._quantity, *self._ends):
            label.paint(theme.ink)
        self._bar.paint(theme.ink)
        self._box.prop.color = theme.lines

    def _add_surface(self) -> pv.Actor:
        actor = add_actor(self.renderer, pv.PolyData(), SURFACE, is_lit=True)
        actor.prop = pv.Property(
            color=SURFACE,
            interpolation="Gouraud",
            ambient=0.15,
            specular=0.2,
            specular_power=20.0,
        )
        return actor
