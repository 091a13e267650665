"""What a store of 10 TB and 100 workers would take: measured on some cells of a phantom, then simulated.

    python -m benchmarks.large.scale STORE [--cells 40]

Measures, on one thread: seconds and bytes read of each group of cells, and what the parent does for each (planning, the
label map). Then puts as many groups as a store of 10 TB has, at the same density, on workers that share what the
store delivers. Adds "scale" to results/large.json.
"""

from __future__ import annotations

import argparse
import csv
import heapq
import json
import math
import random
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import accelsurf
from accelsurf.io import LabelStore
from accelsurf.large.many_objects import segment_many_objects
from accelsurf.large.windowed import LargeImage
from benchmarks.large.study import RESULT

#: Bytes of the store (one a voxel), workers, and what the store delivers, bytes a second; unpacked bytes, as measured.
STORE, WORKERS, DELIVERED = 10**13, (1, 10, 100, 1000), (1e9, 1e10)
SETTINGS = {"energy": "threshold:92,150", "threads": 1}


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.large.scale", description="A store of 10 TB."
    )
    parser.add_argument("store", type=Path, help="folder of a phantom")
    parser.add_argument("--cells", type=int, default=40, help="cells that are run, default 40")
    given = parser.parse_args()
    measured = measure(given.store, given.cells)
    rows = simulate(measured)
    about = json.loads(RESULT.read_text()) if RESULT.exists() else {"runs": []}
    about["scale"] = {"store": given.store.name, **measured, "simulated": rows}
    RESULT.write_text(json.dumps(about, indent=1) + "\n")
    for row in rows:
        print(json.dumps(row))


def measure(store: Path, count: int) -> dict[str, Any]:
    """Seconds and bytes of each group of some cells, spread over the table; seconds of the parent for each cell."""
    with (store / "cells.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    some = table[:: max(1, len(table) // count)][:count]
    image = LargeImage.of([accelsurf.open_volume(store / "image.ome.zarr")], 4_000_000_000)
    groups: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cells.csv"
        lines = [
            "id,x,y,z,r",
            *(",".join(row[key] for key in ("id", "x", "y", "z", "r")) for row in some),
        ]
        path.write_text("\n".join(lines) + "\n")
        began, read = time.perf_counter(), 0

        def ended(ids: Any, result: Any) -> None:
            nonlocal began, read
            now, bytes_now = time.perf_counter(), image.channels[0].bytes_read
            groups.append(
                {"objects": len(tuple(ids)), "seconds": now - began, "bytes": bytes_now - read}
            )
            began, read = now, bytes_now

        whole = image.whole(accelsurf.RunConfig(**SETTINGS))
        statistics_began = time.perf_counter()
        _ = whole[0].scale, whole[0].found(np.ptp)
        statistics = time.perf_counter() - statistics_began
        began = time.perf_counter()
        found = list(segment_many_objects(image, str(path), on_group=ended, **SETTINGS))
        writing = time.perf_counter()
        label = LabelStore(Path(folder) / "a.ome.zarr", image.geometry, np.uint32)
        boxes = 0
        for one in found:
            if one.object is not None:
                there = label.read(one.object.box)
                there[one.object.labels > 0] = one.id
                label.write(one.object.box, there)
                boxes += 1
        writing = time.perf_counter() - writing
        label.discard()
    size = image.geometry.shape[0]
    return {
        "cells": len(table),
        "voxels": size**3,
        "statistics_seconds": round(statistics, 2),
        "groups": [{key: round(value, 3) for key, value in one.items()} for one in groups],
        "label_seconds_per_object": round(writing / max(boxes, 1), 4),
        "failed": sum(one.object is None for one in found),
    }


def simulate(measured: dict[str, Any]) -> list[dict[str, Any]]:
    """Hours of a store of 10 TB: groups in turn to whoever is free; the store's bytes are shared by all at work."""
    objects = round(measured["cells"] * STORE / measured["voxels"])
    # The first group is the one in which the statistics are found, which the parent hands over.
    groups = measured["groups"][1:]
    per_group = sum(one["objects"] for one in groups) / len(groups)
    parent = objects * measured["label_seconds_per_object"]
    rows = []
    for delivered in DELIVERED:
        for workers in WORKERS:
            share = delivered / workers
            draw = random.Random(0)
            free = [0.0] * workers
            # Thousands of groups are as good as millions: the rest is scaled.
            count = round(objects / per_group)
            shown = min(count, 200 * workers)
            for _ in range(shown):
                one = draw.choice(groups)
                took = max(one["seconds"], one["bytes"] / share)
                heapq.heapreplace(free, free[0] + took)
            hours = max(free) * count / shown / 3600.0
            rows.append(
                {
                    "workers": workers,
                    "delivered_bytes_per_second": delivered,
                    "objects": objects,
                    "hours_of_groups": round(hours, 2),
                    "hours_of_label_map_in_one_process": round(parent / 3600.0, 2),
                    "bytes_read": int(count * sum(one["bytes"] for one in groups) / len(groups)),
                    "efficiency": round(_ideal(groups, count) / 3600.0 / (hours * workers), 3),
                }
            )
    return rows


def _ideal(groups: list[dict[str, float]], count: int) -> float:
    return math.fsum(one["seconds"] for one in groups) / len(groups) * count


if __name__ == "__main__":
    main()
