"""Chart of the energies against the step: the potential above, the kinetic energy below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkStringArray

from accelsurf.evolution.records import StepRecord
from accelsurf.viewer.scene.colors import OBJECT_COLORS, Theme
from accelsurf.viewer.scene.overlay import Label, Pixels, round_up

#: Width of a curve, pixels of a usual screen.
LINE = 2.0
#: Said before there is a curve.
WAIT = "energies: from the first step on"


class _Curve(NamedTuple):
    """A curve of the object at this ``position`` in the order of ids: ``values`` against ``steps``."""

    position: int
    steps: list[float]
    values: list[float]

    @classmethod
    def of(
        cls, position: int, records: Sequence[StepRecord], column: Literal["potential", "kinetic"]
    ) -> _Curve:
        """The curve of an energy."""
        values = [
            record.potential if column == "potential" else record.kinetic for record in records
        ]
        return cls(position, [float(record.step) for record in records], values)

    def points(self) -> tuple[list[float], list[float]]:
        """Steps and values, at least two of each, all finite, as the chart needs them."""
        x, y = self.steps, [float(np.nan_to_num(value)) for value in self.values]
        return (x, y) if len(x) > 1 else ([x[0], x[0] + 1e-3], [y[0], y[0]])


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
            chart.grid = True
            plotter.add_chart(chart)
        self.charts[1].x_label = "step"
        self._potential: list[pv.LinePlot2D] = []
        self._kinetic: list[pv.LinePlot2D] = []
        self._curves: tuple[list[_Curve], list[_Curve]] = ([], [])
        self._is_single = True
        self.colors: Sequence[str] = OBJECT_COLORS
        self._theme = theme
        #: Width and height of the tile, and height of text, for which the ticks were made; pixels.
        self._renderer, self._room = plotter.renderer, (0, 0, 0)
        #: Text before there is a curve.
        self._wait = Label(plotter.renderer, theme.ink, (0.5, 0.5))
        self._draw([], [])
        self.update([])
        self.paint(theme)

    def update(self, histories: Sequence[Sequence[StepRecord]]) -> None:
        """Show the histories of the objects of a run, a line for each.

        Each level has an image of its own, with energies of its own: lines of the potential have gaps there.
        """
        self._is_single = len(histories) < 2
        numbered = [
            (position, list(history)) for position, history in enumerate(histories) if history
        ]
        potential = [
            _Curve.of(position, list(records), "potential")
            for position, history in numbered
            for _, records in groupby(history, key=lambda record: record.level)
        ]
        kinetic = [_Curve.of(position, history, "kinetic") for position, history in numbered]
        self._draw(potential, kinetic)
        last = max((1.0, *(history[-1].step for _, history in numbered)))
        for chart, curves in zip(self.charts, (potential, kinetic), strict=True):
            if curves:
                chart.x_range = (0.0, float(last))
                chart.y_range = _range(
                    [v for curve in curves for v in curve.values], from_zero=curves is kinetic
                )
            chart.visible = bool(curves)
        self._wait.text = "" if potential else WAIT
        self._room = (0, 0, 0)

    def _draw(self, potential: list[_Curve], kinetic: list[_Curve]) -> None:
        """Draw the curves, in place of those before; a chart needs at least one line of kinetic energy."""
        self._curves = (potential, kinetic or [_Curve(0, [0.0, 1.0], [0.0, 0.0])])
        for chart, lines, curves in zip(
            self.charts, (self._potential, self._kinetic), self._curves, strict=True
        ):
            while len(lines) < len(curves):
                lines.append(chart.line([0.0, 1.0], [0.0, 0.0], width=LINE))
            while len(lines) > len(curves):
                chart.remove_plot(lines.pop())
            for line, curve in zip(lines, curves, strict=True):
                line.update(*curve.points())
        self._paint_lines()

    def _paint_lines(self) -> None:
        """Colour the lines: of one object as text, of several each in the colour of its surface."""
        ink = self._theme.ink
        for lines, curves in zip((self._potential, self._kinetic), self._curves, strict=True):
            for line, curve in zip(lines, curves, strict=True):
                several = self.colors[curve.position] if curve.position < len(self.colors) else ink
                line.color = ink if self._is_single else several

    def fit(self, pixels: Pixels) -> None:
        """Make text readable, and lines as wide as the screen asks for."""
        size = pixels.text
        self._wait.fit(pixels)
        self._set_ticks(size)
        for line in (*self._potential, *self._kinetic):
            line.width = LINE * pixels.ratio
        for chart in self.charts:
            chart.GetTitleProperties().SetFontSize(size)
            for axis in (chart.x_axis, chart.y_axis):
                axis.GetLabelProperties().SetFontSize(size - 1)
                axis.pen.width = pixels.ratio
                axis.GetGridPen().SetWidth(pixels.ratio)
                axis.GetTitleProperties().SetFontSize(size)

    def _set_ticks(self, text: int) -> None:
        """Put as many ticks on the axes as have room beside each other."""
        width, height = self._renderer.GetSize()
        if self._room == (width, height, text):
            return
        self._room = (width, height, text)
        # Half of the tile for each chart; three lines of it are title and steps.
        rows, columns = 0.5 * height / text - 3.5, width / text - 6.0
        for chart in self.charts:
            if chart.visible:
                _set_ticks(chart.x_axis, chart.x_range, _most(columns / 3.0), whole=True)
                _set_ticks(chart.y_axis, chart.y_range, _most(rows / 1.6), whole=False)

    def paint(self, theme: Theme) -> None:
        """Use a theme."""
        self._theme = theme
        self._wait.paint(theme.ink)
        ink = pv.Color(theme.ink).float_rgb
        for chart in self.charts:
            chart.background_color = theme.background
            chart.GetTitleProperties().SetColor(ink)
            chart.GetTitleProperties().SetBold(False)
            for axis in (chart.x_axis, chart.y_axis):
                axis.GetLabelProperties().SetColor(ink)
                axis.GetTitleProperties().SetColor(ink)
                axis.GetTitleProperties().SetBold(False)
                axis.pen.color = theme.lines
                axis.GetGridPen().SetColor(*pv.Color(theme.lines).int_rgb)
                axis.GetGridPen().SetOpacity(90)
        self._paint_lines()


def _most(room: float) -> int:
    """Return the largest number of gaps between ticks, from 1 to 5."""
    return min(max(int(room), 1), 5)


def _set_ticks(
    axis: pv.plotting.charts.Axis, ends: tuple[float, float], most: int, whole: bool
) -> None:
    """Put ticks at round numbers, with at most ``most`` gaps in the range; VTK's own have many digits."""
    low, high = ends
    gap = max(round_up((high - low) / most), 1.0) if whole else round_up((high - low) / most)
    positions, labels = vtkDoubleArray(), vtkStringArray()
    for number in range(math.ceil(low / gap - 1e-9), math.floor(high / gap + 1e-9) + 1):
        positions.InsertNextValue(number * gap)
        # VTK draws the last column of a text once more before the first, over a minus sign: blanks stand at both ends.
        labels.InsertNextValue(f" {tick_text(number * gap)} ")
    axis.SetCustomTickPositions(positions, labels)


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
