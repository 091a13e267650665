"""`cube`: a cube in noise from twenty random balls, under every flow. How many end in the object's basin?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from accelsurf.image.volume import Volume
from accelsurf.measure.surface_mesh import extract_surface
from benchmarks.figures.common import FINE, Task, agreement, box, make, run_all, write
from benchmarks.figures.planar import save, show, tell

SIZE = 32
CUBE = box((SIZE,) * 3, (8,) * 3, (24,) * 3, 1.0, 5)
STARTS, START_SEED = 20, 2024
#: A run has found the object when its Dice against the truth is at least this; the higher figure counts good ones.
FOUND, GOOD = 0.8, 0.9
FLOWS: dict[str, dict[str, Any]] = {
    "gradient": {"flow": "gradient"},
    "gradient, same diffusion": {"flow": "gradient", "diffusion": "free"},
    "gradient, area weight 0.05 mm": {"flow": "gradient", "smoothness": 0.05},
    "gradient, presmooth 1 mm": {"flow": "gradient", "presmooth": 1.0},
    "Sobolev, 5 mm": {"flow": "sobolev:length=5"},
    "momentum (Andersson et al.)": {"flow": "momentum:blend=0.9"},
    "constant density, diffusion": {"flow": "constant-density", "diffusion": "free"},
    "constant density, none": {"flow": "constant-density", "diffusion": 0.0},
    "flowable mass, diffusion": {"flow": "flowable-mass", "diffusion": "free"},
    "flowable mass, none": {"flow": "flowable-mass", "diffusion": 0.0},
    "flowable mass, gravity": {"flow": "flowable-mass:gravity=1e-5", "diffusion": "free"},
    "constant density, noise": {
        "flow": "constant-density:noise_time=20",
        "noise": 0.1,
        "seed": 1,
    },
}
PICTURED = ("gradient", "gradient, same diffusion", "Sobolev, 5 mm", "constant density, diffusion")


def starts() -> list[str]:
    """Balls of radius 2.5 to 5 voxels with their centres in the cube; some reach out of it.

    A ball that lies mostly outside finds the background instead: Chan-Vese does not know which region is meant.
    """
    random = np.random.default_rng(START_SEED)
    balls = []
    for _ in range(STARTS):
        x, y, z = random.uniform(9.0, 22.0, 3)
        balls.append(f"ball:{x:.1f},{y:.1f},{z:.1f},{random.uniform(2.5, 5.0):.1f}vox")
    return balls


def cube(output: Path) -> None:
    """Run every flow from every start; a table, and a picture of what four of them leave."""
    balls = starts()
    settings = {"max_steps": 200, **FINE}
    tasks = [
        Task((name, start), CUBE, {"start": start, **settings, **changes})
        for name, changes in FLOWS.items()
        for start in balls
    ]
    results = run_all(tasks, tell)
    table = []
    for name in FLOWS:
        runs = [record for record in results if record["name"][0] == name]
        table.append(summary(name, runs))
        print(row(table[-1]))
    limits = {"found_from_dice": FOUND, "good_from_dice": GOOD}
    write(
        output,
        "cube",
        {"shape": CUBE, "start_seed": START_SEED, **limits, "table": table, "runs": results},
    )
    draw(output, results)


def summary(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """One line of the table."""
    dices = [record["dice"] for record in runs]
    return {
        "flow": name,
        "found": sum(value >= FOUND for value in dices),
        "good": sum(value >= GOOD for value in dices),
        "of": len(runs),
        "dice_median": float(np.median(dices)),
        "dice_least": min(dices),
        "corner_dice_median": float(np.median([record["corner_dice"] for record in runs])),
        "agreement_least": float(np.nanmin(agreement([record["labels"] for record in runs]))),
        "energy_median": float(np.median([record["energy"] for record in runs])),
        "steps_median": float(np.median([record["steps"] for record in runs])),
        "converged": sum(record["stop"] == "converged" for record in runs),
        "cells_visited_median": float(np.median([record["cells_visited"] for record in runs])),
    }


def row(line: dict[str, Any]) -> str:
    """The line as text."""
    return (
        f"{line['flow']:34s} found {line['found']:2d}, good {line['good']:2d} of {line['of']}  "
        f"Dice median {line['dice_median']:.3f} least {line['dice_least']:.3f}  "
        f"corners {line['corner_dice_median']:.3f}  energy {line['energy_median']:.1f}  "
        f"steps {line['steps_median']:.0f}  converged {line['converged']}"
    )


def draw(output: Path, results: list[dict[str, Any]]) -> None:
    """Middle slices with all twenty contours, and the surface of the median run, for four flows."""
    truth, image = make(CUBE)
    figure = plt.figure(figsize=(3.4 * len(PICTURED), 7.2))
    for column, name in enumerate(PICTURED):
        runs = sorted(
            (record for record in results if record["name"][0] == name),
            key=lambda record: record["dice"],
        )
        axis = figure.add_subplot(2, len(PICTURED), column + 1)
        show(axis, image, truth, [record["labels"] for record in runs], ["#0072B2"] * len(runs))
        found = sum(record["dice"] >= FOUND for record in runs)
        axis.set_title(f"{name}\nfound by {found} of {len(runs)}", fontsize=9)
        below = figure.add_subplot(2, len(PICTURED), len(PICTURED) + column + 1, projection="3d")
        surface_plot(below, runs[len(runs) // 2])
    save(
        figure,
        output,
        "cube",
        "Cube in noise: all runs in the middle slice, surface of the median run",
    )


def surface_plot(axis: Any, record: dict[str, Any]) -> None:
    """Shaded mesh of a run."""
    labels = record["labels"]
    if labels.any():
        psi = 0.5 - labels.astype(np.float32)
        mesh = extract_surface(psi, Volume.from_array(labels.astype(np.uint8), 1.0).geometry)
        points = mesh.vertices
        axis.plot_trisurf(
            points[:, 0],
            points[:, 1],
            points[:, 2],
            triangles=mesh.faces,
            color="#E69F00",
            linewidth=0,
        )
    axis.set_box_aspect((1, 1, 1))
    for bounds in (axis.set_xlim, axis.set_ylim, axis.set_zlim):
        bounds(0, SIZE)
    axis.set_axis_off()
    axis.set_title(f"Dice {record['dice']:.3f}", fontsize=9)
