"""What every picture shares: colours, the figure, the style of its axes, the bytes of the file.

Drawn with matplotlib's objects, never through pyplot, so that pictures keep no state and need no screen. Colours are
Okabe and Ito's, which people with any colour vision can tell apart.
"""

from __future__ import annotations

import io
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GRID = "#222222", "#D9D9D9"
RUN_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
RUN_DASHES = ("solid", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2)))
DPI = 110


def preload_library() -> None:
    """Load the drawing library in its own thread: it takes half a second, during which compiled kernels can compute."""
    threading.Thread(target=_library, name="accelsurf-drawing").start()


def _library() -> tuple[type[Figure], type[FigureCanvasAgg]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    return Figure, FigureCanvasAgg


def new_figure(width: float, height: float, title: str) -> Figure:
    """Make a figure of ``width`` x ``height`` inches with a title."""
    figure_class, canvas_class = _library()
    figure = figure_class(figsize=(width, height), dpi=DPI, facecolor="white")
    canvas_class(figure)
    figure.suptitle(title, fontsize=12, color=INK, y=0.975)
    return figure


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
