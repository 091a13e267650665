"""Three starts on a noisy cube: how near do they come to one surface? Momentum against descent, same step control.

Both have the same few steps. Descent is not at rest after the default 400, so its rows say how far it has come:
``--max-steps 2000`` lets it go on.

The paper's claim (its figures 2 and 3) in 3D: contrast 1, noise sigma 1 per voxel, no smoothing of the result. Shown
beside it is what helps descent as well: the same diffusion of its speeds, the limiter of the default settings (it
lets the fastest twentieth of the surface set no limit, and makes descent faster), an area weight,
presmoothing.
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
import time
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from accelsurf.api.segment import Result, segment
from accelsurf.measure.metrics import dice
from accelsurf.phantoms.recipes import load_recipe, make
from accelsurf.settings.run_config import RunConfig

#: World mm; the cube spans -24 to 24 in x, y and z.
STARTS = {
    "inside a corner": "ball:-16,-16,-16,6",
    "off centre": "ball:9,-6,3,8",
    "half outside": "ball:-24,0,0,7",
}
#: The claim is tested where the limiter holds nothing back and steps are short, so that only momentum differs.
FINE = {"cfl": 0.25, "percentile": 100.0}
#: What differs from the common settings.
VARIANTS: dict[str, dict[str, Any]] = {
    "constant density": {"flow": "constant-density", **FINE},
    "gradient": {"flow": "gradient", **FINE},
    "gradient, same diffusion": {"flow": "gradient", "diffusion": "free", **FINE},
    "constant density, defaults": {"flow": "constant-density"},
    "gradient, defaults": {"flow": "gradient"},
    "constant density, defaults, smoothness 0.02 mm": {
        "flow": "constant-density",
        "smoothness": 0.02,
    },
    "gradient, defaults, smoothness 0.02 mm": {"flow": "gradient", "smoothness": 0.02},
    "constant density, defaults, presmooth 1 mm": {"flow": "constant-density", "presmooth": 1.0},
    "gradient, defaults, presmooth 1 mm": {"flow": "gradient", "presmooth": 1.0},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--max-steps", type=int, default=400)
    parser.add_argument(
        "--seed", type=int, default=None, help="of the noise; the recipe's unless given"
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", default="", help="variants whose name contains this")
    options = parser.parse_args()

    recipe = load_recipe("cube_noisy")
    phantom = make(recipe if options.seed is None else recipe.changed(seed=options.seed))
    common = RunConfig(
        energy="chan-vese:area=0",
        smoothness=0.0,
        levels=1,
        max_steps=options.max_steps,
        threads=options.threads,
    )
    rows, labels = [], {}
    for name, changes in VARIANTS.items():
        if options.only not in name:
            continue
        config = common.replace(**changes)
        results = {
            start: timed(phantom.image, config.replace(start=where))
            for start, where in STARTS.items()
        }
        labels[name] = [result.labels for result, _ in results.values()]
        rows.append(describe(name, config, results, phantom.truth.array))
        print_row(rows[-1])

    options.output.mkdir(parents=True, exist_ok=True)
    record = {
        "recipe": phantom.recipe.model_dump(mode="json"),
        "starts": STARTS,
        "machine": {
            "processor": platform.machine(),
            "python": platform.python_version(),
            "threads": options.threads,
        },
        "variants": rows,
    }
    (options.output / "three_starts.json").write_text(json.dumps(record, indent=1) + "\n")
    draw(labels, rows, phantom.truth.array, options.output / "three_starts.png")
    print(f"written: {options.output / 'three_starts.json'}, .png")


def timed(image: Any, config: RunConfig) -> tuple[Result, float]:
    began = time.perf_counter()
    return segment(image, config=config), time.perf_counter() - began


def describe(
    name: str, config: RunConfig, results: dict[str, tuple[Result, float]], truth: np.ndarray
) -> dict:
    labels = [result.labels for result, _ in results.values()]
    return {
        "name": name,
        "config": config.model_dump(mode="json"),
        "agreement": min(dice(a, b) for a, b in itertools.combinations(labels, 2)),
        "starts": {
            start: {
                "dice": dice(result.labels, truth),
                "steps": result.stop.steps,
                "stop": result.stop.reason,
                "energy": result.history[-1].potential,
                "area_mm2": result.area_mm2,
                "band_updates": sum(row.band_cells for row in result.history),
                "seconds": seconds,
            }
            for start, (result, seconds) in results.items()
        },
    }


def print_row(row: dict) -> None:
    runs = row["starts"].values()
    dices = "/".join(f"{run['dice']:.3f}" for run in runs)
    steps = "/".join(f"{run['steps']}" for run in runs)
    stops = "/".join(run["stop"] for run in runs)
    seconds = "/".join(f"{run['seconds']:.0f}" for run in runs)
    print(
        f"{row['name']:46s} Dice {dices}  agreement {row['agreement']:.3f}  steps {steps}  {stops}  s {seconds}"
    )


def draw(
    labels: dict[str, list[np.ndarray]], rows: list[dict], truth: np.ndarray, path: Path
) -> None:
    figure, axes = plt.subplots(1, len(rows), figsize=(3.2 * len(rows), 3.6), squeeze=False)
    middle = truth.shape[0] // 2
    for axis, row in zip(axes[0], rows, strict=True):
        axis.imshow(truth[middle], cmap="gray", vmin=-1, vmax=2, origin="lower")
        for one, colour in zip(labels[row["name"]], ("#0072B2", "#E69F00", "#009E73"), strict=True):
            axis.contour(one[middle], [0.5], colors=[colour], linewidths=1.2)
        axis.set_title(f"{row['name']}\nagreement {row['agreement']:.3f}", fontsize=8)
        axis.set_axis_off()
    figure.suptitle(
        "Three starts (colours) on the noisy cube (grey: truth), middle slice", fontsize=9
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
