"""Real scans by commands that a person could type: clicks, or starts; against their references and the best thresholds.

One call makes the tables of docs/explanation/real-scans.md, the JSON beside it, and pictures. The volumes are public
(that page names their sources); the folder that ACCELSURF_VOLUMES names holds them. Rows that are not run again are
kept from the JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf import io
from accelsurf.image.volume import Volume
from accelsurf.measure import metrics
from accelsurf.output.document import versions
from accelsurf.run.evolving_object import ROOM
from accelsurf.text.objects import read_objects
from benchmarks import typed
from benchmarks.clicks.person import next_click
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.objects import compare_on_objects, mean_dice
from benchmarks.peers.scans import best_window, compare_peers

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS_FILE = (
    ROOT / "docs" / "explanation" / "real-scans.md",
    ROOT / "docs" / "explanation" / "real-scans.json",
)


@dataclass(frozen=True)
class Case:
    """An object in a scan: ``options`` of `accelsurf segment`; the reference's ``labels``, all above 0 unless given.

    With ``clicks`` the simulated person adds so many. With ``table`` each label of the reference is an object, with a
    click in it from a table.
    """

    image: str
    options: str = ""
    labels: tuple[int, ...] = ()
    clicks: int = 0
    reference: bool = True
    table: bool = False


_BRAIN, _OBLIQUE, _CT = "mri_brain256", "mri_brain_oblique", "ct_abdomen_hires"
_LIVER = "--inside ball:163,318,19,8vox --inside ball:151,313,0,8vox --inside ball:155,277,19,8vox"
_CORD = " ".join(
    f"--start ball:{place},2.5vox"
    for place in ("31.8,5,24.8", "30.8,16,24.7", "30.3,27,25.0", "30.3,38,25.3", "30.3,49,25.6")
)
_BONES = (32, 33, 69, 70, *range(97, 104), *range(109, 116))
#: By the simulated person's clicks, and then from places selected on the scan by eye.
CASES: dict[str, Case] = {
    "brain": Case(_BRAIN, clicks=3),
    "oblique brain": Case(_OBLIQUE, clicks=3),
    "white matter": Case(_OBLIQUE, labels=(2,), clicks=3),
    "ventricles": Case(_BRAIN, labels=(4, 43), clicks=3),
    "cord": Case("mri_cord_iso", clicks=3),
    "liver": Case(_CT, labels=(5,), clicks=3),
    "spleen": Case(_CT, labels=(1,), clicks=3),
    "aorta": Case(_CT, labels=(52,), clicks=3),
    "nucleus": Case("fluo_nuclei1136", labels=(17,), clicks=3),
    "nuclei, each": Case("fluo_nuclei1136", "--energy seeded --presmooth 1vox", table=True),
    "brain, ball and preset": Case(_BRAIN, "--start ball:126,110,130,30vox --preset mr-brain"),
    "brain, ball": Case(_BRAIN, "--start ball:126,110,130,30vox"),
    "oblique brain, preset": Case(_OBLIQUE, "--start center --preset mr-brain"),
    "oblique brain, no option": Case(_OBLIQUE, "--start center"),
    "cord, balls": Case("mri_cord_iso", _CORD),
    "liver, three clicks by eye": Case(_CT, _LIVER, (5,)),
    "spleen, a click by eye": Case(_CT, "--inside ball:372,311,9,8vox", (1,)),
    "bones": Case(_CT, "--preset ct-skeleton", _BONES),
    "head phantom": Case("ct_phantom_oblique", "--preset ct-skeleton", reference=False),
}
#: Folder of the pictures that the page shows, and the colours of each.
PICTURES, COLOURS = ROOT / "docs" / "images", 96
CLICKED = (
    "object",
    "1 click",
    "2 clicks",
    "3 clicks",
    "HD95 mm",
    "mean mm",
    "best threshold",
    "good",
    "s first",
    "s later",
    "stop",
)
STARTED = (
    "object",
    "Dice",
    "HD95 mm",
    "mean mm",
    "best threshold",
    "other program",
    "steps",
    "s",
    "stop",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", default="", help="names of cases, separated by semicolons")
    parser.add_argument(
        "--peers",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="search each other program so long",
    )
    parser.add_argument(
        "--note", default="", help="about the circumstances, written into the rows that are run"
    )
    options = parser.parse_args()
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        sys.exit(
            "ACCELSURF_VOLUMES is not set: name the folder with the scans (docs/explanation/real-scans.md)"
        )
    names = [name.strip() for name in options.only.split(";") if name.strip()] or list(CASES)
    for name in set(names) - set(CASES):
        sys.exit(f"{name}: there is no such case, expected {'; '.join(CASES)}")
    options.output = options.output.resolve()
    options.output.mkdir(parents=True, exist_ok=True)
    for name in names:
        row = run(name, CASES[name], Path(folder).resolve(), options)
        if options.note:
            row["note"] = options.note
        write_row(name, row)
        print(_clicked(name, row) if CASES[name].clicks else _started(name, row), flush=True)


def write_row(name: str, row: dict[str, Any]) -> None:
    """Put a row into the JSON and the page; what other programs reached stays where they were not run again."""
    results = json.loads(RESULTS_FILE.read_text()) if RESULTS_FILE.exists() else {"cases": {}}
    if "peers" not in row and "peers" in results["cases"].get(name, {}):
        row["peers"] = results["cases"][name]["peers"]
    if "peers" not in row and name in results.get("peers", {}).get("cases", {}):
        # Of a search before the rows were made again; its date is beside it.
        row["peers"] = results["peers"]["cases"][name]
    results["versions"] = {key: value for key, value in versions().items() if key != "platform"}
    results["cases"] = {
        key: {**results["cases"], name: row}[key]
        for key in CASES
        if key in {**results["cases"], name: row}
    }
    RESULTS_FILE.write_text(json.dumps(results, indent=1) + "\n")
    put_table(PAGE, "real-scans", text_of(results["cases"]))


def run(name: str, case: Case, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Run a case as a user does, and measure what it wrote."""
    source, target = folder / f"{case.image}.nii.gz", options.output / slug(name)
    words, truth = shlex.split(case.options), None
    if case.reference:
        truth = io.read_labels(folder / f"{case.image}_ref.nii.gz")
        if not case.table:
            inside = np.isin(truth.array, case.labels) if case.labels else truth.array > 0
            truth = truth.with_array(inside.astype(np.uint8))
    if case.table:
        assert truth is not None
        table = options.output / f"{slug(name)}.csv"
        clicks_of(truth, table)
        words = ["--objects", table.name, *words]
    row: dict[str, Any] = {"threads": options.threads}
    if case.clicks:
        assert truth is not None
        row["clicks"] = typed.play(source, target, truth, words, case.clicks, options.threads)
        row["command"] = "; ".join(one["command"] for one in row["clicks"])
        failed = [one["error"] for one in row["clicks"] if "error" in one]
        if failed:
            return row | {"error": failed[0]}
    else:
        row["command"] = shlex.join(
            ["accelsurf", "segment", source.name, "-o", target.name, *words]
        )
        given = [
            "segment",
            str(source),
            "-o",
            str(target),
            *words,
            "--threads",
            str(options.threads),
        ]
        row |= typed.call([*given, "--overwrite", "--quiet"], options.output)
        if "error" in row:
            return row
        row |= typed.results_of(target, case.image)
    image, labels = io.read(source), io.read_labels(target / f"{case.image}_seg.nii.gz")
    if truth is not None:
        row["metrics"] = (
            each(labels, truth) if case.table else metrics.evaluate(labels, truth).to_dict()
        )
        window = best_window(image.as_float32(), truth.array > 0)
        row["best_threshold"] = window._asdict()
        starts = tuple(word for i, word in enumerate(words) if words[i - 1] == "--start")
        if options.peers > 0 and case.table:
            begun = read_objects(str(table), image.geometry, ROOM)
            row["peers"] = compare_on_objects(image, truth.array, begun, window, options.peers)
        elif options.peers > 0 and starts:
            row["peers"] = compare_peers(image, truth.array > 0, starts, window, options.peers)
    picture(PICTURES / f"real-{target.name}.png", name, image, labels, truth)
    return row


def clicks_of(truth: Volume, path: Path) -> None:
    """A table for --objects: the first click of the simulated person in each label."""
    rows = ["id,x,y,z,r,side"]
    for own in (int(one) for one in np.unique(truth.array) if one > 0):
        click = next_click(truth.array == own, None, truth.geometry)
        assert click is not None
        kind, _, numbers = typed.text_of(click, truth.geometry).partition(":")
        rows.append(f"{own},{numbers}{',' if kind == 'point' else ''},inside")
    path.write_text("\n".join([*rows, ""]))


def each(labels: Volume, truth: Volume) -> dict[str, Any]:
    """Means over the labels of the reference of what each has in common with the object of its id."""
    ids = [int(own) for own in np.unique(truth.array) if own > 0]
    pairs = [
        [one.with_array((one.array == own).astype(np.uint8)) for one in (labels, truth)]
        for own in ids
    ]
    found = [metrics.evaluate(*pair).to_dict() for pair in pairs if pair[0].array.any()]
    means = {
        key: float(np.mean([one[key] for one in found]))
        for key in ("hd95_mm", "mean_surface_distance_mm")
    }
    whole = metrics.dice(labels.array > 0, truth.array > 0)
    own = mean_dice(labels.array, truth.array)
    return {"dice": own, **means, "found": len(found), "of": len(ids), "all_as_one": whole}


def text_of(cases: dict[str, dict[str, Any]]) -> str:
    """The tables, the commands and the pictures, as Markdown."""
    clicked = {name: row for name, row in cases.items() if CASES[name].clicks}
    started = {name: row for name, row in cases.items() if name not in clicked}
    lines = [
        "## By clicks alone",
        "",
        *head_of(CLICKED),
        *(row_of(_clicked(*one)) for one in clicked.items()),
        "",
    ]
    lines += ["## From a start, a preset, or clicks by eye", "", *head_of(STARTED)]
    lines += [*(row_of(_started(*one)) for one in started.items()), "", "## Commands", ""]
    for row in cases.values():
        lines += [f"    {one['command']}" for one in row.get("clicks", [row])]
    shown = [name for name, row in cases.items() if "error" not in row]
    pictures = [f"![{name}](../images/real-{slug(name)}.png)" for name in shown]
    return "\n".join([*lines, "", "## Pictures", "", *pictures, ""])


def _clicked(name: str, row: dict[str, Any]) -> list[str]:
    """Cells of a row from clicks: distances are those after the last one, the probability that after the first."""
    rows = row["clicks"]
    found = [
        f"{one['metrics']['dice']:.3f}" if "metrics" in one else f"exit {one['exit_code']}"
        for one in rows
    ]
    cells = [name, *(found + [""] * 3)[:3]]
    if "error" in row:
        return cells + [""] * (len(CLICKED) - len(cells))
    last, good = rows[-1]["metrics"], (rows[0]["quality"] or {}).get("probability")
    cells += [f"{last['hd95_mm']:.1f}", f"{last['mean_surface_distance_mm']:.2f}"]
    cells += [f"{row['best_threshold']['dice']:.3f}", "" if good is None else f"{good:.0%}"]
    later = float(np.median([one["seconds"] for one in rows[1:]])) if rows[1:] else None
    cells += [
        f"{rows[0]['seconds']:.0f}",
        "" if later is None else f"{later:.0f}",
        rows[0]["stop"]["reason"],
    ]
    return cells


def _started(name: str, row: dict[str, Any]) -> list[str]:
    """Cells of a row from a start."""
    if "error" in row:
        return [name, f"exit {row['exit_code']}"] + [""] * (len(STARTED) - 2)
    found, stop = row.get("metrics"), row["stop"]
    cells = [name]
    keys = (("dice", ".3f"), ("hd95_mm", ".1f"), ("mean_surface_distance_mm", ".2f"))
    cells += [format(found[key], form) for key, form in keys] if found else ["no reference", "", ""]
    cells.append(f"{row['best_threshold']['dice']:.3f}" if found else "")
    other = max((row.get("peers") or {}).get("best", {}).items(), key=_dice, default=None)
    cells.append(f"{other[1]['dice']:.3f} ({other[0]})" if other else "")
    levels = f" on {row['levels']} grids" if row["levels"] > 1 else ""
    return [*cells, f"{stop['steps']}{levels}", f"{row['seconds']:.0f}", stop["reason"]]


def _dice(item: tuple[str, dict[str, Any]]) -> float:
    return float(item[1]["dice"])


def slug(name: str) -> str:
    """A case's name as part of a file's."""
    return name.replace(", ", "_").replace(" ", "_")


def picture(path: Path, title: str, image: Volume, labels: Volume, truth: Volume | None) -> None:
    """The slice with most of the object, across its z axis: ours solid, the reference dashed."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from PIL import Image

    inside = (truth if truth is not None else labels).array > 0
    k = int(inside.sum(axis=(1, 2)).argmax())
    rows, columns = (
        np.flatnonzero((inside | (labels.array > 0)).any(axis=axes)) for axes in ((0, 2), (0, 1))
    )
    (y0, y1), (x0, x1) = ((max(int(at[0]) - 15, 0), int(at[-1]) + 16) for at in (rows, columns))
    part = image.array[k, y0:y1, x0:x1].astype(np.float32)
    figure, axes = pyplot.subplots(figsize=(4, 4), dpi=100)
    spacing = image.geometry.spacing
    # Grey values of what lies about the object: of all else there may be air and metal.
    near = ndimage.binary_dilation((inside | (labels.array > 0))[k, y0:y1, x0:x1], iterations=8)
    low, high = np.percentile(part[near], (1, 99))
    axes.imshow(part, cmap="gray", vmin=low, vmax=high, aspect=spacing[1] / spacing[2])
    looks = [(labels, {"colors": "#ff9d2e", "linewidths": 1.2})]
    if truth is not None:
        looks.append((truth, {"colors": "#2ec4ff", "linewidths": 0.9, "linestyles": "dashed"}))
    for volume, look in looks:
        shown = volume.array[k, y0:y1, x0:x1]
        for own in np.unique(shown[shown > 0]):
            axes.contour(shown == own, [0.5], **look)
    axes.set_title(
        f"{title}: ours solid" + (", reference dashed" if truth is not None else ""), fontsize=9
    )
    axes.axis("off")
    figure.tight_layout(pad=0.3)
    figure.canvas.draw()
    # As a palette: small enough to lie beside the table.
    drawn = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
    drawn.quantize(COLOURS).save(path, optimize=True)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
