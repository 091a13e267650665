"""`start`: seconds of whole commands as a person waits for them, and where the processor's seconds of a run go."""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from accelsurf import io
from accelsurf.image.volume import Volume
from benchmarks.peers.measure import Options, Timing, goal, run_process, set_threads, table
from benchmarks.peers.work import noisy_cube

COLD_RUNS = 2
#: Seconds that a person shall wait at most, by command, where the imports of every command take `IMPORTS_TAKE`.
WANTED = {"help": 0.2, "look": 0.5, "start": 2.0, "click": 2.0, "refine": 1.5, "cold": 30.0}
#: What no command does without, and its seconds on the machine that the wanted seconds are for.
IMPORTS, IMPORTS_TAKE = "import numpy, scipy.ndimage, SimpleITK, numba, pydantic, cyclopts", 0.58


def start(options: Options) -> dict[str, Any]:
    """Time the commands as a user types them."""
    set_threads(options.threads)
    side = 24 if options.quick else 96
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image, _, begin, _ = noisy_cube(side)
        io.write(Volume.from_array(image, 1.0), folder / "cube.nii.gz")
        words = commands(folder, side, begin)
        for command in ("start", "click", "refine"):  # compile
            run_process(words[command], options.threads)
        words["imports"] = [sys.executable, "-c", IMPORTS]
        times = {which: _repeated(command, options, folder) for which, command in words.items()}
        times["cold"] = _repeated(words["start"], options, folder, cold=True)
        parts = {which: parts_of(words[which], options) for which in ("start", "click")}
    titles = {
        "help": "accelsurf --help",
        "look": "accelsurf look",
        "start": f"accelsurf segment --start, {side}^3",
        "click": f"accelsurf segment --inside, {side}^3",
        "refine": "accelsurf refine",
        "cold": f"accelsurf segment --start, {side}^3, nothing compiled",
        "imports": "imports of every command",
    }
    slower = IMPORTS_TAKE / times["imports"].median
    return {
        "work": f"whole commands, the cube in noise in {side}^3, {options.threads} threads, files written",
        "threads": options.threads,
        "times": {titles[which]: time.to_dict() for which, time in times.items()},
        "pairs": [
            {
                "pair": f"{titles[one]} / {titles[by]}",
                "ratio": times[one].median / times[by].median,
                "sense": "<=",
            }
            for one, by in (
                ("start", "imports"),
                ("click", "imports"),
                ("refine", "imports"),
                ("click", "start"),
                ("cold", "start"),
            )
        ],
        "goals": [
            goal(
                f"{titles[which]}; imports {IMPORTS_TAKE} s",
                seconds,
                times[which].median * slower,
                "<=",
                "s",
            )
            for which, seconds in WANTED.items()
        ],
        "tables": [
            table(
                "Commands",
                ("command", "seconds", "runs"),
                [(titles[which], time.median, len(time.seconds)) for which, time in times.items()],
            ),
            table(
                "Where the processor's seconds go, one thread",
                ("part", titles["start"], titles["click"]),
                [(part, *(parts[which].get(part) for which in parts)) for part in parts["click"]],
            ),
        ],
        "bars": [[titles[which], time.median] for which, time in times.items()],
    }


def commands(folder: Path, side: int, begin: str) -> dict[str, list[str]]:
    """The words of each command by its short name; `refine` corrects what `click` has written, elsewhere.

    The click is a ball of 4 voxels: one voxel in noise as strong as the contrast says nothing of the tissue.
    """
    python, cube = [sys.executable, "-m", "accelsurf"], str(folder / "cube.nii.gz")
    segment = [*python, "segment", cube, "--overwrite", "--quiet", "-o"]
    middle = ",".join([f"{side / 2:g}"] * 3)
    beside = f"{side / 2 + 0.3 * side:g},{side / 2:g},{side / 2:g}"
    return {
        "help": [*python, "--help"],
        "look": [*python, "look", cube, "-o", str(folder / "look.png"), "--overwrite"],
        "start": [*segment, str(folder / "start"), "--start", begin, "--presmooth", "1"],
        "click": [*segment, str(folder / "click"), "--inside", f"ball:{middle},4"],
        "refine": [
            *python,
            "refine",
            str(folder / "click"),
            "-o",
            str(folder / "refined"),
            "--overwrite",
            "--quiet",
            "--outside",
            f"point:{beside}",
        ],
    }


def parts_of(command: list[str], options: Options) -> dict[str, float]:
    """Seconds of the processor by part of a command, on one thread: the median of each."""
    call = [sys.executable, "-m", "benchmarks.start_parts", *command[3:], "--threads", "1"]
    runs = [json.loads(run_process(call, 1)[1].splitlines()[-1]) for _ in range(options.repeats)]
    return {part: statistics.median(run.get(part, 0.0) for run in runs) for part in runs[0]}


def _repeated(command: list[str], options: Options, folder: Path, cold: bool = False) -> Timing:
    count = options.repeats if not cold else 1 if options.quick else COLD_RUNS
    seconds = []
    for i in range(count):
        more = {"NUMBA_CACHE_DIR": str(folder / f"cache{i}")} if cold else {}
        seconds.append(run_process(command, options.threads, **more)[0])
    return Timing(seconds)
