"""Chart of the energies against the step: the potential above, the kinetic energy below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkStringArray

from accelsurf.evolution.records import StepRecord
from accelsurf.viewer.scene.colors import Theme
from accelsurf.viewer.scene.overlay import MIN_TEXT, TEXT, round_length


class EnergyChart:
    """Two charts in one renderer, over a common axis of steps.

    Parameters
    ----------
    plotter : pyvista.Plotter
        Its active renderer gets the charts.
    theme : Theme
    """

    def __init__(self, plotter: pv.Plotter, theme: Theme) -> None:
        self._charts = [pv.Chart2D(size=(0.94, 0.49), loc=(0.03, low)) for low in (0.5, 0.01)]
        for chart, title in zip(self._charts, ("Energy (potential)", "Kinetic energy"), strict=True):
            chart.title = title
            chart.border_style = ""
            chart.x_label, chart.y_label = "", ""
            chart.grid = True
            plotter.add_chart(chart)
        self._charts[1].x_label = "step"
        self._segments: list[pv.LinePlot2D] = []
        self._kinetic = self._charts[1].line([0.0, 1.0], [0.0, 0.0], width=2.0)
        self.paint(theme)

    def update(self, history: Sequence[StepRecord]) -> None:
        """Show the rows of a run. Each level has its own image, with energies of its own: the line has gaps there."""
        top, below = self._charts
        groups = [list(rows) for _, rows in groupby(history, key=lambda row: row.level)]
        while len(self._segments) < len(groups):
            self._segments.append(top.line([0.0, 1.0], [0.0, 0.0], color=self._theme.potential, width=2.0))
        while len(self._segments) > len(groups):
            top.remove_plot(self._segments.pop())
        if not groups:
            self._kinetic.update([0.0, 1.0], [0.0, 0.0])
            return
        for line, rows in zip(self._segments, groups, strict=True):
            line.update(*_pair([row.step for row in rows], [row.potential for row in rows]))
        self._kinetic.update(*_pair([row.step for row in history], [row.kinetic for row in history]))
        last = float(max(history[-1].step, 1))
        for chart, values in ((top, [r.potential for r in history]), (below, [r.kinetic for r in history])):
            chart.x_range = (0.0, last)
            chart.y_range = _range(values, from_zero=chart is below)
            _set_ticks(chart.x_axis, chart.x_range, 4, whole=True)
            _set_ticks(chart.y_axis, chart.y_range, 3, whole=False)

    def fit(self, height: int) -> None:
        """Make text readable in a window of so many pixels."""
        size = max(MIN_TEXT, round(height * TEXT))
        for chart in self._charts:
            chart.GetTitleProperties().SetFontSize(size)
            for axis in (chart.x_axis, chart.y_axis):
                axis.GetLabelProperties().SetFontSize(size - 1)
                axis.GetTitleProperties().SetFontSize(size)

    def paint(self, theme: Theme) -> None:
        """Take up a theme."""
        self._theme = theme
        ink = pv.Color(theme.ink).float_rgb
        for chart in self._charts:
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
        for line in self._segments:
            line.color = theme.potential
        self._kinetic.color = theme.kinetic


def _set_ticks(axis: pv.plotting.charts.Axis, ends: tuple[float, float], parts: int, whole: bool) -> None:
    """Put ticks at round numbers: VTK's own would be at odd places, with many digits."""
    low, high = ends
    gap = round_length((high - low) / parts) if high > low else 1.0
    gap = max(gap, 1.0) if whole else gap
    positions, labels = vtkDoubleArray(), vtkStringArray()
    for number in range(math.ceil(low / gap - 1e-9), math.floor(high / gap + 1e-9) + 1):
        positions.InsertNextValue(number * gap)
        labels.InsertNextValue(f"{number * gap:.4g}")
    axis.SetCustomTickPositions(positions, labels)


def _pair(x: Sequence[float], y: Sequence[float]) -> tuple[list[float], list[float]]:
    """At least two points, as the chart wants them."""
    x, y = [float(v) for v in x], [float(np.nan_to_num(v)) for v in y]
    return (x, y) if len(x) > 1 else ([x[0], x[0] + 1e-3], [y[0], y[0]])


def _range(values: Sequence[float], from_zero: bool) -> tuple[float, float]:
    finite = [v for v in values if np.isfinite(v)] or [0.0]
    low, high = (0.0 if from_zero else min(finite)), max(finite)
    if high <= low:
        return (low, low + 1.0) if from_zero else (low - 0.5, low + 0.5)
    return low, high + 0.05 * (high - low)
