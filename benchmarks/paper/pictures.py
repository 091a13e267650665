"""Pictures of the page: middle slices with the surfaces at rest of the first seed, and Dice of every seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from benchmarks.figures.common import COLOURS
from benchmarks.figures.planar import save, show
from benchmarks.paper.landscapes import LANDSCAPES
from benchmarks.paper.tables import groups

Run = dict[str, Any]


def draw(name: str, runs: list[Run], output: Path) -> None:
    """Draw an experiment, each flow and all starts of the first seed; that of random acceleration has no picture."""
    runs = [entry for entry in runs if entry["seed"] == 0 and entry["limits"] == "default" and entry["noise"] == 0.0]
    if name == "random acceleration":
        return
    methods = groups(runs, "method")
    image, truth = LANDSCAPES[runs[0]["landscape"]].make(0)
    figure, axes = plt.subplots(1, len(methods), figsize=(2.6 * len(methods), 3.2))
    for ((method,), found), axis in zip(methods.items(), axes, strict=True):
        show(axis, image, truth, [entry["labels"] for entry in found], COLOURS)
        dices = ", ".join(f"{entry['dice']:.3f}" for entry in found)
        axis.set_title(f"{method}\nDice {dices}", fontsize=9)
    save(figure, output, f"paper-{name.replace(' ', '-')}", f"{name}: middle slice, every run at rest (dashed: truth)")


def scatter(runs: list[Run], output: Path) -> None:
    """Dice of every seed against its steps, a panel for each landscape."""
    rows = groups([e for e in runs if e["experiment"] == e["landscape"] and e["limits"] == "default"], "landscape")
    figure, axes = plt.subplots(1, len(rows), figsize=(2.6 * len(rows), 3.2), sharey=True, squeeze=False)
    for ((landscape,), group), axis in zip(rows.items(), axes[0], strict=True):
        for ((method,), entries), colour in zip(groups(group, "method").items(), COLOURS, strict=False):
            axis.plot([e["steps"] for e in entries], [e["dice"] for e in entries], "o", color=colour, label=method)
        axis.set(title=landscape, xlabel="steps to rest", xscale="log", ylim=(0.0, 1.02))
        axis.grid(True, alpha=0.3)
    axes[0, 0].set_ylabel("Dice at rest")
    axes[0, -1].legend(fontsize=6)
    save(figure, output, "paper-dice", "Dice against steps, five seeds, every run to rest")
