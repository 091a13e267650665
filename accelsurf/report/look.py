"""Pictures of an image without a run: three slices of each channel, with a grid in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow, window_of
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.grid.volume import Volume
from accelsurf.io.headers import UNIT_KEY, is_anatomical
from accelsurf.report.axes import ticks
from accelsurf.report.canvas import SKY, SURFACE, YELLOW, Box, Canvas, object_color
from accelsurf.report.preview import BELOW, LEFT, PANEL, TOP, WIDTH, panel_at
from accelsurf.report.slice_plot import (
    Slice,
    draw_contour,
    draw_scale_bar,
    name_section,
    open_slice,
    write_letters,
)
from accelsurf.report.slice_views import SliceView, displayed, whole_ranges

#: Opacity of the lines of the grid.
GRID_OPACITY = 0.5
#: Labels whose contours are drawn in a slice, at most.
MAX_LABELS = 60


def look_png(
    channels: Sequence[Volume],
    title: str,
    *,
    at: tuple[float, float, float] | None = None,
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
        Chosen for each channel unless given.
    labels : ndarray (nz, ny, nx), optional
        Drawn as contours, each label in a colour with its number.

    Returns
    -------
    bytes
        A PNG file.
    """
    geometry = channels[0].geometry
    place = _place(geometry, at, labels)
    planes = [0, 1, 2]
    if geometry.slice_axis is not None:
        planes = [DisplayOrientation.of(geometry).order.index(geometry.slice_axis)]
    canvas = Canvas(WIDTH if len(planes) > 1 else 940, _height(len(channels), len(planes)), title)
    for row, volume in enumerate(channels):
        own_window = window if window is not None else _window(volume, labels)
        for column, plane in enumerate(planes):
            panel = panel_at(row, column) if len(planes) > 1 else _single_panel(row)
            why = f"channel {row + 1}" if len(channels) > 1 else ""
            view = SliceView(plane, round(displayed(place, geometry)[plane]), why)
            anatomical = is_anatomical(channels[0].metadata)
            shown = open_slice(
                canvas, panel, volume.array, geometry, view, whole_ranges(geometry), own_window, anatomical
            )
            _draw_grid(shown)
            _draw_cross(shown, place)
            if labels is not None:
                _draw_labels(shown, labels)
            if anatomical:
                write_letters(shown)
            draw_scale_bar(shown, channels[0].metadata.get(UNIT_KEY, "mm"))
        bottom = TOP + (row + 1) * (_panel_height(len(planes)) + BELOW) - 26
        canvas.text((canvas.width - 10, bottom), f"window {own_window.text}", 11, anchor="rd")
    return canvas.png()


def _place(geometry: Geometry, at: tuple[float, float, float] | None, labels: NDArray[Any] | None) -> Any:
    """The voxel (z, y, x) through which the slices go."""
    if at is not None:
        return tuple(int(v) for v in np.rint(geometry.world_to_index(at)))
    if labels is not None and labels.any():
        filled = [np.flatnonzero((labels > 0).any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
        return tuple(int(np.median(one)) for one in filled)
    return tuple(n // 2 for n in geometry.shape)


def _window(volume: Volume, labels: NDArray[Any] | None) -> GreyWindow:
    if labels is None or not labels.any():
        return window_of(volume.array)
    return window_of(volume.array, np.asarray(labels > 0))


def _panel_height(planes: int) -> int:
    return PANEL if planes > 1 else 700


def _height(rows: int, planes: int) -> int:
    return TOP + rows * (_panel_height(planes) + BELOW)


def _single_panel(row: int) -> Box:
    """The panel of the one slice of an image."""
    top = TOP + row * (_panel_height(1) + BELOW)
    return LEFT, top, 910, top + _panel_height(1)


def _draw_grid(shown: Slice) -> None:
    """Draw lines across the slice at the ticks of its scales."""
    axes, canvas = shown.axes, shown.axes.canvas
    left, top, right, bottom = axes.box
    for at, _ in ticks(*axes.x, max(2, int((right - left) / 70))):
        x = float(axes.to_canvas([(at, axes.y[0])])[0, 0])
        canvas.shade((x - 0.5, top, x + 0.5, bottom), SKY, GRID_OPACITY)
    for at, _ in ticks(*axes.y, max(2, int((bottom - top) / 45))):
        y = float(axes.to_canvas([(axes.x[0], at)])[0, 1])
        canvas.shade((left, y - 0.5, right, y + 0.5), SKY, GRID_OPACITY)


def _draw_cross(shown: Slice, place: tuple[int, int, int]) -> None:
    """Mark the place through which all slices go, at the ends of its lines: nothing covers the image there."""
    at = displayed(place, shown.geometry)
    vertical, horizontal = IN_PLANE[shown.view.plane]
    ((x, y),) = shown.to_canvas(at[vertical], at[horizontal])
    left, top, right, bottom = shown.axes.box
    for ends in (
        [(x, top), (x, top + 12)], [(x, bottom - 12), (x, bottom)], [(left, y), (left + 12, y)],
        [(right - 12, y), (right, y)],
    ):  # fmt: skip
        shown.axes.canvas.line(ends, YELLOW, 2)


def _draw_labels(shown: Slice, labels: NDArray[Any]) -> None:
    """Draw the contour of each label in its colour, with its number where there are several."""
    section, known = shown.section(labels), np.unique(labels[labels > 0])
    for position, number in enumerate(known):
        inside = section == number
        if position < MAX_LABELS and inside.any():
            color = SURFACE if len(known) == 1 else object_color(position)
            draw_contour(shown, np.where(inside, -0.5, 0.5), color, width=1.5)
            if len(known) > 1:
                name_section(shown, inside, str(number), color)
