"""Pictures with matplotlib: colours, the style of axes and texts, scale bars, and the bytes of the file.

A picture is a figure of its own, drawn by Agg; pyplot is not used, and the settings of matplotlib (rcParams) stay.
One point is one pixel. Boxes are pixels from the upper left corner. Colours are Okabe and Ito's, which people with
any colour vision can tell apart. matplotlib is imported by the first picture: the viewer takes only colours from here.
"""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.output.pictures.movies import png_bytes
from accelsurf.settings.wording import in_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patheffects import AbstractPathEffect

BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
YELLOW = "#F0E442"
INK = "#222222"
GRID = "#D9D9D9"
PALE = "#999999"
DARK = "#101010"
#: Colours of the surface and of its reference in every picture of the program.
SURFACE_COLOR = ORANGE
REFERENCE_COLOR = SKY
#: Colours of objects with ids, again from the first when there are more; none is that of the reference.
OBJECT_COLORS = (SURFACE_COLOR, GREEN, BLUE, VERMILION, PURPLE)
#: A style of matplotlib's lines: solid, or lengths of dashes and gaps in widths of the line.
Dashes = Literal["-"] | tuple[float, tuple[float, ...]]
SOLID: Dashes = "-"
DASHED: Dashes = (0, (4.5, 2))
#: Height of the numbers at ticks and in legends, of labels, of titles, and of the heading of a picture, pixels.
TICK_SIZE = 11
LABEL_SIZE = 12
TITLE_SIZE = 14
HEADING_SIZE = 17

#: Width that a title has at least, pixels, above narrow axes in the middle of a panel.
MIN_TITLE = 240

#: The font of all texts, which comes with matplotlib, and those with further scripts, taken where they are installed.
_FONT = "DejaVu Sans"
_FURTHER_FONTS = (
    "Noto Sans CJK JP",
    "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei",
    "Droid Sans Fallback",
    "IPAGothic",
    "IPAexGothic",
    "Hiragino Sans",
    "PingFang SC",
    "Arial Unicode MS",
    "Microsoft YaHei",
    "MS Gothic",
    "Malgun Gothic",
    "SimHei",
    "Noto Sans Devanagari",
    "Noto Sans Arabic",
    "Noto Sans Thai",
)
#: A white square: stands for a character that no font has.
_MISSING = "\u25a1"
_POINTS_PER_INCH = 72
_HORIZONTAL = {"l": "left", "m": "center", "r": "right"}
_VERTICAL = {"a": "top", "m": "center", "d": "bottom"}

# Without a home, matplotlib reports its temporary folder through logging, which a command would print.
logging.getLogger("matplotlib").addHandler(logging.NullHandler())


class Box(NamedTuple):
    """A rectangle, pixels from the upper left corner of a picture."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def width(self) -> float:
        """Width, pixels."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Height, pixels."""
        return self.bottom - self.top

    @property
    def middle(self) -> tuple[float, float]:
        """Centre (right, down), pixels."""
        return 0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom)


class Canvas:
    """A white picture to draw on.

    Parameters
    ----------
    width, height : float
        Pixels.
    title : str, optional
        One line at the top, in the middle.

    Attributes
    ----------
    figure : matplotlib.figure.Figure

    Examples
    --------
    >>> canvas = Canvas(40, 30)
    >>> canvas.axes(Box(5, 5, 35, 25), (0, 1), (0, 1)).plot([0, 1], [0, 1])
    [<matplotlib.lines.Line2D object at ...>]
    >>> canvas.png()[1:4]
    b'PNG'
    """

    def __init__(self, width: float, height: float, title: str = "") -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.width, self.height = max(int(width), 1), max(int(height), 1)
        inches = self.width / _POINTS_PER_INCH, self.height / _POINTS_PER_INCH
        self.figure = Figure(inches, dpi=_POINTS_PER_INCH, facecolor="white", edgecolor="none")
        self._agg = FigureCanvasAgg(self.figure)
        if title:
            self.text(
                (self.width / 2, 22),
                fitting(title, HEADING_SIZE, self.width - 20),
                HEADING_SIZE,
                anchor="mm",
            )

    def axes(self, box: Box, x: Sequence[float], y: Sequence[float]) -> Axes:
        """Return new axes in a box, with the values ``x`` at its left and right, ``y`` at its lower and upper side."""
        place = (
            box.left / self.width,
            1 - box.bottom / self.height,
            box.width / self.width,
            box.height / self.height,
        )
        axes = self.figure.add_axes(place, xlim=x, ylim=y, facecolor="none")
        # A user's own settings of matplotlib may have both.
        axes.grid(False)
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_visible(False)  # until it gets a scale
        for spine in axes.spines.values():
            spine.set(edgecolor=PALE, linewidth=1)
        return axes

    def text(
        self,
        at: tuple[float, float],
        text: str,
        size: int = LABEL_SIZE,
        color: str = INK,
        anchor: str = "la",
    ) -> None:
        """Write lines of text.

        Parameters
        ----------
        at : (float, float)
            Where its anchor is, pixels.
        text : str
        size : int
            Height of the font, pixels.
        color : str
        anchor : str
            Two letters: l, m, r (left, middle, right) and a, m, d (top, middle, bottom).
        """
        self.figure.text(
            at[0] / self.width,
            1 - at[1] / self.height,
            drawable(text),
            color=color,
            ha=_HORIZONTAL[anchor[0]],
            va=_VERTICAL[anchor[1]],
            **font(size),
        )

    def pixels(self) -> NDArray[np.uint8]:
        """Draw the picture, (height, width, 3)."""
        self._agg.draw()
        return np.asarray(self._agg.buffer_rgba())[..., :3]

    def png(self) -> bytes:
        """Draw the picture as a PNG file."""
        return png_bytes(self.pixels())


def object_color(position: int) -> str:
    """Return the colour of the object at this place in the order of ids; colours repeat after five objects.

    Examples
    --------
    >>> object_color(0) == SURFACE_COLOR, object_color(5) == SURFACE_COLOR
    (True, True)
    """
    return OBJECT_COLORS[position % len(OBJECT_COLORS)]


# ------------------------------------------------------------------------------------------------------------- axes


def write_scales(
    axes: Axes,
    xlabel: str,
    ylabel: str,
    *,
    grid: bool = False,
    color: str = INK,
    right: bool = False,
) -> None:
    """Write round values along the lower and the left (or right) side, their labels, and with ``grid`` lines across."""
    from matplotlib.ticker import MaxNLocator

    for axis, pixels in ((axes.xaxis, axes.bbox.width / 70), (axes.yaxis, axes.bbox.height / 45)):
        axis.set(visible=True, major_locator=MaxNLocator(max(2, int(pixels)), steps=[1, 2, 5, 10]))
        axis.get_offset_text().set(color=INK, **font(TICK_SIZE))
    axes.ticklabel_format(useOffset=False, scilimits=(-3, 5), useMathText=False)
    axes.tick_params(
        bottom=True,
        labelbottom=True,
        left=not right,
        labelleft=not right,
        right=right,
        labelright=right,
        length=4,
        width=1,
        pad=3.5,
        direction="out",
        color=PALE,
        labelcolor=INK,
        labelsize=TICK_SIZE,
        labelfontfamily=_FONT,
    )
    if grid:
        axes.grid(color=GRID, linewidth=1, linestyle="-", alpha=1)
        axes.set_axisbelow(True)
    axes.set_xlabel(xlabel, labelpad=4, color=INK, **font(LABEL_SIZE))
    axes.set_ylabel(ylabel, labelpad=4, color=color, **font(LABEL_SIZE))


def write_lengths(axes: Axes, across: str, up: str, unit: str) -> None:
    """Write scales of axes in mm, as numbers of a unit: two ticks at least on each, and on large ones one every 50 mm.

    ``across`` and ``up`` are the names of the axes; an empty one is left out.
    """
    from matplotlib.ticker import FuncFormatter, MultipleLocator

    write_scales(axes, f"{across} ({unit})", f"{up} ({unit})" if up else "")
    for axis, ends, pixels, room in (
        (axes.xaxis, axes.get_xlim(), axes.bbox.width, 42),
        (axes.yaxis, axes.get_ylim(), axes.bbox.height, 26),
    ):
        low, high = in_unit(min(ends), unit), in_unit(max(ends), unit)
        step = tick_step(low, high, pixels, room)
        axis.set_major_locator(MultipleLocator(step / in_unit(1.0, unit)))
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: f"{round(in_unit(value, unit), 9):.12g}")
        )


def tick_step(low: float, high: float, pixels: float, room: float) -> float:
    """Return the distance of ticks: the least round one with ``room`` pixels for each, or less, for two at least.

    Examples
    --------
    >>> tick_step(0, 400, 362, 42), tick_step(-3, 100, 362, 42), tick_step(-803, -781, 60, 26), tick_step(1, 19, 60, 42)
    (50.0, 20.0, 10.0, 5.0)
    """
    least = (high - low) * room / pixels
    step = round_step(least)
    while step < least * (1 - 1e-9):
        step = round_step(2.51 * step)
    while math.floor(high / step) - math.ceil(low / step) < 1:
        step = round_step(0.51 * step)
    return step


def write_title(axes: Axes, text: str) -> None:
    """Write above axes, each line shortened if it is wider than they are and a third more; a place always fits."""
    width = max(1.3 * axes.bbox.width, MIN_TITLE)
    lines = (fitting(line, TITLE_SIZE, width) for line in text.split("\n"))
    # With a height of its own matplotlib does not lay out all ticks once more, to see whether any is in the way.
    axes.set_title("\n".join(lines), y=1, pad=7, color=INK, **font(TITLE_SIZE))


def write_legend(
    axes: Axes, lines: Sequence[Any], names: Sequence[str], place: Any, **options: Any
) -> None:
    """Write a legend of lines, on a light ground."""
    legend = axes.legend(
        lines,
        ["line"] * len(lines),
        loc=place,
        facecolor="white",
        edgecolor="none",
        framealpha=0.8,
        fancybox=False,
        borderpad=0.4,
        labelspacing=0.35,
        handlelength=2.4,
        borderaxespad=0.4,
        **options,
        prop={"family": _families(), "size": TICK_SIZE},
    )
    for text, name in zip(legend.get_texts(), names, strict=True):
        # Set here: matplotlib leaves out labels that begin with an underscore.
        text.set(text=drawable(name), parse_math=False, color=INK)


def draw_scale_bar(
    axes: Axes, unit: str = "mm", color: str = INK, rim: Sequence[AbstractPathEffect] = ()
) -> None:
    """Draw a bar of a round length, about a quarter of axes in mm, in their lower right corner."""
    left, right = axes.get_xlim()
    per_pixel = (right - left) / axes.bbox.width
    length = round_step(0.25 * in_unit(right - left, unit))
    end = right - 10 * per_pixel
    first = end - length / in_unit(1.0, unit)
    at = 9 / axes.bbox.height
    axes.plot(
        [first, end],
        [at, at],
        color=color,
        lw=2.5,
        ls="-",
        solid_capstyle="butt",
        path_effects=rim,
        transform=axes.get_xaxis_transform(),
    )
    axes.annotate(
        f"{length:g} {unit}",
        (0.5 * (first + end), at),
        (0, 4),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        ha="center",
        va="bottom",
        color=color,
        path_effects=rim,
        **font(TICK_SIZE, bold=True),
    )


def round_step(wanted: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a length.

    Examples
    --------
    >>> round_step(37.0), round_step(0.9)
    (20.0, 0.5)
    """
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in (1, 2, 5) if step * decade <= wanted * (1 + 1e-9))


def range_of(values: Any) -> tuple[float, float]:
    """Return the lowest and highest finite value, with a margin; 0 to 1 where there is none, or no difference."""
    numbers = np.asarray(values, float)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return 0.0, 1.0
    low, high = float(numbers.min()), float(numbers.max())
    room = 0.05 * (high - low) or 0.5 * abs(high) or 0.5
    return low - room, high + room


# ------------------------------------------------------------------------------------------------------------ texts


def font(size: int, bold: bool = False) -> dict[str, Any]:
    """Return the properties of a text ``size`` pixels high; a dollar is a dollar, not the begin of a formula."""
    weight = "bold" if bold else "normal"
    return {"fontfamily": _families(), "fontsize": size, "fontweight": weight, "parse_math": False}


@functools.cache
def _families() -> list[str]:
    """The fonts that are installed, by family."""
    from matplotlib.font_manager import fontManager

    installed = set(fontManager.get_font_names())
    return [_FONT, *(name for name in _FURTHER_FONTS if name in installed)]


@functools.cache
def _characters() -> frozenset[int]:
    """The code points that any of the fonts has."""
    from matplotlib.font_manager import findfont, get_font

    return frozenset(
        code for name in _families() for code in get_font(findfont(name)).get_charmap()
    )


def drawable(text: str) -> str:
    """Return a text with a white square for each character that no font has.

    Examples
    --------
    >>> drawable("a$b" + chr(7)) == "a$b" + chr(0x25A1)
    True
    """
    if all(line.isascii() and line.isprintable() for line in text.split("\n")):
        return text
    characters = _characters()
    return "".join(
        c if c == "\n" or (c.isprintable() and ord(c) in characters) else _MISSING for c in text
    )


def text_width(text: str, size: int, bold: bool = False) -> float:
    """Return the width of one line of text, pixels."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    properties = FontProperties(family=_families(), size=size, weight="bold" if bold else "normal")
    return float(text_to_path.get_text_width_height_descent(drawable(text), properties, False)[0])


def fitting(text: str, size: int, width: float) -> str:
    """Return a line of text, shortened in the middle if it is wider than ``width`` pixels.

    Examples
    --------
    >>> fitting("short", 12, 200), len(fitting("a" * 500, 12, 200)) < 40
    ('short', True)
    """
    if text_width(text, size) <= width:
        return text
    low, high = 0, len(text) // 2
    while low < high:  # the largest number of letters at each end that fits
        many = (low + high + 1) // 2
        low, high = (
            (many, high)
            if text_width(f"{text[:many]}...{text[-many:]}", size) <= width
            else (low, many - 1)
        )
    return f"{text[:low]}...{text[len(text) - low :]}"
