"""Pictures of a run: where the surface lies in the image, and how the energy fell.

Pure functions from arrays to PNG bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.image.grey_window import GreyWindow, window_of
from accelsurf.output.pictures.canvas import (
    BLUE,
    DASHED,
    HEADING_SIZE,
    INK,
    PALE,
    VERMILION,
    Box,
    Canvas,
    range_of,
    text_width,
    write_legend,
    write_scales,
    write_title,
)
from accelsurf.output.pictures.preview_content import PreviewContent
from accelsurf.output.pictures.slice_views import (
    Ranges,
    SliceView,
    box_of,
    click_views,
    main_views,
    native_plane,
    second_view,
    shown_ranges,
    uncertain_views,
)
from accelsurf.output.pictures.slices import draw_slice, typed_note

if TYPE_CHECKING:
    from accelsurf.evolution import StepRecord

#: Width of a picture, of its margins and of the space between panels, pixels.
WIDTH = 1386
LEFT = 78
RIGHT = 30
GAP = 92
#: Height of the title, of a panel, of a large one, of the energies, and below a panel.
TOP = 74
PANEL = 378
LARGE = 560
LOW = 200
BELOW = 84


def preview_png(content: PreviewContent) -> bytes:
    """Draw one run, so that a person can judge it.

    Above three slices with the contour, through the first click or the largest sections, cropped to the object. Below
    the slice of the fastest late growth if that is known, else that of where to click next, the energies against step,
    small, and slices through further clicks. Where the object is flat along the thick slices, that slice is above too,
    both larger, and the two low ones are below. Of an image of one slice: the image with contour and start, and the
    energies.

    Parameters
    ----------
    content : PreviewContent
        Content of the picture.

    Returns
    -------
    bytes
        A PNG file.
    """
    if content.geometry.slice_axis is not None:
        return _png_2d(content, content.geometry.slice_axis)
    ranges = shown_ranges(content)
    window = content_window(content, ranges)
    main = main_views(content)
    native = native_plane(content.geometry)
    low = [
        view for view in main if view.plane != native and _is_low(view, ranges, content.geometry)
    ]
    is_flat = len(low) == 2
    second = second_view(content, is_flat)
    more = [view for view in (*click_views(content), *uncertain_views(content)) if view != second][
        -3:
    ]
    further = LARGE - PANEL if is_flat else 0
    canvas = Canvas(
        WIDTH, TOP + further + (3 if len(more) > 1 else 2) * (PANEL + BELOW), content.title
    )
    first = [main[native], second] if is_flat else main
    width = (WIDTH - LEFT - RIGHT - (len(first) - 1) * GAP) / len(first)
    panels = {}
    for column, view in enumerate(first):
        left = column * (width + GAP) + LEFT
        panels[view] = Box(left, TOP, left + width, TOP + PANEL + further)
    below = [panel_at(1, column, further) for column in range(3)]
    if is_flat:
        middle = below[0].middle[1]
        panels[low[0]] = below[0]._replace(bottom=middle - BELOW / 2)
        panels[low[1]] = below[0]._replace(top=middle + BELOW / 2)
    else:
        panels[second] = below[0]
    places = [below[2], panel_at(2, 0, further), panel_at(2, 1, further)]
    panels |= dict(zip(more, places, strict=False))
    for view, panel in panels.items():
        if view is not None:
            draw_slice(canvas, panel, content, view, ranges, window)
    last = below[1] if more else below[2]
    energies = below[1]._replace(right=last.right - 24, bottom=below[1].top + LOW)
    draw_energies(canvas, energies, content.history, content.steps_left_out)
    write_window(canvas, window, content.geometry)
    return canvas.png()


def _is_low(view: SliceView, ranges: Ranges, geometry: Geometry) -> bool:
    """Return True if the slice is less than half as high as wide."""
    up, (vertical, horizontal) = DisplayOrientation.of(geometry), IN_PLANE[view.plane]
    tall, wide = (
        (ranges[axis][1] - ranges[axis][0]) * up.spacing[axis] for axis in (vertical, horizontal)
    )
    return tall < 0.5 * wide


def panel_at(row: int, column: int, further: float = 0) -> Box:
    """Return the box of a panel; those below the first row are ``further`` down."""
    width = (WIDTH - LEFT - RIGHT - 2 * GAP) / 3
    left, top = LEFT + column * (width + GAP), TOP + row * (PANEL + BELOW) + further
    return Box(left, top, left + width, top + PANEL)


def content_window(content: PreviewContent, ranges: Ranges) -> GreyWindow:
    """The window that was asked for, else one for the part of the image that is shown."""
    if content.window is not None:
        return content.window
    part = box_of(ranges, content.geometry)
    inside = content.inside()[part]
    return window_of(content.image[part], inside) if inside.any() else window_of(content.image)


def write_window(canvas: Canvas, window: GreyWindow, geometry: Geometry) -> None:
    """Write the grey window in the lower right corner, and in the left one how places on the scales are typed."""
    canvas.text((10, canvas.height - 8), typed_note(geometry), 11, anchor="ld")
    canvas.text((canvas.width - 10, canvas.height - 8), f"window {window.text}", 11, PALE, "rd")


def _png_2d(content: PreviewContent, axis: int) -> bytes:
    """Draw a run on an image of one slice; the picture is as wide and high as suits the image."""
    order = DisplayOrientation.of(content.geometry).order
    plane = order.index(axis)
    ranges = shown_ranges(content)
    tall, wide = (_length(content.geometry, order[i]) for i in IN_PLANE[plane])
    pixels = min(748 / wide, 748 / tall)  # per mm
    left = max(wide * pixels, 340)
    high = max(tall * pixels, 320)
    right = 340
    # As wide as its title, so that none is cut off.
    width = max(LEFT + left + GAP + 20 + right + 90, text_width(content.title, HEADING_SIZE) + 40)
    canvas = Canvas(width, TOP + high + BELOW, content.title)
    window = content_window(content, ranges)
    view = SliceView(plane, 0)
    draw_slice(canvas, Box(LEFT, TOP, LEFT + left, TOP + high), content, view, ranges, window)
    first, middle = LEFT + left + GAP + 20, TOP + high / 2
    half = 0.5 * LOW
    panel = Box(first, middle - half, first + right, middle + half)
    draw_energies(canvas, panel, content.history, content.steps_left_out)
    write_window(canvas, window, content.geometry)
    return canvas.png()


def _length(geometry: Geometry, axis: int) -> float:
    return geometry.shape[axis] * geometry.spacing[axis]


def draw_energies(
    canvas: Canvas, panel: Box, history: Sequence[StepRecord], left_out: int = 0
) -> None:
    """Draw the energy of a run and, on a second scale, its kinetic energy; triangles mark restarts.

    A line below says how many steps of corrections are ``left_out``: their energy is that of a part of the image, and
    does not compare.
    """
    steps, values = energy_curve(history)
    first = min(steps, default=0)
    axes = canvas.axes(panel, (first, max([*steps, first + 1])), range_of(values))
    kinetic = [row.kinetic for row in history]
    notes = [f"step (without the {left_out} of corrections)" if left_out else "step"]
    if not any(kinetic):
        notes.append("no kinetic energy: the flow has no momentum")
    write_title(axes, "Energy and kinetic energy")
    write_scales(axes, "\n".join(notes), "energy", grid=True, color=BLUE)
    axes.plot(steps, values, color=BLUE, linestyle="-", linewidth=2.5)
    if any(kinetic):
        second = axes.twinx()
        second.set(xlim=axes.get_xlim(), ylim=(0.0, 1.05 * max(kinetic)), frame_on=False)
        second.plot(
            [row.step for row in history], kinetic, color=VERMILION, linestyle=DASHED, linewidth=2
        )
        second.grid(False)
        write_scales(second, "", "kinetic energy (dashed)", color=VERMILION, right=True)
        second.xaxis.set_visible(False)
    restarts = [row.step for row in history if row.restarted]
    if restarts:
        (marks,) = axes.plot(
            restarts,
            [0.015] * len(restarts),
            transform=axes.get_xaxis_transform(),
            marker="^",
            markersize=9,
            markerfacecolor=INK,
            markeredgecolor="none",
            linestyle="none",
        )
        write_legend(axes, [marks], ["restart (momentum set to zero)"], "upper right")


def energy_curve(history: Sequence[StepRecord]) -> tuple[list[int], list[float]]:
    """Return steps and potentials, with a gap where the grid changes: each level has its own image and energies."""
    steps: list[int] = []
    values: list[float] = []
    for place, row in enumerate(history):
        if place and row.level != history[place - 1].level:
            steps.append(row.step)
            values.append(float("nan"))
        steps.append(row.step)
        values.append(row.potential)
    return steps, values
