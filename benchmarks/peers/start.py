"""`start`: seconds of the whole commands `accelsurf --help` and `accelsurf segment`, warm and without compiled code."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from accelsurf import io
from accelsurf.grid.volume import Volume
from benchmarks.peers.measure import Options, Timing, goal, run_process, set_threads, table
from benchmarks.peers.work import noisy_cube

COLD_RUNS = 2


def start(options: Options) -> dict[str, Any]:
    """Time the commands as a user types them."""
    set_threads(options.threads)
    side = 24 if options.quick else 96
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image, _, begin, _ = noisy_cube(side)
        io.write(Volume.from_array(image, 1.0), folder / "cube.nii.gz")
        python = [sys.executable, "-m", "accelsurf"]
        call = [*python, "segment", str(folder / "cube.nii.gz"), "-o", str(folder / "out"), "--start", begin]
        call += ["--presmooth", "1", "--threads", str(options.threads), "--overwrite", "--quiet"]

        def repeated(command: list[str], count: int, cold: bool = False) -> Timing:
            seconds = []
            for i in range(count):
                more = {"NUMBA_CACHE_DIR": str(folder / f"cache{i}")} if cold else {}
                seconds.append(run_process(command, options.threads, **more)[0])
            return Timing(seconds)

        run_process(call, options.threads)  # compile
        times = {
            "accelsurf --help": repeated([*python, "--help"], options.repeats),
            f"accelsurf segment, {side}^3, warm": repeated(call, options.repeats),
            f"accelsurf segment, {side}^3, cold": repeated(call, 1 if options.quick else COLD_RUNS, cold=True),
        }
    wanted = dict(zip(times, (0.5, 3.0, 40.0), strict=True))
    return {
        "work": f"whole commands, the cube in noise in {side}^3, presmooth 1, {options.threads} threads, files written",
        "threads": options.threads, "times": {n: t.to_dict() for n, t in times.items()}, "pairs": [],
        "goals": [goal(n, wanted[n], t.median, "<=", "s") for n, t in times.items()],
        "tables": [table(
            "Commands", ("command", "seconds", "runs"), [(n, t.median, len(t.seconds)) for n, t in times.items()]
        )],
        "bars": [[n, t.median] for n, t in times.items()],
    }
