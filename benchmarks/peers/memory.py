"""`memory`: peak memory of a whole segmentation, less that of a process which only holds the image."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.measure import MissingError, Options, goal, run_process, set_threads, table

STEPS = 5


def memory(options: Options) -> dict[str, Any]:
    """Peak resident memory of processes that segment, and of processes that only hold the image."""
    set_threads(1)
    sides = (32, 48) if options.quick else (128, 256, 384, 512)
    lines = []
    for side in sides:
        image_alone, _ = peak("hold", side)
        run, cells = peak("run", side)
        lines.append(
            {
                "side": side,
                "hold_bytes": image_alone,
                "run_bytes": run,
                "band_cells": cells,
                "bytes_per_voxel": (run - image_alone) / side**3,
            }
        )
        print(
            f"   {side}^3: {run / 1e9:.2f} GB, {lines[-1]['bytes_per_voxel']:.1f} bytes a voxel beyond the image"
        )
    per_voxel, per_cell, constant = fitted(lines)
    largest = lines[-1]
    return {
        "work": f"peak memory of segment() of a ball in n^3 float32, {STEPS} steps, n = {', '.join(map(str, sides))}",
        "threads": 1,
        "lines": lines,
        "fit": {"bytes_per_voxel": per_voxel, "bytes_per_band_cell": per_cell, "bytes": constant},
        "pairs": [
            {
                "pair": f"segmenting / holding the image, {largest['side']}^3",
                "ratio": largest["run_bytes"] / largest["hold_bytes"],
                "sense": "<=",
            }
        ],
        "goals": [
            goal("bytes a voxel beyond the image, band term apart", 12.0, per_voxel, "<=", "B"),
            goal(f"peak at {largest['side']}^3", 3.0, largest["run_bytes"] / 1e9, "<=", "GB"),
        ],
        "tables": [
            table(
                "Peak memory",
                (
                    "volume",
                    "band cells",
                    "holding the image (MB)",
                    "segmenting (MB)",
                    "bytes a voxel beyond the image",
                ),
                [
                    (
                        f"{e['side']}^3",
                        e["band_cells"],
                        e["hold_bytes"] / 1e6,
                        e["run_bytes"] / 1e6,
                        e["bytes_per_voxel"],
                    )
                    for e in lines
                ],
            )
        ],
        "curves": {
            "x": "voxels a side",
            "y": "peak memory beyond the image (MB)",
            "lines": {
                "segment()": [[e["side"], (e["run_bytes"] - e["hold_bytes"]) / 1e6] for e in lines]
            },
        },
    }


def fitted(lines: list[dict[str, Any]]) -> tuple[float, float, float]:
    """Bytes a voxel, a band cell, and of any run, none below 0, that explain the peaks best."""
    from scipy.optimize import nnls

    beyond = np.array([e["run_bytes"] - e["hold_bytes"] for e in lines], float)
    terms = np.array([(e["side"] ** 3, e["band_cells"], 1.0) for e in lines], float)
    weight = 1.0 / terms[:, :1]
    (voxel, cell, constant), _ = nnls(terms * weight, np.maximum(beyond, 0.0) * weight[:, 0])
    return float(voxel), float(cell), float(constant)


def peak(what: str, side: int) -> tuple[int, int]:
    """Peak bytes of a process, and its band cells, both as it tells them."""
    command = [sys.executable, "-m", "benchmarks.peers.memory", what, str(side)]
    try:
        _, said = run_process(command, 1)
    except MissingError as failed:
        raise MissingError(f"{failed} (for {side}^3; out of memory?)") from None
    cells, most = said.split()[-2:]
    return int(most), int(cells)


def own_peak() -> int:
    """Peak bytes of this process.

    From /proc where there is one: getrusage and wait4 count, on Linux, the memory of the process that forked this one
    too, and would report the benchmark instead of what it measures.
    """
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    import resource

    # Kilobytes but for macOS, where it is bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )


def phantom(side: int) -> np.ndarray:
    """A ball of a third of the side, made slice by slice, so that making it needs no memory."""
    image = np.empty((side,) * 3, np.float32)
    middle, radius = 0.5 * (side - 1), side / 3.0
    random = np.random.default_rng(0)
    y, x = np.ogrid[:side, :side]
    for z in range(side):
        far = (z - middle) ** 2 + (y - middle) ** 2 + (x - middle) ** 2
        image[z] = (far < radius**2) + 0.2 * random.standard_normal((side, side), np.float32)
    return image


def child(what: str, side: int) -> None:
    """The process that is measured: both load everything and compile nothing new; one of them segments."""
    from accelsurf.api.segment import segment

    segment(phantom(24), start="ball:11,11,11,5vox", max_steps=STEPS)
    image = phantom(side)
    cells = 0
    if what == "run":
        middle = 0.5 * (side - 1)
        result = segment(
            image, start=f"ball:{middle},{middle},{middle},{0.3 * side}vox", max_steps=STEPS
        )
        cells = result.history[-1].band_cells
    print(cells, own_peak())


if __name__ == "__main__":
    child(sys.argv[1], int(sys.argv[2]))
