"""The mouse in the scene, of window and page alike.

Left uses the tool, or looks around; right changes the grey values of slices, and zooms in 3D; middle (or shift with
left) moves the picture; the wheel goes through slices, with Ctrl it zooms. One button at a time counts. Places are
parts of the width, and of the height from the top, each from 0 to 1.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.viewer.core.status import Status
from accelsurf.viewer.scene.picking import Picked
from accelsurf.viewer.workplace.checks import number, whole, word
from accelsurf.viewer.workplace.feature import Feature, Key
from accelsurf.viewer.workplace.frames import FramesFeature
from accelsurf.viewer.workplace.slices import SlicesFeature
from accelsurf.viewer.workplace.tool import Tool
from accelsurf.viewer.workplace.tools import TOOLS
from accelsurf.viewer.workplace.wheel import ZOOM, SliceTurns, notches_of

#: Buttons, as browsers number them.
LEFT, MIDDLE, RIGHT = 0, 1, 2
#: Degrees that the camera turns per pixel of a picture 720 high.
TURN = 0.45
#: A mouse that has not moved for so many seconds is still.
STILL = 0.5


class MouseFeature(Feature):
    """What mouse and tools do.

    Attributes
    ----------
    tool : Tool
        In use.
    is_dragging : bool
        Whether a button is down.
    gesture : int
        How many presses there have been.
    """

    def __init__(self, workplace: Any) -> None:
        super().__init__(workplace)
        self._tools = tuple(kind(workplace) for kind in TOOLS)
        self.tool: Tool = self._tools[0]
        #: The tile in which a button is down, that button, and what it does: with shift, left is as middle.
        self._tile, self._pressed, self._button, self._at = "", LEFT, LEFT, (0.0, 0.0)
        self._moved_at, self.gesture, self._turns = 0.0, 0, SliceTurns()

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "tool": self._use,
            "no_tool": lambda: self._use("look"),
            "radius": self._radius,
            "scale_radius": lambda factor: self._radius(self.workplace.radius * number(factor, 0.1, 10.0)),
            "press": self.press,
            "move": self.move,
            "release": self.release,
            "cancel": self.cancel,
            "hover": self._hover,
            "wheel": self._wheel,
            "scroll": self._scroll,
            "double": self._double,
        }

    def tools(self) -> Sequence[Tool]:
        return self._tools

    def keys(self) -> Mapping[str, Key]:
        return {
            "Escape": Key("no_tool", (), "look; what is being drawn is dropped"),
            "[": Key("scale_radius", (1 / 1.25,), "smaller ball and brush"),
            "]": Key("scale_radius", (1.25,), "larger ball and brush"),
        }

    def state(self, status: Status) -> dict[str, Any]:
        return {"tool": self.tool.name, "radius": self.workplace.radius}

    @property
    def is_dragging(self) -> bool:
        """Whether a button is down."""
        return bool(self._tile)

    @property
    def is_moving(self) -> bool:
        """Whether a button is down and the mouse has moved a moment ago."""
        return self.is_dragging and time.monotonic() - self._moved_at < STILL

    # -- choices ------------------------------------------------------------------------------------------

    def _use(self, name: Any) -> None:
        tool = self.workplace.tools[word(name, tuple(self.workplace.tools))]
        self.cancel()
        self.tool.leave()
        self.tool = tool
        self.workplace.scene.mark_ball(None)
        self.workplace.note(tool.tip)
        self.workplace.changed = True

    def _radius(self, mm: Any) -> None:
        geometry = self.workplace.scene.geometry
        self.workplace.radius = number(mm, 0.0, float(max(geometry.extent_mm)))
        self.tool.resize()
        self.workplace.changed = True

    # -- events -------------------------------------------------------------------------------------------

    def press(self, x: Any, y: Any, button: Any = LEFT, shift: Any = False) -> None:
        """A button goes down; while another one is down nothing happens."""
        pixel, button = self._pixel(x, y), whole(button, LEFT, RIGHT)
        if self.is_dragging and button != self._pressed:
            return
        self.cancel()  # the same one again: its release was lost
        self._moved_at, self.gesture = time.monotonic(), self.gesture + 1
        at = self.workplace.scene.pick(*pixel)
        self._pressed, self._button = button, MIDDLE if shift and button == LEFT else button
        self._tile, self._at = at.tile, pixel
        tiles = self.workplace.scene.tiles
        tiles.redraw.hurries = at.tile in self.workplace.scene.slice_tiles
        if at.tile == "space":
            tiles.coarsen(True)
        if self._button == LEFT and at.world is not None and self._uses_tool(at.tile):
            self.workplace.feature(FramesFeature).refuse_tool(self.tool.name)
            self.tool.press(at)
        self.workplace.changed = True

    def move(self, x: Any, y: Any) -> None:
        """The mouse moves; without a button nothing happens."""
        pixel = self._pixel(x, y)
        if not self._tile:
            return
        right, up, self._moved_at = pixel[0] - self._at[0], pixel[1] - self._at[1], time.monotonic()
        self._at = pixel
        if self._button == LEFT and self._uses_tool(self._tile):
            at = self.workplace.scene.pick(*pixel)
            if at.world is not None and at.tile == self._tile:
                self.tool.move(at)
        else:
            self._look_around(right, up)
            at = self.workplace.scene.pick(*pixel)
        self._read(at)
        self.workplace.changed = True

    def _look_around(self, right: float, up: float) -> None:
        """Move by pixels in the tile in which a button went down."""
        scene, tile = self.workplace.scene, self._tile
        tiles, size = scene.tiles, scene.plotter.render_window.GetSize()
        if tile in scene.slice_tiles:
            if self._button == MIDDLE:
                tiles.shift_slice(tile, right, up)
            elif self._button == RIGHT:
                self.workplace.feature(SlicesFeature).drag_window(right / size[0], up / size[1])
        elif tile == "space":
            if self._button == MIDDLE:
                tiles.shift(right, up)
            elif self._button == RIGHT:
                tiles.zoom(ZOOM ** (40.0 * up / size[1]))
            else:
                tiles.turn(-TURN * 720.0 / size[1] * right, -TURN * 720.0 / size[1] * up)

    def release(self, button: Any = None) -> None:
        """A button goes up, by default the one that is down."""
        if button is not None and whole(button, LEFT, RIGHT) != self._pressed:
            return
        if self._leave_tile():
            self.tool.release()

    def cancel(self) -> None:
        """End what is being dragged, as if no button had gone down."""
        if self._leave_tile():
            self.tool.cancel()
            self.workplace.scene.mark_ball(None)

    def _leave_tile(self) -> bool:
        """No button is down any more; returns whether the tool was used."""
        tile, self._tile = self._tile, ""
        self.workplace.scene.tiles.redraw.hurries = False
        self.workplace.changed = True
        return bool(tile) and self._button == LEFT and self._uses_tool(tile)

    def _hover(self, x: Any, y: Any) -> None:
        self._read(self.workplace.scene.pick(*self._pixel(x, y)) if not self.is_dragging else None)

    def _wheel(self, x: Any, y: Any, notches: Any, zoom: Any = False) -> None:
        scene, (across, up) = self.workplace.scene, self._pixel(x, y)
        at, notches = scene.pick(across, up), number(notches, -100, 100)
        factor = ZOOM ** min(max(notches, -5.0), 5.0)
        if at.tile in scene.slice_tiles and zoom:
            scene.tiles.zoom_slice(at.tile, factor, *self._place(at.tile, across, up))
        elif at.tile in scene.slice_tiles:
            slices = self._turns.add(at.tile, notches)
            if not slices:
                return
            scene.step_slice(at.tile, slices)
            self._read(scene.pick(across, up))
        elif at.tile == "space":
            scene.tiles.zoom(factor)
        self.workplace.changed = True

    def _scroll(self, x: Any, y: Any, delta: Any, mode: Any, zoom: Any = False) -> None:
        """The wheel as browsers report it: how much, and in pixels, lines or pages."""
        self._wheel(x, y, notches_of(delta, mode, bool(zoom)), zoom)

    def zoom(self, x: float, y: float, factor: float) -> None:
        """Enlarge the tile in which a button is down; what is at this place stays there."""
        scene, place = self.workplace.scene, self._place(self._tile, *self._pixel(x, y))
        if self._tile in scene.slice_tiles:
            scene.tiles.zoom_slice(self._tile, factor, *place)
        elif self._tile == "space":
            scene.tiles.zoom(factor, *place)
        self.workplace.changed = True

    def _double(self, x: Any, y: Any) -> None:
        tile = self.workplace.scene.pick(*self._pixel(x, y)).tile
        self.cancel()
        if tile in self.workplace.scene.tiles.names and self.tool.name == "look":
            self.workplace.feature(SlicesFeature).enlarge(tile)

    def _uses_tool(self, tile: str) -> bool:
        """Whether the left button uses the tool there: to look around in 3D is to turn the camera."""
        return tile in self.workplace.scene.slice_tiles or (tile == "space" and self.tool.name != "look")

    def _read(self, at: Picked | None) -> None:
        self.workplace.feature(SlicesFeature).read(at)

    def _pixel(self, x: Any, y: Any) -> tuple[float, float]:
        """Pixels from the lower left corner, of parts of the width and of the height from the top."""
        width, height = self.workplace.scene.plotter.render_window.GetSize()
        return number(x, 0.0, 1.0) * width, (1.0 - number(y, 0.0, 1.0)) * height

    def _place(self, tile: str, x: float, y: float) -> tuple[float, float]:
        """Place of a pixel in a tile, each coordinate from 0 to 1; beyond that where it lies beside it."""
        width, height = self.workplace.scene.plotter.render_window.GetSize()
        left, bottom, right, top = self.workplace.scene.tiles.renderer(tile).GetViewport()
        if right <= left or top <= bottom:  # another layout, which does not show it
            return 0.5, 0.5
        return (x / width - left) / (right - left), (y / height - bottom) / (top - bottom)
