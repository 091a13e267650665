"""Pictures of a run: how the energy fell, where the surface lies in the image, what it looks like.

Pure functions from arrays to PNG bytes; the parts of a picture have a module each.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.report.canvas import (
    INK,
    RUN_COLORS,
    RUN_DASHES,
    drawable,
    name_style,
    new_figure,
    png_bytes,
    style_axes,
)
from accelsurf.report.energy_plot import draw_energies, energy_curve
from accelsurf.report.preview_content import PreviewContent
from accelsurf.report.slice_plot import draw_slice, middle_voxel
from accelsurf.report.surface_plot import draw_surface


def preview_png(content: PreviewContent) -> bytes:
    """Draw one run: three slices with the contour, energies against step, the surface in 3D.

    Of an image of one slice: the image with the contour and the start, and the energies.

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
    figure = new_figure(12.6, 8.6, content.title)
    grid = figure.add_gridspec(2, 3, left=0.06, right=0.965, top=0.89, bottom=0.075, hspace=0.27, wspace=0.26)
    place = middle_voxel(content)
    for plane in range(3):
        draw_slice(figure.add_subplot(grid[0, plane]), content, plane, place)
    draw_energies(figure.add_subplot(grid[1, :2]), content.history)
    draw_surface(figure.add_subplot(grid[1, 2]), content)
    return png_bytes(figure)


def _png_2d(content: PreviewContent, axis: int) -> bytes:
    """Draw a run on an image of one slice; the picture is as wide and high as suits the image."""
    order = DisplayOrientation.of(content.geometry).order
    plane = order.index(axis)
    tall, wide = (_length(content.geometry, order[i]) for i in IN_PLANE[plane])
    inch = min(6.8 / wide, 8.0 / tall)  # per mm
    left, high, right = max(wide * inch, 2.5), max(tall * inch, 4.0), 4.6
    width, height = left + right + 2.7, high + 1.55
    figure = new_figure(width, height, content.title)
    grid = figure.add_gridspec(
        1,
        2,
        left=0.8 / width,
        right=1 - 0.8 / width,
        top=1 - 0.9 / height,
        bottom=0.65 / height,
        wspace=2.2 / (left + right),
        width_ratios=(left, right),
    )
    draw_slice(figure.add_subplot(grid[0, 0]), content, plane, middle_voxel(content))
    energies = figure.add_subplot(grid[0, 1])
    draw_energies(energies, content.history)
    energies.set_box_aspect(min(0.9, high / right))
    return png_bytes(figure)


def _length(geometry: Geometry, axis: int) -> float:
    return geometry.shape[axis] * geometry.spacing[axis]


def comparison_png(runs: Mapping[str, PreviewContent], title: str) -> bytes:
    """Draw several runs on the same image side by side: a slice and the surface of each, then all energies.

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
    count, axis = len(runs), next(iter(runs.values())).geometry.slice_axis
    ratios = (1, 1, 0.75) if axis is None else (1, 0.75)  # of one slice there is no surface
    height = 12.0 if axis is None else 8.2
    figure = new_figure(max(4.1 * count, 8.2), height, title)
    place = {"left": 0.09, "right": 0.965, "top": 1 - 1.14 / height, "bottom": 0.66 / height}
    grid = figure.add_gridspec(len(ratios), count, hspace=0.24, wspace=0.25, height_ratios=ratios)
    grid.update(**place)
    vertices = [content.surface.vertices for content in runs.values() if content.surface is not None]
    box = np.concatenate(vertices) if vertices else None
    for column, (name, content) in enumerate(runs.items()):
        top = figure.add_subplot(grid[0, column])
        plane = 0 if axis is None else DisplayOrientation.of(content.geometry).order.index(axis)
        draw_slice(top, content, plane, middle_voxel(content))
        text = f"{name}\n{content.title}"
        top.set_title(drawable(text), fontsize=10, color=INK, **name_style(text))
        color = RUN_COLORS[column % len(RUN_COLORS)]
        if axis is None:
            draw_surface(figure.add_subplot(grid[1, column]), content, box=box, color=color)
    below = figure.add_subplot(grid[-1, :])
    for number, (name, content) in enumerate(runs.items()):
        below.plot(
            *energy_curve(content.history),
            color=RUN_COLORS[number % len(RUN_COLORS)],
            linestyle=RUN_DASHES[number % len(RUN_DASHES)],
            linewidth=1.8,
            label=name,
        )
    style_axes(below, "step", "energy")
    below.legend(frameon=False, fontsize=9, labelcolor=INK)
    return png_bytes(figure)
