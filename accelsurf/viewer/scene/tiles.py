"""The tiles of the scene: their layout, the part of the image in each, and the redraw.

Places of the tiles in the picture: four up, one large and the others beside it, slices alone, one alone.

    four           one               slices            single
    +----+----+    +-------+---+    +---+---+---+    +-----------+
    | ax | co |    |       | . |    |   |   |   |    |           |
    +----+----+    | large | . |    | a | c | s |    |   large   |
    | sa | 3D |    |       | . |    |   |   |   |    |           |
    +----+----+    +-------+---+    +---+---+---+    +-----------+

The chart of the energies takes the place of a tile where there is one to spare, otherwise a strip below. The picture in
3D can be left out, as long as there is nothing to show in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import pyvista as pv

from accelsurf.errors import check_known
from accelsurf.viewer.scene.overlay import DPI, Pixels
from accelsurf.viewer.scene.redraw import Redraw
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import VIEWS, SpaceTile

#: Samples of a pixel where edges are drawn smoothly.
SAMPLES = 8


class Fitted(Protocol):
    """A part of the scene that is drawn as large as window and screen ask for."""

    def fit(self, pixels: Pixels) -> None:
        """Before a picture of this size."""


class Tiles:
    """The tiles of a scene.

    Parameters
    ----------
    redraw : Redraw
    space : SpaceTile or None
        The picture in 3D.
    slices : mapping of str to SliceTile
    chart : pyvista.Renderer
        Where the energies are drawn.

    Attributes
    ----------
    layout : str
        How they lie, one of `LAYOUTS`.
    large : str
        The tile that the layouts ``one`` and ``single`` show large.
    shows_chart, shows_space : bool
        Whether the chart of the energies and the picture in 3D are shown.
    pixel_ratio : float
        Pixels of the device for one of a usual screen, from who owns the window: text and lines scale with it.
    redraw : Redraw
    """

    def __init__(
        self,
        redraw: Redraw,
        space: SpaceTile | None,
        slices: Mapping[str, SliceTile],
        chart: pv.Renderer,
    ) -> None:
        self._space = space
        self._slices = slices
        self._chart = chart
        self.redraw = redraw
        self._window = redraw.window
        self.pixel_ratio = 1.0
        self.layout = "one"
        self.shows_chart = True
        self.shows_space = space is not None
        self._is_tall = False
        #: Half the mm that the tile in 3D had to be high for the whole image, when it was shown last.
        self._fitted = 0.0
        self.large = "space" if space is not None else next(iter(slices))
        self.lay_out()

    def fit(self, *others: Fitted) -> None:
        """Before each picture: make text and lines, of ``others`` too, as large as window and screen ask for."""
        if self._window.GetDPI() != DPI:  # Qt sets it on a fine screen
            self._window.SetDPI(DPI)
        width, height = self._window.GetSize()
        pixels = Pixels(min(int(height), round(width * 9 / 16)), self.pixel_ratio)
        for part in (self._space, *self._slices.values(), *others):
            if part is not None:
                part.fit(pixels)

    # -- layout -------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """All that show the image, slices first."""
        return (*self._slices, *(("space",) if self._space is not None else ()))

    def lay_out(
        self,
        layout: str | None = None,
        large: str | None = None,
        chart: bool | None = None,
        space: bool | None = None,
    ) -> None:
        """Change the layout of the tiles, and whether chart and picture in 3D are shown; None changes nothing.

        Raises
        ------
        UsageError
            For an unknown layout or tile.
        """
        layout, large = layout or self.layout, large or self.large
        check_known("tile", large, self.names)
        chart = self.shows_chart if chart is None else chart
        space = self.shows_space if space is None or self._space is None else space
        names = tuple(name for name in self.names if space or name != "space")
        large = large if large in names else names[0]
        places = viewports(layout, names, large, chart, self._is_tall)
        self._note_fitted()
        self.layout = layout
        self.large = large
        self.shows_chart = chart
        self.shows_space = space
        renderers = {"energies": self._chart, **{name: self.renderer(name) for name in self.names}}
        for name, renderer in renderers.items():
            # A tile that is not shown has no place, so that nothing is picked in it.
            renderer.SetViewport(*places.get(name, (0.0, 0.0, 0.0, 0.0)))
        self.redraw.show_only(renderers[name] for name in places)
        if self._space is not None:
            self._space.place_cube("space" in places)
            before = self._fitted
            if self._note_fitted() and before:
                # An image seen whole in a narrow tile is seen as large as the other one allows.
                self._space.zoom(before / self._fitted)

    def lay_out_fitted(self, width: float, height: float, space: bool) -> None:
        """Lay the tiles out so that the slices are as large as a picture of this size, pixels, allows, without a chart.

        ``space``: with the picture in 3D.
        """
        extents = {name: tile.stack.extent for name, tile in self._slices.items()}
        sides = {
            name: (right - left, top - bottom)
            for name, (left, right, bottom, top) in extents.items()
        }
        space = space and self._space is not None
        layout, large, is_tall = fitting(sides, width, height, space)
        now = self.layout, self.large, self._is_tall, self.shows_chart, self.shows_space
        if (layout, large, is_tall, False, space) != now:
            self._is_tall = is_tall
            self.lay_out(layout, large, False, space)

    def _note_fitted(self) -> bool:
        """Note how high the tile in 3D must be for the whole image; returns whether it is shown."""
        if self._space is None or 0 in self._space.renderer.GetSize():
            return False
        self._fitted = self._space.fitted_scale()
        return True

    def renderer(self, name: str) -> pv.Renderer:
        """Return the renderer of a tile."""
        return self.tile(name).renderer

    def tile(self, name: str) -> SpaceTile | SliceTile:
        """Return a tile by its name."""
        return self._space if self._space is not None and name == "space" else self._slices[name]

    # -- part of the image in each ------------------------------------------------------------------------

    def show_whole(self) -> None:
        """Show the whole image in all tiles, as at first."""
        for tile in self._slices.values():
            tile.show_whole()
        if self._space is not None:
            self._space.look_from()
        self.redraw.mark_all()

    def look_from(self, view: str) -> None:
        """Look at the whole image in 3D from one of `space.VIEWS`; another is a UsageError."""
        check_known("view", view, VIEWS)
        if self._space is not None:
            self._space.look_from(view)

    def orbit(self, degrees: float) -> None:
        """Turn the camera in 3D around the vertical axis."""
        if self._space is not None:
            self._space.orbit(degrees)

    def smooth_edges(self, on: bool) -> bool:
        """Draw edges smoothly (the default), or not: faster without a graphics card. Returns whether that changes."""
        samples = SAMPLES if on else 0
        if self._window.GetMultiSamples() == samples:
            return False
        self._window.SetMultiSamples(samples)
        self.redraw.begin_anew()
        return True

    def resize(self, width: int, height: int) -> None:
        """Change the size of the picture, pixels."""
        self.redraw.begin_anew()
        before = None if self._space is None else self._space.fitted_scale()
        self._window.SetSize(width, height)
        if self._space is not None and before is not None:
            self._space.zoom(before / self._space.fitted_scale())

    def coarsen(self, on: bool) -> bool:
        """Draw large surfaces in 3D with fewer triangles, or in full; returns whether that changes the picture."""
        return self._space is not None and self._space.coarsen(on)


LAYOUTS = ("one", "four", "slices", "single")
#: Part of the height that the chart takes where it is a strip.
STRIP = 0.2
#: Part of the width that the large tile takes beside others; height of the picture in 3D beside that of a slice there.
LARGE = 0.6
SPACE = 0.8
#: Least area of another slice to be the large one, in areas of the first slice.
MUCH = 1.5

#: Left, bottom, right, top in the picture, each from 0 to 1.
Viewport = tuple[float, float, float, float]


def viewports(
    layout: str, tiles: tuple[str, ...], large: str, chart: bool, is_tall: bool = False
) -> dict[str, Viewport]:
    """Return the place of each tile that is shown, and of ``energies``, the chart, if it is.

    Parameters
    ----------
    layout : str
        One of `LAYOUTS`.
    tiles : tuple of str
        All that there are, slices first; an image of one slice has one.
    large : str
        The tile that ``one`` and ``single`` show large.
    chart : bool
        Whether the chart is shown.
    is_tall : bool, optional
        Without the chart: tiles lie below each other, not beside each other, in a picture that is high.

    Raises
    ------
    UsageError
        For another layout.

    Examples
    --------
    >>> viewports("single", ("axial", "coronal", "sagittal", "space"), "axial", False)
    {'axial': (0.0, 0.0, 1.0, 1.0)}
    >>> viewports("slices", ("axial",), "axial", True)
    {'axial': (0.0, 0.0, 0.75, 1.0), 'energies': (0.75, 0.0, 1.0, 1.0)}
    """
    check_known("layout", layout, LAYOUTS)
    if len(tiles) == 1:
        width = 0.75 if chart else 1.0
        return {
            tiles[0]: (0.0, 0.0, width, 1.0),
            **({"energies": (0.75, 0.0, 1.0, 1.0)} if chart else {}),
        }
    if is_tall and not chart:
        flat = viewports(layout, tiles, large, False)
        return {
            name: (1.0 - top, 1.0 - right, 1.0 - low, 1.0 - left)
            for name, (left, low, right, top) in flat.items()
        }
    if layout == "one":
        return _one(tiles, large, chart)
    floor = STRIP if chart else 0.0
    strip: dict[str, Viewport] = {"energies": (0.0, 0.0, 1.0, STRIP)} if chart else {}
    match layout:
        case "single":
            return {large: (0.0, floor, 1.0, 1.0), **strip}
        case "slices":
            slices = [name for name in tiles if name != "space"]
            n = len(slices)
            return {name: (i / n, floor, (i + 1) / n, 1.0) for i, name in enumerate(slices)} | strip
        case _:
            middle = 0.5 * (floor + 1.0)
            places = [
                (0.0, middle, 0.5, 1.0),
                (0.5, middle, 1.0, 1.0),
                (0.0, floor, 0.5, middle),
                (0.5, floor, 1.0, middle),
            ]
            if len(tiles) == 3:
                places[2] = (0.0, floor, 1.0, middle)
            return dict(zip(tiles, places, strict=False)) | strip


def fitting(
    sides: Mapping[str, tuple[float, float]], width: float, height: float, space: bool
) -> tuple[str, str, bool]:
    """Return the layout in which slices take most of a picture, the tile that is large in it, and whether it is tall.

    Parameters
    ----------
    sides : mapping of str to (float, float)
        Width and height of each slice, mm.
    width, height : float
        Of the picture, pixels.
    space : bool
        Whether the picture in 3D is shown, too.

    Examples
    --------
    >>> cube = dict.fromkeys(("axial", "coronal", "sagittal"), (200.0, 200.0))
    >>> fitting(cube, 1602, 980, False), fitting(cube, 462, 700, False), fitting(cube, 706, 660, True)
    (('one', 'axial', False), ('one', 'axial', True), ('four', 'axial', False))
    """
    names, first = (*sides, *(["space"] if space else [])), next(iter(sides))
    # Whatever the window, the same slice of an image is large: the first, unless another is by far larger.
    large = max(sides, key=lambda name: math.prod(sides[name]) * (MUCH if name == first else 1.0))
    if len(sides) == 1:
        return "one", large, False
    layouts = ("one", "four") if space else ("one", "four", "slices")
    choices = [(layout, large, tall) for layout in layouts for tall in (False, True)]

    def area(layout: str, large: str, tall: bool) -> float:
        total = 0.0
        for name, (left, bottom, right, top) in viewports(
            layout, names, large, False, tall
        ).items():
            if name in sides:
                wide, high = sides[name]
                total += (
                    wide
                    * high
                    * min((right - left) * width / wide, (top - bottom) * height / high) ** 2
                )
        return total

    return max(choices, key=lambda choice: area(*choice))


def _one(tiles: tuple[str, ...], large: str, chart: bool) -> dict[str, Viewport]:
    """The large tile at the left; the others beside it, two by two with the chart, or in a column without."""
    others = [name for name in tiles if name != large]
    if chart:
        places = [
            (0.5, 0.5, 0.75, 1.0),
            (0.75, 0.5, 1.0, 1.0),
            (0.5, 0.0, 0.75, 0.5),
            (0.75, 0.0, 1.0, 0.5),
        ]
        return {
            large: (0.0, 0.0, 0.5, 1.0),
            **dict(zip([*others, "energies"], places, strict=False)),
        }
    weights = [SPACE if name == "space" else 1.0 for name in others]
    ends = [1.0 - sum(weights[:number]) / sum(weights) for number in range(len(others) + 1)]
    column = {name: (LARGE, max(ends[i + 1], 0.0), 1.0, ends[i]) for i, name in enumerate(others)}
    return {large: (0.0, 0.0, LARGE, 1.0), **column}
