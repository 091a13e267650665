"""`speed`: steps and seconds to the minimum of a regularised energy, as the grid is refined.

One physical problem: a soft ball of radius 20 mm in a cube of 64 mm (in 2D a disc in a square), Chan-Vese with the
area weight 2 mm, from an ellipsoid off its centre; 32 to 128 voxels a side. Descent must take steps of h^2, momentum
takes steps of h. Each flow has its own stable step, the same limiter; counted are the steps until the energy is within
1 % of the least that any flow reached on that grid.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from accelsurf.energies import ChanVese
from accelsurf.evolution.convergence import Restart
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, Flow, FlowableMass, Gradient, Sobolev, StepLimits
from accelsurf.levelset import LevelSet
from benchmarks.figures.common import COLOURS, write
from benchmarks.figures.planar import save

WIDTH, ALPHA = 64.0, 2.0
SIZES = {3: (32, 48, 64, 96, 128), 2: (32, 48, 64, 96, 128, 192, 256)}
#: Where seconds are compared: the largest grid that every flow has run on.
COMPARED = {3: 96, 2: 256}
BUDGET = 4000


def flows() -> dict[str, Flow]:
    """The flows compared, new."""
    return {
        "gradient": Gradient(),
        "Sobolev, 10 mm": Sobolev(10.0),
        "constant density": ConstantDensity(),
        "flowable mass": FlowableMass(),
    }


def problem(n: int, dim: int) -> tuple[LevelSet, ChanVese]:
    """The problem on a grid of ``n`` voxels a side."""
    h = WIDTH / n
    axis = (np.arange(n) + 0.5) * h - 0.5 * WIDTH
    z = axis if dim == 3 else np.zeros(1)
    z, y, x = np.meshgrid(z, axis, axis, indexing="ij")
    image = 0.5 * (1.0 - np.tanh((np.sqrt(x**2 + y**2 + z**2) - 20.0) / 3.0))
    start = np.sqrt(((x - 6) / 18) ** 2 + ((y + 4) / 10) ** 2 + (z / 10) ** 2) - 1.0
    return LevelSet(10.0 * start, (h, h, h), 4.0), ChanVese(image, ALPHA, means=(1.0, 0.0))


def history(
    flow: Flow, n: int, dim: int, steps: int, enough: float = -np.inf
) -> dict[str, np.ndarray]:
    """Energy, cells visited and seconds at every step, until it has settled or the energy is ``enough``."""
    surface, energy = problem(n, dim)
    evolution = Evolution(
        surface, energy, SolverSetup(flow, StepLimits(0.5, 95.0), restart=Restart()), steps
    )
    energies = []
    cells = [0]
    seconds = [0.0]
    for step in evolution:
        energies.append(step.record.potential)
        cells.append(cells[-1] + step.record.cells_visited)
        seconds.append(seconds[-1] + step.record.seconds)
        if is_steady(energies) or energies[-1] <= enough:
            break
    return {"energy": np.array(energies), "cells": np.array(cells), "seconds": np.array(seconds)}


def is_steady(energies: list[float]) -> bool:
    """Whether the last half of the steps, 30 at least, won less than a thousandth of all that was won."""
    half = len(energies) // 2
    won = energies[0] - min(energies)
    return half >= 30 and won > 0 and min(energies[:half]) - min(energies) < 1e-3 * won


def speed(output: Path) -> None:
    """Run every flow on every grid, in 2D and 3D."""
    history(ConstantDensity(), 32, 2, 3)  # compile
    history(Sobolev(), 32, 3, 3)
    history(FlowableMass(), 32, 3, 3)
    lines, slopes = [], []
    began = time.perf_counter()
    for dim, sizes in SIZES.items():
        for n in sizes:
            runs = {
                name: history(flow, n, dim, BUDGET)
                for name, flow in flows().items()
                if worth(name, n, dim)
            }
            least = min(float(run["energy"].min()) for run in runs.values())
            for name, run in runs.items():
                lines.append(line(name, n, dim, run, least))
                print(text(lines[-1]), f"({time.perf_counter() - began:.0f} s)", flush=True)
    for dim in SIZES:
        for name in flows():
            found = [
                (e["n"], e["steps"])
                for e in lines
                if (e["dim"], e["flow"]) == (dim, name) and e["steps"]
            ]
            if len(found) >= 3:
                slope = float(np.polyfit(*np.log(np.array(found, float)).T, 1)[0])
                slopes.append({"flow": name, "dim": dim, "slope": slope, "grids": len(found)})
                print(f"{dim}D {name:18s} steps grow as n^{slope:.2f}")
    ratios = speed_ups(lines)
    draw(output, lines, slopes)
    write(output, "speed", {"alpha_mm": ALPHA, "lines": lines, "slopes": slopes, "ratios": ratios})


def worth(name: str, n: int, dim: int) -> bool:
    """Flows with a dear step are not run on the largest grid in 3D."""
    return dim == 2 or n <= 96 or name in ("gradient", "constant density")


def line(name: str, n: int, dim: int, run: dict[str, np.ndarray], least: float) -> dict[str, Any]:
    """When a run came within 1 % of the least energy, and what it cost."""
    gap = run["energy"] - least
    there = np.flatnonzero(gap <= 0.01 * gap[0])
    at = int(there[0]) if there.size else None
    steps = len(run["energy"]) - 1
    return {
        "flow": name,
        "dim": dim,
        "n": n,
        "steps": at,
        "seconds": None if at is None else float(run["seconds"][at]),
        "cells_visited": None if at is None else int(run["cells"][at]),
        "milliseconds_per_step": 1e3 * float(run["seconds"][steps]) / max(steps, 1),
        "cells_per_step": float(run["cells"][steps]) / max(steps, 1),
    }


def text(entry: dict[str, Any]) -> str:
    """A line as text."""
    total = (
        "not reached"
        if entry["steps"] is None
        else f"{entry['steps']:5d} steps, {entry['seconds']:7.2f} s"
    )
    each = f"{entry['milliseconds_per_step']:.1f} ms per step"
    return f"{entry['dim']}D {entry['n']:4d} {entry['flow']:18s} {total}, {each}"


def speed_ups(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Seconds and cells of the others over those of constant density, at the grids that are compared."""
    ratios = []
    for dim, n in COMPARED.items():
        at = {entry["flow"]: entry for entry in lines if (entry["dim"], entry["n"]) == (dim, n)}
        best = at["constant density"]
        for name, entry in at.items():
            if entry["steps"] and best["steps"] and entry is not best:
                ratios.append(
                    {
                        "flow": name,
                        "dim": dim,
                        "n": n,
                        **{
                            key: entry[key] / best[key]
                            for key in ("steps", "seconds", "cells_visited", "cells_per_step")
                        },
                    }
                )
                print(
                    f"{dim}D, {n}: {name} takes {ratios[-1]['seconds']:.1f} times the seconds and "
                    f"{ratios[-1]['cells_visited']:.1f} times the cells of constant density"
                )
    return ratios


def draw(output: Path, lines: list[dict[str, Any]], slopes: list[dict[str, Any]]) -> None:
    """Steps against the grid, 2D and 3D."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.4))
    for axis, dim in zip(axes, (2, 3), strict=True):
        for (name, colour), marker in zip(zip(flows(), COLOURS, strict=False), "os^D", strict=True):
            found = [
                (e["n"], e["steps"])
                for e in lines
                if (e["dim"], e["flow"]) == (dim, name) and e["steps"]
            ]
            if not found:
                continue
            slope = [s["slope"] for s in slopes if (s["dim"], s["flow"]) == (dim, name)]
            label = name + (f": n^{slope[0]:.2f}" if slope else "")
            axis.loglog(*zip(*found, strict=True), marker=marker, color=colour, label=label)
        axis.set_xlabel("voxels per side, n")
        axis.set_ylabel("steps to 1 % of the energy gap")
        axis.set_title(f"{dim}D", fontsize=10)
        axis.grid(True, which="both", alpha=0.3)
        axis.legend(fontsize=8)
    save(
        figure,
        output,
        "speed",
        f"Regularised energy (area weight {ALPHA:g} mm), each flow at its own stable step",
    )
