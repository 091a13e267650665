"""Mouse, scrolling and touch in the scene, of window and page alike.

Left uses the tool, or looks around; right changes the grey values of slices, and zooms in 3D; middle (or shift with
left) moves the picture; scrolling goes through slices, with Ctrl it zooms. One button at a time counts. Places are
parts of the width, and of the height from the top, each from 0 to 1.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.viewer.actions.answers import AnswersFeature
from accelsurf.viewer.actions.frames import FramesFeature
from accelsurf.viewer.actions.settings_rows import amount, from_read, read_in
from accelsurf.viewer.actions.slices import SlicesFeature
from accelsurf.viewer.actions.tool import (
    AllActions,
    Feature,
    Key,
    Tool,
    finest,
    number,
    whole,
    word,
)
from accelsurf.viewer.actions.tools import TOOLS
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.scene.space import Picked, place_in_renderer

#: Zoom per notch.
ZOOM = 1.12
#: Scroll of a notch in browsers, in pixels, lines and pages: the modes in which they count, in this order.
PER_NOTCH = (100.0, 3.0, 1.0)
#: From this part of a notch in pixels on it is a mouse's, which turns by whole notches: how many pixels one has depends
#: on the system and on the browser's own zoom.
WHOLE = 0.5
#: Largest magnitude that a browser may report.
MAX_DELTA = 1e6


def notches_of(delta: object, mode: object, zoom: bool) -> float:
    """Return the notches that a browser reports of scrolling, up positive.

    Parameters
    ----------
    delta, mode : object
        ``deltaY`` and ``deltaMode`` of the event, not trusted.
    zoom : bool
        Whether it zooms: a small turn is then a pinch on a trackpad, of which 100 pixels are a factor of e.

    Raises
    ------
    UsageError
        When ``delta`` or ``mode`` is no number in its range.

    Examples
    --------
    >>> notches_of(-120, 0, False), notches_of(-4, 0, False), notches_of(3, 1, False), notches_of(0, 0, False)
    (1.0, 0.04, -1.0, 0.0)
    """
    unit = whole(mode, 0, len(PER_NOTCH) - 1)
    turned = 0.0 - number(delta, -MAX_DELTA, MAX_DELTA) / PER_NOTCH[unit]
    if unit == 0 and abs(turned) >= WHOLE:
        return math.copysign(min(max(round(abs(turned)), 1), 100), turned)
    if unit == 0 and zoom:
        return turned / math.log(ZOOM)
    return min(max(turned, -100.0), 100.0)


class SliceScroll:
    """Scrolling over slices: fractions of a notch add up until they are a whole slice."""

    def __init__(self) -> None:
        self._tile, self._left = "", 0.0

    def add(self, tile: str, notches: float) -> int:
        """Scroll over a tile; returns how many slices further it is now."""
        if tile != self._tile or notches * self._left < 0:
            self._left = 0.0
        self._tile, self._left = tile, self._left + notches
        slices = int(self._left + math.copysign(1e-9, self._left))
        self._left -= slices
        return slices


#: Buttons, as browsers number them.
LEFT = 0
MIDDLE = 1
RIGHT = 2
#: Number in place of a button's, for a press on the slider of a slice.
SLIDE = 3
#: Degrees that the camera turns per pixel of a picture 720 high.
TURN = 0.45
#: Ends of the slider: voxels of the smallest spacing, and parts of the image's longest side.
LEAST = 0.5
MOST = 0.4
#: Seconds without a move after which a mouse is still.
STILL = 0.5


class MouseFeature(Feature):
    """Mouse and tools.

    Attributes
    ----------
    tool : Tool
        In use.
    is_dragging : bool
        Whether a button is down.
    gesture : int
        How many presses there have been.
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._tools = tuple(kind(actions) for kind in TOOLS)
        self.tool: Tool = self._tools[0]
        #: The tile in which a button is down, that button, and the button it acts as: with shift, left is as middle.
        self._tile = ""
        self._pressed = LEFT
        self._button = LEFT
        self._at = (0.0, 0.0)
        self._moved_at, self.gesture = 0.0, 0
        self._scrolled = SliceScroll()
        self._unit, self._per = read_in("mm", actions.scene.unit)

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "tool": self._use,
            "no_tool": self._look,
            "radius": self._radius,
            "set_radius": lambda value: self._radius(from_read(value, self._per)),
            "scale_radius": lambda factor: self._radius(
                self.actions.radius * number(factor, 0.1, 10.0)
            ),
            "press": self.press,
            "move": self.move,
            "release": self.release,
            "cancel": self.cancel,
            "hover": self._hover,
            "scroll": self._scroll,
            "scroll_delta": self._scroll_delta,
            "double": self._double,
        }

    def tools(self) -> Sequence[Tool]:
        return self._tools

    def keys(self) -> Mapping[str, Key]:
        return {
            "Escape": Key(
                "no_tool", (), "look; what is being drawn is dropped, outlines of other answers too"
            ),
            "[": Key("scale_radius", (1 / 1.25,), "smaller click and ball"),
            "]": Key("scale_radius", (1.25,), "larger click and ball"),
        }

    def state(self, status: Status) -> dict[str, Any]:
        geometry, radius = self.actions.scene.geometry, self.actions.radius
        longest = float(max(geometry.extent_mm))
        row = amount(LEAST * finest(geometry), MOST * longest, radius, 2.0, longest, per=self._per)
        tool = {"tool": self.tool.name, "tool_tip": self.tool.tip}
        return {**tool, "radius": radius, "radius_row": {"unit": self._unit, **row}}

    @property
    def is_dragging(self) -> bool:
        """Test if a button is down."""
        return bool(self._tile)

    @property
    def is_moving(self) -> bool:
        """Test if a button is down and the mouse has moved a moment ago."""
        return self.is_dragging and time.monotonic() - self._moved_at < STILL

    # -- choices ------------------------------------------------------------------------------------------

    def _use(self, name: Any) -> None:
        tool = self.actions.tools[word(name, tuple(self.actions.tools))]
        self.cancel()
        self.tool.leave()
        self.tool = tool
        self.actions.scene.mark_ball(None)

    def _look(self) -> None:
        self._use("look")
        self.actions.feature(AnswersFeature).hide()

    def _radius(self, mm: Any) -> None:
        self.actions.radius = number(mm, 0.0, float(max(self.actions.scene.geometry.extent_mm)))
        self.tool.resize()

    # -- events -------------------------------------------------------------------------------------------

    def press(self, x: Any, y: Any, button: Any = LEFT, shift: Any = False) -> None:
        """A button goes down; while another one is down nothing happens."""
        pixel, button = self._pixel(x, y), whole(button, LEFT, RIGHT)
        if self.is_dragging and button != self._pressed:
            return
        self.cancel()  # the same one again: its release was lost
        self._moved_at, self.gesture = time.monotonic(), self.gesture + 1
        at = self.actions.scene.pick(*pixel)
        self._pressed, self._button = button, MIDDLE if shift and button == LEFT else button
        self._tile, self._at = at.tile, pixel
        tiles = self.actions.scene.tiles
        tiles.redraw.hurry(at.tile in self.actions.scene.slice_tiles)
        if at.tile == "space":
            tiles.coarsen(True)
        tile = self.actions.scene.slice_tiles.get(at.tile)
        place = None if tile is None else place_in_renderer(tile.renderer, *pixel)
        if (
            self._button == LEFT
            and tile is not None
            and place is not None
            and tile.slider_takes(place[1])
        ):
            self._button = SLIDE
            self._look_around(0.0, 0.0)
        elif self._button == LEFT and at.world is not None and self._uses_tool(at.tile):
            self.actions.feature(FramesFeature).refuse_tool(self.tool.name)
            self.tool.press(at)

    def move(self, x: Any, y: Any) -> None:
        """The mouse moves; without a button nothing happens."""
        pixel = self._pixel(x, y)
        if not self._tile:
            return
        right = pixel[0] - self._at[0]
        up = pixel[1] - self._at[1]
        self._moved_at = time.monotonic()
        self._at = pixel
        if self._button == LEFT and self._uses_tool(self._tile):
            at = self.actions.scene.pick(*pixel)
            if at.world is not None and at.tile == self._tile:
                self.tool.move(at)
        else:
            self._look_around(right, up)
            at = self.actions.scene.pick(*pixel)
        self._read(at)
        if self._button == RIGHT and self._tile in self.actions.scene.slice_tiles:
            self.actions.feature(SlicesFeature).write(self._tile)

    def _look_around(self, right: float, up: float) -> None:
        """Move by pixels in the tile in which a button went down."""
        scene = self.actions.scene
        if self._tile not in scene.tiles.names:
            return
        size, space = (
            scene.plotter.render_window.GetSize(),
            scene.space if self._tile == "space" else None,
        )
        if self._button == SLIDE:
            tile = scene.slice_tiles[self._tile]
            place = place_in_renderer(tile.renderer, *self._at, beside=True) or (0.0, 0.0)
            scene.go_to_slice(self._tile, tile.number_at(place[0]))
        elif self._button == MIDDLE:
            scene.tiles.tile(self._tile).shift(right, up)
        elif self._button == RIGHT and space is None:
            self.actions.feature(SlicesFeature).drag_window(right / size[0], up / size[1])
        elif self._button == RIGHT and space is not None:
            space.zoom(ZOOM ** (40.0 * up / size[1]))
        elif space is not None:
            space.turn(-TURN * 720.0 / size[1] * right, -TURN * 720.0 / size[1] * up)

    def release(self, button: Any = None) -> None:
        """A button goes up, by default the one that is down."""
        if button is not None and whole(button, LEFT, RIGHT) != self._pressed:
            return
        if self._leave_tile():
            self.tool.release()

    def cancel(self) -> None:
        """End the drag, as if no button had gone down."""
        if self._leave_tile():
            self.tool.cancel()
            self.actions.scene.mark_ball(None)

    def _leave_tile(self) -> bool:
        """Note that no button is down any more; returns whether the tool was used."""
        tile, self._tile = self._tile, ""
        self.actions.scene.tiles.redraw.hurry(False)
        if self._button == RIGHT and tile in self.actions.scene.slice_tiles:
            self.actions.scene.slice_tiles[tile].write("")
        return bool(tile) and self._button == LEFT and self._uses_tool(tile)

    def _hover(self, x: Any, y: Any) -> None:
        self._read(self.actions.scene.pick(*self._pixel(x, y)) if not self.is_dragging else None)

    def _scroll(self, x: Any, y: Any, notches: Any, zoom: Any = False) -> None:
        scene, (across, up) = self.actions.scene, self._pixel(x, y)
        at, notches = scene.pick(across, up), number(notches, -100, 100)
        factor = ZOOM ** min(max(notches, -5.0), 5.0)
        if at.tile in scene.slice_tiles and zoom:
            self._zoom(at.tile, across, up, factor)
        elif at.tile in scene.slice_tiles:
            if slices := self._scrolled.add(at.tile, notches):
                scene.step_slice(at.tile, slices)
                self._read(scene.pick(across, up))
        elif scene.space is not None and at.tile == "space":
            scene.space.zoom(factor)

    def _scroll_delta(self, x: Any, y: Any, delta: Any, mode: Any, zoom: Any = False) -> None:
        """Scroll as browsers report it: how much, and in pixels, lines or pages."""
        self._scroll(x, y, notches_of(delta, mode, bool(zoom)), zoom)

    def zoom(self, x: float, y: float, factor: float) -> None:
        """Enlarge the tile in which a button is down; the point at this place stays there."""
        pixel = self._pixel(x, y)
        if self._tile in self.actions.scene.tiles.names:
            self._zoom(self._tile, *pixel, factor)

    def _double(self, x: Any, y: Any) -> None:
        tile = self.actions.scene.pick(*self._pixel(x, y)).tile
        self.cancel()
        if tile in self.actions.scene.tiles.names and self.tool.name == "look":
            self.actions.feature(SlicesFeature).enlarge(tile)

    def _uses_tool(self, tile: str) -> bool:
        """Test if the left button uses the tool there: in 3D it turns the camera, unless the tool paints."""
        return tile in self.actions.scene.slice_tiles or (
            tile == "space" and self.tool.name not in ("look", "size")
        )

    def _read(self, at: Picked | None) -> None:
        self.actions.feature(SlicesFeature).read(at)

    def _pixel(self, x: Any, y: Any) -> tuple[float, float]:
        """Pixels from the lower left corner, of parts of the width and of the height from the top."""
        width, height = self.actions.scene.plotter.render_window.GetSize()
        return number(x, 0.0, 1.0) * width, (1.0 - number(y, 0.0, 1.0)) * height

    def _zoom(self, tile: str, x: float, y: float, factor: float) -> None:
        """Enlarge a tile; the point at this pixel stays there."""
        tiles = self.actions.scene.tiles
        tiles.tile(tile).zoom(
            factor, *(place_in_renderer(tiles.renderer(tile), x, y, beside=True) or (0.5, 0.5))
        )


#: Touches that are counted; and the largest magnitude of the number by which a screen knows each.
MAX_TOUCHES = 10
MAX_NUMBER = 2**31
#: Least distance of two touches, pixels: it is a divisor.
NEAR = 10.0


class TouchFeature(Feature):
    """Makes touches act as the mouse does.

    The first one draws. With the second one a gesture of two begins, so the action of the first is cancelled, and
    nothing is drawn until all are up: who lifts one touch of two does not mean to paint.
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        #: Places of all that are down, parts of the width and of the height from the top.
        self._places: dict[int, tuple[float, float]] = {}
        #: Those whose moves count: one, two, or none where the rest of a gesture is waited for.
        self._leading: tuple[int, ...] = ()
        self._gesture = 0

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "touch_down": self._down,
            "touch_move": self._move,
            "touch_up": self._up,
            "touch_cancel": self._cancel,
        }

    @property
    def _mouse(self) -> MouseFeature:
        return self.actions.feature(MouseFeature)

    @property
    def _leads(self) -> bool:
        """Test if the drag was begun by these touches, not by a mouse or a pen meanwhile."""
        return (
            bool(self._leading) and self._mouse.is_dragging and self._mouse.gesture == self._gesture
        )

    def _down(self, x: Any, y: Any, touch: Any, first: Any = False) -> None:
        """Begin a touch; ``first`` when the screen knows of no other: any that are known here were lost."""
        touch, place = _number(touch), _place(x, y)
        if first:
            self._cancel()
        if len(self._places) >= MAX_TOUCHES or (not self._places and self._mouse.is_dragging):
            return  # a hand that rests on the screen while a pen draws
        is_alone = not self._places
        self._places[touch] = place
        if is_alone:
            self._begin_with((touch,), LEFT)
        elif len(self._leading) == 1 and touch not in self._leading:
            if self._leads:
                self._mouse.cancel()
                self._begin_with((*self._leading, touch), MIDDLE)
            else:  # a pen draws meanwhile, or a key has ended the gesture
                self._leading = ()

    def _begin_with(self, touches: tuple[int, ...], button: int) -> None:
        self._leading = touches
        try:
            self._mouse.press(*self._middle(), button)
        finally:  # a tool may be refused; the button is down all the same
            self._gesture = self._mouse.gesture

    def _move(self, x: Any, y: Any, touch: Any) -> None:
        touch, place = _number(touch), _place(x, y)
        if touch not in self._places:
            return
        before, self._places[touch] = self._apart(), place
        if touch in self._leading and self._leads:
            self._mouse.move(*self._middle())
            if len(self._leading) == 2:
                self._mouse.zoom(*self._middle(), self._apart() / before)

    def _up(self, touch: Any) -> None:
        self._forget(_number(touch), self._mouse.release)

    def _cancel(self, touch: Any = None) -> None:
        """End the gesture of a touch, or of all: the system has taken it for something else."""
        for lost in (*self._places,) if touch is None else (_number(touch),):
            self._forget(lost, self._mouse.cancel)

    def _forget(self, touch: int, end: Callable[[], None]) -> None:
        """Forget a touch that has ended; its gesture ends with ``end``."""
        self._places.pop(touch, None)
        if touch in self._leading:
            leads, self._leading = self._leads, ()
            if leads:
                end()

    def _middle(self) -> tuple[float, float]:
        """Return the place between the touches that lead."""
        x, y = zip(*(self._places[touch] for touch in self._leading), strict=True)
        return sum(x) / len(x), sum(y) / len(y)

    def _apart(self) -> float:
        """Pixels between the two touches that lead."""
        if len(self._leading) != 2:
            return NEAR
        width, height = self.actions.scene.plotter.render_window.GetSize()
        (x, y), (far_x, far_y) = (self._places[touch] for touch in self._leading)
        return max(math.hypot((far_x - x) * width, (far_y - y) * height), NEAR)


def _number(touch: Any) -> int:
    return whole(touch, -MAX_NUMBER, MAX_NUMBER)


def _place(x: Any, y: Any) -> tuple[float, float]:
    return number(x, 0.0, 1.0), number(y, 0.0, 1.0)
