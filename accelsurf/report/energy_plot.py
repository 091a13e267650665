"""Energies against step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from accelsurf.report.canvas import BLUE, INK, RUN_DASHES, VERMILION, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from accelsurf.evolution.records import StepRecord


def draw_energies(axes: Axes, history: Sequence[StepRecord]) -> None:
    """Draw the energy of a run and, on a second axis, its kinetic energy; triangles mark restarts."""
    steps = [row.step for row in history]
    axes.set_title("Energy and kinetic energy", fontsize=10, color=INK)
    axes.plot(*energy_curve(history), color=BLUE, linewidth=1.8)
    style_axes(axes, "step", "energy")
    axes.yaxis.label.set_color(BLUE)
    kinetic = [row.kinetic for row in history]
    if any(kinetic):
        right = axes.twinx()
        right.plot(steps, kinetic, color=VERMILION, linewidth=1.5, linestyle=RUN_DASHES[1])
        style_axes(right, "", "kinetic energy (dashed)", lines=False)
        right.ticklabel_format(style="sci", scilimits=(-3, 5), axis="y")
        right.yaxis.label.set_color(VERMILION)
        right.set_ylim(bottom=0)
    else:
        axes.text(0.98, 0.93, "no kinetic energy: the flow has no momentum", transform=axes.transAxes, ha="right")
    restarts = [row.step for row in history if row.restarted]
    if restarts:
        bottom = np.zeros(len(restarts))
        axes.plot(restarts, bottom, "^", color=INK, markersize=6, transform=axes.get_xaxis_transform(), clip_on=False)
        axes.plot([], [], "^", color=INK, markersize=6, linestyle="none", label="restart (momentum set to zero)")
        axes.legend(frameon=False, fontsize=9, loc="upper right", bbox_to_anchor=(1.0, 0.9), labelcolor=INK)


def energy_curve(history: Sequence[StepRecord]) -> tuple[list[int], list[float]]:
    """Steps and potentials, with a gap where the grid changes: each level has its own image, with its own energies."""
    steps: list[int] = []
    values: list[float] = []
    for place, row in enumerate(history):
        if place and row.level != history[place - 1].level:
            steps.append(row.step)
            values.append(float("nan"))
        steps.append(row.step)
        values.append(row.potential)
    return steps, values
