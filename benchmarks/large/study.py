"""What a run on an image larger than memory takes: seconds, memory, bytes read; and whether it has the same bytes.

    scripts/study large STORES --sizes 512 1024 1701 2048

makes the phantoms that are not there yet (a folder for each size in STORES), runs single objects on each under a hard
limit of the address space, and compares that of 512^3 with the run in memory. Writes results/large.json.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

RESULT = Path(__file__).parents[1] / "results" / "large.json"
#: Hard limit of the address space by size, bytes.
LIMITS = {512: 3_000_000_000, 1024: 3_000_000_000, 1701: 4_000_000_000, 2048: 4_000_000_000}
#: What the run may plan with: the limit counts addresses, of libraries and threads too, most of which hold nothing.
PLANNED = 0.8
#: Name of a run -> settings; the first cell of the table is meant, whose centre and radius they take.
RUNS = {
    "ball": {"start": "ball:{x},{y},{z},{r}"},
    "click": {"inside": "point:{x},{y},{z}"},
    "click, size": {"inside": "point:{x},{y},{z}", "size": "{volume}mm3"},
    "tree": {
        "start": "ball:{tree_x},{tree_y},{tree_z},{tree_r}",
        "energy": "threshold:150,",
        "max_steps": "300",
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="scripts/study large", description="Runs on images larger than memory."
    )
    parser.add_argument("stores", type=Path, help="folder of the phantoms, a folder for each size")
    parser.add_argument("--sizes", type=int, nargs="+", default=sorted(LIMITS))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--child", default="", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        print(json.dumps(measured(json.loads(given.child))))
        return
    found = json.loads(RESULT.read_text()) if RESULT.exists() else {"runs": []}
    rows = [row for row in found["runs"] if row["size"] not in given.sizes]
    for size in given.sizes:
        store = given.stores / str(size)
        if not store.exists():
            subprocess.run(
                [sys.executable, "-m", "benchmarks.large", str(store), "--size", str(size)],
                check=True,
            )
        for name in RUNS:
            ways = ["parts", "memory"] if size == 512 and name != "tree" else ["parts"]
            for way in ways:
                row = _child(
                    {
                        "store": str(store),
                        "size": size,
                        "run": name,
                        "way": way,
                        "threads": given.threads,
                    }
                )
                rows.append({"size": size, "run": name, "way": way, **row})
                print(json.dumps(rows[-1]), flush=True)
    rows.sort(key=lambda row: (row["size"], list(RUNS).index(row["run"]), row["way"]))
    from accelsurf.output.document import versions

    result = {
        "versions": versions(),
        "load": os.getloadavg(),
        "limits": LIMITS,
        "planned": PLANNED,
        "runs": rows,
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n")
    print(f"written: {RESULT}")


def _child(task: dict[str, Any]) -> dict[str, Any]:
    words = [
        sys.executable,
        "-m",
        "benchmarks.large.study",
        task["store"],
        "--child",
        json.dumps(task),
    ]
    ended = subprocess.run(words, capture_output=True, text=True)
    if ended.returncode:
        return {
            "failed": ended.stderr.strip().splitlines()[-1]
            if ended.stderr.strip()
            else str(ended.returncode)
        }
    return dict(json.loads(ended.stdout.splitlines()[-1]))


def measured(task: dict[str, Any]) -> dict[str, Any]:
    """Run in this process, under the limit, and measure."""
    store, in_parts = Path(task["store"]), task["way"] == "parts"
    limit = LIMITS[task["size"]]
    if in_parts:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    import accelsurf

    settings = settings_of(store, task["run"])
    level = tree_level(task["size"]) if task["run"] == "tree" else 0
    began, used = time.perf_counter(), time.process_time()
    image = accelsurf.open_volume(store / "image.ome.zarr", level=level)
    options: dict[str, Any] = {"threads": task["threads"], **settings}
    if in_parts:
        options["max_memory"] = f"{int(PLANNED * limit / 1e6)}MB"
        result = accelsurf.segment(image, **options)
    else:
        whole = tuple(slice(0, n) for n in image.geometry.shape)
        result = accelsurf.segment(accelsurf.Volume(image.read(whole), image.geometry), **options)
    seconds, used = time.perf_counter() - began, time.process_time() - used
    vertices = (
        np.ascontiguousarray(result.surface.vertices, "<f4")
        if result.objects[0].has_surface
        else np.zeros(0)
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "seconds": round(seconds, 2),
        "cpu_seconds": round(used, 2),
        "peak_bytes": peak,
        "bytes_read": image.bytes_read if in_parts else None,
        "voxels": int(np.count_nonzero(result.labels)),
        "surface_voxels": int(result.history[-1].band_cells),
        "window": None if result.window is None else list(result.window.shape),
        "stop": result.stop.reason,
        "steps": result.stop.steps,
        "mesh": hashlib.sha256(vertices.tobytes()).hexdigest()[:16],
        "dice": _dice(result, store, task["run"]),
    }


def tree_level(size: int) -> int:
    """The finest level whose grid has at most 256 voxels along an axis: the tree is nearly as large as the volume."""
    level = 0
    while size >> level > 256:
        level += 1
    return level


def settings_of(store: Path, run: str) -> dict[str, str]:
    with (store / "cells.csv").open(newline="") as stream:
        row = next(csv.DictReader(stream))
    scene = json.loads((store / "scene.json").read_text())
    x, y, z = scene["root_mm_xyz"]
    places = {
        **row,
        "volume": f"{_volume_mm3(store, row):.6f}",
        "tree_x": x,
        "tree_y": y,
        "tree_z": z,
        "tree_r": 0.5 * scene["root_radius_mm"],
    }
    return {key: text.format(**places) for key, text in RUNS[run].items()}


def _volume_mm3(store: Path, row: dict[str, str]) -> float:
    """Of the first cell; people know a size to about a quarter, so it is said a quarter too large."""
    from benchmarks.large.__main__ import SPACING_MM
    from benchmarks.large.scene import Scene
    from benchmarks.large.voxels import truth

    about = json.loads((store / "scene.json").read_text())
    middle = [round(float(row[axis]) / SPACING_MM) for axis in "zyx"]
    reach = round(4.0 * float(row["r"]) / SPACING_MM)
    z, y, x = (slice(max(m - reach, 0), min(m + reach, about["size"])) for m in middle)
    scene = Scene.of(about["size"], about["seed"], about["cells"])
    return 1.25 * float((truth(scene, (z, y, x)) == 1).sum()) * SPACING_MM**3


def _dice(result: Any, store: Path, run: str) -> float | None:
    """Dice with the truth in the window; None of a coarse level."""
    if run == "tree":
        return None
    from benchmarks.large.scene import Scene
    from benchmarks.large.voxels import truth

    about = json.loads((store / "scene.json").read_text())
    scene = Scene.of(about["size"], about["seed"], about["cells"])
    box = result.window.box if result.window is not None else _around(result.labels)
    labels = result.labels if result.window is not None else result.labels[box]
    meant = truth(scene, box) == 1
    return round(
        2.0 * float((meant & (labels > 0)).sum()) / float(meant.sum() + (labels > 0).sum()), 4
    )


def _around(labels: np.ndarray) -> Any:
    from accelsurf.grid.boxes import bounding_box

    return bounding_box(labels > 0, 40)


if __name__ == "__main__":
    main()
