"""`--flow auto` beside momentum and descent: phantoms and scans of the table of defaults, from its starts.

    python -m benchmarks.flow_choice [--only NAME;NAME] [--again]

makes the tables of docs/decisions/0046-flow-by-energy.md from benchmarks/results/flow_choice.json; rows that the file
has are not run again without ``--again``. `TUNED` are the inputs that a rule by noise was found on, which was not kept.
A row misses where what ``auto`` takes is more than .002 Dice worse than the better flow, or takes more than 1.2 times
the processor's seconds of the better one, or of either where both are within .002.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf import io, segment
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.phantoms import recipe_files, recipes
from accelsurf.run.run import Run
from accelsurf.settings.flow_specs import DESCENT, MOMENTUM
from accelsurf.settings.run_config import RunConfig
from benchmarks.defaults import RESULTS_FILE, SCANS
from benchmarks.pages import head_of, put_table, row_of

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = (
    ROOT / "docs" / "decisions" / "0046-flow-by-energy.md",
    ROOT / "benchmarks/results/flow_choice.json",
)
TUNED = ("ball_small", "disc", "torus", "ball", "two_balls")
NOISE = (0.0, 0.3, 1.0, 2.0)
#: How much worse, and by which factor slower, a choice may be.
WORSE, SLOWER = 0.002, 1.2
COLUMNS = (
    "input",
    "noise",
    "momentum: Dice",
    "steps",
    "s",
    "descent: Dice",
    "steps",
    "s",
    "auto",
    "misses by",
)


class Case(NamedTuple):
    """An image with its truth and a start."""

    name: str
    noise: float | None
    image: Volume
    truth: NDArray[np.bool_]
    start: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="names, separated by semicolons")
    parser.add_argument("--again", action="store_true")
    options = parser.parse_args()
    wanted = [name for name in options.only.split(";") if name] or [
        *recipe_files.recipe_names(),
        *SCANS,
    ]
    for flow in (MOMENTUM, DESCENT):  # loads the compiled code
        segment(
            recipes.make(recipes.load_recipe("ball_small")).image,
            start="ball:0,0,0,4",
            flow=flow,
            max_steps=5,
        )
    rows = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for case in (case for name in wanted for case in cases(name)):
        key = f"{case.name} {case.noise}"
        row = {} if options.again else rows.get(key, {})
        for flow in (MOMENTUM, DESCENT):
            row[flow] = row.get(flow) or measured(case, flow)
        with Run(case.image, RunConfig(start=case.start, threads=1)) as run:
            row["auto"], row["why"] = run.flow_choice
        rows[key] = row
        print(key, json.dumps(row), flush=True)
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
        for is_tuned in (True, False):
            half = "tuning" if is_tuned else "judged"
            put_table(PAGE, half, text_of(rows, is_tuned), "python -m benchmarks.flow_choice")


def cases(name: str) -> Iterator[Case]:
    """The images of a name; those of a scan need the folder ACCELSURF_VOLUMES."""
    starts = {
        key: row["start"] for key, row in json.loads(RESULTS_FILE.read_text())["rows"].items()
    }
    if name in SCANS:
        folder, stem = Path(os.environ["ACCELSURF_VOLUMES"]), SCANS[name][0]
        if not SCANS[name][2]:
            truth = io.read_labels(folder / f"{stem}_ref.nii.gz").array > 0
            yield Case(
                name, None, io.read(folder / f"{stem}.nii.gz"), truth, starts[f"{name} None"]
            )
        return
    recipe = recipes.load_recipe(name)
    for noise in NOISE:
        made = recipes.make(recipe.changed(noise=noise * abs(recipe.contrast)))
        yield Case(
            name, noise, made.image, made.truth.array > 0, starts[f"{name} {min(noise, 1.0)}"]
        )


def measured(case: Case, flow: str) -> dict[str, Any]:
    """Dice, steps, cells visited and seconds of the processor of a run."""
    began = time.process_time()
    result = segment(case.image, start=case.start, flow=flow, threads=1)
    return {
        "dice": round(dice(result.labels > 0, case.truth), 5),
        "steps": result.stop.steps,
        "stop": result.stop.reason,
        "cells": sum(row.cells_visited for row in result.history),
        "seconds": round(time.process_time() - began, 3),
    }


def missed(row: dict[str, Any]) -> str:
    """By how much the selected flow is worse or slower than the best; empty within the limits.

    Examples
    --------
    >>> fast, good = {"dice": 0.90, "seconds": 1.0}, {"dice": 0.95, "seconds": 3.0}
    >>> missed({"auto": "gradient", "gradient": fast, "constant-density": good})
    'Dice -0.0500'
    >>> missed({"auto": "constant-density", "gradient": fast, "constant-density": good})
    ''
    """
    taken, best = row[row["auto"]], max(row[MOMENTUM]["dice"], row[DESCENT]["dice"])
    fastest = min(
        each["seconds"] for each in (row[MOMENTUM], row[DESCENT]) if each["dice"] >= best - WORSE
    )
    said = [f"Dice {taken['dice'] - best:.4f}"] if taken["dice"] < best - WORSE else []
    return ", ".join(
        said
        + ([f"{taken['seconds'] / fastest:.1f} x s"] if taken["seconds"] > SLOWER * fastest else [])
    )


def text_of(rows: dict[str, Any], is_tuned: bool) -> str:
    """The table of half of the rows, as Markdown."""
    lines = head_of(COLUMNS)
    for key, row in rows.items():
        name, _, noise = key.rpartition(" ")
        if (name in TUNED) == is_tuned and "auto" in row:
            both = [
                str(row[flow][what])
                for flow in (MOMENTUM, DESCENT)
                for what in ("dice", "steps", "seconds")
            ]
            lines.append(row_of([name, noise.replace("None", ""), *both, row["auto"], missed(row)]))
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
