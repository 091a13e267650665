"""Slices through the image with contours and clicks, as radiologists hang them.

Slices are reoriented to the nearest anatomical axes: the patient's left at the right, front at the top (axial) or head
at the top (coronal, sagittal). Their axes are mm: world coordinates where the grid is parallel to the world, so that a
click can be read off the picture, otherwise mm along the grid from its first voxel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.clicks import NO_OBJECT
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow
from accelsurf.grid.orientation import IN_PLANE, LETTERS, DisplayOrientation
from accelsurf.report.axes import Axes, round_step
from accelsurf.report.canvas import (
    DARK,
    GREEN,
    REFERENCE,
    SOLID,
    VERMILION,
    YELLOW,
    Box,
    Canvas,
    Dashes,
    fitting,
    text_width,
)
from accelsurf.report.preview_content import ClickMark, PreviewContent
from accelsurf.report.slice_views import Ranges, SliceView, displayed, fitted, plane_name
from accelsurf.settings.wording import in_unit

#: The inset takes this part of the slice's width or height, whichever is less.
INSET = 0.27
#: There is no inset when the slice shows so much of the image.
NEARLY_ALL = 0.6
#: Shorter sides than these have no room for an inset, and for a scale bar and letters, pixels.
MIN_FOR_INSET, MIN_FOR_BAR = 150, 90
#: An object whose section is less deep than this has no room for its id, pixels.
MIN_FOR_ID = 7
#: Width of a name at most, pixels.
MAX_NAME = 110
#: Length of the arms of a click's mark, and of its distance from a name, pixels.
ARM, AWAY = 7, 24
REFERENCE_DASHES: Dashes = (3, 3)
START_DASHES: Dashes = (8, 4)


@dataclass(frozen=True, eq=False)
class Slice:
    """One slice in its frame: what contours and marks are drawn through.

    Attributes
    ----------
    axes : Axes
        In mm along the displayed axes.
    view : SliceView
    ranges : tuple of (int, int)
        Voxels that are shown, along the displayed axes.
    up : DisplayOrientation
    geometry : Geometry
    """

    axes: Axes
    view: SliceView
    ranges: Ranges
    up: DisplayOrientation
    geometry: Geometry

    def section(self, array: NDArray[Any], whole: bool = False) -> NDArray[Any]:
        """The shown part of an array's slice, or the whole slice, (rows, columns)."""
        parts: list[slice | int] = [slice(None) if whole else slice(*pair) for pair in self.ranges]
        parts[self.view.plane] = self.view.index
        return np.asarray(self.up.reorient(array)[tuple(parts)])

    def to_canvas(self, rows: Any, columns: Any) -> NDArray[np.float64]:
        """Pixels (n, 2) of (continuous) voxels of the whole slice."""
        vertical, horizontal = IN_PLANE[self.view.plane]
        x = self.up.first[horizontal] + np.asarray(columns, float) * self.up.spacing[horizontal]
        y = self.up.first[vertical] + np.asarray(rows, float) * self.up.spacing[vertical]
        return self.axes.to_canvas(np.stack([np.atleast_1d(x), np.atleast_1d(y)], axis=1))


def open_slice(
    canvas: Canvas,
    panel: Box,
    image: NDArray[Any],
    geometry: Geometry,
    view: SliceView,
    ranges: Ranges,
    window: GreyWindow,
    anatomical: bool,
) -> Slice:
    """Draw the image of one slice with its frame into a panel, as large as fits; the panel's margins stay free."""
    shown = lay_slice(canvas, panel, image, geometry, view, ranges, window)
    up, (vertical, horizontal) = shown.up, IN_PLANE[view.plane]
    where = f"{up.names[view.plane]} = {up.coordinate(view.plane, view.index):.4g} mm"
    shown.axes.title(", ".join(word for word in (view.why, plane_name(view.plane, anatomical), where) if word))
    shown.axes.frame(f"{up.names[horizontal]} (mm)", f"{up.names[vertical]} (mm)")
    return shown


def lay_slice(
    canvas: Canvas,
    panel: Box,
    image: NDArray[Any],
    geometry: Geometry,
    view: SliceView,
    ranges: Ranges,
    window: GreyWindow,
) -> Slice:
    """Draw the image of one slice into a panel, as large as fits, without frame and title."""
    left, top, right, bottom = panel
    ranges = fitted(ranges, view.plane, geometry, (right - left) / (bottom - top))
    up, (vertical, horizontal) = DisplayOrientation.of(geometry), IN_PLANE[view.plane]
    x, y = (
        tuple(up.coordinate(axis, ranges[axis][end] - 0.5) for end in (0, 1)) for axis in (horizontal, vertical)
    )
    wide, tall = x[1] - x[0], y[1] - y[0]
    scale = min((right - left) / wide, (bottom - top) / tall)
    half = 0.5 * scale * wide, 0.5 * scale * tall
    middle = 0.5 * (left + right), 0.5 * (top + bottom)
    box = middle[0] - half[0], middle[1] - half[1], middle[0] + half[0], middle[1] + half[1]
    # Front at the top (y runs down) in the axial slice; head at the top (z runs up) in the other two.
    axes = Axes(canvas, box, (x[0], x[1]), (y[1], y[0]) if view.plane == 0 else (y[0], y[1]))
    shown = Slice(axes, view, ranges, up, geometry)
    grey = window.grey(shown.section(image))
    canvas.image(grey if view.plane == 0 else grey[::-1], box, smooth=True)
    return shown


def draw_slice(
    canvas: Canvas, panel: Box, content: PreviewContent, view: SliceView, ranges: Ranges, window: GreyWindow
) -> Slice:
    """Draw a slice of a result with contours, clicks, an inset of the whole slice, letters and a scale bar."""
    shown = open_slice(
        canvas, panel, content.image, content.geometry, view, ranges, window, content.anatomical
    )
    named = _draw_contours(shown, content)
    for mark in content.clicks:
        draw_click(shown, mark, {one.id: content.color(place) for place, one in enumerate(content.objects)})
    if content.late_growth is not None:
        _draw_late_growth(shown, content.late_growth)
    for place in content.next_clicks:
        _draw_next_click(shown, place)
    draw_inset(shown, content.image, window)
    if content.anatomical:
        write_letters(shown)
    draw_scale_bar(shown, content.unit)
    write_legend(shown, named)
    return shown


def _draw_contours(shown: Slice, content: PreviewContent) -> list[tuple[str, str, Dashes]]:
    """Draw the contours of result, reference and start; returns name, colour and dashes of those that need a legend."""
    lines: list[tuple[str, str, Dashes]] = []
    if not content.objects:
        draw_contour(shown, shown.section(content.psi), content.color())
        lines.append((content.name() or "result", content.color(), SOLID))
    else:
        _draw_objects(shown, content)
    if content.reference is not None:
        draw_contour(shown, np.where(shown.section(content.reference) > 0, -0.5, 0.5), REFERENCE, REFERENCE_DASHES)
        lines.append(("reference", REFERENCE, REFERENCE_DASHES))
    if content.start is not None:
        draw_contour(shown, shown.section(content.start), GREEN, START_DASHES)
        lines.append(("start", GREEN, START_DASHES))
    return lines if len(lines) > 1 or (content.objects and lines) else []


def _draw_objects(shown: Slice, content: PreviewContent) -> None:
    """Draw the contour of each of several objects in its colour, with its name or id in the middle of the section."""
    far = max(float(np.abs(one.psi).max()) for one in content.objects)
    plane = shown.up.order[shown.view.plane]
    n = content.geometry.shape[plane]
    index = n - 1 - shown.view.index if shown.up.flips[shown.view.plane] else shown.view.index
    for position, one in enumerate(content.objects):
        if not one.box[plane].start <= index < one.box[plane].stop:
            continue
        whole = np.full(content.geometry.shape, far, np.float32)
        whole[one.box] = one.psi
        section = shown.section(whole)
        color = content.color(position)
        draw_contour(shown, section, color)
        marks = [at for mark in content.clicks if (at := _mark_in(shown, mark)) is not None]
        name = fitting(content.name(position) or str(one.id), 12, MAX_NAME)
        name_section(shown, section < 0, name, color, marks)


def name_section(
    shown: Slice, inside: NDArray[np.bool_], name: str, color: str, marks: Sequence[tuple[float, float]] = ()
) -> None:
    """Write a name or an id at the deepest place of a section that is away from marks, which it would cover."""
    if not inside.any():
        return
    from scipy import ndimage  # a picture without sections does without SciPy

    depth = ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
    vertical, horizontal = IN_PLANE[shown.view.plane]
    left, _, right, _ = shown.axes.box
    depth *= (right - left) / (shown.ranges[horizontal][1] - shown.ranges[horizontal][0])  # pixels
    rows, columns = np.nonzero(depth > MIN_FOR_ID)
    if not rows.size:
        return
    places = shown.to_canvas(rows + shown.ranges[vertical][0], columns + shown.ranges[horizontal][0])
    free = np.ones(len(places), bool)
    for mark in marks:
        free &= np.hypot(*(places - mark).T) > AWAY
    depths = np.where(free, depth[rows, columns], -1.0) if free.any() else depth[rows, columns]
    x, y = places[int(np.argmax(depths))]
    # In a section without such a place it is written beside it.
    shown.axes.canvas.boxed_text((x if free.any() else x + AWAY, y), name, 12, "black", color, 0.85)


def draw_contour(
    shown: Slice, psi: NDArray[Any], color: str, dashes: Dashes = SOLID, width: float = 2.0
) -> None:
    """Draw the zero level of a slice of psi, dark below and coloured above, so that it shows on any grey."""
    if min(psi.shape) < 2 or not (psi < 0).any() or not (psi > 0).any():
        return
    from skimage.measure import find_contours

    vertical, horizontal = IN_PLANE[shown.view.plane]
    lines = [
        shown.to_canvas(line[:, 0] + shown.ranges[vertical][0], line[:, 1] + shown.ranges[horizontal][0])
        for line in find_contours(np.asarray(psi, float), 0.0)
    ]
    for line in lines:
        shown.axes.canvas.line(line, DARK, width + 1.5)
    for line in lines:
        shown.axes.canvas.line(line, color, width, dashes)


# ------------------------------------------------------------------------------------------------------------- marks


def click_color(mark: ClickMark, colors: Mapping[int, str]) -> str:
    """Colour of a click: outside red; inside that of its object where there are several, else green."""
    if mark.side == "outside" or mark.id == NO_OBJECT:
        return VERMILION
    return colors.get(mark.id, GREEN)


def _mark_in(shown: Slice, mark: ClickMark) -> tuple[float, float] | None:
    """Where the mark of a click is drawn in a slice; None where its voxels do not reach it."""
    low = displayed(tuple(part.start for part in mark.box), shown.geometry)[shown.view.plane]
    high = displayed(tuple(part.stop - 1 for part in mark.box), shown.geometry)[shown.view.plane]
    if not min(low, high) <= shown.view.index <= max(low, high):
        return None
    at = displayed(mark.place, shown.geometry)
    row, column = (at[axis] for axis in IN_PLANE[shown.view.plane])
    ((x, y),) = shown.to_canvas(row, column)
    return x, y


def draw_click(shown: Slice, mark: ClickMark, colors: Mapping[int, str]) -> None:
    """Draw a click where it cuts the slice: the outline of its voxels, and + for inside, x for outside."""
    at = _mark_in(shown, mark)
    if at is None:
        return
    (x, y), color = at, click_color(mark, colors)
    whole = np.zeros(shown.geometry.shape, bool)
    whole[mark.box] = mark.mask
    section = shown.section(whole)
    if not section.any():
        return
    draw_contour(shown, np.where(section, -0.5, 0.5), color, width=1.0)
    turn = 0.0 if mark.side == "inside" else np.pi / 4
    for line_color, width in ((DARK, 5.0), (color, 2.5)):
        for angle in (turn, turn + np.pi / 2):
            arm = ARM * np.array([np.cos(angle), np.sin(angle)])
            shown.axes.canvas.line([(x - arm[0], y - arm[1]), (x + arm[0], y + arm[1])], line_color, width)


def _draw_late_growth(shown: Slice, place: tuple[float, float, float]) -> None:
    """Draw a ring around the place of the fastest late growth where the slice goes through it."""
    at = displayed(place, shown.geometry)
    if round(at[shown.view.plane]) != shown.view.index or not shown.view.why:
        return
    row, column = (at[axis] for axis in IN_PLANE[shown.view.plane])
    ((x, y),) = shown.to_canvas(row, column)
    turn = np.linspace(0, 2 * np.pi, 49)
    ring = np.stack([x + 15 * np.cos(turn), y + 15 * np.sin(turn)], axis=1)
    for color, width in ((DARK, 4.0), (YELLOW, 2.0)):
        shown.axes.canvas.line(ring, color, width)


def _draw_next_click(shown: Slice, place: tuple[float, float, float]) -> None:
    """Draw an open diamond with a caption where to click next, where the slice goes through it."""
    at = displayed(place, shown.geometry)
    if round(at[shown.view.plane]) != shown.view.index:
        return
    row, column = (at[axis] for axis in IN_PLANE[shown.view.plane])
    ((x, y),) = shown.to_canvas(row, column)
    diamond = np.array([[x + ARM, y], [x, y + ARM], [x - ARM, y], [x, y - ARM], [x + ARM, y]])
    for color, width in ((DARK, 4.5), (YELLOW, 2.0)):
        shown.axes.canvas.line(diamond, color, width)
    left, _, right, _ = shown.axes.box
    half = 0.5 * text_width("click next?", 11) + 4
    middle = min(max(x, left + half), right - half)
    shown.axes.canvas.boxed_text((middle, y + ARM + 11), "click next?", 11)


def draw_inset(shown: Slice, image: NDArray[Any], window: GreyWindow) -> None:
    """Draw the whole slice small in the upper right corner, with a frame around the part that is shown."""
    vertical, horizontal = IN_PLANE[shown.view.plane]
    canvas, (left, top, right, bottom) = shown.axes.canvas, shown.axes.box
    whole = shown.section(image, whole=True)
    rows, columns = shown.ranges[vertical], shown.ranges[horizontal]
    if (rows[1] - rows[0]) * (columns[1] - columns[0]) > NEARLY_ALL * whole.size or (
        min(right - left, bottom - top) < MIN_FOR_INSET
    ):
        return
    tall, wide = whole.shape[0] * shown.up.spacing[vertical], whole.shape[1] * shown.up.spacing[horizontal]
    scale = INSET * min((right - left) / wide, (bottom - top) / tall)
    box = right - scale * wide - 3, top + 3, right - 3, top + 3 + scale * tall
    skip = max(1, min(whole.shape) // 256)
    grey = window.grey(whole[::skip, ::skip])
    down = shown.view.plane == 0
    canvas.image(grey if down else grey[::-1], box, smooth=True)
    canvas.rectangle(box, outline="white")
    mm = shown.up.spacing[vertical], shown.up.spacing[horizontal]
    across = [box[0] + scale * mm[1] * end for end in columns]
    along = [scale * mm[0] * end for end in rows]
    ends = [box[1] + end for end in along] if down else [box[3] - end for end in reversed(along)]
    canvas.rectangle((across[0], ends[0], across[1], ends[1]), outline=YELLOW, width=1.5)


def draw_scale_bar(shown: Slice, unit: str = "mm") -> None:
    """Draw a bar of a round length in a unit, about a fifth of the slice, in its lower right corner."""
    canvas, (left, _, right, bottom) = shown.axes.canvas, shown.axes.box
    if bottom - shown.axes.box[1] < MIN_FOR_BAR:
        return  # its scales are there
    wide = in_unit(shown.axes.x[1] - shown.axes.x[0], unit)
    length = round_step(0.25 * wide)
    pixels = length / wide * (right - left)
    text = f"{length:g} {unit}"
    half = 0.5 * max(pixels, text_width(text, 11, bold=True)) + 4
    middle = right - half - 4
    canvas.shade((middle - half, bottom - 27, middle + half, bottom - 4), "black", 0.55)
    canvas.line([(middle - pixels / 2, bottom - 9), (middle + pixels / 2, bottom - 9)], "white", 2.5)
    canvas.text((middle, bottom - 13), text, 11, "white", "md", bold=True)


def write_letters(shown: Slice) -> None:
    """Write the patient's directions at the edges of a slice."""
    vertical, horizontal = IN_PLANE[shown.view.plane]
    first, last = LETTERS[2 - horizontal]
    low, high = LETTERS[2 - vertical]
    upper, lower = (low, high) if shown.view.plane == 0 else (high, low)
    left, top, right, bottom = shown.axes.box
    middle = 0.5 * (left + right), 0.5 * (top + bottom)
    places = [((left + 12, middle[1]), first), ((right - 12, middle[1]), last)]
    if bottom - top < MIN_FOR_BAR:  # a few thick slices: beside them
        places = [((left - 42, bottom), lower), ((left - 42, top), upper), *places]
    else:
        places += [((middle[0], top + 12), upper), ((middle[0], bottom - 12), lower)]
    for at, letter in places:
        shown.axes.canvas.boxed_text(at, letter, 13)


def write_legend(shown: Slice, lines: list[tuple[str, str, Dashes]]) -> None:
    """Write what each line is, in the lower left corner."""
    if not lines:
        return
    canvas, (left, _, _, bottom) = shown.axes.canvas, shown.axes.box
    wide = 44 + max(text_width(name, 11) for name, _, _ in lines)
    top = bottom - 6 - 16 * len(lines)
    canvas.shade((left + 4, top - 3, left + 4 + wide, bottom - 4), "white", 0.8)
    for number, (name, color, dashes) in enumerate(lines):
        y = top + 16 * number + 7
        canvas.line([(left + 9, y), (left + 36, y)], color, 2.5, dashes)
        canvas.text((left + 42, y), name, 11, anchor="lm")
