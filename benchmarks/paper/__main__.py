"""The paper's experiments in 3D, every run to rest: tables in docs/explanation/paper.md, figures and JSON beside them.

    python -m benchmarks.paper [EXPERIMENT...] [--jobs N]

Three quarters of an hour on one core for all. Experiments that are not named keep what the JSON has of them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from accelsurf.measure.metrics import dice
from benchmarks.figures.common import plain
from benchmarks.paper import pictures, tables
from benchmarks.paper.experiments import EXPERIMENTS
from benchmarks.paper.runs import ridge, run
from benchmarks.paper.tables import groups

ROOT = Path(__file__).resolve().parents[2]
PAGE, FIGURES = ROOT / "docs" / "explanation" / "paper.md", ROOT / "docs" / "figures"
Tell = Callable[[dict[str, Any]], None]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "experiment", nargs="*", help=f"some of {', '.join(EXPERIMENTS)}; all unless given"
    )
    parser.add_argument(
        "--jobs", type=int, default=1, help="processes; seconds are those of a processor"
    )
    parser.add_argument(
        "--tables", action="store_true", help="only write the tables again, from the JSON"
    )
    options = parser.parse_args()
    unknown = set(options.experiment) - set(EXPERIMENTS)
    if unknown:
        parser.error(f"no experiment {', '.join(sorted(unknown))}")
    matplotlib.use("Agg")
    path = FIGURES / "paper.json"
    done = json.loads(path.read_text())["runs"] if path.exists() else []
    if options.tables:
        tables.write(PAGE, done)
        return
    for name in options.experiment or EXPERIMENTS:
        runs = run_all(name, options.jobs)
        done = [entry for entry in done if entry["experiment"] != name] + [
            plain(entry) for entry in runs
        ]
        path.write_text(json.dumps({"runs": done}, indent=1) + "\n")
        pictures.draw(name, runs, FIGURES)
        tables.write(PAGE, done)
        print(f"{name}: written to {path}, {PAGE}", flush=True)


def run_all(name: str, jobs: int) -> list[dict[str, Any]]:
    """Run the tasks of an experiment, in order."""
    runs = []
    with ProcessPoolExecutor(jobs) as pool:
        for figures in pool.map(ridge if name == "ridge" else run, EXPERIMENTS[name]):
            runs.append(figures)
            tell(figures)
    if name != "ridge":
        alike = ("landscape", "method", "seed", "noise", "limits", "epsilon", "remedy")
        for group in groups(runs, *alike).values():
            for entry in group:
                entry["agreement"] = min(dice(entry["labels"], other["labels"]) for other in group)
    return runs


def tell(figures: dict[str, Any]) -> None:
    """Print a run as it ends."""
    what = (
        f"{figures['experiment']}: {figures['landscape']}, {figures['start']}, {figures['method']}, seed "
        f"{figures['seed']}, {figures['limits']} steps, noise {figures['noise']:g}, epsilon {figures['epsilon']:g}, "
        f"remedy {figures['remedy']}: "
    )
    if "crest" in figures:
        print(f"{what}least {figures['least']:.0f}, crest {figures['crest']:.0f}", flush=True)
        return
    later = figures.get("later_dice", np.nan)
    print(
        f"{what}Dice {figures['dice']:.3f}, later {later:.3f}, {figures['steps']} steps, {figures['stop']}, "
        f"{figures['seconds']:.1f} s",
        flush=True,
    )


if __name__ == "__main__":
    main()
