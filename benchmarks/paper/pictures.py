"""Pictures of the page: middle slices with the surfaces at rest, of the first seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from benchmarks.figures.common import COLOURS
from benchmarks.figures.planar import save, show
from benchmarks.paper.landscapes import LANDSCAPES
from benchmarks.paper.tables import PICTURED, groups

Run = dict[str, Any]


def draw(name: str, runs: list[Run], output: Path) -> None:
    """Draw an experiment, each flow and all starts of the first seed; those without a picture are left out."""
    runs = [
        entry
        for entry in runs
        if entry["seed"] == 0 and entry["limits"] == "default" and entry["noise"] == 0.0
    ]
    if name not in {*LANDSCAPES, *PICTURED}:
        return
    methods = groups(runs, "method")
    image, truth = LANDSCAPES[runs[0]["landscape"]].make(0)
    figure, axes = plt.subplots(1, len(methods), figsize=(2.6 * len(methods), 3.2))
    for ((method,), found), axis in zip(methods.items(), axes, strict=True):
        show(axis, image, truth, [entry["labels"] for entry in found], COLOURS)
        dices = ", ".join(f"{entry['dice']:.3f}" for entry in found)
        axis.set_title(f"{method}\nDice {dices}", fontsize=9)
    save(
        figure,
        output,
        f"paper-{name.replace(' ', '-')}",
        f"{name}: middle slice, every run at rest (dashed: truth)",
    )
