"""Energies against step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from accelsurf.report.axes import Axes, range_of
from accelsurf.report.canvas import BLUE, INK, RUN_DASHES, VERMILION, Box, Canvas

if TYPE_CHECKING:
    from accelsurf.evolution.records import StepRecord


def draw_energies(canvas: Canvas, panel: Box, history: Sequence[StepRecord], left_out: int = 0) -> None:
    """Draw the energy of a run and, on a second scale, its kinetic energy; triangles mark restarts.

    It is said how many steps of corrections are ``left_out``.
    """
    left, top, right, bottom = panel
    steps, values = energy_curve(history)
    x = (float(min(steps, default=0)), float(max([*steps, min(steps, default=0) + 1])))
    axes = Axes(canvas, panel, x, range_of(values))
    axes.title("Energy and kinetic energy")
    axes.frame("step", "energy", grid=True, color=BLUE)
    axes.curve(steps, values, BLUE, 2.5)
    kinetic = [row.kinetic for row in history]
    if any(kinetic):
        second = Axes(canvas, panel, x, (0.0, 1.05 * max(kinetic)))
        second.curve([row.step for row in history], kinetic, VERMILION, 2.0, RUN_DASHES[1])
        second.right_scale("kinetic energy (dashed)", VERMILION)
    else:
        canvas.text((right - 8, top + 14), "no kinetic energy: the flow has no momentum", 11, anchor="rm")
    if left_out:
        canvas.text((right - 8, top + 34), f"{left_out} steps of corrections are not drawn:", 11, anchor="rm")
        canvas.text((right - 8, top + 48), "their energy is that of a box", 11, anchor="rm")
    restarts = [row.step for row in history if row.restarted]
    for step in restarts:
        at = float(axes.to_canvas([(step, axes.y[0])])[0, 0])
        _triangle(canvas, at, bottom)
    if restarts:
        canvas.text((right - 10, top + 18), "restart (momentum set to zero)", 11, anchor="rm")
        _triangle(canvas, right - 206, top + 23)


def _triangle(canvas: Canvas, x: float, bottom: float) -> None:
    canvas.polygon([(x - 5, bottom), (x + 5, bottom), (x, bottom - 9)], INK)


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
