"""`exact`: radius against the exact radius for every model that has an exact solution; order of convergence."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.figures.common import COLOURS, PROCESSES, write
from benchmarks.figures.planar import save
from tests.support import exact
from tests.support.follow import STEP, WIDTH, Misfit, follow, lattice, order

SIZES = (32, 48, 64)
MODELS = {
    "A": "sphere, area only",
    "B": "sphere in a well",
    "C": "sphere, Chan-Vese",
    "D": "flowable sphere in a well",
    "E": "flowable sphere, Chan-Vese",
    "F": "circle, Chan-Vese",
    "G": "C with constant friction",
    "H": "C with k = 3",
    "J": "flowable circle in a well",
    "K": "C with k = 4",
    "L": "C with k = 1 from t0 = 0.3",
    "M": "E with k = 0.6 from t0 = 0.3",
}


def run(job: tuple[str, int]) -> tuple[Misfit, list[tuple[float, float]]]:
    """Follow a case on a grid; the misfit, and the mean radius over time."""
    name, n = job
    case = exact.CASES[name]
    radii: list[tuple[float, float]] = []
    misfit = follow(case, lattice(n, flat=case.dim == 2), STEP[name] * WIDTH / (n - 1), radii=radii)
    return misfit, radii


def exact_solutions(output: Path) -> None:
    """Every case on every grid."""
    jobs = [(name, n) for name in MODELS for n in SIZES]
    with ProcessPoolExecutor(PROCESSES) as pool:
        found = dict(zip(jobs, pool.map(run, jobs), strict=True))
    table: list[dict[str, Any]] = []
    figure, axes = plt.subplots(3, 4, figsize=(14, 9))
    for axis, (name, words) in zip(axes.flat, MODELS.items(), strict=True):
        misfits = [found[name, n][0] for n in SIZES]
        h = [WIDTH / (n - 1) for n in SIZES]
        table.append(
            {
                "case": name,
                "model": words,
                "point_error_voxels": [m.point / step for m, step in zip(misfits, h, strict=True)],
                "mean_error_voxels": [m.mean / step for m, step in zip(misfits, h, strict=True)],
                "order_of_mean": order([m.mean for m in misfits], SIZES),
                "order_of_point": order([m.point for m in misfits], SIZES),
            }
        )
        line = table[-1]
        print(
            f"{name} {words:32s} worst point at 64: {line['point_error_voxels'][2]:.4f} h, order "
            f"{line['order_of_mean']:.2f} (mean), {line['order_of_point']:.2f} (worst point)",
            flush=True,
        )
        t, radius = np.array(found[name, 32][1]).T
        path = exact.path(exact.CASES[name])
        fine = np.linspace(0.0, exact.CASES[name].t_end, 200)
        axis.plot(fine, [path(s) for s in fine], color=COLOURS[0], label="exact")
        axis.plot(
            t[::4], radius[::4], "o", markersize=3, color=COLOURS[5], label="32 voxels a side"
        )
        axis.set_title(
            f"{name}: {words}\nworst point at 64: {line['point_error_voxels'][2]:.4f} h", fontsize=8
        )
        axis.grid(True, alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    save(figure, output, "exact", "Radius (mm) against flow time")
    write(output, "exact", {"sizes": SIZES, "table": table})
