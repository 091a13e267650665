"""What a case of a batch costs beyond the library call: ``python -m benchmarks.batch [--cases 200] [--size 64]``.

Cases are balls in noise. First `accelsurf.segment` is called for some of them in one process, then ``accelsurf batch``
runs all, with one worker and with as many as it chooses. Kernels are compiled before. Seconds of the processor are
those of all processes, with one thread each; they compare on a busy machine too, the others do not. Writes
``benchmarks/results/batch.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

RESULTS = Path(__file__).resolve().parent / "results" / "batch.json"
#: Wanted: seconds of a case beyond the library call.
WANTED = 0.3
#: Cases that the library is called for.
CALLS = 20


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--size", type=int, default=64, help="voxels a side")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), options.cases, options.size)
    options.results.parent.mkdir(parents=True, exist_ok=True)
    options.results.write_text(json.dumps(found, indent=2) + "\n")
    print(table(found))


def measure(folder: Path, count: int, size: int) -> dict[str, Any]:
    """Seconds of the library call and of batches, per case."""
    scans = folder / "scans"
    scans.mkdir()
    for number in range(count):
        io.write(phantom(size, number), scans / f"case{number:04d}.nii.gz")
    start = f"ball:0,0,0,{0.2 * size:g}"
    paths = sorted(scans.iterdir())
    load = os.getloadavg()[0]
    call(paths[0], start)  # compiles, loads
    before, began = time.process_time(), time.perf_counter()
    for path in paths[:CALLS]:
        call(path, start)
    calls = min(CALLS, count)
    library = {
        "seconds": (time.perf_counter() - began) / calls,
        "processor_seconds": (time.process_time() - before) / calls,
    }
    batch(scans, folder / "warm", start, "--shard", f"1/{count}")
    rows = []
    for name, more in (
        ("one worker", ("--jobs", "1", "--threads", "1")),
        ("as it chooses", ("--threads", "1")),
    ):
        one = batch(scans, folder / name.replace(" ", "-"), start, *more)
        rows.append(
            {
                "name": name,
                **{key: value / count for key, value in one.items() if key != "jobs"},
                **jobs(one),
            }
        )
    return {
        "cases": count,
        "size": size,
        "wanted_beyond": WANTED,
        "machine": {"cores": os.cpu_count(), "system": platform.platform(), "load": load},
        "library": library,
        "batches": rows,
    }


def jobs(found: dict[str, Any]) -> dict[str, int]:
    return {"jobs": int(found["jobs"])}


def phantom(size: int, seed: int) -> Volume:
    """A ball in noise."""
    middle = 0.5 * (size - 1)
    z, y, x = np.ogrid[:size, :size, :size]
    radius = size * (0.28 + 0.02 * (seed % 5))
    ball = 100.0 * ((x - middle) ** 2 + (y - middle) ** 2 + (z - middle) ** 2 < radius**2)
    noisy = ball + np.random.default_rng(seed).normal(0, 20, ball.shape)
    return Volume(
        noisy.astype(np.float32), Geometry(ball.shape, (1.0, 1.0, 1.0), origin=(-middle,) * 3)
    )


def call(path: Path, start: str) -> None:
    segment(io.read(path), start=start, threads=1)


def batch(scans: Path, out: Path, start: str, *more: str) -> dict[str, float]:
    """Seconds of a batch, of the clock and of the processor, and the number of its workers."""
    command = [
        sys.executable,
        "-m",
        "accelsurf",
        "batch",
        str(scans),
        "-o",
        str(out),
        "--start",
        start,
        *more,
    ]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    execute([*command, "--quiet"])
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    (report,) = out.glob("batch_report*.json")
    return {
        "seconds": seconds,
        "processor_seconds": processor,
        "jobs": json.loads(report.read_text())["jobs"],
    }


def execute(command: list[str]) -> None:
    subprocess.run(command, check=True)


def table(found: dict[str, Any]) -> str:
    library = found["library"]
    lines = [
        f"{found['cases']} cases of {found['size']}^3; the library call: {library['seconds']:.3f} s, "
        f"{library['processor_seconds']:.3f} s of the processor"
    ]
    for one in found["batches"]:
        beyond = one["processor_seconds"] - library["processor_seconds"]
        lines.append(
            f"{one['name']} ({one['jobs']}): {one['seconds']:.3f} s a case, {one['processor_seconds']:.3f} of the "
            f"processor, {beyond:.3f} beyond the call (wanted {found['wanted_beyond']})"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
