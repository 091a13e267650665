"""One slice of the image as radiologists hang it, with contours, the cursor's lines, letters and a scale bar.

Contours are cuts of surfaces, functions of the image and drags: segments (n, 2, 2) in the slice's plane, mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.orientation import IN_PLANE, LETTERS, PLANES
from accelsurf.image.grey_window import GreyWindow
from accelsurf.image.slice_stack import Patch, SliceStack, linear
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.core.frame import Frame, SurfaceFrame
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.colors import CURSOR, INSIDE, MARK, OUTSIDE, REFERENCE, Theme
from accelsurf.viewer.scene.legend import measure
from accelsurf.viewer.scene.overlay import FlatLine, Label, Pixels, ScaleBar
from accelsurf.viewer.scene.redraw import TileContext
from accelsurf.viewer.scene.shapes import Texture, add_actor, contour, dashed, polygon, slice_of

NONE = np.zeros((0, 2, 2))


def surface_lines(surface: SurfaceFrame, stack: SliceStack, number: int) -> Floats:
    """The contour of an object in a slice."""
    if not surface.has_surface:
        return NONE
    if not stack.is_straight:
        part = slice_of(surface, stack.axis, number)
        return (
            NONE
            if part is None
            else stack.to_place(surface.to_image(_ends(contour(part), stack.axis)))[..., :2]
        )
    last = np.array(surface.psi.shape) - 1.0
    patch = stack.patch(number, surface.to_image((0.0, 0.0, 0.0)), surface.to_image(last))
    index = surface.from_image(np.stack(np.broadcast_arrays(*patch.places), axis=-1))
    lines = contour(linear(surface.psi, (index[..., 0], index[..., 1], index[..., 2])))
    return _in_plane(
        lines, patch, stack, number, surface.to_image((-0.5,) * 3), surface.to_image(last + 0.5)
    )


def function_lines(function: NDArray[np.float32], stack: SliceStack, number: int) -> Floats:
    """Return the lines in a slice on which a function (nz, ny, nx) of the whole image, negative inside, is 0."""
    if not stack.is_straight:
        return stack.to_place(
            _ends(contour(np.asarray(function.take(number, axis=stack.axis))), stack.axis)
        )[..., :2]
    patch = stack.patch(number)
    lines = contour(linear(function, patch.places))
    return _in_plane(lines, patch, stack, number, (-0.5,) * 3, np.array(function.shape) - 0.5)


class DragLines:
    """The outline of an object of a size, in a tile; in a straight slice its times are read once."""

    def __init__(self) -> None:
        self._read_for: tuple[SizeDrag, SliceStack, int] | None = None
        self._times = np.zeros((0, 0), np.float32)

    def lines(self, drag: SizeDrag, volume_mm3: float, stack: SliceStack, number: int) -> Floats:
        """The outline in a slice, of a volume."""
        first = np.asarray(drag.first, float)
        if not stack.is_straight:
            plane = drag.plane(stack.axis, number, volume_mm3)
            return (
                NONE
                if plane is None
                else stack.to_place(_ends(contour(plane), stack.axis) + first)[..., :2]
            )
        last = first + drag.times.shape - 1.0
        patch = stack.patch(number, first, last)
        if self._read_for != (drag, stack, number):  # drags and stacks are themselves alone
            z, y, x = (place - corner for place, corner in zip(patch.places, first, strict=True))
            self._read_for, self._times = (drag, stack, number), drag.times_at((z, y, x))
        lines = contour(drag.signed(self._times, volume_mm3))
        return _in_plane(lines, patch, stack, number, first - 0.5, last + 0.5)


def ball_lines(center: Floats, radius: float, stack: SliceStack, number: int) -> Floats:
    """The circle in which a ball around an index (z, y, x) of the image, radius in mm, cuts a slice."""
    place = stack.to_place(center)
    off = place[2] - stack.across(number)
    if abs(off) >= radius:
        return NONE
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    ring = place[:2] + np.sqrt(radius**2 - off**2) * np.stack([np.cos(turn), np.sin(turn)], -1)
    return np.stack([ring[:-1], ring[1:]], axis=1)


def _ends(lines: Floats, axis: int) -> Floats:
    """Ends (n, 2, 3) as indices (z, y, x), 0 along an axis, of segments (n, 2, 2) of rows and columns."""
    places = np.zeros((len(lines), 2, 3))
    rows, columns = (other for other in range(3) if other != axis)
    places[..., rows], places[..., columns] = lines[..., 0], lines[..., 1]
    return places


def _in_plane(
    lines: Floats, patch: Patch, stack: SliceStack, number: int, low: object, high: object
) -> Floats:
    """Segments (n, 2, 2) of rows and columns of a patch, in mm; without those beyond a box, where nothing is known."""
    if not len(lines):
        return NONE
    left, _, bottom, _ = stack.extent
    right, up = stack.pitch
    places = np.empty_like(lines)
    places[..., 0] = left + right * (patch.columns.start + lines[..., 1] + 0.5)
    places[..., 1] = bottom + up * (patch.rows.start + lines[..., 0] + 0.5)
    middles = places.mean(axis=1)
    index = stack.to_index(np.column_stack([middles, np.full(len(middles), stack.across(number))]))
    is_inside = (index >= np.asarray(low, float)) & (index <= np.asarray(high, float))
    return np.asarray(places[is_inside.all(axis=1)])


#: Part of a tile's width and height that the image may take.
FILL = 0.97
#: The slider: its distance from the sides of the tile (parts of its width), thickness of track and handle, width of the
#: handle, height of the strip along the lower edge in which a press takes it (pixels of a usual screen).
SIDE = 0.02
TRACK = 2.0
HANDLE = 11.0
WIDE = 9.0
STRIP = 17.0
#: Largest enlargement, and smallest, from the size that fits the tile.
MAX_ZOOM = 40.0
MIN_ZOOM = 0.5
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
    stack : SliceStack
        The slices.
    plane : int
        0 is axial, 1 coronal, 2 sagittal.
    context : TileContext

    Attributes
    ----------
    stack : SliceStack
    index : int
        Number of the slice that is shown.
    """

    def __init__(
        self,
        renderer: pv.Renderer,
        image: NDArray[Any],
        window: GreyWindow,
        stack: SliceStack,
        plane: int,
        context: TileContext,
    ) -> None:
        self.renderer = renderer
        self.plane = plane
        self.stack = stack
        self._context = context
        self.image = image
        self._window = window
        self._is_smooth = True
        self._vertical, self._horizontal = IN_PLANE[plane]
        self.index = -1
        #: Actor of each line, and its width in pixels of a usual screen.
        self.lines: dict[str, tuple[pv.Actor, float]] = {}
        self._ratio = 1.0
        self._drawn_objects, self._drag = 0, DragLines()
        self._texture, self._grey = Texture(is_smooth=True), np.zeros((2, 2), np.uint8)
        self._values: NDArray[Any] = self._grey
        #: Pictures of the whole slice, and their depth.
        self._pictures: list[tuple[pv.Actor, float]] = []
        self._middle, self._zoom = self._center, 1.0
        middle = (*self._middle, 0.0)
        self._picture = add_actor(renderer, pv.PolyData(), "white")
        self._picture.SetTexture(self._texture.texture)
        camera = renderer.camera
        camera.parallel_projection = True
        camera.focal_point = middle
        camera.position = (middle[0], middle[1], 100.0)
        camera.up = (0.0, 1.0, 0.0)
        camera.clipping_range = (1.0, 200.0)
        renderer.camera_set = True
        renderer.SetInteractive(False)
        self.title = Label(renderer, "white", (0.015, 0.985), top=True, backed=True)
        self._bar = ScaleBar(renderer, "white", context.unit, backed=True)
        self._slider: tuple[FlatLine, FlatLine] | None = None
        self._letters = self._write_letters() if context.anatomical else []

    # -- places -------------------------------------------------------------------------------------------

    @property
    def across(self) -> float:
        """Coordinate of the slice that is shown, across it, mm."""
        return self.stack.across(self.index)

    @property
    def sight(self) -> tuple[bool, int]:
        """Key of the slice that is shown, among all of the tile: whether it is straight, and its number."""
        return self.stack.is_straight, self.index

    @property
    def _center(self) -> NDArray[np.float64]:
        left, right, bottom, top = self.stack.extent
        return np.array([0.5 * (left + right), 0.5 * (bottom + top)])

    def to_tile(self, indices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places (..., 2) in the tile, mm, of indices (z, y, x) of the image (..., 3)."""
        return self.stack.to_place(indices)[..., :2]

    def from_tile(self, right: float, up: float) -> NDArray[np.float64] | None:
        """Index (z, y, x) of a place in the tile, on the slice that is shown; None beside the image."""
        index = self.stack.to_index([right, up, self.across])
        return (
            np.clip(index, 0.0, np.array(self.image.shape) - 1.0)
            if self.stack.contains(index)
            else None
        )

    def to_plane(self, right: float, up: float) -> tuple[float, float]:
        """Place in the tile's plane, mm, of a place in its renderer, each from 0 to 1."""
        width, height = self.renderer.GetSize()
        mm = 2.0 * self.renderer.camera.parallel_scale / height
        x, y, _ = self.renderer.camera.focal_point
        return x + (right - 0.5) * width * mm, y + (up - 0.5) * height * mm

    # -- drawing ------------------------------------------------------------------------------------------

    def show(self, cursor: NDArray[np.float64]) -> None:
        """Go to the slice nearest to an index (z, y, x) of the image, and draw the cursor's lines."""
        index = self.stack.nearest_number(cursor)
        if index != self.index:
            self.index = index
            self._show_values()
        left, right, bottom, top = self.stack.extent
        x, y = self.to_tile(np.asarray(cursor, float))
        cross = np.array([[[left, y], [right, y]], [[x, bottom], [x, top]]])
        self._draw_lines("cursor", cross, CURSOR, 1.0, 0.45)
        name, unit = PLANES[self.plane] if self._context.anatomical else "Slice", self._context.unit
        self.title.text = (
            f"{name}  {self.stack.name} = {measure(in_unit(self.across, unit))} {unit}"
        )

    def use_stack(self, stack: SliceStack, cursor: NDArray[np.float64]) -> None:
        """Show other slices of the image, the one nearest to an index (z, y, x), as a whole."""
        self.stack, self.index = stack, -1
        for actor, depth in self._pictures:
            actor.mapper.SetInputData(polygon(self._corners, self.stack.extent, depth))
        self.show_whole()
        self.show(cursor)

    def _show_values(self) -> None:
        """Draw the image in the slice, as far as it reaches."""
        last = np.array(self.image.shape) - 1
        corners = (
            self.stack.outline(self.across, (0, 0, 0), last)
            if self.stack.is_straight
            else self._corners
        )
        self._picture.mapper.SetInputData(polygon(corners, self.stack.extent))
        self._values = self.stack.values(self.image, self.index, self._is_smooth)
        self._show_grey()

    def _show_grey(self) -> None:
        self._grey = self._window.grey(self._values)
        self._texture.show(self._grey)
        self.mark()

    @property
    def _corners(self) -> NDArray[np.float64]:
        left, right, bottom, top = self.stack.extent
        return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])

    def in_space(self) -> tuple[pv.PolyData, NDArray[np.uint8]]:
        """Return the slice in world mm, and its picture, as a texture has it."""
        mesh = self._picture.mapper.GetInput().copy()
        places = np.asarray(mesh.points, float)
        places[:, 2] = self.across
        world = self.stack.geometry.index_to_world(self.stack.to_index(places))
        mesh.points = world.astype(np.float32)
        return mesh, self._grey

    def use_image(self, image: NDArray[Any]) -> None:
        """Show another image (nz, ny, nx) on the same grid."""
        self.image = image
        self._show_values()

    def use_window(self, window: GreyWindow) -> None:
        """Draw other values black and white."""
        self._window = window
        self._show_grey()

    def interpolate(self, on: bool) -> None:
        """Draw smoothly between voxels, or each voxel as a rectangle."""
        self._texture.texture.SetInterpolate(on)
        self._is_smooth = on
        self.mark()
        if self.stack.is_straight:
            self._show_values()

    def draw_objects(self, frame: Frame) -> None:
        """Draw the contour of each object of a frame in this slice."""
        for position, (surface, style) in enumerate(
            zip(frame.surfaces, self._context.styles.of(frame), strict=True)
        ):
            lines = surface_lines(surface, self.stack, self.index) if style.visible else NONE
            self._draw_lines(f"object {position}", lines, style.color, 2.2, style.opacity)
        for position in range(len(frame.surfaces), self._drawn_objects):
            self.lines[f"object {position}"][0].SetVisibility(False)
        self._drawn_objects = len(frame.surfaces)
        expected = (
            dashed(surface_lines(surface, self.stack, self.index)) for surface in frame.predicted
        )
        self._draw_lines("predicted", np.concatenate([NONE, *expected]), REFERENCE, 1.6)
        self._draw_clicks(frame)

    def draw_reference(self, function: NDArray[np.float32]) -> None:
        """Draw the lines in this slice on which a function of the whole image, negative inside, is 0."""
        self._draw_lines(
            "reference", function_lines(function, self.stack, self.index), REFERENCE, 1.8
        )

    def mark_ball(self, center: NDArray[np.float64] | None, radius: float) -> None:
        """Draw the circle in which this slice cuts a ball around an index (z, y, x) of the image, radius in mm; nothing
        for None or beside it.
        """
        lines = NONE if center is None else ball_lines(center, radius, self.stack, self.index)
        if len(lines) or ("ball" in self.lines and self.lines["ball"][0].GetVisibility()):
            self._draw_lines("ball", lines, MARK, 2.2)

    def write(self, text: str) -> None:
        """Write a line below the title; none for an empty text."""
        self.title.text = "\n".join(
            line for line in (self.title.text.partition("\n")[0], text) if line
        )
        self.mark()

    def mark_size(self, drag: SizeDrag | None, volume_mm3: float | None, text: str = "") -> None:
        """Draw the outline that a drag shows in this slice, and write a text below the title; nothing for None."""
        self.write(text)
        lines = NONE
        if drag is not None and volume_mm3 is not None:
            lines = self._drag.lines(drag, volume_mm3, self.stack, self.index)
        self._draw_lines("size", lines, MARK, 2.2)

    def mark_answers(self, answers: Sequence[SurfaceFrame]) -> None:
        """Draw thin dashed outlines of other answers to the first click."""
        lines = [dashed(surface_lines(surface, self.stack, self.index)) for surface in answers]
        if lines or "answers" in self.lines:
            self._draw_lines("answers", np.concatenate([NONE, *lines]), MARK, 1.8)

    def mark_places(self, places: NDArray[np.float64]) -> None:
        """Draw a diamond in a larger one at each of these indices (z, y, x), (n, 3), that lies in this slice."""
        left, right, bottom, top = self.stack.extent
        here = self.to_tile(
            places[np.rint(self.stack.place_number(places)) == self.index].reshape(-1, 3)
        )
        corners = (
            ARM
            * max(right - left, top - bottom)
            * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        )
        sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        lines = [place + size * sides for place in here for size in (1.4, 2.4)]
        self._draw_lines("places", np.concatenate(lines) if lines else NONE, CURSOR, 2.5)

    def add_picture(self, texture: Texture, depth: float) -> pv.Actor:
        """Draw a picture of the whole slice; a larger ``depth`` lies over a smaller one."""
        actor = add_actor(self.renderer, polygon(self._corners, self.stack.extent, depth), "white")
        actor.SetTexture(texture.texture)
        self._pictures.append((actor, depth))
        return actor

    def _draw_clicks(self, frame: Frame) -> None:
        """Draw the clicks that this slice cuts: + inside, x outside."""
        arms: dict[str, list[NDArray[np.float64]]] = {"inside": [], "outside": []}
        left, right, bottom, top = self.stack.extent
        arm = ARM * max(right - left, top - bottom)
        for mark in frame.clicks:
            low, high = ([getattr(side, end) for side in mark.box] for end in ("start", "stop"))
            if self.stack.cuts(self.index, low, np.array(high) - 1):
                place = self.to_tile(np.asarray(mark.place, float))
                arms[mark.side] += [
                    np.stack([place - arm * way, place + arm * way]) for way in _WAYS[mark.side]
                ]
        for side, lines in arms.items():
            segments = np.array(lines) if lines else NONE
            self._draw_lines(side, segments, INSIDE if side == "inside" else OUTSIDE, 3.0)

    def _draw_lines(
        self, name: str, lines: NDArray[np.float64], color: str, width: float, opacity: float = 1.0
    ) -> None:
        """Draw segments (n, 2, 2) in the tile's plane, in place of those drawn before under this name."""
        depth = {"cursor": 1.0, "reference": 2.0}.get(name, 3.0)
        points = np.column_stack([lines.reshape(-1, 2), np.full(2 * len(lines), depth)])
        mesh = pv.line_segments_from_points(points) if len(lines) else pv.PolyData()
        if name not in self.lines:
            self.lines[name] = add_actor(self.renderer, mesh, color, opacity), width
            self.lines[name][0].prop.line_width = width * self._ratio
        actor = self.lines[name][0]
        actor.prop.color, actor.prop.opacity = color, opacity
        actor.mapper.SetInputData(mesh)
        actor.SetVisibility(len(lines) > 0)
        self.mark()

    def mark(self) -> None:
        """Have the tile drawn anew."""
        self._context.redraw.mark(self.renderer)

    def fit(self, pixels: Pixels) -> None:
        """Make the slice as large as its tile allows, the bar as long as that makes it, and text readable."""
        for label in (self.title, *self._letters):
            label.fit(pixels)
        self._ratio = pixels.ratio
        for actor, line_width in self.lines.values():
            actor.prop.line_width = line_width * pixels.ratio
        width, height = self.renderer.GetSize()
        if not width or not height:
            return
        self._aim()
        if self._slider is not None:
            self._fit_slider(*self._slider, pixels)
        self._bar.fit(pixels, self._strip)
        if self._letters:
            left, right, bottom, top = self.stack.extent
            scale = 2.0 * self.renderer.camera.parallel_scale
            room = LETTER * pixels.text / height
            self._place_letters(
                (right - left) * height / width / scale, (top - bottom) / scale, room
            )

    # -- slider -------------------------------------------------------------------------------------------

    def show_slider(self) -> None:
        """Draw a slider over the slices along the lower edge."""
        if self._slider is None and self.stack.count > 1:
            self._slider = (
                FlatLine(self.renderer, "#8A93A0"),
                FlatLine(self.renderer, self._context.theme.ink),
            )

    def _fit_slider(self, track: FlatLine, handle: FlatLine, pixels: Pixels) -> None:
        width = self.renderer.GetSize()[0]
        share = self.index / (self.stack.count - 1)
        share = share if self.stack.step > 0 else 1.0 - share
        up, wide = 0.5 * self._strip, 0.5 * WIDE * pixels.ratio / width
        middle = SIDE + wide + share * (1.0 - 2.0 * (SIDE + wide))
        track.move(SIDE, 1.0 - SIDE, up, TRACK * pixels.ratio)
        handle.move(middle - wide, middle + wide, up, HANDLE * pixels.ratio)

    def slider_takes(self, up: float) -> bool:
        """Test if a press so far up in the tile, from 0 to 1, is on the slider."""
        return up < self._strip

    def number_at(self, right: float) -> int:
        """Return the slice that the slider stands for at this place, from 0 at the left side to 1."""
        share = min(max((right - SIDE) / (1.0 - 2.0 * SIDE), 0.0), 1.0)
        number = round(share * (self.stack.count - 1))
        return number if self.stack.step > 0 else self.stack.count - 1 - number

    # -- zoom and pan -------------------------------------------------------------------------------------

    def _fitted(self) -> float:
        """Half the mm that the tile must be high for the whole slice to be seen."""
        width, height = self.renderer.GetSize()
        left, right, bottom, top = self.stack.extent
        return (
            0.5
            * max((top - bottom) / (1.0 - self._strip), (right - left) * height / max(width, 1))
            / FILL
        )

    @property
    def _strip(self) -> float:
        """Part of the tile's height that the slider takes, which the image leaves free."""
        return (
            0.0
            if self._slider is None
            else min(STRIP * self._ratio / max(self.renderer.GetSize()[1], 1), 0.5)
        )

    def _aim(self) -> None:
        camera = self.renderer.camera
        camera.parallel_scale = self._fitted() / self._zoom
        x, y = (float(part) for part in self._middle)
        y -= self._strip * camera.parallel_scale
        camera.focal_point, camera.position = (x, y, 0.0), (x, y, 100.0)

    def zoom(self, factor: float, right: float = 0.5, up: float = 0.5) -> None:
        """Enlarge by a factor; the point at this place of the tile, each coordinate from 0 to 1, stays there."""
        before = np.array(self.to_plane(right, up))
        self._zoom = float(np.clip(self._zoom * factor, MIN_ZOOM, MAX_ZOOM))
        self._aim()
        self._move(*(before - self.to_plane(right, up)))

    def shift(self, right: float, up: float) -> None:
        """Shift the slice by pixels of the picture."""
        mm = self.mm_per_pixel()
        self._move(-right * mm, -up * mm)

    def _move(self, right_mm: float, up_mm: float) -> None:
        """Move the camera by mm in the tile's plane; never so far that the slice is out of sight."""
        left, right, bottom, top = self.stack.extent
        self._middle = np.clip(
            self._middle + np.array([right_mm, up_mm]), [left, bottom], [right, top]
        )
        self._aim()
        self.mark()

    def show_whole(self) -> None:
        """Show the whole slice, as at first."""
        self._middle, self._zoom = self._center, 1.0
        self._aim()

    def mm_per_pixel(self) -> float:
        """Return the mm that a pixel of the picture is wide."""
        return 2.0 * self.renderer.camera.parallel_scale / max(self.renderer.GetSize()[1], 1)

    def paint(self, theme: Theme) -> None:
        """Use another theme; text is white on black in each, to be read on any image."""
        if self._slider is not None:
            self._slider[1].paint(theme.ink)
        self.mark()

    def _write_letters(self) -> list[Label]:
        """The patient's directions at the left, right, upper and lower edge of the image."""
        left, right = LETTERS[2 - self._horizontal]
        low, high = LETTERS[2 - self._vertical]
        top, bottom = (low, high) if self.plane == 0 else (high, low)  # the front at the top
        return [
            Label(self.renderer, "white", (0.5, 0.5), text, boxed=True)
            for text in (left, right, top, bottom)
        ]

    def _place_letters(self, wide: float, high: float, room: float) -> None:
        """Put the letters beside an image that takes these parts of the tile, ``room`` from it: two at a thin slab do
        not overlap; below the title, above the bar.
        """
        middle = 0.5 + 0.5 * self._strip
        right, up = min(0.5 + 0.5 * wide + 0.03, 0.97), min(middle + 0.5 * high + room, 0.905)
        down = max(middle - 0.5 * high - room, 0.035 + self._strip)
        sides = ((1 - right, middle), (right, middle), (0.5, up), (0.5, down))
        for letter, place in zip(self._letters, sides, strict=True):
            letter.move(*place)
