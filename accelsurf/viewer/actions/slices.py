"""Slices to be read: grey values, layout, the cursor, and the read-out under the mouse."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from accelsurf.errors import UsageError
from accelsurf.image.grey_window import AUTO, CT_WINDOWS, GreyWindow, parse_window, window_of
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, number, text, whole, word
from accelsurf.viewer.core.status import Status, View
from accelsurf.viewer.scene.space import Picked
from accelsurf.viewer.scene.tiles import LAYOUTS

#: The window of the whole image; `AUTO` is the window of the object and its surroundings.
IMAGE = "image"
#: Words of windows, as lists show them.
WINDOWS = (IMAGE, AUTO, *CT_WINDOWS)
#: Entries of the state about the place under the mouse.
READ_OUT = ("place", "where", "voxel", "value", "label", "as_ball", "as_point")
#: A drag over the whole picture changes level and width by this many widths.
DRAG = 2.0
#: Largest magnitude of a level or width.
MAX_GREY = 1e9
#: Surroundings of an object: its box, larger by this part of its extent to each side.
AROUND = 0.5


class SlicesFeature(Feature):
    """Draws slices, and reads the image under the mouse."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._picked: Picked | None = None
        self._before = "one"
        #: Whether the person has said how the tiles lie; until then it follows from the room that there is.
        self._layout_is_set = False
        self._sides: tuple[float, float] = actions.scene.plotter.render_window.GetSize()
        self._word = IMAGE
        for tile in actions.scene.slice_tiles.values():
            tile.show_slider()
        self.fit_layout(*self._sides)

    def requests(self) -> Mapping[str, Callable[..., None]]:
        scene = self.actions.scene
        return {
            "window": self._window,
            "window_named": self._window_named,
            "layout": self._layout,
            "next_layout": self._next_layout,
            "large": lambda tile: self.enlarge(word(tile, scene.tiles.names)),
            "next_large": self._next_large,
            "chart": self._chart,
            "next_chart": lambda: self._chart(not scene.tiles.shows_chart),
            "interpolate": lambda on: scene.interpolate(bool(on)),
            "next_interpolate": lambda: scene.interpolate(not scene.is_interpolated),
            "straight": self._straighten,
            "next_straight": lambda: self._straighten(not scene.is_straight),
            "whole": scene.tiles.show_whole,
            "slice": self._slice,
            "through": self._through,
            "cursor": self._cursor,
            "copy_point": lambda: self.actions.copy(self.read_out()["as_point"]),
            "copy_ball": lambda: self.actions.copy(self.read_out()["as_ball"]),
        }

    def keys(self) -> Mapping[str, Key]:
        return {
            "Up": Key("through", (1,), "next slice under the mouse"),
            "Down": Key("through", (-1,), "slice before it"),
            "A": Key("window_named", (AUTO,), "grey values of the object and what is around it"),
            "W": Key("next_layout", (), "next layout"),
            "1": Key("next_large", (), "tile under the mouse alone, and back"),
            "E": Key("next_chart", (), "chart of the energies"),
            "M": Key("next_interpolate", (), "smooth slices, or voxels"),
            "2": Key("next_straight", (), "slices straight by anatomy, or along the voxels"),
            "Ctrl+C": Key("copy_point", (), "copy the place under the mouse as point:X,Y,Z"),
            "Ctrl+Shift+C": Key("copy_ball", (), "copy it as ball:X,Y,Z,R"),
            "R": Key("whole", (), "whole image, camera as at first"),
        }

    def state(self, status: Status) -> dict[str, Any]:
        scene, tiles = self.actions.scene, self.actions.scene.tiles
        window = scene.window
        return {
            "level": window.level,
            "width": window.width,
            "window_word": self._word,
            "windows": list(WINDOWS),
            "layout": tiles.layout,
            "layouts": list(LAYOUTS),
            "large": tiles.large,
            "chart": tiles.shows_chart,
            "interpolate": scene.is_interpolated,
            "straight": scene.is_straight,
            "is_oblique": scene.is_oblique,
            # Number of the slice that each tile shows, from 1, and how many there are.
            "slices": {
                name: [tile.index + 1, tile.stack.count] for name, tile in scene.slice_tiles.items()
            },
            "cursor": self._text(scene.cursor),
            **self.read_out(),
        }

    def update(self, view: View) -> None:
        self.fit_layout(*self._sides)  # there may be something to show in 3D now

    # -- grey values --------------------------------------------------------------------------------------

    def _window(self, level: Any, width: Any) -> None:
        level, width = number(level, -MAX_GREY, MAX_GREY), number(width, 0.0, MAX_GREY)
        if not width > 0:
            raise UsageError(f"window: a width of {width:g} was given, expected one above 0")
        self._show_window(GreyWindow.of(level, width), "")

    def _window_named(self, name: Any) -> None:
        if text(name, 40) == IMAGE:
            return self._show_window(window_of(self.actions.scene.volume.array), IMAGE)
        window = parse_window(name)
        known = window is None or name in CT_WINDOWS
        return self._show_window(window or self._object_window(), name if known else "")

    def _show_window(self, window: GreyWindow, name: str) -> None:
        self._word = name
        self.actions.scene.window = window
        self.actions.note(self._window_text(), 3.0)

    def _window_text(self) -> str:
        window = self.actions.scene.window
        return f"level {window.level:.4g}, width {window.width:.4g}"

    def _object_window(self) -> GreyWindow:
        """Return the window of the values in the objects and around them.

        Raises
        ------
        UsageError
            When there is no surface.
        """
        frame, array = self.actions.scene.frame, self.actions.scene.volume.array
        surfaces = () if frame is None else frame.surfaces
        corners = [
            surface.to_image(end)
            for surface in surfaces
            for end in ((0, 0, 0), np.array(surface.psi.shape) - 1.0)
            if surface.has_surface
        ]
        if not corners:
            raise UsageError(
                "window: there is no object yet whose grey values could be shown",
                "begin with a click",
            )
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        around = AROUND * (high - low)
        z, y, x = (
            slice(max(int(a), 0), min(int(b) + 1, n))
            for a, b, n in zip(low - around, high + around, array.shape, strict=True)
        )
        return window_of(
            array[z, y, x], np.any([surface.inside((z, y, x)) for surface in surfaces], axis=0)
        )

    def drag_window(self, right: float, up: float) -> None:
        """A drag with the right button, by parts of the picture: sideways the width, up darkens as a higher level."""
        level, width = self.actions.scene.window.level, self.actions.scene.window.width
        # In widths, so that it is as fine in an image from 0 to 1 as in one of 16 bits.
        self._show_window(
            GreyWindow.of(level + DRAG * up * width, width * float(np.exp(DRAG * right))), ""
        )

    def write(self, tile: str) -> None:
        """Write level, width and the value under the mouse into a tile: grey values are being dragged in it."""
        text = self._window_text() + (
            f", value {self.read_out()['value']}" if self._picked is not None else ""
        )
        self.actions.scene.slice_tiles[tile].write(text)

    # -- layout -------------------------------------------------------------------------------------------

    def fit_layout(self, width: float, height: float) -> None:
        """Make slices as large as this size in pixels of a usual screen allows, unless somebody has selected a layout.

        3D is left out until there is a surface.
        """
        self._sides = (width, height)
        scene, tiles = self.actions.scene, self.actions.scene.tiles
        if not self._layout_is_set:
            tiles.lay_out_fitted(width, height, scene.frame is not None and scene.frame.has_surface)
            self._before = tiles.layout

    def _layout(self, name: Any) -> None:
        self._layout_is_set = True
        self.actions.scene.tiles.lay_out(word(name, LAYOUTS), space=name != "slices")

    def _next_layout(self) -> None:
        self._layout(LAYOUTS[(LAYOUTS.index(self.actions.scene.tiles.layout) + 1) % len(LAYOUTS)])

    def enlarge(self, tile: str) -> None:
        """Show a tile alone; asked for again, all as before."""
        tiles, self._layout_is_set = self.actions.scene.tiles, True
        if tile == "space":
            tiles.lay_out(space=True)
        if tiles.layout == "single" and tiles.large == tile:
            tiles.lay_out(self._before)
        else:
            self._before = self._before if tiles.layout == "single" else tiles.layout
            tiles.lay_out("single", tile)

    def _next_large(self) -> None:
        """Show the tile under the mouse alone, or else the large one; asked for again, all as before."""
        tiles, picked = self.actions.scene.tiles, self._picked
        under = tiles.large if picked is None or tiles.layout == "single" else picked.tile
        self.enlarge(under if under in tiles.names else tiles.large)

    def _chart(self, on: Any) -> None:
        self._layout_is_set = True
        self.actions.scene.tiles.lay_out(chart=bool(on))

    def _straighten(self, on: Any) -> None:
        if not self.actions.scene.is_oblique:
            raise UsageError(
                "straight: the voxels of this image lie along the world's axes, or in one slice"
            )
        self.actions.scene.straighten(bool(on))

    # -- places -------------------------------------------------------------------------------------------

    def _slice(self, tile: Any, number_from_1: Any) -> None:
        scene = self.actions.scene
        shown = scene.slice_tiles[word(tile, tuple(scene.slice_tiles))]
        scene.go_to_slice(tile, whole(number_from_1, 1, shown.stack.count) - 1)

    def _through(self, count: Any) -> None:
        """Go through the slices of the tile under the mouse, or else of the first."""
        scene, picked = self.actions.scene, self._picked
        tile = (
            picked.tile
            if picked is not None and picked.tile in scene.slice_tiles
            else next(iter(scene.slice_tiles))
        )
        scene.step_slice(tile, whole(count, -100, 100))

    def _cursor(self, x: Any, y: Any, z: Any) -> None:
        self.actions.scene.cursor = [number(part, -1e9, 1e9) for part in (x, y, z)]

    def read(self, at: Picked | None) -> None:
        """Read values at this place from now on: the mouse is there."""
        self._picked = at

    def read_out(self) -> dict[str, Any]:
        """Place, voxel, value and label under the mouse, or at the cursor where the mouse is beside the image."""
        scene, picked = self.actions.scene, self._picked
        world = scene.cursor if picked is None or picked.world is None else np.asarray(picked.world)
        index = scene.geometry.world_to_index(world)
        voxel = tuple(
            int(np.clip(round(float(i)), 0, n - 1))
            for i, n in zip(index, scene.geometry.shape, strict=True)
        )
        surfaces = () if scene.frame is None else scene.frame.surfaces
        ids = [str(surface.id) for surface in surfaces if surface.contains(voxel)]
        value = scene.volume.array[voxel]
        where = self._text(world)
        return {
            "place": where,
            "where": self.shown(world),
            "voxel": ", ".join(str(i) for i in voxel[::-1]),
            "value": f"{value:.6g}" if np.isfinite(value) else str(value),
            "label": ", ".join(ids) or "0",
            "as_ball": f"ball:{where.replace(' ', '')},{self.actions.radius:.4g}",
            "as_point": f"point:{where.replace(' ', '')}",
        }

    def shown(self, world: Any) -> str:
        """Return a place in the unit of the file."""
        unit = self.actions.scene.unit
        if unit == "mm":
            return f"{self._text(world)} mm"
        return ", ".join(f"{in_unit(float(part), unit) + 0.0:.5g}" for part in world) + f" {unit}"

    def _text(self, world: Any) -> str:
        """A place in world mm, as settings have it."""
        # A tenth of the smallest voxel is as fine as a mouse.
        digits = max(0, 1 - int(np.floor(np.log10(min(self.actions.scene.geometry.spacing)))))
        return ", ".join(f"{round(float(part), digits) + 0.0:g}" for part in world)
