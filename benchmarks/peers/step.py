"""`step`: one whole step of constant density per band cell, against the least traffic that memory needs for it."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from accelsurf.levelset import Workers
from benchmarks.peers.clock import Clock
from benchmarks.peers.measure import Options, goal, set_threads, table
from benchmarks.peers.work import ball, evolution

#: Bytes of a band cell's state: index 8, psi 4, foot 3 x 4, slot in the volume 4, psi in the volume 4, speed 4.
#: A step must read each once and write each once, and read the image's 4.
BYTES_PER_CELL = 2 * (8 + 4 + 12 + 4 + 4 + 4) + 4


def step(options: Options) -> dict[str, Any]:
    """Time steps on a smooth surface and in noise; a streaming copy beside them; profile."""
    set_threads(1)
    side, radius, count = (40, 10.0, 6) if options.quick else (192, 60.0, 30)
    bandwidth = copy_bandwidth(2**22 if options.quick else 2**26, options.repeats)
    copy_ns = 1e9 * BYTES_PER_CELL / bandwidth
    inside = (ball(side, radius * 1.1) < 0).astype(np.float32)
    noise = np.random.default_rng(4).normal(0.0, 1.0, inside.shape).astype(np.float32)
    surfaces = {"smooth": inside, "noisy": inside + noise}
    found = {name: one(ball(side, radius), image, count) for name, image in surfaces.items()}
    smooth = found["smooth"]["ns_per_cell"]
    tables = [
        table(
            "One step, all included",
            ("surface", "band cells", "ms per step", "ns per band cell", "times a streaming copy"),
            [
                (n, f["band_cells"], f["ms_per_step"], f["ns_per_cell"], f["ns_per_cell"] / copy_ns)
                for n, f in found.items()
            ],
        )
    ]
    for name, f in found.items():
        tables.append(
            table(
                f"Where it goes, {name} surface",
                ("part", "ns per band cell", "share (%)"),
                [(part, ns, 100 * ns / f["ns_per_cell"]) for part, ns in f["profile"].items()],
            )
        )
    return {
        "work": f"whole steps of constant density on a ball of radius {radius:g} in {side}^3, smooth and in noise "
        "sigma 1, 1 thread",
        "threads": 1,
        "copy_bytes_per_cell": BYTES_PER_CELL,
        "copy_gb_per_s": bandwidth / 1e9,
        "copy_ns_per_cell": copy_ns,
        "surfaces": found,
        "pairs": [
            {
                "pair": f"{name} step / streaming copy of {BYTES_PER_CELL} bytes",
                "ratio": f["ns_per_cell"] / copy_ns,
                "sense": "<=",
            }
            for name, f in found.items()
        ],
        "goals": [
            goal("ns per band cell, smooth surface", 100.0, smooth, "<=", "ns"),
            goal(
                "ns per band cell, noisy surface", 100.0, found["noisy"]["ns_per_cell"], "<=", "ns"
            ),
        ],
        "tables": tables,
        "bars": [
            [f"{name}: {part}", 1e-9 * ns]
            for name, f in found.items()
            for part, ns in f["profile"].items()
        ],
        "bars_unit": "seconds per band cell and step",
    }


def copy_bandwidth(count: int, repeats: int) -> float:
    """Bytes a second, read and written, of a copy between arrays of ``count`` floats, far larger than any cache."""
    source, target = np.ones(count, np.float32), np.zeros(count, np.float32)
    seconds = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - began)
    return 2.0 * source.nbytes / statistics.median(seconds[1:])


def one(psi: np.ndarray, image: np.ndarray, count: int) -> dict[str, Any]:
    """Median time of the second half of ``count`` steps, per band cell; and its parts, from runs with a clock."""
    for _ in evolution(psi, image, 3):  # compile
        pass
    made = evolution(psi, image, count)
    for _ in made:
        pass
    rows = [row for row in made.history if row.dt > 0][count // 2 :]
    each = [1e9 * row.seconds / row.band_cells for row in rows]
    ns = statistics.median(each)
    return {
        "steps": len(made.history) - 1,
        "band_cells": rows[-1].band_cells,
        "ns_per_cell": ns,
        "all_ns_per_cell": each,
        "ms_per_step": 1e3 * statistics.median(row.seconds for row in rows),
        "profile": profile(psi, image, count, ns),
    }


def profile(psi: np.ndarray, image: np.ndarray, count: int, ns: float) -> dict[str, float]:
    """ns per band cell by stage where the package keeps a record, else by kernel; the rest is serial."""
    workers = Workers(1)
    clock = Clock(workers)
    made = evolution(psi, image, count, workers=workers)
    seconds = 0.0
    cells = 0
    half = count // 2
    for taken in made:
        if taken.record.step + 1 == half:
            clock.reset()
            seconds, cells = 0.0, 0
        elif taken.record.dt > 0:
            seconds += taken.record.seconds
            cells += taken.record.band_cells
    parts = clock.stages or clock.kernels
    counted = {
        name: 1e9 * s / cells for name, s in sorted(parts.items(), key=lambda item: -item[1])
    }
    rest = "not in a stage" if clock.stages else "march and other work outside the threads' kernels"
    counted[rest] = max(0.0, 1e9 * seconds / cells - sum(counted.values()))
    # The clock costs a little: the parts are shares of the time taken without it.
    total = sum(counted.values())
    return {name: value * ns / total for name, value in counted.items()}
