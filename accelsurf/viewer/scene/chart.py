"""Chart of the energies against the step: the potential above, the kinetic energy below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter

import numpy as np
import pyvista as pv

from accelsurf.evolution import StepRecord
from accelsurf.output import OBJECT_COLORS
from accelsurf.viewer.scene.colors import Theme
from accelsurf.viewer.scene.overlay import Label, Pixels, round_up

#: Width of a curve, pixels of a usual screen.
LINE = 2.0
#: Said before there is a curve.
WAIT = "energies: from the first step on"


class EnergyChart:
    """Two charts in one renderer, over a common axis of steps.

    Parameters
    ----------
    plotter : pyvista.Plotter
        Its active renderer gets the charts.
    theme : Theme

    Attributes
    ----------
    colors : sequence of str
        Of the objects, where there are several.
    """

    def __init__(self, plotter: pv.Plotter, theme: Theme) -> None:
        self.charts = [pv.Chart2D(size=(0.94, 0.49), loc=(0.03, low)) for low in (0.5, 0.01)]
        for chart, title in zip(self.charts, ("Energy (potential)", "Kinetic energy"), strict=True):
            chart.title = title
            chart.border_style = ""
            chart.x_label, chart.y_label = "", ""
            plotter.add_chart(chart)
        self.charts[1].x_label = "step"
        self._histories: Sequence[Sequence[StepRecord]] = ()
        self.colors: Sequence[str] = OBJECT_COLORS
        self._theme, self._pixels = theme, Pixels(0)
        self._renderer = plotter.renderer
        #: Text before there is a curve.
        self._wait = Label(plotter.renderer, theme.ink, (0.5, 0.5), WAIT)
        self.paint(theme)

    def update(self, histories: Sequence[Sequence[StepRecord]]) -> None:
        """Show the histories of the objects of a run, a line for each.

        Each level has an image of its own, with energies of its own: lines of the potential have gaps there.
        """
        self._histories = histories
        self._wait.text = "" if any(histories) else WAIT
        potential, kinetic = self.charts
        self._draw(potential, "potential")
        self._draw(kinetic, "kinetic")

    def _draw(self, chart: pv.Chart2D, column: str) -> None:
        """Draw a column of the records: of one object in the colour of text, of several in those of their surfaces."""
        chart.clear()
        values, last = [], 1.0
        for position, history in enumerate(self._histories):
            several = len(self._histories) > 1 and position < len(self.colors)
            color = self.colors[position] if several else self._theme.ink
            by_level = groupby(history, key=attrgetter("level"))
            parts = [list(part) for _, part in by_level] if column == "potential" else [history]
            for part in filter(None, parts):
                found = [float(np.nan_to_num(getattr(record, column))) for record in part]
                steps = [float(record.step) for record in part]
                # A line has two points at least.
                x, y = [*steps, steps[-1] + 1e-3], [*found, found[-1]]
                chart.line(x, y, color=color, width=self._line)
                values += [getattr(record, column) for record in part]
                last = max(last, steps[-1])
        chart.visible = bool(values)
        chart.x_range = 0.0, last
        chart.y_range = _range(values, from_zero=column == "kinetic")
        self._set_ticks(chart)

    @property
    def _line(self) -> float:
        """Width of a curve in pixels of the device."""
        return LINE * self._pixels.ratio

    def fit(self, pixels: Pixels) -> None:
        """Make text readable, and lines as wide as the screen asks for."""
        self._pixels = pixels
        self._wait.fit(pixels)
        for chart in self.charts:
            self._set_ticks(chart)
            chart.GetTitleProperties().SetFontSize(pixels.text)
            for plot in chart.plots():
                plot.line_width = self._line
            for axis in (chart.x_axis, chart.y_axis):
                axis.tick_label_size = pixels.text - 1
                axis.label_size = pixels.text
                axis.pen.width = pixels.ratio
                axis.GetGridPen().SetWidth(pixels.ratio)

    def _set_ticks(self, chart: pv.Chart2D) -> None:
        """Put as many ticks on the axes as have room beside each other."""
        width, height = self._renderer.GetSize()
        text = self._pixels.text
        # Half of the tile for each chart; three lines of it are title and steps.
        _set_ticks(chart.x_axis, (width / text - 6.0) / 3.0, least=1.0)
        _set_ticks(chart.y_axis, (0.5 * height / text - 3.5) / 1.6, least=0.0)

    def paint(self, theme: Theme) -> None:
        """Use a theme."""
        self._theme = theme
        self._wait.paint(theme.ink)
        ink = pv.Color(theme.ink).float_rgb
        for chart in self.charts:
            chart.background_color = theme.background
            texts = [chart.GetTitleProperties()]
            for axis in (chart.x_axis, chart.y_axis):
                texts += [axis.GetLabelProperties(), axis.GetTitleProperties()]
                axis.pen.color = theme.lines
                axis.GetGridPen().SetColor(*pv.Color(theme.lines).int_rgb)
                axis.GetGridPen().SetOpacity(90)
            for text in texts:
                text.SetColor(ink)
                text.SetBold(False)
        self.update(self._histories)


def _set_ticks(axis: pv.plotting.charts.Axis, room: float, least: float) -> None:
    """Put ticks at round numbers, at least ``least`` apart, with room for a number of gaps from 1 to 5; VTK's own have
    many digits.
    """
    low, high = axis.range
    gap = max(round_up((high - low) / min(max(int(room), 1), 5)), least)
    numbers = range(math.ceil(low / gap - 1e-9), math.floor(high / gap + 1e-9) + 1)
    axis.tick_locations = [number * gap for number in numbers]
    # VTK draws the last column of a text once more before the first, over a minus sign: blanks stand at both ends.
    axis.tick_labels = [f" {tick_text(number * gap)} " for number in numbers]


def tick_text(value: float) -> str:
    """Return a number as it stands beside an axis.

    Examples
    --------
    >>> tick_text(-8000.0), tick_text(12000.0), tick_text(2e-06), tick_text(0.0)
    ('-8000', '1.2e4', '2e-6', '0')
    """
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}"
    digits, _, power = f"{value:.3e}".partition("e")
    return f"{float(digits):g}e{int(power)}"


def _range(values: Sequence[float], from_zero: bool) -> tuple[float, float]:
    finite = [v for v in values if np.isfinite(v)] or [0.0]
    low, high = (0.0 if from_zero else min(finite)), max(finite)
    if high <= low:
        return (low, low + 1.0) if from_zero else (low - 0.5, low + 0.5)
    return low, high + 0.05 * (high - low)
