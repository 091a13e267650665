"""Real sequences and phantoms with known identities: accelsurf's models of motion beside other trackers.

Usage: python -m benchmarks.tracking_real [SEQUENCES] [-o FILE] [--only NAME]

SEQUENCES (default: ACCELSURF_SEQUENCES; sources: docs/explanation/real-scans.md) is a folder with ``droplet21.tif`` and
``droplet21_points.csv`` (napari-stress) and ``cells2d_laptrack.npz`` (laptrack). What is not there is left out and said
to be; the phantoms need no files. All have the same start, the true objects of the first frame. laptrack, btrack and
traccuracy (the scores) are optional, see `benchmarks.tracking_peers`.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.filters import threshold_otsu

from accelsurf import io
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.phantoms.motions import MovingPhantom, load_motion
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track.track import Tracking
from benchmarks.tracking_peers import (
    LINKERS,
    Followed,
    Labels,
    by_accelsurf,
    challenge_scores,
    dice_of_frame,
    installed,
    parts_of_frames,
    seg_of_frame,
    spots_of,
    versions_of,
)

ROOT = Path(__file__).parents[1]
MODELS = ("flowable-mass", "last-displacement", "none")
PHANTOMS = (
    "ball_moving",
    "ball_gap",
    "ball_returning",
    "balls_passing",
    "balls_bouncing",
    "disc_dividing",
)
#: Voxels that a peer looks around an object of a phantom; the fastest moves by 4.9 a frame.
REACH = 15.0
#: Spacing x, y, z of the droplet, um.
DROPLET = (1.98, 1.98, 3.998)
#: World position z, y, x of the droplet's first voxel in its table of points, um.
DROPLET_ORIGIN = (1.71, 122.14, 181.65)
#: Every frame of the droplet, and every fifth: it then moves by about a pixel at a time.
STRIDES = (1, 5)
#: The energy of the cells was selected on frames 0 to 4; these are the frames that are told.
CELLS_FROM, CELLS_TO = 5, 10
CELLS_ENERGY = "likelihood:histogram"


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    folder = os.environ.get("ACCELSURF_SEQUENCES")
    options.add_argument(
        "sequences", nargs="?", type=Path, default=None if folder is None else Path(folder)
    )
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/tracking_real.json"
    )
    options.add_argument(
        "--only", choices=sorted(WORKS), help="one of the works; the others' rows stay as they are"
    )
    given = options.parse_args()
    found = json.loads(given.output.read_text()) if given.only and given.output.exists() else {}
    for name in [given.only] if given.only else WORKS:
        rows = list(WORKS[name](given.sequences))
        for row in rows:
            print(name, {key: value for key, value in row.items() if key != "frames"}, flush=True)
        found[name] = rows
    found["peers"] = versions_of(("laptrack", "btrack", "traccuracy"))
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(found, indent=1) + "\n")
    picture(found, given.output.with_suffix(".png"))


def missing(folder: Path | None, name: str) -> bool:
    """Say that a file of a work is not there."""
    if folder is not None and (folder / name).exists():
        return False
    print(f"{name}: left out, it is not in SEQUENCES", file=sys.stderr)
    return True


def tracking(sequence: ImageSequence, start: Labels, model: str, energy: str) -> Tracking:
    config = TrackConfig(model=model, threads=1, energy=energy, levels=1)
    return Tracking(sequence, config, objects=Volume(start, sequence.geometry))


# -- phantoms with identities ---------------------------------------------------------------------------------------


def phantoms(folder: Path | None) -> Iterator[dict[str, Any]]:
    """SEG, DET and TRA against the truth of every frame but the hidden ones: there an object is to be found again."""
    del folder
    if not installed("traccuracy"):
        print("phantoms: left out, traccuracy is not installed", file=sys.stderr)
        return
    for name in PHANTOMS:
        phantom = MovingPhantom(load_motion(name))
        count = len(phantom)
        hidden = phantom.recipe.empty
        labels: list[Labels] = [phantom.truth(n) * np.uint8(n not in hidden) for n in range(count)]
        parents = {row.id: (row.parent,) if row.parent else () for row in phantom.rows()}
        truth = Followed(labels, parents)
        for model in MODELS:
            began = time.perf_counter()
            found = by_accelsurf(tracking(phantom, labels[0], model, "chan-vese"))
            seconds = time.perf_counter() - began
            yield {
                "phantom": name,
                "tracker": f"accelsurf {model}",
                **challenge_scores(found, truth),
                "seconds_per_frame": round(seconds / count, 3),
            }
        frames = [phantom.channels(n)[0].array for n in range(count)]
        for tracker, found, seconds in by_peers(frames, labels[0], REACH):
            yield {
                "phantom": name,
                "tracker": tracker,
                **challenge_scores(found, truth),
                "seconds_per_frame": round(seconds / count, 3),
            }


def by_peers(
    frames: list[NDArray[Any]], first: Labels, reach: float, both_ways: bool = False
) -> Iterator[tuple[str, Followed, float]]:
    """The trivial segmentation, linked by each peer: its name, what it found, seconds with the segmentation."""
    began = time.perf_counter()
    parts = parts_of_frames(frames, first, both_ways)
    spots = spots_of(parts)
    segmented = time.perf_counter() - began
    for name, (package, link) in LINKERS.items():
        if not installed(package):
            print(f"{name}: left out, it is not installed", file=sys.stderr)
            continue
        began = time.perf_counter()
        found = link(parts, spots, reach)
        yield f"threshold, {name}", found, segmented + time.perf_counter() - began


# -- an oil droplet in tissue, 3D -----------------------------------------------------------------------------------


def droplet(folder: Path | None) -> Iterator[dict[str, Any]]:
    """Dice with Otsu's threshold of each frame, and distances from the surface to another program's surface points."""
    if missing(folder, "droplet21.tif") or missing(folder, "droplet21_points.csv"):
        return
    assert folder is not None  # the files are there
    sequence = io.read_sequence(folder / "droplet21.tif", options=ReadOptions(spacing=DROPLET))
    with (folder / "droplet21_points.csv").open() as file:
        table = np.array([[float(value) for value in row] for row in list(csv.reader(file))[1:]])
    for stride in STRIDES:
        numbers = list(range(0, len(sequence), stride))
        part = VolumeSequence([sequence.channels(n)[0] for n in numbers])
        truth = [otsu(one.array) for one in (part.channels(n)[0] for n in range(len(numbers)))]
        for model in MODELS:
            began = time.perf_counter()
            scores = []
            off = []
            for result in tracking(part, truth[0].astype(np.uint8), model, "chan-vese"):
                if not result.frame:
                    continue
                labels = result.labels(seen_only=False)
                scores.append(dice_of_frame(labels, truth[result.frame]))
                points = table[table[:, 1] == numbers[result.frame], 2:] - np.array(DROPLET_ORIGIN)
                surface = result.objects[0].surface
                places = points / np.array(DROPLET[::-1]) - np.array(surface.corner)
                off.append(
                    np.abs(ndimage.map_coordinates(surface.psi, places.T, order=1, mode="nearest"))
                )
            seconds = (time.perf_counter() - began) / len(numbers)
            every = np.concatenate(off)
            yield {
                "every": stride,
                "tracker": f"accelsurf {model}",
                "frames": [round(one, 4) for one in scores],
                "dice": round(float(np.mean(scores)), 4),
                "points_um": round(float(every.mean()), 3),
                "points_um_p95": round(float(np.percentile(every, 95)), 3),
                "seconds_per_frame": round(seconds, 3),
            }


def otsu(values: NDArray[Any]) -> NDArray[np.bool_]:
    """The largest part above Otsu's threshold of the blurred frame, without holes."""
    blurred = ndimage.gaussian_filter(values.astype(np.float64), 0.7)
    parts, _ = ndimage.label(blurred > threshold_otsu(blurred))
    return np.asarray(
        ndimage.binary_fill_holes(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    )


# -- cells in phase contrast, 2D ------------------------------------------------------------------------------------


def cells(folder: Path | None) -> Iterator[dict[str, Any]]:
    """SEG and Dice of each frame; the reference has no identities from frame to frame, so there is no TRA."""
    if missing(folder, "cells2d_laptrack.npz"):
        return
    assert folder is not None  # the file is there
    with np.load(folder / "cells2d_laptrack.npz") as file:
        images, labels = file["images"][:, None], file["labels"][:, None]
    images, labels = images[CELLS_FROM:CELLS_TO].astype(np.float32), labels[CELLS_FROM:CELLS_TO]
    sequence = VolumeSequence([Volume.from_array(one) for one in images])
    for model in MODELS:
        began = time.perf_counter()
        found = by_accelsurf(tracking(sequence, labels[0], model, CELLS_ENERGY))
        seconds = time.perf_counter() - began
        yield cell_row(f"accelsurf {model}", found.labels, list(labels), seconds)
    began = time.perf_counter()
    parts = parts_of_frames(list(images), labels[0], both_ways=True)
    yield cell_row("threshold of each frame", parts, list(labels), time.perf_counter() - began)
    yield cell_row("first frame kept", [labels[0]] * len(labels), list(labels), 0.0)


def cell_row(
    tracker: str, found: list[Labels], truth: list[Labels], seconds: float
) -> dict[str, Any]:
    """Scores of the frames after the first."""
    each = [seg_of_frame(one, true) for one, true in zip(found[1:], truth[1:], strict=True)]
    dices = [dice_of_frame(one, true) for one, true in zip(found[1:], truth[1:], strict=True)]
    return {
        "tracker": tracker,
        "frames": [round(float(np.mean(one)), 4) for one in each],
        "seg": round(float(np.mean([score for one in each for score in one])), 4),
        "found": sum(score > 0 for one in each for score in one),
        "of": sum(len(one) for one in each),
        "dice": [round(one, 4) for one in dices],
        "seconds_per_frame": round(seconds / len(truth), 3),
    }


WORKS = {"phantoms": phantoms, "droplet": droplet, "cells": cells}


def picture(found: dict[str, Any], path: Path) -> None:
    """TRA of the phantoms, Dice of the droplet and SEG of the cells by frame."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(16, 4.4))
    rows = found.get("phantoms", [])
    names = list(dict.fromkeys(row["tracker"] for row in rows))
    for place, name in enumerate(names):
        own = {row["phantom"]: row["TRA"] for row in rows if row["tracker"] == name}
        across = np.arange(len(own)) + 0.8 * (place / max(1, len(names)) - 0.5)
        axes[0].bar(across, list(own.values()), 0.8 / len(names), align="edge", label=name)
    axes[0].set_xticks(range(len(PHANTOMS)), [one.replace("_", "\n") for one in PHANTOMS])
    axes[0].set(title="TRA of the phantoms", ylim=(0.5, 1.12))
    for row in found.get("droplet", []):
        numbers = np.arange(1, len(row["frames"]) + 1) * row["every"]
        axes[1].plot(
            numbers,
            row["frames"],
            "o-" if row["every"] == 1 else "s--",
            ms=3,
            label=f"{row['tracker']}, every {row['every']}",
        )
    axes[1].set(title="Droplet: Dice with Otsu of each frame", xlabel="frame")
    for row in found.get("cells", []):
        axes[2].plot(np.arange(CELLS_FROM + 1, CELLS_TO), row["frames"], "o-", label=row["tracker"])
    axes[2].set(title="Cells in phase contrast: SEG", xlabel="frame", ylim=(0, 1))
    axes[2].set_xticks(range(CELLS_FROM + 1, CELLS_TO))
    for axis in axes:
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
