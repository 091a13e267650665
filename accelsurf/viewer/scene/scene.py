"""The scene: surfaces in 3D, three slices, chart of the energies; the same for desktop, browser, movie and preview.

    +---------------+-------+-------+
    |               | axial | coro- |
    | surfaces, mm  |       | nal   |      an image of one slice:      +-----------+------+
    |               +-------+-------+                                  |   slice   | ener-|
    |               | sagit-| ener- |                                  |           | gies |
    |               | tal   | gies  |                                  +-----------+------+
    +---------------+-------+-------+

A scene draws `Frame`s and knows no solver. Nothing is rendered before `render` or `screenshot` is called.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from accelsurf.errors import UsageError, check_known
from accelsurf.evolution.records import StepRecord
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.grid.volume import Volume
from accelsurf.io.files import write_bytes
from accelsurf.io.headers import is_anatomical
from accelsurf.viewer.core.frame import COLORS, Frame
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.chart import EnergyChart
from accelsurf.viewer.scene.colors import REFERENCE, Theme, object_color, theme_named
from accelsurf.viewer.scene.grey_images import grab, grey_values, png_bytes
from accelsurf.viewer.scene.headless import require_graphics
from accelsurf.viewer.scene.legend import Legend
from accelsurf.viewer.scene.picking import Picked, place_in_renderer
from accelsurf.viewer.scene.reference import Reference
from accelsurf.viewer.scene.shapes import label_surface
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import VIEWS, SpaceTile

#: Lines of the legend at most.
MAX_LEGEND = 20
#: Samples of a pixel where edges are drawn smoothly.
SAMPLES = 8
#: Size of a window or picture unless another is asked for, pixels.
SIZE = (1280, 720)
TILES = ("axial", "coronal", "sagittal")


class Scene:
    """Everything that is drawn of one image and the surfaces in it.

    Parameters
    ----------
    volume : Volume
        The image, of one slice or more.
    theme : str, optional
        "dark" or "light".
    reference : Volume, optional
        Labels on the same grid (above 0 is the object) to compare with.
    plotter : pyvista.Plotter, optional
        To draw in, made with ``**Scene.layout(volume.geometry)``; one that needs no screen is made otherwise.
    size : (int, int), optional
        Width and height, pixels, of the plotter that is made.
    title : str, optional
        First line over the picture; the file's name unless given.

    Attributes
    ----------
    plotter : pyvista.Plotter
    frame : Frame or None
        What is drawn now.

    Raises
    ------
    UsageError
        For an unknown theme.
    InputError
        When the reference is on another grid.
    GraphicsError
        When no plotter is given and nothing here can draw.
    """

    def __init__(
        self,
        volume: Volume,
        *,
        theme: str = "dark",
        reference: Volume | None = None,
        plotter: pv.Plotter | None = None,
        size: tuple[int, int] = SIZE,
        title: str | None = None,
    ) -> None:
        self._theme = theme_named(theme)
        self._reference = None if reference is None else Reference(reference, volume.geometry)
        self.volume, self.geometry = volume, volume.geometry
        self.frame: Frame | None = None
        self._color = "plain"
        self.title = (volume.source.name if volume.source else "") if title is None else title
        self._cursor = 0.5 * (np.array(self.geometry.shape) - 1.0)
        self._cursor_is_set = False
        self.anatomical = is_anatomical(volume.metadata)
        if plotter is None:
            require_graphics()
            plotter = pv.Plotter(off_screen=True, window_size=list(size), **self.layout(self.geometry))
        self.plotter = plotter
        self._build()
        self.paint(theme)
        self.plotter.render_window.AddObserver("StartEvent", lambda *_: self._fit())

    @staticmethod
    def layout(geometry: Geometry) -> dict[str, Any]:
        """Arguments of a `pyvista.Plotter` whose renderers are what the scene of such an image needs."""
        if geometry.slice_axis is not None:
            return {"shape": (1, 3), "groups": [(0, [0, 1])], "border": False}
        return {"shape": (2, 4), "groups": [([0, 1], [0, 1])], "border": False}

    def _build(self) -> None:
        plotter, upright, grey = self.plotter, DisplayOrientation.of(self.geometry), grey_values(self.volume)
        flat = self.geometry.slice_axis
        places = {0: (0, 2), 1: (0, 3), 2: (1, 2)} if flat is None else {upright.order.index(flat): (0, 0)}
        self.space: SpaceTile | None = None
        if flat is None:
            plotter.subplot(0, 0)
            self.space = SpaceTile(plotter, self.geometry, grey, self.anatomical, self._theme)
            if self._reference is not None:
                self.space.show_reference(label_surface(self._reference.inside, self.geometry))
        self.slice_tiles: dict[str, SliceTile] = {}
        for plane, place in places.items():
            plotter.subplot(*place)
            tile = SliceTile(plotter.renderer, grey, upright, plane, self.anatomical, self._theme)
            self.slice_tiles[TILES[plane]] = tile
        plotter.subplot(*((1, 3) if flat is None else (0, 2)))
        self._chart_renderer = plotter.renderer
        self._chart_renderer.SetInteractive(False)
        self._chart = EnergyChart(plotter, self._theme)
        plotter.subplot(0, 0)
        largest = self.space.renderer if self.space is not None else next(iter(self.slice_tiles.values())).renderer
        self._legend = Legend(largest)
        self._show_slices()

    # -- what is drawn ------------------------------------------------------------------------------------

    def update(self, frame: Frame, histories: Sequence[Sequence[StepRecord]] = ()) -> None:
        """Draw a frame.

        Parameters
        ----------
        frame : Frame
            Of this image.
        histories : sequence of sequences of StepRecord, optional
            The records of each object up to this frame, for the chart.
        """
        self.frame = frame
        if frame.has_surface and not self._cursor_is_set:
            self._cursor = np.clip(frame.middle(), 0.0, np.array(self.geometry.shape) - 1.0)
            self._cursor_is_set = True
            self._show_slices()
        self._show_frame()
        self._chart.update(histories)

    def _show_frame(self) -> None:
        frame = self.frame
        if frame is None:
            return
        if self.space is not None:
            self.space.show(frame, self._color)
        for tile in self.slice_tiles.values():
            tile.draw_objects(frame)
        self._legend.show(self._legend_lines(frame))
        lines = [line for line in (self.title, *self._caption(frame)) if line]
        if self.space is not None:
            self.space.title.text = "\n".join(lines)
        else:
            next(iter(self.slice_tiles.values())).title.text = "   ".join(lines)

    def _legend_lines(self, frame: Frame) -> list[tuple[str, str]]:
        """Text and colour of each line of the legend; none for one object without a reference."""
        several = len(frame.surfaces) > 1
        if not several and self._reference is None:
            return []
        lines = [
            (f"object {surface.id}" if several else "surface", object_color(position))
            for position, surface in enumerate(frame.surfaces[:MAX_LEGEND])
        ]
        if len(frame.surfaces) > MAX_LEGEND:
            lines.append((f"and {len(frame.surfaces) - MAX_LEGEND} more", self._theme.ink))
        return lines if self._reference is None else [*lines, (f"reference, Dice {self.dice:.3f}", REFERENCE)]

    def _caption(self, frame: Frame) -> list[str]:
        """Step, level, and the volume (of an image of one slice the area) of the objects."""
        step = f"step {frame.step}" + (f", level {frame.level} (coarse grid)" if frame.level else "")
        axis = self.geometry.slice_axis
        if axis is None:
            return [step, f"volume {_number(frame.volume_mm3)} mm3"]
        return [step, f"area {_number(frame.volume_mm3 / self.geometry.spacing[axis])} mm2"]

    @property
    def theme(self) -> Theme:
        """The colours in use."""
        return self._theme

    @property
    def legend(self) -> tuple[str, ...]:
        """What each colour is, and Dice; empty for one object without a reference."""
        return self._legend.lines

    @property
    def dice(self) -> float | None:
        """Dice of the objects drawn now and the reference; None without either. Coarse frames count their voxels."""
        return None if self._reference is None or self.frame is None else self._reference.dice(self.frame)

    def color_by(self, name: str) -> None:
        """Colour the surfaces by a quantity, ``plain``, ``speed``, ``force`` or ``density``.

        A frame that lacks it is drawn plain.

        Raises
        ------
        UsageError
            For another name.
        """
        check_known("color", name, COLORS)
        self._color = name
        self._show_frame()

    def show_volume(self, on: bool) -> None:
        """Draw the image itself in 3D, translucent, or not; an image of one slice has no such picture."""
        if self.space is not None:
            self.space.show_volume(on)

    def show_planes(self, on: bool) -> None:
        """Draw the three slices in 3D, or not."""
        if self.space is not None:
            self.space.show_planes(on, self._cursor)

    @property
    def cursor(self) -> NDArray[np.float64]:
        """The world point (x, y, z), mm LPS, through which the slices go; clipped to the image when set."""
        return self.geometry.index_to_world(self._cursor)

    @cursor.setter
    def cursor(self, world: ArrayLike) -> None:
        place = np.asarray(world, float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise UsageError(f"cursor: {world!r} was given, expected three finite numbers x, y, z in mm")
        self._cursor = np.clip(self.geometry.world_to_index(place), 0.0, np.array(self.geometry.shape) - 1.0)
        self._cursor_is_set = True
        self._show_slices()
        self._show_frame()

    def step_slice(self, name: str, count: int) -> None:
        """Go ``count`` slices further in a tile, one of ``slice_tiles``, towards larger world coordinates."""
        tile = self.slice_tiles[name]
        index = self._cursor.copy()
        sign = -1 if DisplayOrientation.of(self.geometry).flips[tile.plane] else 1
        index[tile.axis] = round(index[tile.axis]) + sign * count
        self.cursor = self.geometry.index_to_world(index)

    def _show_slices(self) -> None:
        for tile in self.slice_tiles.values():
            tile.show(self._cursor)
            if self._reference is not None:
                tile.draw_reference(self._reference.contour_function)
        if self.space is not None:
            self.space.move_planes(self._cursor)

    def mark_ball(self, center: ArrayLike | None, radius: float = 0.0) -> None:
        """Draw a ball that is being placed (world mm), in 3D and where it cuts the slices; None removes it."""
        middle = None if center is None else np.asarray(center, float)
        if self.space is not None:
            self.space.mark_ball(middle, radius)
        for tile in self.slice_tiles.values():
            tile.mark_ball(middle, radius, self.geometry)

    def mark_size(self, drag: SizeDrag | None, drag_mm: float = 0.0) -> None:
        """Draw in the slices what belongs to the object if it has the size that a drag stands for; None removes it.

        Until then only the slices are drawn, which change: the surface, and still more the image in 3D, takes longer
        where there is no graphics card.
        """
        volume = None if drag is None else drag.volume_of(drag_mm)
        self._draw_beside_slices(drag is None)
        if drag is None:
            self._show_slices()
            self._show_frame()
        for tile in self.slice_tiles.values():
            tile.mark_size(drag, volume, "" if volume is None else f"size {_number(volume)} mm3")

    def _draw_beside_slices(self, on: bool) -> None:
        """Draw everything from now on, or the slices alone: what was drawn beside them stays as it was."""
        slices = [tile.renderer for tile in self.slice_tiles.values()]
        for renderer in self.plotter.renderers:
            renderer.SetDraw(on or renderer in slices)

    def paint(self, theme: str) -> None:
        """Use a theme.

        Raises
        ------
        UsageError
            For an unknown one.
        """
        self._theme = theme_named(theme)
        for renderer in self.plotter.renderers:
            renderer.background_color = self._theme.background
        for tile in (self.space, *self.slice_tiles.values(), self._chart):
            if tile is not None:
                tile.paint(self._theme)

    # -- pictures -----------------------------------------------------------------------------------------

    def look_from(self, view: str) -> None:
        """Look at the whole image from one of `space.VIEWS`: corner, front, back, left, right, top or bottom.

        Raises
        ------
        UsageError
            For another view.
        """
        check_known("view", view, VIEWS)
        if self.space is not None:
            self.space.look_from(view)

    def orbit(self, degrees: float) -> None:
        """Turn the camera around the vertical axis."""
        if self.space is not None:
            self.space.orbit(degrees)

    def pick(self, x: float, y: float) -> Picked:
        """What lies under a pixel, counted from the lower left corner of the window."""
        for name, tile in self.slice_tiles.items():
            inside = place_in_renderer(tile.renderer, x, y)
            if inside is not None:
                right, up = tile.to_plane(*inside)
                left, far, bottom, top = tile.extent
                if left <= right <= far and bottom <= up <= top:
                    index = tile.from_tile(right, up, self._cursor)
                    return Picked(name, self.geometry.index_to_world(index))
                return Picked(name, None)
        if self.space is not None and place_in_renderer(self.space.renderer, x, y) is not None:
            return Picked("space", self.space.pick(x, y))
        return Picked("energies", None)

    def smooth_edges(self, on: bool) -> None:
        """Draw edges smoothly (the default), or not: two to four times faster where there is no graphics card."""
        window, samples = self.plotter.render_window, SAMPLES if on else 0
        if window.GetMultiSamples() != samples:
            window.SetMultiSamples(samples)
            self._draw_beside_slices(True)  # the next picture begins empty

    def resize(self, width: int, height: int) -> None:
        """Change the size of the picture, pixels."""
        self._draw_beside_slices(True)
        before = None if self.space is None else self.space.fitted_scale()
        self.plotter.render_window.SetSize(width, height)
        if self.space is not None and before is not None:
            self.space.zoom(before / self.space.fitted_scale())

    def render(self) -> None:
        """Draw what has changed."""
        self.plotter.render_window.Render()

    def screenshot(self, path: str | Path | None = None) -> NDArray[np.uint8]:
        """Render, and return the picture (height, width, 3), uint8; with a path write it there as PNG."""
        self.render()
        picture = grab(self.plotter.render_window)
        if path is not None:
            write_bytes(Path(path), png_bytes(picture))
        return picture

    def close(self) -> None:
        """Free the plotter and its memory."""
        self.plotter.close()

    def _fit(self) -> None:
        """Before each picture: what depends on the size of the window and on the camera."""
        height = int(self.plotter.render_window.GetSize()[1])
        for tile in (self.space, *self.slice_tiles.values()):
            if tile is not None:
                tile.fit(height)
        self._legend.fit(height)
        self._chart.fit(height)


def _number(value: float) -> str:
    """A measure with four digits, or all before the point, in groups of three."""
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}".replace(",", " ")
