"""Pictures of an image without a run: three slices of each channel, with a grid in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.image.grey_window import GreyWindow, window_of
from accelsurf.image.volume import Volume
from accelsurf.io import shows_patient
from accelsurf.output.pictures.canvas import (
    SKY,
    SURFACE_COLOR,
    TICK_SIZE,
    YELLOW,
    Box,
    Canvas,
    object_color,
)
from accelsurf.output.pictures.marks import marked_png
from accelsurf.output.pictures.preview import BELOW, LEFT, PANEL, TOP, WIDTH, panel_at
from accelsurf.output.pictures.slice_views import SliceView, displayed, whole_ranges
from accelsurf.output.pictures.slices import (
    ShownImage,
    Slice,
    draw_contour,
    draw_slice_scale,
    name_section,
    open_slice,
    typed_note,
    write_letters,
)

#: Opacity of the lines of the grid.
GRID_OPACITY = 0.5
#: Labels whose contours are drawn in a slice, at most.
MAX_LABELS = 60


def look_png(
    channels: Sequence[Volume],
    title: str,
    *,
    at: Sequence[float] | None = None,
    window: GreyWindow | None = None,
    labels: NDArray[Any] | None = None,
) -> bytes:
    """Draw slices of an image through a place, each channel in a row of its own.

    Parameters
    ----------
    channels : sequence of Volume
        At least one, all on one grid.
    title : str
        One line above the picture.
    at : (float, float, float), optional
        World place (x, y, z), mm LPS; the middle of the labels, else of the image, unless given.
    window : GreyWindow, optional
        Selected for each channel unless given.
    labels : ndarray (nz, ny, nx), optional
        Drawn as contours, each label in a colour with its number.

    Returns
    -------
    bytes
        A PNG file.
    """
    geometry = channels[0].geometry
    place = voxel_shown(geometry, at, labels)
    planes = [0, 1, 2]
    if geometry.slice_axis is not None:
        planes = [DisplayOrientation.of(geometry).order.index(geometry.slice_axis)]
    several = len(planes) > 1
    tall = PANEL if several else 700
    canvas = Canvas(WIDTH if several else 940, TOP + len(channels) * (tall + BELOW), title)
    anatomical, unit = shows_patient(channels[0]), geometry.unit
    for row, volume in enumerate(channels):
        grey = window if window is not None else _window(volume, labels)
        top = TOP + row * (tall + BELOW)
        for column, plane in enumerate(planes):
            panel = panel_at(row, column) if several else Box(LEFT, top, 910, top + tall)
            why = f"channel {row + 1}" if len(channels) > 1 else ""
            view = SliceView(plane, round(displayed(place, geometry)[plane]), why)
            image = ShownImage(volume.array, geometry, grey, anatomical, unit)
            shown = open_slice(canvas, panel, image, view, whole_ranges(geometry))
            shown.axes.grid(color=SKY, linewidth=1, linestyle="-", alpha=GRID_OPACITY)
            _draw_cross(shown, place)
            if labels is not None:
                _draw_labels(shown, labels)
            if anatomical:
                write_letters(shown)
            draw_slice_scale(shown, unit)
        canvas.text((10, top + tall + BELOW - 26), typed_note(geometry), TICK_SIZE, anchor="ld")
        canvas.text(
            (canvas.width - 10, top + tall + BELOW - 26),
            f"window {grey.text}",
            TICK_SIZE,
            anchor="rd",
        )
    return marked_png(canvas.pixels())


def voxel_shown(geometry: Geometry, at: Sequence[float] | None, labels: NDArray[Any] | None) -> Any:
    """The voxel (z, y, x) through which the slices go."""
    if at is not None:
        return tuple(int(v) for v in np.rint(geometry.world_to_index(at)))
    if labels is not None and labels.any():
        filled = [
            np.flatnonzero((labels > 0).any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)
        ]
        return tuple(int(np.median(places)) for places in filled)
    return tuple(n // 2 for n in geometry.shape)


def _window(volume: Volume, labels: NDArray[Any] | None) -> GreyWindow:
    if labels is None or not labels.any():
        return window_of(volume.array)
    return window_of(volume.array, np.asarray(labels > 0))


def _draw_cross(shown: Slice, voxel: tuple[int, int, int]) -> None:
    """Mark the place through which all slices go, at the ends of its lines: nothing covers the image there."""
    x, y = shown.place(voxel)
    for ends in ((0.0, 0.03), (0.97, 1.0)):
        shown.axes.axvline(x, *ends, color=YELLOW, linewidth=2, linestyle="-")
        shown.axes.axhline(y, *ends, color=YELLOW, linewidth=2, linestyle="-")


def _draw_labels(shown: Slice, labels: NDArray[Any]) -> None:
    """Draw the contour of each label in its colour, with its number where there are several."""
    section, numbers = shown.section(labels), np.unique(labels[labels > 0])
    for position, number in enumerate(numbers):
        inside = section == number
        if position < MAX_LABELS and inside.any():
            color = SURFACE_COLOR if len(numbers) == 1 else object_color(position)
            draw_contour(shown, np.where(inside, -0.5, 0.5), color, width=1.5)
            if len(numbers) > 1:
                name_section(shown, inside, str(number), color)
