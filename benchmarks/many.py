"""Many objects at once from a click in each, beside a watershed from the same seeds: ``python -m benchmarks.many``.

Cells between membranes, and bright nuclei of which most touch another one, with two clicks on the dark ground (id 0).
Each scene is segmented twice in a process of its own, which tells the seconds of the second time, and the peak of its
memory, image and interpreter included. Watershed and random walker get their best setting by the truth, the walker
only where there are few objects. The results are kept in benchmarks/results/many.json, scene by scene.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from skimage.segmentation import random_walker, watershed

from accelsurf.api.segment import segment_objects
from benchmarks.peers.hard_works import Ball, Work, deepest, drawn, seeds_of
from benchmarks.peers.memory import own_peak
from tests.support.tissues import membrane_cells, nuclei

RESULTS = Path(__file__).resolve().parent / "results" / "many.json"
#: Shape and number of objects.
SCENES = {
    "8 cells": ((24, 48, 48), 8),
    "50 cells in 48 slices": ((48, 96, 96), 50),
    "50 cells": ((96, 96, 96), 50),
    "50 nuclei": ((96, 96, 96), 50),
    "250 nuclei": ((64, 256, 256), 250),
    "1000 nuclei": ((64, 512, 512), 1000),
}
#: Settings of cells; nuclei have no membranes, which noise could open. The walker solves a system for each object.
CELLS: dict[str, Any] = {"preset": "membrane-cells"}
NUCLEI: dict[str, Any] = {"energy": "partition:0", "presmooth": "0.5vox", "smoothness": 0.0}
MOST_WALKED = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--threads", type=int, nargs="*", default=[1, 2])
    parser.add_argument(
        "--here", action="store_true", help="measure one scene in this process and print it"
    )
    options = parser.parse_args()
    for name in options.scenes:
        work = scene(name, options.seed)
        if options.here:
            print(json.dumps(measured(work, options.threads[0])))
            continue
        row: dict[str, Any] = {
            "seed": options.seed,
            "voxels": work.truth.size,
            "peers": peers(work),
        }
        for threads in options.threads:
            words = [
                "--here",
                "--scenes",
                name,
                "--seed",
                str(options.seed),
                "--threads",
                str(threads),
            ]
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.many", *words], stdout=-1, check=True
            )
            row[f"{threads} threads"] = json.loads(done.stdout)
        print(name, json.dumps(row), flush=True)
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        RESULTS.write_text(json.dumps(results | {name: row}, indent=1) + "\n")


def scene(name: str, seed: int) -> Work:
    """Draw a scene, with the ball of half the depth in each object as its click."""
    shape, count = SCENES[name]
    is_ground = "nuclei" in name
    image, truth = (
        nuclei(shape, count, seed=seed) if is_ground else membrane_cells(shape, count, seed=seed)
    )[:2]
    inside, outside = dict[int, Ball](), list[Ball]()
    for number, box in enumerate(ndimage.find_objects(truth), 1):
        z, y, x, radius = deepest(truth[box] == number)
        inside[number] = (
            z + box[0].start,
            y + box[1].start,
            x + box[2].start,
            max(radius - 1.0, 1.0),
        )
    depth = ndimage.distance_transform_edt(truth == 0)
    for _ in range(2 if is_ground else 0):
        at = np.unravel_index(int(depth.argmax()), shape)
        outside.append((float(at[0]), float(at[1]), float(at[2]), 4.0))
        depth[drawn(shape, (*outside[-1][:3], 30.0))] = 0.0
    return Work(image, truth, inside, tuple(outside))


def measured(work: Work, threads: int) -> dict[str, float]:
    """Return seconds, Dice and memory of accelsurf."""
    rows = [*work.inside.items(), *((0, ball) for ball in work.outside)]
    lines = [f"{id},{x:g},{y:g},{z:g},{r:g},inside\n" for id, (z, y, x, r) in rows]
    settings = NUCLEI if work.outside else CELLS
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder, "clicks.csv")
        table.write_text("id,x_vox,y_vox,z_vox,r_vox,side\n" + "".join(lines))
        for _ in range(2):
            began, used = time.perf_counter(), time.process_time()
            labels = segment_objects(work.image, str(table), threads=threads, **settings).labels
            seconds, processor = time.perf_counter() - began, time.process_time() - used
    peak = own_peak() / work.truth.size
    return {
        "seconds": seconds,
        "processor_s": processor,
        "dice": work.score(labels),
        "peak_bytes_per_voxel": peak,
    }


def peers(work: Work) -> dict[str, Any]:
    """Return Dice, processor seconds and setting of the best of each other program."""
    seeds = seeds_of(work)
    rows = dict[str, Any]()
    other = max(work.inside) + 1
    markers = np.where(seeds < 0, other, seeds)
    for sigma in (0.5, 1.0, 1.5):
        smooth = ndimage.gaussian_filter(work.image, sigma)
        programs = {"watershed, value": partial(watershed, smooth, markers)}
        if work.outside:
            mask = (
                smooth > 0.5 * (np.median(smooth[seeds > 0]) + np.median(smooth[seeds < 0]))
            ) | (seeds != 0)
            reliefs = {"value": -smooth, "depth": -ndimage.distance_transform_edt(mask)}
            programs = {
                f"watershed, {key}": partial(watershed, of, markers, mask=mask)
                for key, of in reliefs.items()
            }
        if len(work.inside) <= MOST_WALKED:
            programs["random walker"] = partial(
                random_walker, smooth, markers, beta=100.0, mode="cg_j", tol=1e-3
            )
        for name, run in programs.items():
            began = time.process_time()
            found = run()
            seconds, score = (
                time.process_time() - began,
                work.score(np.where(found == other, 0, found)),
            )
            if score > rows.get(name, {"dice": 0.0})["dice"]:
                rows[name] = {"dice": score, "sigma": sigma, "processor_s": seconds}
    return rows


if __name__ == "__main__":
    main()
