"""`tuned`: every flow with its settings tuned, over seeds, noise levels and starts.

The comparison that a fair reader asks for: descent gets an area weight, presmoothing and the same diffusion, Sobolev
its length, momentum its blend, each selected on the truth (which favours all alike) as the best mean Dice over all
images and starts of one noise level. (Descent suffers from redistancing in programs that move the surface by it; here a
hundred redistances move it by a thousandth of a voxel, so their interval is nothing to tune.)
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.figures.common import COLOURS, Task, agreement, box, run_all, write
from benchmarks.figures.planar import STARTS, STEPS, save

SEEDS, LEVELS = (0, 1), (0.5, 1.0, 2.0)
BUDGET = {**STEPS, "max_steps": 400}
SMOOTH: dict[str, list[Any]] = {"smoothness": [0.0, 0.1, 0.3], "presmooth": [0.0, 1.0]}
GRIDS: dict[str, tuple[dict[str, Any], dict[str, list[Any]]]] = {
    "gradient": ({"flow": "gradient"}, {**SMOOTH, "diffusion": [0.0, "free"]}),
    "sobolev": (
        {"flow": "sobolev"},
        {"flow": [f"sobolev:length={mm}" for mm in (5, 10, 20)], "presmooth": [0.0, 1.0]},
    ),
    "momentum": ({"flow": "momentum:blend=0.9"}, SMOOTH),
    "constant density": ({"flow": "constant-density"}, SMOOTH),
    "flowable mass": (
        {"flow": "flowable-mass"},
        {"smoothness": [0.0, 0.1], "presmooth": [0.0, 1.0]},
    ),
}


def tuned(output: Path) -> None:
    """Run all; for each flow and noise level the best settings, and the plain ones."""
    tasks = [
        Task(
            (flow, level, setting, seed, start),
            shape(level, seed),
            {"start": where, **BUDGET, **fixed, **setting},
        )
        for flow, (fixed, grid) in GRIDS.items()
        for setting in choices(grid)
        for level, seed in itertools.product(LEVELS, SEEDS)
        for start, where in STARTS.items()
    ]
    print(f"{len(tasks)} runs", flush=True)
    results = run_all(tasks)
    table = []
    for flow, level in itertools.product(GRIDS, LEVELS):
        grid = choices(GRIDS[flow][1])
        groups = [
            [r for r in results if r["name"][:3] == (flow, level, setting)] for setting in grid
        ]
        means = [float(np.mean([record["dice"] for record in group])) for group in groups]
        for kind, at in (("plain", 0), ("tuned", int(np.argmax(means)))):
            table.append(
                {
                    "flow": flow,
                    "noise": level,
                    "kind": kind,
                    "settings": grid[at],
                    **figures(groups[at]),
                }
            )
            print(row(table[-1]), flush=True)
    write(
        output,
        "tuned",
        {"seeds": SEEDS, "levels": LEVELS, "starts": STARTS, "table": table, "runs": results},
    )
    draw(output, table)


def shape(level: float, seed: int) -> tuple:
    """The rectangle with other noise."""
    return box((1, 96, 96), (0, 28, 18), (1, 68, 78), level, 100 + seed)


def choices(grid: dict[str, list[Any]]) -> list[dict[str, Any]]:
    """All combinations; the first is the plain one."""
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


def figures(group: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of the runs of one setting and noise level."""
    by_seed: dict[int, list[np.ndarray]] = {}
    for record in group:
        by_seed.setdefault(record["name"][3], []).append(record["labels"])
    distances = [record["hausdorff_mm"] for record in group if record["hausdorff_mm"] is not None]
    return {
        "dice_mean": float(np.mean([record["dice"] for record in group])),
        "dice_least": min(record["dice"] for record in group),
        "corner_dice_mean": float(np.mean([record["corner_dice"] for record in group])),
        "hausdorff_median_mm": float(np.median(distances)) if distances else None,
        "agreement_mean": float(
            np.nanmean([value for labels in by_seed.values() for value in agreement(labels)])
        ),
        "steps_median": float(np.median([record["steps"] for record in group])),
        "cells_visited_median": float(np.median([record["cells_visited"] for record in group])),
    }


def row(line: dict[str, Any]) -> str:
    """A line as text."""
    settings = ", ".join(f"{key} {value}" for key, value in line["settings"].items())
    return (
        f"noise {line['noise']:g} {line['flow']:17s} {line['kind']:5s} Dice {line['dice_mean']:.3f} (least "
        f"{line['dice_least']:.3f}) corners {line['corner_dice_mean']:.3f} "
        f"agreement {line['agreement_mean']:.3f}  {settings}"
    )


def draw(output: Path, table: list[dict[str, Any]]) -> None:
    """Mean Dice, plain and tuned, per noise level."""
    figure, axes = plt.subplots(1, len(LEVELS), figsize=(13, 4.2), sharey=True)
    for axis, level in zip(axes, LEVELS, strict=True):
        for offset, kind, colour in ((-0.2, "plain", COLOURS[1]), (0.2, "tuned", COLOURS[0])):
            lines = [line for line in table if line["noise"] == level and line["kind"] == kind]
            at = np.arange(len(lines)) + offset
            axis.bar(at, [line["dice_mean"] for line in lines], 0.38, color=colour, label=kind)
            axis.plot(at, [line["corner_dice_mean"] for line in lines], "k_", markersize=12)
        axis.set_xticks(range(len(GRIDS)), [name.replace(" ", "\n") for name in GRIDS], fontsize=8)
        axis.set_title(f"noise {level:g} of the contrast", fontsize=10)
        axis.grid(True, axis="y", alpha=0.3)
    axes[0].set_ylabel("mean Dice (dash: near the corners)")
    axes[0].legend(fontsize=8)
    save(
        figure,
        output,
        "tuned",
        "Rectangle in noise, 2 seeds x 3 starts: plain settings, and the best on the truth",
    )
