"""Commands as a person types them: a run from clicks, corrected by further clicks.

The clicks are those of the simulated person of `scripts/benchmark clicks` (record 0023), in place of a person's own:
the first in the object's deepest point, each further one in the deepest point of all that is wrong. Coordinates are
rounded to a tenth of the smallest spacing.
"""

from __future__ import annotations

import json
import math
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure import metrics
from benchmarks.clicks.person import PersonClick, next_click

#: What rows keep of a run's report.
KEPT = ("stop", "levels", "resolved_settings", "volume_mm3", "peak_rss_mb", "quality", "warnings")


def text_of(click: PersonClick, geometry: Geometry) -> str:
    """A click as it is typed, rounded.

    Examples
    --------
    >>> text_of(PersonClick("inside", (2, 3, 4), (4.0, 3.04, 2.0), 2.5), Geometry((9, 9, 9), (1.0, 1.0, 1.0)))
    'ball:4.0,3.0,2.0,2.5'
    >>> text_of(PersonClick("outside", (2, 3, 4), (4.0, 3.0, 2.0), 0.5), Geometry((9, 9, 9), (1.0, 1.0, 1.0)))
    'point:4.0,3.0,2.0'
    """
    least = min(geometry.spacing)
    digits = max(0, math.ceil(1 - math.log10(least)))
    numbers = [f"{value:.{digits}f}" for value in (*click.centre, click.radius)]
    return (
        f"point:{','.join(numbers[:3])}"
        if click.radius <= 0.5 * least
        else f"ball:{','.join(numbers)}"
    )


def call(words: Sequence[str], folder: Path) -> dict[str, Any]:
    """Run `accelsurf` with these words in a folder: exit code, seconds, the message of a failure."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "accelsurf", *words], capture_output=True, text=True, cwd=folder
    )
    row: dict[str, Any] = {"exit_code": done.returncode, "seconds": time.perf_counter() - began}
    return row | ({"error": done.stderr.strip() or "no message"} if done.returncode else {})


def results_of(target: Path, name: str) -> dict[str, Any]:
    """What rows keep of the report in a folder of outputs."""
    report = json.loads((target / f"{name}_report.json").read_text())
    row = {key: report[key] for key in KEPT}
    row["levels"] = len(report["levels"])
    return row


def play(
    source: Path,
    target: Path,
    truth: Volume,
    options: Sequence[str] = (),
    clicks: int = 3,
    threads: int = 2,
) -> list[dict[str, Any]]:
    """`accelsurf segment --inside` and then `accelsurf refine`, a click each.

    Parameters
    ----------
    source, target : Path
        The image (.nii.gz), and the folder of the outputs, which is named in the commands without its parents.
    truth : Volume
        The object, 1 inside.
    options : sequence of str
        Of the first command, beside its click.
    clicks, threads : int
        Number of clicks at most; fewer where nothing is wrong any more.

    Returns
    -------
    list of dict
        A row for each click: `command`, what `call` and `results_of` say, and `metrics` of the labels. The last one has
        an `error` where a command failed.
    """
    rows: list[dict[str, Any]] = []
    name, labels = source.name.removesuffix(".nii.gz"), None
    for number in range(clicks):
        click = next_click(truth.array > 0, labels, truth.geometry)
        if click is None:
            break
        side = [f"--{click.side}", text_of(click, truth.geometry)]
        begin = ["refine", target.name] if number else ["segment", source.name, "-o", target.name]
        row: dict[str, Any] = {
            "command": shlex.join(["accelsurf", *begin, *side, *([] if number else options)])
        }
        if number:
            words = ["refine", str(target), *side, "--quiet"]
        else:
            words = [
                "segment",
                str(source),
                "-o",
                str(target),
                *side,
                *options,
                "--threads",
                str(threads),
            ]
            words += ["--overwrite", "--quiet"]
        rows.append(row | call(words, target.parent))
        if rows[-1]["exit_code"]:
            break
        found = io.read_labels(target / f"{name}_seg.nii.gz")
        labels = np.asarray(found.array > 0)
        rows[-1] |= results_of(target, name) | {"metrics": metrics.evaluate(found, truth).to_dict()}
    return rows
