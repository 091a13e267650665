"""What a converged surface still does: how far 200 steps more move it, with the stop rule's forecast and without.

Phantoms without and with noise (sigma in contrasts), both mass models and descent. After the stop the run goes on
without a stop rule; the surface is compared with where it had stopped. ``python -m benchmarks.stop_rule``
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution.convergence import StopRule
from accelsurf.image.volume import Volume
from accelsurf.levelset import LevelSet
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

N = 32
#: Steps after the stop.
MORE = 200
NOISES = (0.0, 0.3, 1.0)
FLOWS = ("constant-density", "flowable-mass", "gradient")
STARTS = {"ball": "ball:15,15,12,5", "cube": "ball:15,15,12,5", "angle": "ball:10,10,15,4"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path(__file__).parent / "results" / "stop_rule.json"
    )
    parser.add_argument("--max-steps", type=int, default=400)
    parser.add_argument("--levels", type=int, default=1)
    parser.add_argument(
        "--energy",
        default="chan-vese:area=0",
        help="by default one that lets a surface follow noise",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    options = parser.parse_args()
    rows = []
    for noise, shape, flow in itertools.product(NOISES, STARTS, FLOWS):
        image = phantom(shape, noise, options.seed)
        config = RunConfig(
            energy=options.energy,
            flow=flow,
            levels=options.levels,
            max_steps=options.max_steps,
            threads=1,
            start=(STARTS[shape],),
            smoothness=0.0,
        )
        row: dict[str, Any] = {"shape": shape, "noise": noise, "flow": flow}
        row["without forecast"] = measured(image, config, math.inf)
        row["with forecast"] = measured(image, config, None)
        rows.append(row)
        print(json.dumps(row), flush=True)
    options.output.write_text(
        json.dumps({"voxels": N, "levels": options.levels, "runs": rows}, indent=1) + "\n"
    )


def phantom(shape: str, noise: float, seed: int = 0) -> NDArray[np.float32]:
    """A shape of value 1 in 0, with Gaussian noise."""
    z, y, x = np.indices((N, N, N)) - 0.5 * (N - 1)
    if shape == "ball":
        image = np.clip(0.3 * N - np.sqrt(z**2 + y**2 + x**2) + 0.5, 0, 1)
    elif shape == "cube":
        image = 1.0 * (np.maximum(np.maximum(abs(z), abs(y)), abs(x)) < 0.25 * N)
    else:
        plate = (abs(z) < 0.15 * N) & (abs(y) < 0.3 * N) & (abs(x) < 0.3 * N)
        image = 1.0 * (plate & ~((y > -0.05 * N) & (x > -0.05 * N)))
    return (image + np.random.default_rng(seed).normal(0, noise, image.shape)).astype(np.float32)


def measured(
    image: NDArray[np.float32], config: RunConfig, further: float | None
) -> dict[str, Any]:
    """Steps to the stop, its reason, and the motion in the steps that follow; ``further`` of the rule unless None."""
    with Run(Volume.from_array(image), config) as run:
        if further is not None:
            evolution = run.objects[0].evolution
            evolution.rule = (evolution.rule or StopRule())._replace(further=further)
        for _ in run:
            pass
        evolution = run.objects[0].evolution
        assert evolution.stop is not None
        result: dict[str, Any] = {"reason": evolution.stop.reason, "steps": evolution.stop.steps}
        surface = evolution.surface
        cells, psi = surface.band.cells, surface.band.psi
        evolution.history.pop()
        evolution.stop = None
        evolution.rule = None
        evolution.max_steps = 10**9
        for _ in range(MORE):
            if evolution.step() is None:
                break
        mean, percentile = distances(surface, cells, psi)
    return result | {"mean": round(mean, 4), "percentile 99": round(percentile, 3)}


def distances(
    surface: LevelSet, cells: NDArray[np.int64], psi: NDArray[np.float32]
) -> tuple[float, float]:
    """Mean and 99th percentile over the area of the distance from an earlier band, voxels; isotropic spacing."""
    area = surface.fraction_and_area()[1]
    on = np.flatnonzero(area)
    at = np.minimum(np.searchsorted(cells, surface.band.cells[on]), cells.size - 1)
    known = cells[at] == surface.band.cells[on]
    far = np.where(
        known, np.abs(surface.band.psi[on] - psi[at]) / surface.smallest_spacing, surface.half_width
    )
    order = np.argsort(far)
    share = np.cumsum(area[on][order]) / area.sum()
    return float((area[on] * far).sum() / area.sum()), float(
        far[order][np.searchsorted(share, 0.99)]
    )


if __name__ == "__main__":
    main()
