"""What every picture shares: colours, the figure, the style of its axes, the bytes of the file.

Drawn with matplotlib's objects, never through pyplot, so that pictures keep no state and need no screen. Colours are
Okabe and Ito's, which people with any colour vision can tell apart.
"""

from __future__ import annotations

import functools
import io
import logging
import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GRID = "#222222", "#D9D9D9"
RUN_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
RUN_DASHES = ("solid", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2)))
DPI = 110
#: Fonts of other scripts than Latin, Greek and Cyrillic, by the names that systems install them under.
_FURTHER_FONTS = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans CJK KR", "WenQuanYi Micro Hei", "WenQuanYi Zen Hei",
    "Droid Sans Fallback", "IPAGothic", "Hiragino Sans", "PingFang SC", "Arial Unicode MS", "Microsoft YaHei",
    "MS Gothic", "Malgun Gothic", "SimHei", "Noto Sans Devanagari", "Noto Sans Arabic", "Noto Sans Thai",
)


def preload_library() -> None:
    """Load the drawing library in its own thread: it takes half a second, during which compiled kernels can compute."""
    threading.Thread(target=_library, name="accelsurf-drawing").start()


def _library() -> tuple[type[Figure], type[FigureCanvasAgg]]:
    # It talks of folders and fonts of its own, which nobody asked for, from its import on.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    return Figure, FigureCanvasAgg


def new_figure(width: float, height: float, title: str) -> Figure:
    """Make a figure of ``width`` x ``height`` inches with a title."""
    figure_class, canvas_class = _library()
    figure = figure_class(figsize=(width, height), dpi=DPI, facecolor="white")
    canvas_class(figure)
    figure.suptitle(drawable(title), fontsize=12, color=INK, y=0.975, **name_style(title))
    return figure


@functools.cache
def _families() -> tuple[str, ...]:
    """Fonts for names of files: matplotlib's own, then those with further scripts that are installed."""
    from matplotlib import font_manager

    installed = {font.name for font in font_manager.fontManager.ttflist}
    return ("DejaVu Sans", *(name for name in _FURTHER_FONTS if name in installed))


def name_style(text: str) -> dict[str, Any]:
    """How matplotlib draws a text with the name of a file: not as a formula, and in fonts that have its script."""
    return {"parse_math": False} | ({} if text.isascii() else {"fontfamily": list(_families())})


def drawable(text: str) -> str:
    """A text with a box in place of each character that no font has, so that the library does not warn or fail.

    Examples
    --------
    >>> drawable("a$b"), drawable("bell" + chr(7)) == "bell" + chr(0x25A1)
    ('a$b', True)
    """
    if text.isascii() and text.replace("\n", "").isprintable():
        return text
    from matplotlib import font_manager

    fonts = [font_manager.get_font(font_manager.findfont(name)) for name in _families()]

    def has(one: str) -> bool:
        known = not "\ud800" <= one <= "\udfff" and any(font.get_char_index(ord(one)) for font in fonts)
        return one == "\n" or (one.isprintable() and known)

    return "".join(one if has(one) else "\u25a1" for one in text)


def style_axes(axes: Axes, xlabel: str, ylabel: str, lines: bool = True) -> None:
    """Label axes; ``lines``: of a curve over steps, with a grid."""
    axes.set_xlabel(xlabel, fontsize=9, color=INK)
    axes.set_ylabel(ylabel, fontsize=9, color=INK)
    axes.tick_params(labelsize=8, colors=INK, length=3)
    for side in axes.spines.values():
        side.set_color("#999999")
    if lines:
        # Powers of ten as mathematical text would take a third of the picture's time.
        axes.ticklabel_format(style="sci", scilimits=(-3, 5), axis="y")
        axes.locator_params(axis="x", integer=True)  # steps
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)


def png_bytes(figure: Figure) -> bytes:
    """Encode a figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": "accelsurf"})
    return stream.getvalue()
