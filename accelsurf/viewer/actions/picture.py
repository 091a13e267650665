"""Look of the scene: colours, theme, slices in 3D, size of the picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.viewer.actions.slices import SlicesFeature
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, number, word
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.scene.colors import THEMES
from accelsurf.viewer.scene.space import VIEWS

#: Smallest and largest size of a picture, pixels.
MIN_SIZE = (320, 200)
MAX_SIZE = (3840, 2400)
#: Most pixels of a device for one of a usual screen, along each side.
MAX_RATIO = 4.0


class PictureFeature(Feature):
    """Changes how the scene is drawn."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        #: Size of the picture in pixels of a usual screen, and how many of the device each is.
        self._sides: tuple[int, int] = self.actions.scene.plotter.render_window.GetSize()
        self._ratio = 1.0

    def requests(self) -> Mapping[str, Callable[..., None]]:
        scene = self.actions.scene
        return {
            "color": lambda name: scene.color_by(word(name, COLORS)),
            "next_color": lambda: scene.color_by(
                COLORS[(COLORS.index(scene.color) + 1) % len(COLORS)]
            ),
            "theme": lambda name: scene.paint(word(name, tuple(THEMES))),
            "next_theme": lambda: scene.paint("light" if scene.theme_name == "dark" else "dark"),
            "planes": lambda on: scene.show_planes(bool(on)),
            "next_planes": lambda: scene.show_planes(not scene.shows_planes),
            "view": lambda name: scene.tiles.look_from(word(name, tuple(VIEWS))),
            "size": self._size,
        }

    def keys(self) -> Mapping[str, Key]:
        return {
            "C": Key("next_color", (), "colour by the next quantity"),
            "L": Key("next_planes", (), "slices in 3D"),
            "T": Key("next_theme", (), "dark, light"),
        }

    def state(self, status: Status) -> dict[str, Any]:
        scene = self.actions.scene
        return {
            "color": scene.color,
            "colors": list(COLORS),
            "theme": scene.theme_name,
            "planes": scene.shows_planes,
            "is_flat": scene.space is None,
        }

    def _size(self, width: Any, height: Any, ratio: Any = 1.0) -> None:
        # In steps of 8, so that resizing a window does not redraw the scene for every pixel.
        wide, high = (
            int(min(max(number(side, 0, 1e6), low), high)) // 8 * 8
            for side, low, high in zip((width, height), MIN_SIZE, MAX_SIZE, strict=True)
        )
        # A page that is zoomed out has less than a pixel; one on a large fine screen gets the most that is allowed.
        ratio = min(
            max(number(ratio, 0.01, 100.0), 1.0), MAX_RATIO, MAX_SIZE[0] / wide, MAX_SIZE[1] / high
        )
        if (wide, high) == self._sides and ratio == self._ratio:
            return
        self._sides, self._ratio = (wide, high), ratio
        self.draw_fine(True)
        self.actions.feature(SlicesFeature).fit_layout(wide, high)

    def draw_fine(self, on: bool) -> None:
        """Draw in pixels of the device, or, while something moves, in pixels of a usual screen, which is faster."""
        scene, ratio = self.actions.scene, self._ratio if on else 1.0
        sides = round(self._sides[0] * ratio), round(self._sides[1] * ratio)
        scene.tiles.pixel_ratio = ratio
        if tuple(scene.plotter.render_window.GetSize()) != sides:
            scene.tiles.resize(*sides)
