"""The scene: surfaces in 3D, three slices, chart of the energies; the same for desktop, browser, movie and preview.

A scene draws `Frame`s and knows no solver. Nothing is rendered before `render` or `screenshot` is called.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkWindowToImageFilter

from accelsurf.errors import InputError, UsageError, check_known
from accelsurf.evolution import StepRecord
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.image.grey_window import GreyWindow, window_of
from accelsurf.image.slice_stack import SliceStack
from accelsurf.image.volume import Volume
from accelsurf.io import shows_patient
from accelsurf.output import write_png
from accelsurf.settings.labels import LabelTable
from accelsurf.viewer.core.frame import COLORS, Frame
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.chart import EnergyChart
from accelsurf.viewer.scene.colors import ObjectStyles, theme_named
from accelsurf.viewer.scene.headless import require_graphics
from accelsurf.viewer.scene.legend import Legend, caption, legend_lines, volume_line
from accelsurf.viewer.scene.redraw import Redraw, TileContext
from accelsurf.viewer.scene.shapes import label_surface
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import Picked, SpaceTile, place_in_renderer
from accelsurf.viewer.scene.stroke_marks import Marks
from accelsurf.viewer.scene.tiles import Tiles

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
    window : GreyWindow, optional
        Which values of the image are black and white; from all of it unless given.

    Attributes
    ----------
    plotter : pyvista.Plotter
    frame : Frame or None
        On display now.
    theme, theme_name : Theme, str
        Colours in use.
    color : str
        Quantity that colours the surfaces, where they have it.
    is_interpolated : bool
        Whether slices are drawn smoothly between voxels, not each voxel as a rectangle.
    tiles : Tiles
        Layout of the tiles, and the part of the image in each.
    is_straight : bool
        Whether slices follow the world's axes, not the voxels; at first where the header names a patient's.
    unit : str
        Of lengths in the file, and in read-outs.
    marks : Marks
        Strokes that are painted, and uncertain locations.

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
        window: GreyWindow | None = None,
    ) -> None:
        self.theme, self.theme_name = theme_named(theme), theme
        self._reference = None if reference is None else Reference(reference, volume.geometry)
        self.volume, self.geometry = volume, volume.geometry
        self.frame: Frame | None = None
        self.color = "plain"
        self._window = window_of(volume.array) if window is None else window
        self.is_interpolated = True
        self.title = (volume.source.name if volume.source else "") if title is None else title
        self._cursor = 0.5 * (np.array(self.geometry.shape) - 1.0)
        self._cursor_is_set = False
        self.anatomical, self.unit = (
            shows_patient(volume),
            volume.geometry.unit,
        )
        self.is_straight = self.anatomical and self.is_oblique
        if plotter is None:
            require_graphics()
            plotter = pv.Plotter(
                off_screen=True, window_size=list(size), **self.layout(self.geometry)
            )
        self.plotter = plotter
        self.styles = ObjectStyles()
        self._redraw = Redraw(plotter.render_window, plotter.renderers)
        self._build()
        self.tiles = Tiles(self._redraw, self.space, self.slice_tiles, self._chart_renderer)
        self.marks = Marks(self.geometry, self.slice_tiles.values(), self.space, self._redraw)
        self.paint(theme)
        others = self._legend, self.chart
        plotter.render_window.AddObserver("StartEvent", lambda *_: self.tiles.fit(*others))

    @staticmethod
    def layout(geometry: Geometry) -> dict[str, Any]:
        """Arguments of a `pyvista.Plotter` with the renderers of the scene of an image."""
        if geometry.slice_axis is not None:
            return {"shape": (1, 3), "groups": [(0, [0, 1])], "border": False}
        return {"shape": (2, 4), "groups": [([0, 1], [0, 1])], "border": False}

    def _build(self) -> None:
        plotter = self.plotter
        upright = DisplayOrientation.of(self.geometry)
        image = self.volume.array
        flat = self.geometry.slice_axis
        context = TileContext(self._redraw, self.styles, self.theme, self.anatomical, self.unit)
        places = (
            {0: (0, 2), 1: (0, 3), 2: (1, 2)}
            if flat is None
            else {upright.order.index(flat): (0, 0)}
        )
        self.space: SpaceTile | None = None
        if flat is None:
            plotter.subplot(0, 0)
            self.space = SpaceTile(plotter, self.geometry, context)
        self.slice_tiles: dict[str, SliceTile] = {}
        for plane, place in places.items():
            plotter.subplot(*place)
            tile = SliceTile(
                plotter.renderer, image, self._window, self._stack_of(plane), plane, context
            )
            self.slice_tiles[TILES[plane]] = tile
        plotter.subplot(*((1, 3) if flat is None else (0, 2)))
        self._chart_renderer = plotter.renderer
        self._chart_renderer.SetInteractive(False)
        self.chart = EnergyChart(plotter, self.theme)
        plotter.subplot(0, 0)
        largest = (
            self.space.renderer
            if self.space is not None
            else next(iter(self.slice_tiles.values())).renderer
        )
        self._legend = Legend(largest, self.theme.ink)
        for tile in self.slice_tiles.values():
            tile.show(self._cursor)
        if self._reference is not None:
            self._reference.draw(self.space, self.slice_tiles.values())

    # -- drawing ------------------------------------------------------------------------------------------

    def update(
        self, frame: Frame, histories: Sequence[Sequence[StepRecord]] = (), coarse: bool = False
    ) -> None:
        """Draw a frame of this image, its objects' ``histories`` in the chart; ``coarse`` as of `Tiles.coarsen`."""
        self.frame = frame
        if frame.has_surface and not self._cursor_is_set:
            self._cursor = np.clip(frame.middle(), 0.0, np.array(self.geometry.shape) - 1.0)
            self._cursor_is_set = True
            self._show_slices()
        self._show_frame(coarse)
        self.chart.colors = [style.color for style in self.styles.of(frame)]
        self.chart.update(histories)
        self._redraw.mark_all()

    def _show_frame(self, coarse: bool = False) -> None:
        frame = self.frame
        if frame is None:
            return
        if self.space is not None:
            self.space.show(frame, self.color, coarse)
        self._show_flat(frame)
        lines = [line for line in (self.title, *caption(frame, self.geometry, self.unit)) if line]
        if self.space is not None:
            self.space.title.text = "\n".join(lines).replace(" = ", "\n= ")
        else:
            next(iter(self.slice_tiles.values())).title.text = "   ".join(lines)

    def _show_flat(self, frame: Frame) -> None:
        for tile in self.slice_tiles.values():
            tile.draw_objects(frame)
        self._legend.show(legend_lines(frame, self.dice, self.styles.of(frame)))

    def name_objects(self, labels: LabelTable) -> None:
        """Draw objects with these names and in these colours; those that have none as by default."""
        self.styles.give(labels)
        self.restyle()

    def restyle(self) -> None:
        """Draw objects in their styles, which have changed."""
        if self.space is not None:
            self.space.restyle()
        if self.frame is not None:
            self._show_flat(self.frame)
            self._redraw.mark_all()

    def compare(self, labels: Volume) -> None:
        """Compare with labels from now on; InputError when they are on another grid."""
        self._reference = Reference(labels, self.geometry)
        self._reference.draw(self.space, self.slice_tiles.values())
        self._show_frame()
        self._redraw.mark_all()

    @property
    def legend(self) -> tuple[str, ...]:
        """Lines of the legend, with Dice; empty for one object without a reference."""
        return self._legend.lines

    @property
    def dice(self) -> float | None:
        """Dice of the objects drawn now and the reference; None without either. Coarse frames count their voxels."""
        return (
            None
            if self._reference is None or self.frame is None
            else self._reference.dice(self.frame)
        )

    def color_by(self, name: str) -> None:
        """Colour the surfaces by a quantity of `COLORS`, plain where they lack it; another is a UsageError."""
        check_known("color", name, COLORS)
        self.color = name
        self._show_frame()
        self._redraw.mark_all()

    def show_planes(self, on: bool) -> None:
        """Draw the three slices in 3D, or not."""
        if self.space is not None:
            self.space.show_planes(
                [tile.in_space() for tile in self.slice_tiles.values()] if on else None
            )

    @property
    def shows_planes(self) -> bool:
        """Test if the three slices are drawn in 3D."""
        return self.space is not None and self.space.shows_planes

    @property
    def window(self) -> GreyWindow:
        """Range of the values of the image from black to white."""
        return self._window

    @window.setter
    def window(self, window: GreyWindow) -> None:
        self._window = window
        for tile in self.slice_tiles.values():
            tile.use_window(window)
        if self.shows_planes:
            self.show_planes(True)

    def interpolate(self, on: bool) -> None:
        """Draw slices smoothly between voxels, or each voxel as a rectangle."""
        self.is_interpolated = on
        for tile in self.slice_tiles.values():
            tile.interpolate(on)

    @property
    def is_oblique(self) -> bool:
        """Test if slices along the voxels and straight ones differ."""
        return (
            self.geometry.slice_axis is None
            and not DisplayOrientation.of(self.geometry).is_parallel
        )

    def straighten(self, on: bool) -> None:
        """Show slices straight along the world's axes, or along the voxels, if that makes a difference."""
        self.is_straight = on and self.is_oblique
        self._show_slices()

    def _stack_of(self, plane: int) -> SliceStack:
        kind = SliceStack.straight if self.is_straight else SliceStack.along_voxels
        return kind(self.geometry, plane)

    @property
    def cursor(self) -> NDArray[np.float64]:
        """The world point (x, y, z), mm LPS, through which the slices go; clipped to the image when set."""
        return self.geometry.index_to_world(self._cursor)

    @cursor.setter
    def cursor(self, world: ArrayLike) -> None:
        place = np.asarray(world, float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise UsageError(
                f"cursor: {world!r} was given, expected three finite numbers x, y, z in mm"
            )
        self._cursor = np.clip(
            self.geometry.world_to_index(place), 0.0, np.array(self.geometry.shape) - 1.0
        )
        self._cursor_is_set = True
        self._show_slices()

    def step_slice(self, name: str, count: int) -> None:
        """Go ``count`` slices further in a tile, one of ``slice_tiles``, towards larger world coordinates."""
        tile = self.slice_tiles[name]
        self.go_to_slice(name, tile.index + (count if tile.stack.step > 0 else -count))

    def go_to_slice(self, name: str, number: int) -> None:
        """Go to a slice of a tile by its number, or to the nearest that there is."""
        self._cursor = self.slice_tiles[name].stack.go_to(self._cursor, number)
        self._cursor_is_set = True
        self._show_slices()

    def _show_slices(self) -> None:
        """Go to the cursor: contours are drawn anew only in the tiles whose slice has changed."""
        for tile in self.slice_tiles.values():
            before = tile.sight
            if tile.stack.is_straight != self.is_straight:
                tile.use_stack(self._stack_of(tile.plane), self._cursor)
            else:
                tile.show(self._cursor)
            if tile.sight != before:
                if self._reference is not None:
                    tile.draw_reference(self._reference.contour_function)
                if self.frame is not None:
                    tile.draw_objects(self.frame)
        self.marks.show_slices()
        if self.shows_planes:
            self.show_planes(True)

    def mark_ball(self, center: ArrayLike | None, radius: float = 0.0) -> None:
        """Draw a ball that is being placed (world mm), in 3D and where it cuts the slices; None removes it."""
        middle = None if center is None else np.asarray(center, float)
        if self.space is not None:
            self.space.mark_ball(middle, radius)
        for tile in self.slice_tiles.values():
            tile.mark_ball(None if middle is None else self.geometry.world_to_index(middle), radius)

    def mark_size(self, drag: SizeDrag | None, drag_mm: float = 0.0) -> None:
        """Draw in the slices the object of the size that a drag stands for; None removes it."""
        volume = None if drag is None else drag.volume_of(drag_mm)
        for tile in self.slice_tiles.values():
            tile.mark_size(
                drag, volume, "" if volume is None else f"size {volume_line(volume, self.unit)}"
            )

    def paint(self, theme: str) -> None:
        """Use a theme; an unknown one is a UsageError."""
        self.theme, self.theme_name = theme_named(theme), theme
        self._redraw.mark_all()
        for renderer in self.plotter.renderers:
            renderer.background_color = self.theme.background
        for part in (self.space, *self.slice_tiles.values(), self.chart, self._legend):
            if part is not None:
                part.paint(self.theme)

    def show_image(self, volume: Volume) -> None:
        """Show another image on the same grid; cursor, camera and grey values stay."""
        self.volume = volume
        for tile in self.slice_tiles.values():
            tile.use_image(volume.array)
        self.show_planes(self.shows_planes)
        self._redraw.mark_all()

    # -- pictures -----------------------------------------------------------------------------------------

    def pick(self, x: float, y: float) -> Picked:
        """Return the tile and the point under a pixel, counted from the lower left corner of the window."""
        for name, tile in self.slice_tiles.items():
            inside = place_in_renderer(tile.renderer, x, y)
            if inside is not None:
                index = tile.from_tile(*tile.to_plane(*inside))
                return Picked(name, None if index is None else self.geometry.index_to_world(index))
        if self.space is not None and place_in_renderer(self.space.renderer, x, y) is not None:
            return Picked("space", self.space.pick(x, y))
        return Picked("energies", None)

    def render(self) -> None:
        """Draw all changes."""
        self._redraw.draw()

    def screenshot(self, path: str | Path | None = None) -> NDArray[np.uint8]:
        """Render, and return the picture (height, width, 3), uint8; with a path write it there as PNG."""
        self.render()
        picture = grab(self.plotter.render_window)
        if path is not None:
            write_png(Path(path), picture)
        return picture

    def close(self) -> None:
        """Free the plotter and its memory."""
        self.plotter.close()


def grab(window: vtkRenderWindow) -> NDArray[np.uint8]:
    """Return the picture of a rendered window, (height, width, 3)."""
    filter_ = vtkWindowToImageFilter(input=window, read_front_buffer=False, should_rerender=False)
    filter_.Update()
    image = pv.wrap(filter_.GetOutput())
    width, height, _ = image.dimensions
    return (
        np.asarray(image.point_data.active_scalars).reshape(height, width, -1)[::-1, :, :3].copy()
    )


class Reference:
    """The true object or objects, as one.

    Parameters
    ----------
    labels : Volume
        Above 0 is the object.
    geometry : Geometry
        Of the image.

    Attributes
    ----------
    inside : ndarray (nz, ny, nx), bool
    contour_function : ndarray (nz, ny, nx), float32
        Negative inside; 0 halfway between voxels inside and outside.

    Raises
    ------
    InputError
        When the labels are on another grid than the image.
    """

    def __init__(self, labels: Volume, geometry: Geometry) -> None:
        if not geometry.matches(labels.geometry):
            raise InputError(
                f"the reference is not on the image's grid: {geometry.difference(labels.geometry)}",
                "resample it to the image's grid",
            )
        self._geometry = geometry
        self.inside: NDArray[np.bool_] = np.asarray(labels.array > 0)
        self.contour_function: NDArray[np.float32] = np.asarray(np.float32(0.5) - self.inside)
        self._voxels = int(self.inside.sum())

    def draw(self, space: SpaceTile | None, tiles: Iterable[SliceTile]) -> None:
        """Draw the surface in 3D, and the contours in the slices."""
        if space is not None:
            space.show_reference(label_surface(self.inside, self._geometry))
        for tile in tiles:
            tile.draw_reference(self.contour_function)

    def dice(self, frame: Frame) -> float:
        """Dice of the reference and all objects of a frame; coarse frames count their voxels."""
        return frame.dice(self.inside, self._voxels)
