"""Slices through the image with contours and clicks, as radiologists hang them.

Slices are reoriented to the nearest anatomical axes: the patient's left at the right, front at the top (axial) or head
at the top (coronal, sagittal). Their axes are mm: world coordinates where the grid is parallel to the world, so that a
click can be read off the picture, otherwise mm along the grid from its first voxel, which are typed with ``grid``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from accelsurf.grid.boxes import as_corner, corner_of
from accelsurf.grid.clicks import NO_OBJECT
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, LETTERS, DisplayOrientation
from accelsurf.image.grey_window import GreyWindow
from accelsurf.output.pictures.canvas import (
    DARK,
    GREEN,
    LABEL_SIZE,
    SOLID,
    TICK_SIZE,
    VERMILION,
    YELLOW,
    Box,
    Canvas,
    Dashes,
    draw_scale_bar,
    drawable,
    fitting,
    font,
    text_width,
    write_legend,
    write_lengths,
    write_title,
)
from accelsurf.output.pictures.preview_content import ClickMark, PreviewContent
from accelsurf.output.pictures.slice_views import Ranges, SliceView, displayed, fitted, plane_name
from accelsurf.settings.wording import in_unit
from accelsurf.text.coordinates import digits_of, suffix_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patheffects import AbstractPathEffect

#: A shorter side than this has no room for a scale bar and letters, pixels.
MIN_FOR_BAR = 90
#: An object whose section is less deep than this has no room for its id, pixels.
MIN_FOR_ID = 7
#: Width of a name at most, pixels.
MAX_NAME = 110
#: Width of a click's mark, and its distance from a name, pixels.
MARK = 14
AWAY = 24
#: A slice with more voxels along a side is drawn smaller: nobody sees them all.
MAX_VOXELS = 1024
REFERENCE_DASHES: Dashes = (0, (1.5, 1.5))
START_DASHES: Dashes = (0, (4, 2))
#: A side shorter than this has no room for a label along it, pixels.
MIN_FOR_LABEL = 60


class ShownImage(NamedTuple):
    """An image as it is shown: voxels (nz, ny, nx), grid, grey window, whether its axes are a patient's, its unit."""

    array: NDArray[Any]
    geometry: Geometry
    window: GreyWindow
    anatomical: bool = False
    unit: str = "mm"


class NamedLine(NamedTuple):
    """A line in a legend."""

    name: str
    color: str
    dashes: Dashes = SOLID


@dataclass(frozen=True, eq=False)
class Slice:
    """One slice in its frame: contours and marks are drawn through it.

    Attributes
    ----------
    axes : matplotlib.axes.Axes
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

    def section(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the shown part of an array's slice, (rows, columns)."""
        parts: list[slice | int] = [slice(*pair) for pair in self.ranges]
        parts[self.view.plane] = self.view.index
        return np.asarray(self.up.reorient(array)[tuple(parts)])

    def place(self, voxel: Sequence[float]) -> tuple[float, float]:
        """Return where a (continuous) voxel (z, y, x) of the image lies in the slice, (right, up) in mm."""
        at = displayed((voxel[0], voxel[1], voxel[2]), self.geometry)
        vertical, horizontal = IN_PLANE[self.view.plane]
        return self.up.coordinate(horizontal, at[horizontal]), self.up.coordinate(
            vertical, at[vertical]
        )

    def coordinates(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places of the shown columns and rows, mm."""
        y, x = (
            np.array([self.up.coordinate(axis, index) for index in range(*self.ranges[axis])])
            for axis in IN_PLANE[self.view.plane]
        )
        return x, y

    def pixels(self, x: Any, y: Any) -> NDArray[np.float64]:
        """Return places in mm as pixels of the picture, (n, 2)."""
        return np.asarray(
            self.axes.transData.transform(np.stack([np.atleast_1d(x), np.atleast_1d(y)], axis=1))
        )

    def goes_through(self, voxel: Sequence[float]) -> bool:
        """Test if a (continuous) voxel (z, y, x) of the image lies in the slice."""
        at = displayed((voxel[0], voxel[1], voxel[2]), self.geometry)
        return round(at[self.view.plane]) == self.view.index


def open_slice(
    canvas: Canvas, panel: Box, image: ShownImage, view: SliceView, ranges: Ranges
) -> Slice:
    """Draw the image of one slice with its frame into a panel, as large as fits; the panel's margins stay free."""
    shown = lay_slice(canvas, panel, image, view, ranges)
    up, (vertical, horizontal) = shown.up, IN_PLANE[view.plane]
    place = f"{plane_name(view.plane, image.anatomical)}, {across_text(shown, image.unit)}"
    write_title(shown.axes, f"{place}: {view.why}" if view.why else place)
    tall = shown.axes.bbox.height > MIN_FOR_LABEL
    write_lengths(shown.axes, up.names[horizontal], up.names[vertical] if tall else "", image.unit)
    return shown


def across_text(shown: Slice, unit: str) -> str:
    """Return the place of a slice on the scale across it, to a part of a voxel."""
    plane = shown.view.plane
    digits = digits_of([in_unit(step, unit) for step in shown.geometry.spacing])
    at = in_unit(shown.up.coordinate(plane, shown.view.index), unit)
    return f"{shown.up.names[plane]} = {round(at, digits) + 0.0:.12g} {unit}"


def typed_note(geometry: Geometry) -> str:
    """Say how a place that is read off the scales is typed, where these are not mm in the world; else nothing.

    Examples
    --------
    >>> typed_note(Geometry((9, 9, 9), (1e-3, 1e-3, 1e-3), unit="um"))
    'places on these scales end in um: X,Y,Zum'
    """
    suffix = suffix_of(geometry)
    return f"places on these scales end in {suffix}: X,Y,Z{suffix}" if suffix else ""


def lay_slice(
    canvas: Canvas, panel: Box, image: ShownImage, view: SliceView, ranges: Ranges
) -> Slice:
    """Draw the image of one slice into a panel, as large as fits, without frame and title."""
    geometry = image.geometry
    ranges = fitted(ranges, view.plane, geometry, panel.width / panel.height)
    up, (vertical, horizontal) = DisplayOrientation.of(geometry), IN_PLANE[view.plane]
    x, y = (
        tuple(up.coordinate(axis, ranges[axis][end] - 0.5) for end in (0, 1))
        for axis in (horizontal, vertical)
    )
    wide, tall = x[1] - x[0], y[1] - y[0]
    scale = min(panel.width / wide, panel.height / tall)
    half, (right, down) = (0.5 * scale * wide, 0.5 * scale * tall), panel.middle
    box = Box(right - half[0], down - half[1], right + half[0], down + half[1])
    # Front at the top (y runs down) in the axial slice; head at the top (z runs up) in the other two.
    axes = canvas.axes(box, x, y[::-1] if view.plane == 0 else y)
    shown = Slice(axes, view, ranges, up, geometry)
    _draw_image(axes, image.window.grey(shown.section(image.array)), (*x, *y))
    return shown


def _draw_image(axes: Axes, grey: NDArray[np.uint8], extent: tuple[float, ...]) -> None:
    """Draw grey values (rows, columns) over ``extent`` (first and last column's edge, row's edge), mm."""
    fewer = max(1, grey.shape[1] // MAX_VOXELS), max(1, grey.shape[0] // MAX_VOXELS)
    pixels = np.asarray(Image.fromarray(np.ascontiguousarray(grey)).reduce(fewer))
    axes.imshow(
        pixels,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=extent,  # type: ignore[arg-type]
        origin="lower",
        aspect="auto",
        interpolation="catrom",
        resample=True,
    )


def draw_slice(
    canvas: Canvas,
    panel: Box,
    content: PreviewContent,
    view: SliceView,
    ranges: Ranges,
    window: GreyWindow,
) -> Slice:
    """Draw a slice of a result with contours, clicks, letters and a scale bar."""
    image = ShownImage(content.image, content.geometry, window, content.anatomical, content.unit)
    shown = open_slice(canvas, panel, image, view, ranges)
    contours = _draw_contours(shown, content)
    colors = {shape.id: content.color(place) for place, shape in enumerate(content.objects)}
    for mark in content.clicks:
        draw_click(shown, mark, colors)
    if content.late_growth is not None and view.why and shown.goes_through(content.late_growth):
        _draw_mark(shown, content.late_growth, "o", YELLOW, 2, 30)
    for place in content.next_clicks:
        _draw_next_click(shown, place)
    if content.anatomical:
        write_letters(shown)
    draw_slice_scale(shown, content.unit)
    write_line_names(shown, contours)
    return shown


def _draw_contours(shown: Slice, content: PreviewContent) -> list[NamedLine]:
    """Draw the contours of result and start; returns those that need a legend."""
    lines: list[NamedLine] = []
    if content.start is not None:  # below the result, which may lie on it
        draw_contour(shown, shown.section(content.start), GREEN, START_DASHES)
        lines.append(NamedLine("start", GREEN, START_DASHES))
    if not content.objects:
        draw_contour(shown, shown.section(content.psi), content.color())
        lines.append(NamedLine(content.name() or "result", content.color()))
    else:
        _draw_objects(shown, content)
    return lines if len(lines) > 1 or (content.objects and lines) else []


def _draw_objects(shown: Slice, content: PreviewContent) -> None:
    """Draw the contour of each of several objects in its colour, with its name or id in the middle of the section."""
    far = max(float(np.abs(shape.psi).max()) for shape in content.objects)
    plane = shown.up.order[shown.view.plane]
    n = content.geometry.shape[plane]
    index = n - 1 - shown.view.index if shown.up.flips[shown.view.plane] else shown.view.index
    marks = [shown.place(mark.place) for mark in content.clicks if _reaches(shown, mark)]
    for position, shape in enumerate(content.objects):
        if not shape.box[plane].start <= index < shape.box[plane].stop:
            continue
        whole = np.full(content.geometry.shape, far, np.float32)
        whole[shape.box] = shape.psi
        section = shown.section(whole)
        color = content.color(position)
        draw_contour(shown, section, color)
        name = fitting(content.name(position) or str(shape.id), LABEL_SIZE, MAX_NAME)
        name_section(shown, section < 0, name, color, marks)


def name_section(
    shown: Slice,
    inside: NDArray[np.bool_],
    name: str,
    color: str,
    marks: Sequence[tuple[float, float]] = (),
) -> None:
    """Write a name or an id at the deepest place of a section that is away from marks (mm), which it would cover."""
    if not inside.any():
        return
    from scipy import ndimage  # a picture without sections does without SciPy

    x, y = shown.coordinates()
    depth = ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
    depth *= shown.axes.bbox.width / len(x)  # pixels
    rows, columns = np.nonzero(depth > MIN_FOR_ID)
    if not rows.size:
        return
    places = shown.pixels(x[columns], y[rows])
    free = np.ones(len(places), bool)
    for mark in marks:
        free &= np.hypot(*(places - shown.pixels(*mark)).T) > AWAY
    depths = np.where(free, depth[rows, columns], -1.0) if free.any() else depth[rows, columns]
    best = int(np.argmax(depths))
    # In a section without a free place the name is written beside it.
    shown.axes.annotate(
        drawable(name),
        (x[columns[best]], y[rows[best]]),
        (0 if free.any() else AWAY, 0),
        textcoords="offset points",
        ha="center",
        va="center",
        color="black",
        **font(LABEL_SIZE, bold=True),
        bbox={"boxstyle": "square,pad=0.2", "facecolor": color, "alpha": 0.85, "edgecolor": "none"},
    )


def draw_contour(
    shown: Slice, psi: NDArray[Any], color: str, dashes: Dashes = SOLID, width: float = 2.0
) -> None:
    """Draw the zero level of a slice of psi, dark below and coloured above, so that it shows on any grey."""
    if min(psi.shape) < 2 or not (psi < 0).any() or not (psi > 0).any():
        return
    shown.axes.contour(
        *shown.coordinates(),
        psi,
        [0.0],
        colors=[color],
        linewidths=[width],
        linestyles=[dashes],
        algorithm="serial",
        corner_mask=False,
        antialiased=True,
        zorder=2,
    ).set_path_effects(_rim(width + 1.5))


# ------------------------------------------------------------------------------------------------------------- marks


def click_color(mark: ClickMark, colors: Mapping[int, str]) -> str:
    """Return the colour of a click: outside red; inside that of its object where there are several, else green."""
    if mark.side == "outside" or mark.id == NO_OBJECT:
        return VERMILION
    return colors.get(mark.id, GREEN)


def _reaches(shown: Slice, mark: ClickMark) -> bool:
    """Test if the box of a click's voxels reaches a slice."""
    first = corner_of(mark.box)
    last = as_corner(part.stop - 1 for part in mark.box)
    ends = [displayed(corner, shown.geometry)[shown.view.plane] for corner in (first, last)]
    return min(ends) <= shown.view.index <= max(ends)


def draw_click(shown: Slice, mark: ClickMark, colors: Mapping[int, str]) -> None:
    """Draw a click where it cuts the slice: the outline of its voxels, and + for inside, x for outside."""
    if not _reaches(shown, mark):
        return
    whole = np.zeros(shown.geometry.shape, bool)
    whole[mark.box] = mark.mask
    section = shown.section(whole)
    if not section.any():
        return
    color = click_color(mark, colors)
    draw_contour(shown, np.where(section, -0.5, 0.5), color, width=1.0)
    sign, size = ("+", MARK) if mark.side == "inside" else ("x", MARK / np.sqrt(2))
    _draw_mark(shown, mark.place, sign, color, 2.5, size)


def _draw_mark(
    shown: Slice, voxel: Sequence[float], sign: str, color: str, width: float, size: float
) -> None:
    """Draw an open sign at a voxel (z, y, x) of the image, coloured on dark."""
    shown.axes.plot(
        *([at] for at in shown.place(voxel)),
        marker=sign,
        markersize=size,
        markeredgewidth=width,
        markeredgecolor=color,
        markerfacecolor="none",
        linestyle="none",
        zorder=3,
        clip_on=False,
        path_effects=_rim(width + 2.5),
    )


def _draw_next_click(shown: Slice, place: tuple[float, float, float]) -> None:
    """Draw an open diamond with a caption where to click next, where the slice goes through it."""
    if not shown.goes_through(place):
        return
    _draw_mark(shown, place, "D", YELLOW, 2, MARK / np.sqrt(2))
    ((x, _),), box = shown.pixels(*shown.place(place)), shown.axes.bbox
    half = 0.5 * text_width("click next?", TICK_SIZE, bold=True) + 4
    aside = min(max(x, box.x0 + half), box.x1 - half) - x
    _write(shown.axes, "click next?", shown.place(place), (aside, -MARK - 4), "data")


def draw_slice_scale(shown: Slice, unit: str = "mm") -> None:
    """Draw a scale bar into a slice, unless it is so low that its scales must do."""
    if shown.axes.bbox.height >= MIN_FOR_BAR:
        draw_scale_bar(shown.axes, unit, "white", _rim(5))


def write_letters(shown: Slice) -> None:
    """Write the patient's directions at the edges of a slice."""
    vertical, horizontal = IN_PLANE[shown.view.plane]
    first, last = LETTERS[2 - horizontal]
    low, high = LETTERS[2 - vertical]
    upper, lower = (low, high) if shown.view.plane == 0 else (high, low)
    places = [((0.0, 0.5), (12, 0), first), ((1.0, 0.5), (-12, 0), last)]
    if shown.axes.bbox.height < MIN_FOR_BAR:  # a few thick slices: beside them
        places += [((0.0, 0.0), (-42, 0), lower), ((0.0, 1.0), (-42, 0), upper)]
    else:
        places += [((0.5, 1.0), (0, -12), upper), ((0.5, 0.0), (0, 12), lower)]
    for at, aside, letter in places:
        _write(shown.axes, letter, at, aside, "axes fraction", 13)


def _write(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    aside: tuple[float, float],
    place: str,
    size: int = TICK_SIZE,
) -> None:
    """Write bold white letters on a dark ground, readable on any grey, pixels ``aside`` (right, up) of a place."""
    axes.annotate(
        text,
        at,
        aside,
        xycoords=place,
        textcoords="offset points",
        ha="center",
        va="center",
        color="white",
        zorder=4,
        **font(size, bold=True),
        bbox={
            "boxstyle": "square,pad=0.2",
            "facecolor": "black",
            "alpha": 0.55,
            "edgecolor": "none",
        },
    )


def _rim(width: float) -> list[AbstractPathEffect]:
    """Return the effects that draw a dark line, never dashed, below a line or letters."""
    from matplotlib.patheffects import Normal, Stroke

    solid = {"dash_offset": 0, "dash_list": None}
    return [Stroke(linewidth=width, foreground=DARK, dashes=solid), Normal()]


def write_line_names(shown: Slice, lines: Sequence[NamedLine]) -> None:
    """Write the name of each line, in the lower left corner."""
    if not lines:
        return
    from matplotlib.lines import Line2D

    samples = [
        Line2D([], [], color=line.color, linestyle=line.dashes, linewidth=2.5) for line in lines
    ]
    write_legend(shown.axes, samples, [line.name for line in lines], "lower left")
