"""How long a viewer waits for `accelsurf serve`: the real client, over HTTP, on a scan of 256^3 voxels.

python -m benchmarks.serve [--objects A,B] [--volumes DIR] [--results DIR]

For each object of the brain a person begins with a point, a box, a scribble, a lasso and the labels of another program
(here: the reference, cut), and goes on with four points where the labels are most wrong. Each wait is that of the
client's call: packing, HTTP, work, answer. One server, started for this, is asked by nobody else.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from nnInteractive.inference.remote import nnInteractiveRemoteInferenceSession
from scipy import ndimage

from benchmarks.clicks.objects import load, selected
from benchmarks.clicks.person import next_click
from benchmarks.peers.measure import scans_folder
from benchmarks.refine import IN_BRAIN

ROOT = Path(__file__).resolve().parent.parent
NAME = "serve.json"
#: Kinds of the first prompt.
KINDS = ("point", "bbox", "scribble", "lasso", "labels")
#: Points after it.
LATER = 4
#: Seconds that are wanted of a first answer and of a later one.
WANTED = {"first": 1.5, "later": 0.5}


class Waits:
    """A viewer that notes how long each of its calls takes, and the processor's time of the server."""

    def __init__(self, address: str, server: int) -> None:
        self.client = nnInteractiveRemoteInferenceSession(address)
        self._server, self.rows = psutil.Process(server), list[dict[str, Any]]()

    def call(self, work: Callable[[], Any], **said: Any) -> dict[str, Any]:
        """Make a call; return its row."""
        before, began = self._server.cpu_times(), time.perf_counter()
        work()
        seconds, after = time.perf_counter() - began, self._server.cpu_times()
        cpu = after.user + after.system - before.user - before.system
        self.rows.append({**said, "seconds": round(seconds, 3), "processor": round(cpu, 2)})
        return self.rows[-1]


def first_prompt(
    kind: str, client: Any, truth: Any, labels: Any, geometry: Any
) -> Callable[[], Any]:
    """Return the first prompt of a kind, of a person who knows the truth: in the slice of the deepest place."""
    deep = next_click(truth, None, geometry)
    assert deep is not None
    if kind == "point":
        return lambda: client.add_point_interaction(deep.index, True)
    if kind == "labels":
        cut = truth.copy()
        cut[: deep.index[0]] = False
        return lambda: client.add_initial_seg_interaction(cut.astype(np.uint8))
    section = np.zeros_like(truth)
    parts, _ = ndimage.label(truth[deep.index[0]])
    section[deep.index[0]] = parts == parts[deep.index[1:]]
    if kind == "scribble":
        depth = ndimage.distance_transform_edt(section[deep.index[0]])
        section[deep.index[0]] &= depth > 0.7 * depth.max()
    box = [[int(places.min()), int(places.max()) + 1] for places in np.nonzero(section)]
    crop = section[tuple(slice(*side) for side in box)].astype(np.uint8)
    if kind == "bbox":
        return lambda: client.add_bbox_interaction(box, True)
    add = client.add_scribble_interaction if kind == "scribble" else client.add_lasso_interaction
    return lambda: add(crop, True, interaction_bbox=box)


def measured(address: str, process: int, names: list[str]) -> dict[str, Any]:
    """Return the waits of all prompts for some objects."""
    objects = selected(names=names)
    scene = load(objects[0])
    image, geometry = scene.image.as_float32(), scene.image.geometry
    viewer, labels = Waits(address, process), np.zeros(geometry.shape, np.uint8)
    spacing = list(geometry.spacing)
    sent = viewer.call(
        lambda: viewer.client.set_image(image[np.newaxis], {"spacing": spacing}), prompt="image"
    )
    viewer.client.set_target_buffer(labels)
    for found in objects:
        truth = np.asarray(load(found).truth)
        for kind in KINDS:
            viewer.client.reset_interactions()
            work = first_prompt(kind, viewer.client, truth, labels, geometry)
            for number in range(1 + LATER):
                said = {"object": found.name, "begun": kind, "number": number + 1}
                row = viewer.call(work, prompt=kind if number == 0 else "point", **said)
                both = int(np.count_nonzero((labels > 0) & truth))
                row["dice"] = round(
                    2 * both / (np.count_nonzero(labels) + np.count_nonzero(truth)), 3
                )
                click = next_click(truth, labels > 0, geometry)
                if click is None:
                    break
                work = _point(viewer.client, click)
            viewer.call(viewer.client.undo, prompt="undo", object=found.name)
    viewer.client.close()
    return {"image": sent, "prompts": viewer.rows[1:]}


def _point(client: Any, click: Any) -> Callable[[], Any]:
    return lambda: client.add_point_interaction(click.index, click.side == "inside")


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Median, 95 % and largest wait of first prompts by kind, of later ones and of undo, and the median Dice after."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        number = row.get("number")
        name = (
            "undo"
            if number is None
            else f"first {row['prompt']}"
            if number == 1
            else f"later, after {row['begun']}"
        )
        groups.setdefault(name, []).append(row)
    out = {}
    for name, found in groups.items():
        seconds = [row["seconds"] for row in found]
        out[name] = {
            "count": len(found),
            **{
                key: round(float(np.percentile(seconds, at)), 3)
                for key, at in (("median", 50), ("95 %", 95))
            },
            "largest": max(seconds),
            **{
                f"processor, {key}": round(
                    float(np.percentile([row["processor"] for row in found], at)), 2
                )
                for key, at in (("median", 50), ("95 %", 95))
            },
        }
        if "dice" in found[0]:
            out[name]["dice, median"] = round(float(np.median([row["dice"] for row in found])), 3)
    return out


def main() -> int:
    """Measure, and write the JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", default=",".join(IN_BRAIN))
    parser.add_argument("--volumes", type=Path)
    parser.add_argument("--results", type=Path, default=ROOT / "benchmarks/results")
    options = parser.parse_args()
    if options.volumes is not None:
        os.environ["ACCELSURF_VOLUMES"] = str(options.volumes)
    assert scans_folder() is not None, "ACCELSURF_VOLUMES names no folder"
    command = [sys.executable, "-m", "accelsurf", "serve", "--port", "0"]
    load_before = os.getloadavg()[0]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            found = measured(address, process.pid, options.objects.split(","))
            memory = psutil.Process(process.pid).memory_info().rss
        finally:
            process.terminate()
    result = {
        "scan": "T1 brain, niivue's demo images, 256 x 256 x 256, 1 mm",
        "wanted": WANTED,
        "machine": {
            "cores": os.cpu_count(),
            "load": round(load_before, 1),
            "system": platform.system(),
        },
        "server's memory at the end, MB": memory >> 20,
        "summary": summary(found["prompts"]),
        **found,
    }
    options.results.mkdir(parents=True, exist_ok=True)
    (options.results / NAME).write_text(json.dumps(result, indent=1) + "\n")
    for name, row in result["summary"].items():
        print(f"{name:22}", *(f"{key} {value}" for key, value in row.items()), sep="  ")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
