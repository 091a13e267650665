"""Runs that write their state, are killed at seeded moments, and go on: do they end with the same bytes?

One run has everything whose state could be lost: five objects that meet, two levels, random noise, an edit. It is
killed again and again, at any moment from its first to its last, and repeated with ``--resume`` until it ends.
"""

from __future__ import annotations

import csv
import hashlib
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.image.volume import Volume

SHAPE = (32, 40, 48)
CENTRES = ((16, 12, 12), (16, 12, 30), (16, 28, 12), (16, 28, 30), (16, 20, 40))
#: Files that must be the same, and columns of tables that need not be: what the work took.
PATTERNS = ("*_seg.nii.gz", "*.ply", "*_preview.png", "*_objects.csv", "*_trace.csv")
EFFORT = frozenset({"seconds", "cells_visited"})
#: Of a run that is killed before it ends at the most so often, in a row.
MAX_KILLS = 3


def prepared(folder: Path) -> list[str]:
    """Make image and seeds; return the words of the command, without its output folder."""
    folder.mkdir(parents=True, exist_ok=True)
    places = np.indices(SHAPE)
    nearest = np.min(
        [sum((p - c) ** 2 for p, c in zip(places, at, strict=True)) for at in CENTRES], axis=0
    )
    image = 100.0 * (nearest < 9**2) + np.random.default_rng(5).normal(0, 25, SHAPE)
    seeds = np.zeros(SHAPE, np.uint8)
    for id, (z, y, x) in enumerate(CENTRES, start=1):
        seeds[z - 2 : z + 3, y - 2 : y + 3, x - 2 : x + 3] = id
    io.write(Volume.from_array(image.astype(np.float32), 1.0), folder / "cells.nii.gz")
    io.write(Volume.from_array(seeds, 1.0), folder / "seeds.nii.gz")
    words = [
        "segment",
        str(folder / "cells.nii.gz"),
        "--objects",
        str(folder / "seeds.nii.gz"),
        "--levels",
        "2",
    ]
    words += [
        "--noise",
        "0.05",
        "--seed",
        "7",
        "--max-steps",
        "60",
        "--edit",
        "step=8 smoothness=0.3",
    ]
    return [*words, "--threads", "1", "--checkpoint", "2"]


def started(words: list[str], out: Path) -> subprocess.Popen[str]:
    """A run in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words, "-o", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def content(out: Path) -> dict[str, str]:
    """SHA-256 of the files that must be the same."""
    paths = sorted(path for pattern in PATTERNS for path in out.glob(pattern))
    return {path.name: hashlib.sha256(without_effort(path)).hexdigest() for path in paths}


def without_effort(path: Path) -> bytes:
    """The bytes of a file; of a table without the columns in `EFFORT`."""
    if path.suffix != ".csv":
        return path.read_bytes()
    with path.open(encoding="utf-8", newline="") as file:
        rows = [
            {key: value for key, value in row.items() if key not in EFFORT}
            for row in csv.DictReader(file)
        ]
    return repr(rows).encode()


def trials(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Kill ``count`` runs and let them go on; return counts and faults."""
    chance, words = random.Random(seed), prepared(folder)
    faults: list[str] = []
    counts = {"runs": 0, "kills": 0, "from a state": 0, "from the beginning": 0, "had ended": 0}
    if count == 0:
        return {**counts, "faults": faults}
    began = time.perf_counter()
    finished(started(words, folder / "whole"))
    seconds = time.perf_counter() - began
    whole = content(folder / "whole")
    for number in range(1, count + 1):
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        counts["runs"] += 1
        moments = [chance.uniform(0.0, 1.1 * seconds) for _ in range(chance.randint(1, MAX_KILLS))]
        for moment in moments:
            killed(started([*words, "--resume"], out), moment)
            counts["kills"] += 1
            counts[_left(out)] += 1
        code, error = finished(started([*words, "--resume"], out))
        said = f"killed after {', '.join(f'{moment:.3f}' for moment in moments)} s"
        if code != 0 or content(out) != whole:
            faults.append(f"{said}: exit {code}, other files than without kills; {error[-300:]!r}")
        if (out / "cells_checkpoint.npz").exists() or list(out.glob(".*")):
            faults.append(f"{said}: something is left")
        if number % 10 == 0:
            print(
                f"resumed: {number} of {count}, {len(faults)} faults", file=sys.stderr, flush=True
            )
    return {**counts, "seconds_of_a_run": round(seconds, 2), "faults": faults}


def _left(out: Path) -> str:
    """What a killed run has left."""
    if (out / "cells_report.json").exists():
        return "had ended"
    return "from a state" if (out / "cells_checkpoint.npz").exists() else "from the beginning"


def killed(program: subprocess.Popen[str], moment: float) -> None:
    """Kill a run after some seconds, if it has not ended by then."""
    try:
        program.wait(moment)
    except subprocess.TimeoutExpired:
        program.kill()
    program.communicate()


def finished(program: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and errors of an undisturbed run."""
    _, error = program.communicate(timeout=600)
    return program.returncode, error
