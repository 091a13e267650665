"""Masks that are nearly right: brought to the edges without a click, and clicked, beside starting anew.

ACCELSURF_VOLUMES=DIR python -m benchmarks.mend             plays the scans that are reported; writes JSON and page
ACCELSURF_VOLUMES=DIR python -m benchmarks.mend --tuning    those on which numbers were selected; prints alone
python -m benchmarks.mend --render                          the page again, from the JSON alone

Reference masks are made worse in five ways that errors of networks and of hands have. Then `refine(labels=...)` mends
them, and the simulated person of `benchmarks.clicks` clicks until the Dice is reached, once from the mask and once from
nothing. Each object is played on the part of its scan around it, with all other labels of the reference there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import accelsurf
from accelsurf.errors import AccelsurfError
from accelsurf.grid.boxes import bounding_box, widened
from accelsurf.image.blocks import block_means
from accelsurf.image.volume import Volume
from accelsurf.interact.refiner import Refiner
from accelsurf.run.region_of_interest import cropped
from accelsurf.settings.corrections import Correction
from benchmarks.clicks.person import PersonClick, next_click
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import scans_folder

ROOT = Path(__file__).resolve().parent.parent
JSON, PAGE = ROOT / "docs/explanation/mend.json", ROOT / "docs/explanation/mend.md"


class Selected(NamedTuple):
    """Objects of a scan: how many, who made the reference, least and most voxels, and the first id that is none."""

    scan: str
    count: int
    made_by: str
    sizes: tuple[int, int] = (500, 10_000)
    below: int = 1 << 31


#: What is reported, and what numbers were selected on. FreeSurfer's ids from 1000 on are parts of the cortex, which
#: have no edge between them.
REPORTED = (
    Selected("ct_abdomen_hires", 2, "a network"),
    Selected("ct_abdomen_hires", 2, "a network", (10_000, 150_000)),
    Selected("mri_brain256", 3, "a program", below=1000),
    Selected("mri_brain256", 1, "a program", (10_000, 60_000), below=1000),
    Selected("mri_cord_iso", 1, "people"),
    Selected("mri_cord_thick", 1, "people"),
    Selected("fluo_nuclei1136", 1, "people"),
    Selected("synthetic_nuclei", 2, "a simulation"),
)
TUNED = (
    Selected("ct_vertebra_l3", 1, "a program"),
    Selected("mri_lung_0004", 1, "people"),
    Selected("fluo_nuclei1135", 1, "people"),
)
#: Voxels around an object that is played.
AROUND = 20
#: How far the border may move, smallest spacings; most clicks of a game; Dice that are wanted.
TO_EDGES, MOST_CLICKS, WANTED = 3.0, 4, (0.90, 0.95)
Mask = NDArray[np.bool_]


class Case(NamedTuple):
    """An object of a scan: the image around it, all labels there, and its id."""

    scan: str
    made_by: str
    image: Volume
    labels: NDArray[Any]
    id: int

    @property
    def truth(self) -> Mask:
        return np.asarray(self.labels == self.id)


def cases(selected: Sequence[Selected], folder: Path) -> Iterator[Case]:
    """Objects at equal steps of rank by size, of those that are neither tiny nor huge."""
    for scan, count, made_by, (least, most), below in selected:
        image = accelsurf.read(folder / f"{scan}.nii.gz")
        labels = accelsurf.read_labels(folder / f"{scan}_ref.nii.gz").array
        ids, sizes = np.unique(labels[labels > 0], return_counts=True)
        fits = (sizes >= least) & (sizes <= most) & (ids < below)
        ids = ids[fits][np.argsort(-sizes[fits])]
        for rank in np.linspace(0, len(ids) - 1, count + 2)[1:-1]:
            id = int(ids[round(rank)])
            tight = bounding_box(labels == id)
            assert tight is not None
            box = widened(tight, labels.shape, [AROUND] * 3)
            part = Volume(np.ascontiguousarray(image.array[box]), cropped(image.geometry, box))
            yield Case(scan, made_by, part, np.ascontiguousarray(labels[box]), id)


def restricted(truth: Mask, spacing: tuple[float, ...], random: np.random.Generator) -> Mask:
    """Blocks of four voxels of the smallest spacing: stair steps."""
    steps = [max(1, round(4 * min(spacing) / h)) for h in spacing]
    out = block_means(truth.astype(np.float32), steps) >= 0.5
    for axis, step in enumerate(steps):
        out = np.repeat(out, step, axis=axis)
    return out[tuple(slice(0, n) for n in truth.shape)]


def shifted(truth: Mask, spacing: tuple[float, ...], random: np.random.Generator) -> Mask:
    """Two of the smallest spacings away along each axis that is not coarser."""
    return np.roll(truth, [round(2 * min(spacing) / h) for h in spacing], (0, 1, 2))


def grown(truth: Mask, spacing: tuple[float, ...], random: np.random.Generator) -> Mask:
    """Two of the smallest spacings too large all around."""
    return np.asarray(ndimage.distance_transform_edt(~truth, sampling=spacing) <= 2 * min(spacing))


def cut(truth: Mask, spacing: tuple[float, ...], random: np.random.Generator) -> Mask:
    """A bite out of the border, and a leak elsewhere, as deep as the object or deeper."""
    radius = max(
        1.2 * float(ndimage.distance_transform_edt(truth, sampling=spacing).max()), 3 * max(spacing)
    )
    border = np.argwhere(truth & ~ndimage.binary_erosion(truth))
    bite, leak = (
        _ball(truth.shape, spacing, border[i], radius) for i in random.integers(len(border), size=2)
    )
    return (truth & ~bite) | (leak & ~bite)


def spotted(truth: Mask, spacing: tuple[float, ...], random: np.random.Generator) -> Mask:
    """Eight islands and eight holes of one to two of the largest spacings, or depths of the object where it is thin."""
    depth = float(ndimage.distance_transform_edt(truth, sampling=spacing).max())
    out, size = truth.copy(), min(max(spacing), depth)
    for where, value in (
        (~ndimage.binary_dilation(truth, iterations=4), True),
        (ndimage.binary_erosion(truth), False),
    ):
        places = np.argwhere(where)
        for place in places[random.integers(len(places), size=8)] if len(places) else ():
            spot = _ball(truth.shape, spacing, place, random.uniform(1, 2) * size)
            out[spot & where if value else spot] = value
    return out


def _ball(
    shape: tuple[int, ...], spacing: tuple[float, ...], middle: NDArray[np.int64], radius: float
) -> Mask:
    axes = np.ogrid[tuple(slice(0, n) for n in shape)]
    return np.asarray(
        sum(((axis - c) * h) ** 2 for axis, c, h in zip(axes, middle, spacing, strict=True))
        <= radius**2
    )


WORSE: dict[str, Callable[[Mask, tuple[float, ...], np.random.Generator], Mask]] = {
    "coarsened": restricted,
    "cut": cut,
    "shifted": shifted,
    "spotted": spotted,
    "grown": grown,
    "right": lambda truth, spacing, random: truth,
}
#: Those that are clicked, too.
CLICKED = ("cut",)
#: The games, and how many clicks were made before the first result of each.
GAMES = {"from_mask": 0, "from_nothing": 1}


def dice(found: Mask, truth: Mask) -> float:
    return 2.0 * int((found & truth).sum()) / max(int(found.sum() + truth.sum()), 1)


def surface_distance(found: Mask, truth: Mask, spacing: tuple[float, ...]) -> float:
    """Mean distance of the border voxels of either mask from those of the other, mm."""
    rims = [mask & ~ndimage.binary_erosion(mask, border_value=1) for mask in (found, truth)]
    if not all(rim.any() for rim in rims):
        return float("nan")
    distances = [
        ndimage.distance_transform_edt(~other, sampling=spacing)[rim]
        for rim, other in (rims, rims[::-1])
    ]
    return float(np.concatenate(distances).mean())


def text_of(click: PersonClick) -> str:
    """A click as an option."""
    return "ball:" + ",".join(repr(v) for v in (*click.centre, click.radius))


def clicks_from(case: Case, refiner: Refiner, found: Mask) -> list[float]:
    """Dice after each click that corrects a result."""
    out = [dice(found, case.truth)]
    while out[-1] < WANTED[-1] and len(out) <= MOST_CLICKS:
        click = next_click(case.truth, found, case.image.geometry)
        if click is None:
            break
        try:
            refiner.apply(
                Correction(
                    **{click.side: (text_of(click),)}, object=case.id if refiner.has_ids else None
                )
            )
        except AccelsurfError as error:
            print(f"    {error.message}")
            break
        result = refiner.result()
        found = np.asarray(result.labels == (case.id if refiner.has_ids else 1))
        out.append(dice(found, case.truth))
    return out


def needed(after: list[float], wanted: float, first: int = 0) -> int | None:
    """Number of clicks until a Dice is reached; None where it is not."""
    return next((first + number for number, value in enumerate(after) if value >= wanted), None)


def play(case: Case, ways: list[str], known: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Rows of the table of one object; ``known`` are its rows so far."""
    truth = case.truth
    spacing = case.image.geometry.spacing
    h = min(case.image.geometry.spacing)
    if known:
        from_nothing = known[0]["from_nothing"]
    else:
        click = next_click(truth, None, case.image.geometry)
        assert click is not None
        anew = accelsurf.segment(case.image, inside=text_of(click))
        from_nothing = clicks_from(case, Refiner(anew), anew.labels > 0)
    for way in ways:
        mask = WORSE[way](truth, spacing, np.random.default_rng(case.id)) & (
            truth | (case.labels == 0)
        )
        labels = np.where(mask, case.id, np.where(truth, 0, case.labels)).astype(case.labels.dtype)
        given = _state(case, labels)
        began, volume = time.perf_counter(), f"{0.05 * mask.sum() * np.prod(spacing):.6f}mm3"
        refiner = Refiner(given)
        edges = None if way == "spotted" else TO_EDGES * h
        refiner.apply(Correction(to_edges=edges, islands=volume, holes=volume, object=case.id))
        after = refiner.result().labels
        seconds = time.perf_counter() - began
        assert np.array_equal(
            after[(labels > 0) & (labels != case.id)], labels[(labels > 0) & (labels != case.id)]
        )
        row = {
            "scan": case.scan,
            "made_by": case.made_by,
            "id": case.id,
            "voxels": int(truth.sum()),
            "way": way,
            "dice": [dice(mask, truth), dice(after == case.id, truth)],
            "distance": [
                surface_distance(found, truth, spacing) / h for found in (mask, after == case.id)
            ],
            "seconds": seconds,
            "from_nothing": from_nothing,
        }
        if way in CLICKED:
            row["from_mask"] = clicks_from(case, Refiner(given), mask)
        said = {
            key: row[key] for key in ("dice", "distance", "from_mask", "from_nothing") if key in row
        }
        print(f"  {way:10}", said, flush=True)
        yield row


def _state(case: Case, labels: NDArray[Any]) -> Any:
    """The result that a label map is, the case's object asked for."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "labels.nii.gz"
        accelsurf.write(case.image.with_array(labels), path)
        return accelsurf.segment(case.image, labels=f"{path}@{case.id}")


def page(rows: list[dict[str, Any]]) -> str:
    """Both tables."""
    lines = head_of(
        (
            "mask",
            "objects",
            "Dice before",
            "after `--to-edges`",
            "border off before, voxels",
            "after",
            "better, worse",
        )
    )
    for way in WORSE:
        found = [row for row in rows if row["way"] == way]
        if not found:
            continue
        means = [
            np.mean([row[key][k] for row in found]) for key in ("dice", "distance") for k in (0, 1)
        ]
        moved = [row["dice"][1] - row["dice"][0] for row in found]
        better, worse = sum(m > 0.005 for m in moved), sum(m < -0.005 for m in moved)
        numbers = [f"{mean:.3f}" if mean < 1 else f"{mean:.2f}" for mean in means]
        lines.append(row_of((way, str(len(found)), *numbers, f"{better}, {worse}")))
    lines += ["", *head_of(("mask", "Dice", "clicks from the mask", "from nothing"))]
    for way in CLICKED:
        for wanted in WANTED:
            found = [row for row in rows if row["way"] == way]
            cells = [
                _said([needed(row[key], wanted, first) for row in found])
                for key, first in GAMES.items()
            ]
            lines.append(row_of((way, f"{wanted:.2f}", *cells)))
    lines += [
        "",
        *head_of(("object", "mask", "Dice before", "after `--to-edges`", "clicks to .90")),
    ]
    for row in rows:
        clicks = [needed(row[key], 0.9, first) for key, first in GAMES.items() if key in row]
        said = ", ".join("-" if c is None else str(c) for c in clicks) if "from_mask" in row else ""
        lines.append(
            row_of(
                (f"{row['scan']} {row['id']}", row["way"], *(f"{d:.3f}" for d in row["dice"]), said)
            )
        )
    return "\n".join(lines)


def _said(counts: list[int | None]) -> str:
    """Median number of clicks, and in how many games the Dice was reached."""
    reached = [count for count in counts if count is not None]
    worst = [MOST_CLICKS + 1 if count is None else count for count in counts]
    return (
        f"{np.median(worst):g} ({len(reached)} of {len(counts)})" if counts else "none was played"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--render", action="store_true")
    parser.add_argument(
        "--ways", default=",".join(WORSE), help="masks that are played; the rows of others stay"
    )
    parser.add_argument("--new", action="store_true", help="only masks without a row are played")
    options = parser.parse_args()
    if not options.render:
        ways = options.ways.split(",")
        rows = (
            [row for row in _known() if options.new or row["way"] not in ways]
            if not options.tuning
            else []
        )
        for case in cases(TUNED if options.tuning else REPORTED, scans_folder()):
            known = [row for row in rows if (row["scan"], row["id"]) == (case.scan, case.id)]
            missing = [way for way in ways if way not in {row["way"] for row in known}]
            if not missing:
                continue
            print(f"{case.scan} {case.id}: {int(case.truth.sum())} voxels", flush=True)
            for row in play(case, missing, known):
                rows.append(row)
                if not options.tuning:
                    JSON.write_text(
                        json.dumps({"to_edges": TO_EDGES, "rows": rows}, indent=1) + "\n"
                    )
        if options.tuning:
            print(page(rows))
            return
    put_table(PAGE, "mend", page(_known()), "python -m benchmarks")


def _known() -> list[dict[str, Any]]:
    """Rows that were made before."""
    rows: list[dict[str, Any]] = json.loads(JSON.read_text())["rows"]
    return rows


if __name__ == "__main__":
    main()
