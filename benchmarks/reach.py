"""How far corrections go: stated reach, farthest voxel that moved, and what that did to Dice and probability.

python -m benchmarks.reach                              phantoms; writes JSON and the page's table
ACCELSURF_VOLUMES=DIR python -m benchmarks.reach        scans too, which report and never tune
python -m benchmarks.reach --render                     the table again, from the JSON alone

After a first click the simulated person of `benchmarks.clicks` corrects where most is wrong, and a careless one clicks
outside at the rim of the object: where a voxel of it is too much, if there is one. Cases `cut` begin with a reference
mask without a third of it, clicked in the middle of that third.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import accelsurf
from accelsurf.correct.refine import beginning_with
from accelsurf.correct.refiner import Refiner
from accelsurf.grid.boxes import bounding_box
from accelsurf.image.volume import Volume
from accelsurf.settings.corrections import corrections_of
from benchmarks.clicks.own import text_of
from benchmarks.clicks.person import PersonClick, next_click, voxels_of
from benchmarks.clicks.phantoms import made
from benchmarks.mend import dice
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import scans_folder

ROOT = Path(__file__).resolve().parent.parent
JSON, PAGE = ROOT / "benchmarks/results/reach.json", ROOT / "docs/explanation/clicks.md"
PHANTOMS = ("blob", "half", "tube", "tree", "shell", "touching", "cells", "textured")
#: Scan, id of the object, and whether a third of its reference is cut off.
SCANS = (
    ("ct_vertebra_l3", 22, False),
    ("ct_abdomen_hires", 1, True),
    ("ct_abdomen_hires", 52, False),
    ("mri_cord_iso", 1, False),
    ("synthetic_nuclei", 5, False),
)
#: Corrections where most is wrong, and radius of a careless click at the rim, largest spacings.
GOOD_ONES, RIM_RADIUS = 2, 2.0
Mask = NDArray[np.bool_]


class Case(NamedTuple):
    """An object: its image and truth; ``is_cut`` where its mask without a third is corrected."""

    name: str
    image: Volume
    truth: Mask
    is_cut: bool


def cases(folder: Path | None, names: list[str]) -> Iterator[Case]:
    """The phantoms, and the scans where there is a folder of them."""
    for name in PHANTOMS:
        if not names or name in names:
            yield Case(name, *made(f"phantom-{name}"), False)
    for scan, id, is_cut in SCANS if folder is not None else ():
        name = f"{scan} {id}{', cut' if is_cut else ''}"
        if folder is not None and (not names or scan in names):
            image = accelsurf.read(folder / f"{scan}.nii.gz")
            labels = accelsurf.read_labels(folder / f"{scan}_ref.nii.gz").array
            yield Case(name, image, np.asarray(labels == id), is_cut)


def play(case: Case) -> Iterator[dict[str, Any]]:
    """Correct an object, and measure each correction."""
    image, truth = case.image, case.truth
    if case.is_cut:
        mask = without_third(truth)
        refiner = Refiner(beginning_with(image, mask.astype(np.uint8)))
        click = next_click(truth, mask, image.geometry)
        assert click is not None
        yield measured(case, refiner, click, "third")
        return
    first = next_click(truth, None, image.geometry)
    assert first is not None
    result = accelsurf.segment(image, inside=text_of(first, image), keep_state="yes", threads=1)
    refiner = Refiner(result)
    yield measured(case, refiner, rim_click(truth, result.labels > 0, image), "rim")
    refiner.undo()
    for _ in range(GOOD_ONES):
        click = next_click(truth, refiner.result().labels > 0, image.geometry)
        if click is None:
            return
        yield measured(case, refiner, click, "most wrong")
    yield measured(case, refiner, rim_click(truth, refiner.result().labels > 0, image), "rim")


def without_third(truth: Mask) -> Mask:
    """A mask without the last third of its voxels along its longest axis."""
    box = bounding_box(truth)
    assert box is not None
    axis = int(np.argmax([s.stop - s.start for s in box]))
    at = np.quantile(np.nonzero(truth)[axis], 2.0 / 3.0)
    return truth & (np.indices(truth.shape, sparse=True)[axis] < at)


def rim_click(truth: Mask, labels: Mask, image: Volume) -> PersonClick:
    """An outside click of a ball at the rim of an object, at a voxel that is too much where there is one."""
    rim = labels & ~ndimage.binary_erosion(labels)
    wrong = rim & ~truth
    places = np.argwhere(wrong if wrong.any() else rim)
    at = places[np.random.default_rng(0).integers(len(places))]
    z, y, x = (int(i) for i in at)
    world = tuple(float(v) for v in image.geometry.index_to_world((z, y, x)))
    radius = RIM_RADIUS * max(image.geometry.spacing)
    return PersonClick("outside", (z, y, x), (world[0], world[1], world[2]), radius)


def measured(case: Case, refiner: Refiner, click: PersonClick, kind: str) -> dict[str, Any]:
    """Make a correction and measure it."""
    image, before = case.image, refiner.result()
    (correction,) = corrections_of({click.side: text_of(click, image)})
    shown = refiner.reach_of(correction)
    (change,) = refiner.apply(correction)
    after = refiner.result()
    old, new = (np.asarray(result.labels > 0) for result in (before, after))
    moved = old != new
    clicked = np.zeros(moved.shape, np.bool_)
    voxels = voxels_of(click, image.geometry)
    clicked[voxels.box] = voxels.mask
    far = ndimage.distance_transform_edt(~clicked, sampling=image.geometry.spacing)[moved]
    return {
        "object": case.name,
        "click": kind,
        "side": click.side,
        "radius": round(click.radius, 2),
        "shown": round(shown, 3),
        "reach": None if change.reach is None else round(change.reach.mm, 3),
        "farthest": round(float(far.max(initial=0.0)), 3),
        "beyond": int((far > 1e-4 + (0.0 if change.reach is None else change.reach.mm)).sum()),
        "wanted_mm": None if change.reach is None else round(change.reach.farthest_mm, 1),
        "moved": int(far.size),
        "share": round(float(far.size) / max(int(old.sum()), 1), 4),
        "dice": [round(dice(labels, case.truth), 4) for labels in (old, new)],
        "probability": [round(each.objects[0].quality.probability, 3) for each in (before, after)],
        "seconds": round(change.seconds, 2),
    }


def text_of_rows(rows: list[dict[str, Any]]) -> str:
    """The page's table."""
    lines = head_of(
        (
            "object",
            "click",
            "reach, mm",
            "farthest moved",
            "unbounded",
            "share moved",
            "Dice",
            "probability",
        )
    )
    for row in rows:
        reach = "-" if row["reach"] is None else f"{row['reach']:.1f}"
        wanted = "-" if row["wanted_mm"] is None else f"{row['wanted_mm']:.1f}"
        pairs = (
            "{:.3f} to {:.3f}".format(*row["dice"]),
            "{:.0%} to {:.0%}".format(*row["probability"]),
        )
        what = f"{row['side']}, {row['click']}"
        lines.append(
            row_of(
                (
                    row["object"],
                    what,
                    reach,
                    f"{row['farthest']:.1f}",
                    wanted,
                    f"{row['share']:.0%}",
                    *pairs,
                )
            )
        )
    beyond = sum(row["beyond"] > 0 for row in rows)
    lines += [
        "",
        f"Corrections that moved a voxel beyond their stated reach: {beyond} of {len(rows)}.",
    ]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write JSON and table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reach", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--objects", type=lambda text: text.split(","), default=[], help="only these"
    )
    parser.add_argument("--volumes", type=Path, default=scans_folder(), help="folder of the scans")
    parser.add_argument("--results", type=Path, default=JSON, help="the JSON")
    parser.add_argument("--render", action="store_true", help="measure nothing")
    options = parser.parse_args(arguments)
    if not options.render:
        rows = []
        for case in cases(options.volumes, options.objects):
            for row in play(case):
                rows.append(row)
                print(row, flush=True)
                options.results.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    if options.results == JSON:
        rows = json.loads(JSON.read_text())["rows"]
        put_table(PAGE, "benchmarks.reach", text_of_rows(rows), "python -m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
