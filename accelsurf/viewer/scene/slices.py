"""One slice of the image as radiologists hang it, with contours, the cursor's lines, letters and a scale bar."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkPolyDataMapper

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow
from accelsurf.grid.orientation import IN_PLANE, LETTERS, PLANES, DisplayOrientation
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.captions import measure
from accelsurf.viewer.scene.colors import CURSOR, INSIDE, MARK, OUTSIDE, REFERENCE, Theme
from accelsurf.viewer.scene.object_styles import ObjectStyles
from accelsurf.viewer.scene.overlay import Label, Pixels, ScaleBar
from accelsurf.viewer.scene.shapes import ColorTexture, GreyTexture, contour, slice_of
from accelsurf.viewer.scene.track_marks import dashed

#: Part of a tile's width and height that the image may take; the rest is for text.
FILL = 0.82
#: Largest enlargement, and smallest, of what fits the tile.
MAX_ZOOM, MIN_ZOOM = 40.0, 0.5
#: Between the image and the middle of a letter, heights of text.
LETTER = 0.8
#: Length of the arms of a click's mark, of the longer side of the image.
ARM = 0.012
#: Directions of the arms of a mark: + for inside, x for outside.
_WAYS = {
    "inside": np.array([[1.0, 0.0], [0.0, 1.0]]),
    "outside": np.array([[1.0, 1.0], [1.0, -1.0]]) * np.sqrt(0.5),
}


class SliceTile:
    """A renderer that shows one slice.

    The renderer's plane is in mm: to the right and up as the slice is hung, its z is the order of drawing.

    Parameters
    ----------
    renderer : pyvista.Renderer
    image : ndarray (nz, ny, nx)
    window : GreyWindow
        Which of its values are black and white.
    upright : DisplayOrientation
    plane : int
        0 is axial, 1 coronal, 2 sagittal.
    anatomical : bool
        Whether letters may be written.
    theme : Theme
    unit : str, optional
        Of lengths in the file, in which they are written.
    """

    def __init__(
        self,
        renderer: pv.Renderer,
        image: NDArray[Any],
        window: GreyWindow,
        upright: DisplayOrientation,
        plane: int,
        anatomical: bool,
        theme: Theme,
        unit: str = "mm",
    ) -> None:
        self.renderer, self.plane, self._unit = renderer, plane, unit
        self._up, self._anatomical, self._theme = upright, anatomical, theme
        self._image, self._window = upright.reorient(image), window
        self._vertical, self._horizontal = IN_PLANE[plane]
        #: Array axis of the volume that this slice cuts.
        self.axis = upright.order[plane]
        self._index = -1
        #: What draws each line, and its width in pixels of a usual screen.
        self._lines: dict[str, tuple[pv.Actor, float]] = {}
        self._ratio = 1.0
        self._drawn_objects, self.styles = 0, ObjectStyles()
        self._texture = GreyTexture()
        left, right, bottom, top = self.extent
        self._middle, self._zoom = np.array([0.5 * (left + right), 0.5 * (bottom + top)]), 1.0
        middle = (*self._middle, 0.0)
        self.add_picture(self._texture, 0.0)
        camera = renderer.camera
        camera.parallel_projection = True
        camera.focal_point, camera.position, camera.up = middle, (middle[0], middle[1], 100.0), (0.0, 1.0, 0.0)
        camera.clipping_range = (1.0, 200.0)
        renderer.camera_set = True
        renderer.SetInteractive(False)
        self.title = Label(renderer, theme.ink, (0.03, 0.975), top=True)
        self._bar = ScaleBar(renderer, theme.ink, unit)
        self._letters = self._write_letters() if anatomical else []

    # -- places -------------------------------------------------------------------------------------------

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top of the image in the tile's plane, mm; the outer faces of its border voxels."""
        sides = []
        for axis in (self._horizontal, self._vertical):
            ends = [self._up.coordinate(axis, index) for index in (-0.5, self._image.shape[axis] - 0.5)]
            sides += ends
        left, right, low, high = sides
        return (left, right, -high, -low) if self._down else (left, right, low, high)

    @property
    def _down(self) -> bool:
        """Whether the vertical coordinate runs down the picture: front at the top."""
        return self.plane == 0

    def to_tile(self, indices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (..., 2) in the tile, mm, of indices (z, y, x) of the image (..., 3)."""
        out = np.empty((*indices.shape[:-1], 2))
        for part, axis in enumerate((self._horizontal, self._vertical)):
            index = indices[..., self._up.order[axis]]
            if self._up.flips[axis]:
                index = self._image.shape[axis] - 1 - index
            out[..., part] = self._up.first[axis] + index * self._up.spacing[axis]
        if self._down:
            out[..., 1] *= -1.0
        return out

    def from_tile(self, right: float, up: float, cursor: NDArray[np.float64]) -> NDArray[np.float64]:
        """Index (z, y, x) of a place in the tile, on the slice of the index ``cursor``, clipped to the image."""
        out = np.array(cursor, float)
        for value, axis in ((right, self._horizontal), (-up if self._down else up, self._vertical)):
            n = self._image.shape[axis]
            index = np.clip((value - self._up.first[axis]) / self._up.spacing[axis], 0.0, n - 1.0)
            out[self._up.order[axis]] = n - 1 - index if self._up.flips[axis] else index
        return out

    def to_plane(self, right: float, up: float) -> tuple[float, float]:
        """Place in the tile's plane, mm, of a place in its renderer, each from 0 to 1."""
        width, height = self.renderer.GetSize()
        mm = 2.0 * self.renderer.camera.parallel_scale / height
        x, y, _ = self.renderer.camera.focal_point
        return x + (right - 0.5) * width * mm, y + (up - 0.5) * height * mm

    # -- what is drawn ------------------------------------------------------------------------------------

    def show(self, cursor: NDArray[np.float64]) -> None:
        """Go to the slice nearest to an index (z, y, x) of the image, and draw the cursor's lines."""
        n = self._image.shape[self.plane]
        index = int(np.clip(round(float(cursor[self.axis])), 0, n - 1))
        turned = n - 1 - index if self._up.flips[self.plane] else index
        if turned != self._index:
            self._index = turned
            self._show_grey()
        left, right, bottom, top = self.extent
        x, y = self.to_tile(np.asarray(cursor, float))
        cross = np.array([[[left, y], [right, y]], [[x, bottom], [x, top]]])
        self._draw_lines("cursor", cross, CURSOR, 1.0, 0.45)
        name = PLANES[self.plane] if self._anatomical else "Slice"
        where = in_unit(self._up.coordinate(self.plane, turned), self._unit)
        self.title.text = f"{name}  {self._up.names[self.plane]} = {measure(where)} {self._unit}"

    def _show_grey(self) -> None:
        grey = self._window.grey(self._image.take(self._index, axis=self.plane))
        self._texture.show(self._upwards(grey))

    def _upwards(self, picture: NDArray[Any]) -> NDArray[Any]:
        """A picture with the row at the lower edge of the quad first, as textures have it."""
        return picture[::-1] if self._down else picture

    def hung(self, plane: NDArray[Any]) -> NDArray[Any]:
        """A plane of the image across `axis`, (rows, columns) of its array, as the texture of a quad on `extent`."""
        turned = self._up.reorient(np.expand_dims(plane, self.axis))
        return self._upwards(turned.take(0, axis=self.plane))

    def use_image(self, image: NDArray[Any]) -> None:
        """Show another image (nz, ny, nx) on the same grid."""
        self._image = self._up.reorient(image)
        self._show_grey()

    def use_window(self, window: GreyWindow) -> None:
        """Draw other values black and white."""
        self._window = window
        self._show_grey()

    def interpolate(self, on: bool) -> None:
        """Draw smoothly between voxels, or each voxel as a rectangle."""
        self._texture.interpolate(on)

    @property
    def count(self) -> int:
        """How many slices there are."""
        return int(self._image.shape[self.plane])

    @property
    def index(self) -> int:
        """Index of the slice along `axis`."""
        n = self._image.shape[self.plane]
        return n - 1 - self._index if self._up.flips[self.plane] else self._index

    def draw_objects(self, frame: Frame) -> None:
        """Draw the contour of each object of a frame in this slice."""
        for position, (surface, style) in enumerate(zip(frame.surfaces, self.styles.of(frame), strict=True)):
            part = slice_of(surface, self.axis, self.index)
            places = self._in_slice(np.zeros((0, 2, 2)) if part is None else contour(part))
            lines = self.to_tile(surface.to_image(places))
            lines = lines if style.visible else lines[:0]
            self._draw_lines(f"object {position}", lines, style.color, 2.2, style.opacity)
        for position in range(len(frame.surfaces), self._drawn_objects):
            self._lines[f"object {position}"][0].SetVisibility(False)
        self._drawn_objects = len(frame.surfaces)
        self._draw_predicted(frame)
        self._draw_clicks(frame)

    def _draw_predicted(self, frame: Frame) -> None:
        """Draw where tracked objects were expected in this slice, dashed."""
        parts = [(one, slice_of(one, self.axis, self.index)) for one in frame.predicted]
        lines = [one.to_image(self._in_slice(contour(part))) for one, part in parts if part is not None]
        dashes = np.concatenate([np.zeros((0, 2, 2)), *(dashed(self.to_tile(line)) for line in lines)])
        self._draw_lines("predicted", dashes, REFERENCE, 1.6)

    def draw_reference(self, function: NDArray[np.float32]) -> None:
        """Draw where a function of the whole image, negative inside, is 0 in this slice."""
        places = self._in_slice(contour(np.asarray(function.take(self.index, axis=self.axis))))
        self._draw_lines("reference", self.to_tile(places), REFERENCE, 1.8)

    def _in_slice(self, lines: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ends (n, 2, 3) as indices (z, y, x), 0 along the slice's axis, of segments (n, 2, 2) of rows and columns."""
        places = np.zeros((len(lines), 2, 3))
        rows, columns = (axis for axis in range(3) if axis != self.axis)
        places[..., rows], places[..., columns] = lines[..., 0], lines[..., 1]
        return places

    def mark_ball(self, center: NDArray[np.float64] | None, radius: float, geometry: Geometry) -> bool:
        """Draw the circle in which a ball (world mm) cuts this slice; nothing for None or beside it.

        Returns
        -------
        bool
            Whether the picture has changed.
        """
        lines = np.zeros((0, 2, 2))
        if center is not None:
            index = geometry.world_to_index(center)
            off = (index[self.axis] - self.index) * geometry.spacing[self.axis]
            if abs(off) < radius:
                turn = np.linspace(0.0, 2.0 * np.pi, 65)
                ring = self.to_tile(index) + np.sqrt(radius**2 - off**2) * np.stack([np.cos(turn), np.sin(turn)], -1)
                lines = np.stack([ring[:-1], ring[1:]], axis=1)
        was_there = "ball" in self._lines and bool(self._lines["ball"][0].GetVisibility())
        if not was_there and not len(lines):
            return False
        self._draw_lines("ball", lines, MARK, 2.2)
        return True

    def mark_size(self, drag: SizeDrag | None, volume_mm3: float | None, text: str = "") -> None:
        """Draw the outline that a drag shows in this slice, and write a text below the title; nothing for None."""
        self.title.text = "\n".join(line for line in (self.title.text.partition("\n")[0], text) if line)
        lines = np.zeros((0, 2, 2))
        if drag is not None and volume_mm3 is not None:
            plane = drag.plane(self.axis, self.index, volume_mm3)
            if plane is not None:
                lines = self.to_tile(self._in_slice(contour(plane)) + np.asarray(drag.first))
        self._draw_lines("size", lines, MARK, 2.2)

    def mark_places(self, places: NDArray[np.float64]) -> None:
        """Draw a diamond in another one at each of these indices (z, y, x), (n, 3), that lies in this slice."""
        left, right, bottom, top = self.extent
        here = self.to_tile(places[np.rint(places[:, self.axis]) == self.index].reshape(-1, 3))
        corners = ARM * max(right - left, top - bottom) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        lines = [place + size * sides for place in here for size in (1.4, 2.4)]
        self._draw_lines("places", np.concatenate(lines) if lines else np.zeros((0, 2, 2)), CURSOR, 2.5)

    def add_picture(self, texture: GreyTexture | ColorTexture, depth: float) -> pv.Actor:
        """Draw a picture of the whole slice; what has a larger ``depth`` lies over what has a smaller one."""
        left, right, bottom, top = self.extent
        middle = (0.5 * (left + right), 0.5 * (bottom + top), depth)
        quad = pv.Plane(center=middle, i_size=right - left, j_size=top - bottom, i_resolution=1, j_resolution=1)
        actor = self._add(quad, "white")
        actor.SetTexture(texture.texture)
        return actor

    def _draw_clicks(self, frame: Frame) -> None:
        """Draw the clicks that this slice cuts: + inside, x outside."""
        arms: dict[str, list[NDArray[np.float64]]] = {"inside": [], "outside": []}
        left, right, bottom, top = self.extent
        arm = ARM * max(right - left, top - bottom)
        for mark in frame.clicks:
            part = mark.box[self.axis]
            if part.start <= self.index < part.stop:
                place = self.to_tile(np.asarray(mark.place, float))
                arms[mark.side] += [np.stack([place - arm * way, place + arm * way]) for way in _WAYS[mark.side]]
        for side, lines in arms.items():
            segments = np.array(lines) if lines else np.zeros((0, 2, 2))
            self._draw_lines(side, segments, INSIDE if side == "inside" else OUTSIDE, 3.0)

    def _draw_lines(
        self, name: str, lines: NDArray[np.float64], color: str, width: float, opacity: float = 1.0
    ) -> None:
        """Draw segments (n, 2, 2) in the tile's plane, in place of those drawn before under this name."""
        depth = {"cursor": 1.0, "reference": 2.0}.get(name, 3.0)
        points = np.column_stack([lines.reshape(-1, 2), np.full(2 * len(lines), depth)])
        mesh = pv.PolyData()
        if len(lines):
            cells = np.column_stack([np.full(len(lines), 2), np.arange(2 * len(lines)).reshape(-1, 2)])
            mesh = pv.PolyData(points, lines=cells.ravel())
        if name not in self._lines:
            self._lines[name] = self._add(mesh, color, opacity=opacity), width
            self._lines[name][0].prop.line_width = width * self._ratio
        actor = self._lines[name][0]
        actor.prop.color, actor.prop.opacity = color, opacity
        actor.mapper.SetInputData(mesh)
        actor.SetVisibility(len(lines) > 0)

    def fit(self, pixels: Pixels) -> None:
        """Make the slice as large as its tile allows, the bar as long as that makes it, and text readable."""
        for label in (self.title, *self._letters):
            label.fit(pixels)
        self._ratio = pixels.ratio
        for actor, own_width in self._lines.values():
            actor.prop.line_width = own_width * pixels.ratio
        width, height = self.renderer.GetSize()
        if not width or not height:
            return
        self._aim()
        self._bar.fit(pixels)
        if self._letters:
            left, right, bottom, top = self.extent
            scale = 2.0 * self.renderer.camera.parallel_scale
            room = LETTER * pixels.text / height
            self._place_letters((right - left) * height / width / scale, (top - bottom) / scale, room)

    # -- zoom and pan -------------------------------------------------------------------------------------

    def _fitted(self) -> float:
        """Half the mm that the tile must be high for the whole slice to be seen."""
        width, height = self.renderer.GetSize()
        left, right, bottom, top = self.extent
        return 0.5 * max(top - bottom, (right - left) * height / max(width, 1)) / FILL

    def _aim(self) -> None:
        camera = self.renderer.camera
        camera.parallel_scale = self._fitted() / self._zoom
        x, y = (float(part) for part in self._middle)
        camera.focal_point, camera.position = (x, y, 0.0), (x, y, 100.0)

    def zoom(self, factor: float, right: float = 0.5, up: float = 0.5) -> None:
        """Enlarge by a factor; what is at this place of the tile, each coordinate from 0 to 1, stays there."""
        before = np.array(self.to_plane(right, up))
        self._zoom = float(np.clip(self._zoom * factor, MIN_ZOOM, MAX_ZOOM))
        self._aim()
        self.shift(*(before - self.to_plane(right, up)))

    def shift(self, right_mm: float, up_mm: float) -> None:
        """Move the camera by mm in the tile's plane; never so far that the slice is out of sight."""
        left, right, bottom, top = self.extent
        moved = self._middle + np.array([right_mm, up_mm])
        self._middle = np.clip(moved, [left, bottom], [right, top])
        self._aim()

    def show_whole(self) -> None:
        """Show the whole slice, as at first."""
        left, right, bottom, top = self.extent
        self._middle, self._zoom = np.array([0.5 * (left + right), 0.5 * (bottom + top)]), 1.0
        self._aim()

    def mm_per_pixel(self) -> float:
        """How many mm a pixel of the picture is."""
        return 2.0 * self.renderer.camera.parallel_scale / max(self.renderer.GetSize()[1], 1)

    def paint(self, theme: Theme) -> None:
        """Use another theme."""
        self._theme = theme
        self.renderer.background_color = theme.background
        for part in (self.title, self._bar):
            part.paint(theme.ink)

    def _add(self, mesh: pv.PolyData, color: str, opacity: float = 1.0) -> pv.Actor:
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(mesh)
        mapper.ScalarVisibilityOff()
        actor = pv.Actor(mapper=mapper)
        actor.prop.color, actor.prop.lighting, actor.prop.opacity = color, False, opacity
        self.renderer.add_actor(actor, reset_camera=False, render=False)
        return actor

    def _write_letters(self) -> list[Label]:
        """The patient's directions at the left, right, upper and lower edge of the image."""
        left, right = LETTERS[2 - self._horizontal]
        low, high = LETTERS[2 - self._vertical]
        top, bottom = (low, high) if self._down else (high, low)
        return [Label(self.renderer, "white", (0.5, 0.5), text, boxed=True) for text in (left, right, top, bottom)]

    def _place_letters(self, wide: float, high: float, room: float) -> None:
        """Put the letters beside an image that takes these parts of the tile, ``room`` from it: two at a thin slab do
        not overlap; below the title, above the bar.
        """
        right, up = min(0.5 + 0.5 * wide + 0.03, 0.97), min(0.5 + 0.5 * high + room, 0.905)
        down = max(0.5 - 0.5 * high - room, 0.035)
        for letter, place in zip(self._letters, ((1 - right, 0.5), (right, 0.5), (0.5, up), (0.5, down)), strict=True):
            letter.move(*place)
