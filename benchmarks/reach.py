"""How far corrections go: stated reach, farthest voxel that moved, and what that did to Dice and probability.

python -m benchmarks.reach                              phantoms; writes JSON and the page's table
ACCELSURF_VOLUMES=DIR python -m benchmarks.reach        scans too, which report and never tune
python -m benchmarks.reach --render                     the table again, from the JSON alone

Objects are those of `benchmarks.clicks`: all phantoms, and of the scans one of each family in each fold, drawn with a
seed. After a first click the simulated person corrects where most is wrong, and a careless one clicks outside at the
rim of the object: where a voxel of it is too much, if there is one; a click that the program refuses, as nothing that
was clicked inside would be left, is none. Of an object of each fold, drawn too, the reference without a third of it is
clicked in the middle of that third.

Leaks are drawn: a lump of the object's grey values that a neck joins to it. They are clicked outside up to three times,
each time at the middle of what is left with half of its depth, or anywhere in it with any radius.
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
from accelsurf.errors import InputError
from accelsurf.grid.boxes import bounding_box
from accelsurf.image.volume import Volume
from accelsurf.interact.refine import beginning_with
from accelsurf.interact.refiner import Refiner
from accelsurf.settings.corrections import corrections_of
from benchmarks.clicks.folds import FAMILIES, FOLDS, PHANTOMS
from benchmarks.clicks.objects import ClickObject, Scene, load, selected
from benchmarks.clicks.own import text_of
from benchmarks.clicks.person import PersonClick, next_click, voxels_of
from benchmarks.clicks.references import within
from benchmarks.mend import dice
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import scans_folder

ROOT = Path(__file__).resolve().parent.parent
JSON, PAGE = ROOT / "benchmarks/results/reach.json", ROOT / "docs/explanation/clicks.md"
#: Seed of the objects that are drawn.
SEED = 0
#: Corrections where most is wrong, and radius of a careless click at the rim, largest spacings.
GOOD_ONES, RIM_RADIUS = 2, 2.0
#: Drawn leaks, clicks in each, and least and largest radius of a click anywhere in it, mm.
LEAKS, LEAK_CLICKS, LEAK_RADII = 24, 3, (0.5, 3.0)
Mask = NDArray[np.bool_]
Row = dict[str, Any]
CLICK_NAMES = {
    "rim": "careless, at the rim",
    "most wrong": "where most is wrong",
    "third": "in a third that was cut off",
}


class Case(NamedTuple):
    """An object that is corrected; ``is_cut`` where its mask without a third is."""

    object: ClickObject
    is_cut: bool


def cases(with_scans: bool) -> Iterator[Case]:
    """All phantoms; with scans one object of each family in each fold, and one of each fold to be cut."""
    yield from (Case(each, False) for each in selected([PHANTOMS]))
    random = np.random.default_rng(SEED)
    for fold in FOLDS if with_scans else ():
        held = selected([fold.name])
        for family in FAMILIES:
            alike = [each for each in held if each.family == family]
            if alike:
                yield Case(alike[random.integers(len(alike))], False)
        yield Case(held[random.integers(len(held))], True)


def play(case: Case, folder: Path | None) -> Iterator[Row | None]:
    """Correct an object, and measure each correction; None of one that is refused."""
    scene = load(case.object, folder)
    image, truth = scene.image, scene.truth
    if case.is_cut:
        mask = without_third(truth)
        refiner = Refiner(beginning_with(image, mask.astype(np.uint8)))
        click = next_click(truth, mask, image.geometry)
        assert click is not None
        yield measured(scene, refiner, click, "third")
        return
    first = next_click(truth, None, image.geometry)
    assert first is not None
    result = accelsurf.segment(image, inside=text_of(first, image), keep_state="yes", threads=1)
    refiner = Refiner(result)
    yield measured(scene, refiner, rim_click(scene, refiner), "rim")
    refiner.undo()
    for _ in range(GOOD_ONES):
        click = next_click(truth, compared(scene, refiner), image.geometry)
        if click is None:
            return
        yield measured(scene, refiner, click, "most wrong")
    yield measured(scene, refiner, rim_click(scene, refiner), "rim")


def compared(scene: Scene, refiner: Refiner) -> Mask:
    """The object, where it is compared with the reference."""
    return within(np.asarray(refiner.result().labels > 0), scene.region)


def without_third(truth: Mask) -> Mask:
    """A mask without the last third of its voxels along its longest axis."""
    box = bounding_box(truth)
    assert box is not None
    axis = int(np.argmax([s.stop - s.start for s in box]))
    at = np.quantile(np.nonzero(truth)[axis], 2.0 / 3.0)
    return truth & (np.indices(truth.shape, sparse=True)[axis] < at)


def rim_click(scene: Scene, refiner: Refiner) -> PersonClick:
    """An outside click of a ball at the rim of an object, at a voxel that is too much where there is one."""
    image, labels = scene.image, compared(scene, refiner)
    rim = labels & ~ndimage.binary_erosion(labels)
    wrong = rim & ~scene.truth
    places = np.argwhere(wrong if wrong.any() else rim)
    at = places[np.random.default_rng(0).integers(len(places))]
    z, y, x = (int(i) for i in at)
    world = tuple(float(v) for v in image.geometry.index_to_world((z, y, x)))
    radius = RIM_RADIUS * max(image.geometry.spacing)
    return PersonClick("outside", (z, y, x), (world[0], world[1], world[2]), radius)


def measured(scene: Scene, refiner: Refiner, click: PersonClick, kind: str) -> Row | None:
    """Make a correction and measure it; None where it is refused."""
    image, before = scene.image, refiner.result()
    (correction,) = corrections_of({click.side: text_of(click, image)})
    try:
        shown = refiner.reach_of(correction)
        (change,) = refiner.apply(correction)
    except InputError:
        return None
    after = refiner.result()
    old, new = (np.asarray(result.labels > 0) for result in (before, after))
    moved = old != new
    clicked = np.zeros(moved.shape, np.bool_)
    voxels = voxels_of(click, image.geometry)
    clicked[voxels.box] = voxels.mask
    far = ndimage.distance_transform_edt(~clicked, sampling=image.geometry.spacing)[moved]
    return {
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
        "dice": [
            round(dice(within(labels, scene.region), scene.truth), 4) for labels in (old, new)
        ],
        "probability": [round(each.objects[0].quality.probability, 3) for each in (before, after)],
        "seconds": round(change.seconds, 2),
    }


def leak(seed: int) -> Row:
    """Take a drawn leak away by clicks in the middle of what is left of it, and by clicks anywhere in it."""
    random = np.random.default_rng([SEED, seed])
    radius, neck = random.uniform(6.0, 11.0), random.uniform(1.0, 2.0)
    z, y, x = np.indices((40, 44, 96))
    across = (z - 20) ** 2 + (y - 22) ** 2
    lump = ndimage.gaussian_filter(random.normal(size=z.shape), 4.0)
    lump *= 0.12 * radius / lump.std()
    is_leak = (np.sqrt(across + (x - 44.0 - radius) ** 2) + lump < radius) & (x >= 42)
    body = across + (x - 26) ** 2 < 14**2
    mask = body | is_leak | ((across <= neck**2) & (x >= 38) & (x <= 44 + radius))
    values = 100.0 * mask + random.normal(0.0, random.choice([5.0, 20.0]), mask.shape)
    image = Volume.from_array(ndimage.gaussian_filter(values, 0.5).astype(np.float32), 1.0)
    row: Row = {"radius": round(radius, 1), "neck": round(2.0 * neck, 1)}
    for kind in ("middle", "anywhere"):
        refiner = Refiner(beginning_with(image, mask.astype(np.uint8)))
        gone = []
        for _ in range(LEAK_CLICKS):
            left = is_leak & np.asarray(refiner.result().labels > 0)
            if left.any():
                click = next_click(np.zeros_like(left), left, image.geometry)
                assert click is not None
                if kind == "anywhere":
                    z_, y_, x_ = (int(i) for i in random.choice(np.argwhere(left)))
                    at = (float(x_), float(y_), float(z_))
                    click = PersonClick("outside", (z_, y_, x_), at, random.uniform(*LEAK_RADII))
                (correction,) = corrections_of({click.side: text_of(click, image)})
                refiner.apply(correction)
                left &= np.asarray(refiner.result().labels > 0)
            gone.append(round(1.0 - float(left.sum() / is_leak.sum()), 3))
        row[kind] = gone
        after = np.asarray(refiner.result().labels > 0)
        row[f"{kind}, lost of the body"] = round(1.0 - float((after & body).sum() / body.sum()), 4)
    return row


def text_of_leaks(leaks: list[Row]) -> str:
    """The page's table of leaks."""
    lines = head_of(
        (
            f"outside clicks in {len(leaks)} drawn leaks",
            *(f"gone after {n + 1}: median (mean)" for n in range(LEAK_CLICKS)),
            *(f"all but 5% gone after {n + 1}" for n in range(LEAK_CLICKS)),
            "lost of the body, most",
        )
    )
    names = {"middle": "in the middle, of half the depth", "anywhere": "anywhere, .5 to 3 voxels"}
    for kind, name in names.items():
        gone = np.array([row[kind] for row in leaks])
        shares = [f"{np.median(each):.0%} ({each.mean():.0%})" for each in gone.T]
        whole = [f"{np.mean(each >= 0.95):.0%}" for each in gone.T]
        lost = max(row[f"{kind}, lost of the body"] for row in leaks)
        lines.append(row_of((name, *shares, *whole, f"{lost:.1%}")))
    return "\n".join(lines) + "\n"


def groups(rows: list[Row]) -> dict[str, list[Row]]:
    """The corrections of each line of the table: by side and kind of the click, and by family of the object."""
    scans, drawn = (
        [row for row in rows if (row["fold"] == PHANTOMS) == is_drawn] for is_drawn in (False, True)
    )
    kinds = sorted({(row["side"], row["click"]) for row in rows})
    found = {
        f"{side}, {CLICK_NAMES[kind]}": [
            row for row in rows if (row["side"], row["click"]) == (side, kind)
        ]
        for side, kind in kinds
    }
    found |= {
        f"scans: {each}": [row for row in scans if row["family"] == each] for each in FAMILIES
    }
    return {name: each for name, each in {**found, "phantoms": drawn, "all": rows}.items() if each}


def text_of_rows(rows: list[Row]) -> str:
    """The page's table."""
    lines = head_of(
        (
            "corrections",
            "number",
            "reach, mm: median (largest)",
            "farthest that moved, of the reach: median (largest)",
            "voxels moved, of the object: median (largest)",
            "moved beyond the reach",
            "Dice rises by .005, falls",
            "mean change of Dice",
            "probability rises",
        )
    )
    for name, each in groups(rows).items():
        bounded = [row for row in each if row["reach"] is not None]
        reach = np.array([row["reach"] for row in bounded])
        farthest = np.array([row["farthest"] for row in bounded]) / reach
        share = np.array([row["share"] for row in bounded])
        gain = np.array([row["dice"][1] - row["dice"][0] for row in each])
        raised = sum(row["probability"][1] > row["probability"][0] for row in each)
        cells = (
            name,
            str(len(each)),
            f"{np.median(reach):.1f} ({reach.max():.1f})",
            f"{np.median(farthest):.0%} ({farthest.max():.0%})",
            f"{np.median(share):.0%} ({share.max():.0%})",
            str(sum(row["beyond"] > 0 for row in each)),
            f"{np.mean(gain > 0.005):.0%}, {np.mean(gain < -0.005):.0%}",
            f"{gain.mean():+.3f}",
            str(raised),
        )
        lines.append(row_of(cells))
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write JSON and table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reach", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--volumes", type=Path, default=scans_folder(), help="folder of the scans")
    parser.add_argument(
        "--objects", type=lambda text: text.split(","), default=[], help="these again; 'leaks' too"
    )
    parser.add_argument("--render", action="store_true", help="measure nothing")
    options = parser.parse_args(arguments)
    results: dict[str, list[Row]] = (
        json.loads(JSON.read_text()) if options.render or options.objects else {}
    )
    if not options.render:
        measure(results, options)
    put_table(
        PAGE,
        "benchmarks.reach",
        f"{text_of_rows(results['rows'])}\n{text_of_leaks(results['leaks'])}",
        "python -m",
    )
    return 0


def measure(results: dict[str, list[Row]], options: argparse.Namespace) -> None:
    """Make the rows, and write them as they come."""
    only, keep = options.objects, results.get("rows", [])
    results["rows"] = [row for row in keep if row["object"] not in only]
    if not only or "leaks" in only:
        results["leaks"] = []
        for seed in range(LEAKS):
            results["leaks"].append(leak(seed))
            print(results["leaks"][-1], flush=True)
    for case in cases(options.volumes is not None):
        which = case.object
        about = {"object": which.name, "fold": which.fold, "family": which.family}
        for row in play(case, options.volumes) if not only or which.name in only else ():
            if row is not None:
                results["rows"].append({**about, **row})
                print(results["rows"][-1], flush=True)
        JSON.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
