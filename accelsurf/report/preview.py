"""Pictures of a run: where the surface lies in the image, how the energy fell, what the surface looks like.

Pure functions from arrays to PNG bytes; the parts of a picture have a module each.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow, window_of
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.report.axes import LABEL_SIZE, Axes, range_of
from accelsurf.report.canvas import PALE, RUN_COLORS, RUN_DASHES, Box, Canvas, text_width
from accelsurf.report.energy_plot import draw_energies, energy_curve
from accelsurf.report.preview_content import PreviewContent
from accelsurf.report.slice_plot import draw_slice
from accelsurf.report.slice_views import Ranges, SliceView, box_of, click_views, doubt_views, main_views, shown_ranges
from accelsurf.report.surface_plot import draw_surface

#: Width of a picture, of its margins and of the space between panels, pixels.
WIDTH, LEFT, RIGHT, GAP = 1386, 78, 30, 92
#: Height of the title, of a panel, and below a panel.
TOP, PANEL, BELOW = 74, 378, 84


def preview_png(content: PreviewContent) -> bytes:
    """Draw one run, so that a person can judge it.

    Above three slices with the contour, through the first click or the largest sections, cropped to the object. Below
    the slice of the fastest late growth if that is known, else that of where to click next, the energies against step,
    and the surface in 3D; then slices through further clicks. Of an image of one slice: the image with contour and
    start, and the energies.

    Parameters
    ----------
    content : PreviewContent
        What to show.

    Returns
    -------
    bytes
        A PNG file.
    """
    if content.geometry.slice_axis is not None:
        return _png_2d(content, content.geometry.slice_axis)
    ranges = shown_ranges(content)
    window, doubtful = content_window(content, ranges), doubt_views(content)
    more = [*click_views(content), *doubtful[1:]][-3:]
    rows = 3 if more else 2
    canvas = Canvas(WIDTH, TOP + rows * (PANEL + BELOW), content.title)
    for column, view in enumerate(main_views(content)):
        draw_slice(canvas, panel_at(0, column), content, view, ranges, window)
    left, top, right, bottom = panel_at(1, 1)
    if doubtful:
        draw_slice(canvas, panel_at(1, 0), content, doubtful[0], ranges, window)
    else:
        left = panel_at(1, 0)[0]
    draw_energies(canvas, (left, top, right - 24, bottom), content.history, content.steps_left_out)
    draw_surface(canvas, panel_at(1, 2), content)
    for column, view in enumerate(more):
        draw_slice(canvas, panel_at(2, column), content, view, ranges, window)
    write_window(canvas, window)
    return canvas.png()


def panel_at(row: int, column: int, columns: int = 3) -> Box:
    """Where a panel lies."""
    width = (WIDTH - LEFT - RIGHT - (columns - 1) * GAP) / columns
    left, top = LEFT + column * (width + GAP), TOP + row * (PANEL + BELOW)
    return left, top, left + width, top + PANEL


def content_window(content: PreviewContent, ranges: Ranges) -> GreyWindow:
    """The window that was asked for, else one for the part of the image that is shown."""
    if content.window is not None:
        return content.window
    part = box_of(ranges, content.geometry)
    inside = content.inside()[part]
    return window_of(content.image[part], inside) if inside.any() else window_of(content.image)


def write_window(canvas: Canvas, window: GreyWindow) -> None:
    """Write the grey window in the lower right corner."""
    canvas.text((canvas.width - 10, canvas.height - 8), f"window {window.text}", 11, PALE, "rd")


def _png_2d(content: PreviewContent, axis: int) -> bytes:
    """Draw a run on an image of one slice; the picture is as wide and high as suits the image."""
    order = DisplayOrientation.of(content.geometry).order
    plane = order.index(axis)
    ranges = shown_ranges(content)
    tall, wide = (_length(content.geometry, order[i]) for i in IN_PLANE[plane])
    pixels = min(748 / wide, 748 / tall)  # per mm
    left, high, right = max(wide * pixels, 340), max(tall * pixels, 440), 500
    # As wide as its title, so that none is cut off.
    width = max(LEFT + left + GAP + 20 + right + 90, text_width(content.title, 17) + 40)
    canvas = Canvas(width, TOP + high + BELOW, content.title)
    window = content_window(content, ranges)
    view = SliceView(plane, 0)
    draw_slice(canvas, (LEFT, TOP, LEFT + left, TOP + high), content, view, ranges, window)
    first, middle = LEFT + left + GAP + 20, TOP + high / 2
    half = 0.5 * min(0.9 * right, high)
    draw_energies(
        canvas, (first, middle - half, first + right, middle + half), content.history, content.steps_left_out
    )
    write_window(canvas, window)
    return canvas.png()


def _length(geometry: Geometry, axis: int) -> float:
    return geometry.shape[axis] * geometry.spacing[axis]


def comparison_png(runs: Mapping[str, PreviewContent], title: str) -> bytes:
    """Draw several runs on the same image side by side: a slice and the surface of each, then all energies.

    All have the same slice, crop and window, those of the first.

    Parameters
    ----------
    runs : mapping of str to PreviewContent
        Name of each run (the heading of its column) and what it shows; at least one.
    title : str
        One line above the picture.

    Returns
    -------
    bytes
        A PNG file.
    """
    contents = list(runs.values())
    geometry = contents[0].geometry
    axis = geometry.slice_axis
    width, column_width, top = max(450 * len(runs), 900), 450, 124
    rows = 2 if axis is None else 1  # of one slice there is no surface
    canvas = Canvas(width, top + rows * (360 + BELOW) + 300 + BELOW, title)
    vertices = [content.surface.vertices for content in contents if content.surface is not None]
    box = np.concatenate(vertices) if vertices else None
    ranges = [shown_ranges(content) for content in contents]
    common = tuple((min(r[a][0] for r in ranges), max(r[a][1] for r in ranges)) for a in range(3))
    shown: Ranges = (common[0], common[1], common[2])
    plane = 0 if axis is None else DisplayOrientation.of(geometry).order.index(axis)
    view, window = main_views(contents[0])[plane], content_window(contents[0], shown)
    for column, (name, content) in enumerate(runs.items()):
        left = column * column_width + LEFT + (width - column_width * len(runs)) / 2
        right = left + column_width - LEFT - 20
        slice_ = draw_slice(canvas, (left, top, right, top + 360), content, view, shown, window)
        canvas.text(((left + right) / 2, slice_.axes.box[1] - 26), f"{name}\n{content.title}", 13, anchor="md")
        if axis is None:
            below = top + 360 + BELOW
            color = RUN_COLORS[column % len(RUN_COLORS)]
            draw_surface(canvas, (left, below, right, below + 360), content, box=box, color=color)
    low = top + rows * (360 + BELOW)
    _draw_curves(canvas, (LEFT + 20, low, width - 40, low + 300), runs)
    write_window(canvas, window)
    return canvas.png()


def _draw_curves(canvas: Canvas, panel: Box, runs: Mapping[str, PreviewContent]) -> None:
    """Draw the energies of several runs with a legend."""
    curves = {name: energy_curve(content.history) for name, content in runs.items()}
    last = max([1, *(step for steps, _ in curves.values() for step in steps)])
    axes = Axes(canvas, panel, (0.0, float(last)), range_of([v for _, values in curves.values() for v in values]))
    axes.frame("step", "energy", grid=True)
    _, top, right, _ = panel
    for number, (name, (steps, values)) in enumerate(curves.items()):
        style = RUN_COLORS[number % len(RUN_COLORS)], 2.5, RUN_DASHES[number % len(RUN_DASHES)]
        axes.curve(steps, values, *style)
        y = top + 16 + 18 * number
        canvas.text((right - 60, y), name, LABEL_SIZE, anchor="rm")
        canvas.line([(right - 52, y), (right - 12, y)], *style)
