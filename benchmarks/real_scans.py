"""Real scans: our commands against their references, best global thresholds, and other programs from the same start.

One call makes the table of docs/explanation/real-scans.md, the JSON beside it, and pictures. The volumes are public
(that page names their sources); the folder that ACCELSURF_VOLUMES names holds them. Rows that are not run again are
kept from the JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf import io
from accelsurf.analysis import metrics
from accelsurf.grid.volume import Volume
from accelsurf.initialization import object_starts
from accelsurf.report.environment import peak_rss_mb, versions
from accelsurf.segmentation.object_grid import ROOM
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.objects import compare_on_objects, mean_dice
from benchmarks.peers.scans import best_window, compare_peers

ROOT = Path(__file__).resolve().parent.parent
PAGE, FACTS = ROOT / "docs" / "explanation" / "real-scans.md", ROOT / "docs" / "explanation" / "real-scans.json"


@dataclass(frozen=True)
class Case:
    """An object in a scan: ``options`` of `accelsurf segment`; the reference's ``labels``, all above 0 unless given.

    With ``balls`` each label of the reference is an object, started from a ball of so many mm on its centroid.
    """

    image: str
    options: str
    labels: tuple[int, ...] = ()
    wanted: float | None = None
    reference: bool = True
    balls: float | None = None


_LIVER = "--start ball:163,318,19,12vox --start ball:151,313,0,12vox --start ball:155,277,19,12vox"
_CORD = " ".join(
    f"--start ball:{place},2.5vox"
    for place in ("31.8,5,24.8", "30.8,16,24.7", "30.3,27,25.0", "30.3,38,25.3", "30.3,49,25.6")
)
_WHITE = "threshold:half:110, + 2*local-region:R=15"
_NUCLEI = "local-region:R=2.5 + 0.02*threshold:half:25,"
_BONES = (32, 33, 69, 70, *range(97, 104), *range(109, 116))
CASES: dict[str, Case] = {
    "brain": Case("mri_brain256", "--start ball:126,110,130,30vox --preset mr-brain", wanted=0.96),
    "brain, defaults": Case("mri_brain256", "--start ball:126,110,130,30vox"),
    "oblique brain": Case("mri_brain_oblique", "--start center --preset mr-brain"),
    "oblique brain, defaults": Case("mri_brain_oblique", "--start center"),
    "white matter": Case(
        "mri_brain_oblique",
        f"--start ball:55,90,85,6vox --start ball:88,90,85,6vox --energy '{_WHITE}' --levels 1", (2,), 0.90,
    ),
    "ventricles": Case(
        "mri_brain256", "--start ball:144,100,115,4vox --start ball:109,97,117,4vox --preset mr-ventricle", (4, 43)
    ),
    "cord": Case("mri_cord_iso", f"{_CORD} --preset mr-cord", wanted=0.85),
    "liver": Case("ct_abdomen_hires", f"{_LIVER} --preset ct-organ", (5,), 0.88),
    "liver, window by hand": Case(
        "ct_abdomen_hires", f"{_LIVER} --energy threshold:65,130 --presmooth 3 --smoothness 3", (5,), 0.88
    ),
    "spleen": Case("ct_abdomen_hires", "--start ball:372,311,9,12vox --preset ct-organ", (1,)),
    "aorta": Case("ct_abdomen_hires", "--start ball:263,299,11,7vox --preset ct-vessel", (52,)),
    "bones": Case("ct_abdomen_hires", "--preset ct-bone", _BONES),
    "nuclei, each": Case(
        "fluo_nuclei1136", f"--energy '{_NUCLEI}' --presmooth 0.2 --smoothness 0.006", wanted=0.65, balls=0.8
    ),
    "head phantom": Case("ct_phantom_oblique", "--preset ct-bone", reference=False),
}
#: Folder of the pictures that the page shows, and the colours of each.
PICTURES, COLOURS = ROOT / "docs" / "images", 96
COLUMNS = (
    "object", "wanted", "Dice", "HD95 mm", "mean mm", "best threshold", "best other program", "steps", "s", "stop",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", default="", help="names of cases, separated by semicolons")
    parser.add_argument("--peers", type=float, default=0.0, metavar="SECONDS", help="search each other program so long")
    parser.add_argument("--note", default="", help="about the circumstances, written into the rows that are run")
    options = parser.parse_args()
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        sys.exit("ACCELSURF_VOLUMES is not set: name the folder with the scans (docs/explanation/real-scans.md)")
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
        print(json.dumps({key: value for key, value in row.items() if key not in ("peers", "quality")}), flush=True)


def write_row(name: str, row: dict[str, Any]) -> None:
    """Put a row into the JSON and the page; what other programs reached stays where they were not run again."""
    facts = json.loads(FACTS.read_text()) if FACTS.exists() else {"cases": {}}
    if "peers" not in row and "peers" in facts["cases"].get(name, {}):
        row["peers"] = facts["cases"][name]["peers"]
    facts["versions"] = {key: value for key, value in versions().items() if key != "platform"}
    facts["cases"] = {key: {**facts["cases"], name: row}[key] for key in CASES if key in {**facts["cases"], name: row}}
    FACTS.write_text(json.dumps(facts, indent=1) + "\n")
    put_table(PAGE, "real-scans", text_of(facts["cases"]))


def run(name: str, case: Case, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Run a case as a user does, and measure what it wrote."""
    source, target = folder / f"{case.image}.nii.gz", options.output / slug(name)
    if case.balls is not None:
        table = options.output / f"{slug(name)}.csv"
        case = replace(case, options=f"--objects {table.name} {case.options}")
        seeds(io.read_labels(folder / f"{case.image}_ref.nii.gz"), case.balls, table)
    typed = shlex.split(case.options)
    row: dict[str, Any] = {"command": f"accelsurf segment {source.name} -o {target.name} {case.options}"}
    call = [sys.executable, "-m", "accelsurf", "segment", str(source), "-o", str(target), *typed]
    began = time.perf_counter()
    done = subprocess.run(
        [*call, "--threads", str(options.threads), "--overwrite", "--quiet"], capture_output=True, text=True,
        cwd=options.output,
    )
    row |= {"exit_code": done.returncode, "seconds": time.perf_counter() - began, "threads": options.threads}
    if done.returncode:
        row["error"] = done.stderr.strip()
        return row
    report = json.loads((target / f"{case.image}_report.json").read_text())
    row |= {key: report[key] for key in ("stop", "levels", "volume_mm3", "peak_rss_mb", "quality", "warnings")}
    row["levels"] = len(report["levels"])
    image, labels = io.read(source), io.read_labels(target / f"{case.image}_seg.nii.gz")
    truth = None
    if case.balls is not None:
        truth = io.read_labels(folder / f"{case.image}_ref.nii.gz")
        row["metrics"] = each(labels, truth)
        window = best_window(image.as_float32(), truth.array > 0)
        row["best_threshold"] = window._asdict()
        if options.peers > 0:
            begun = object_starts.read(str(table), image.geometry, ROOM)
            row["peers"] = compare_on_objects(image, truth.array, begun, window, options.peers)
            row["peers"]["threads"] = options.threads
    else:
        row["mesh_beyond_labels_voxels"] = mesh_beyond_labels(target / f"{case.image}_surface.ply", labels)
    if case.reference and case.balls is None:
        truth = io.read_labels(folder / f"{case.image}_ref.nii.gz")
        inside = np.isin(truth.array, case.labels) if case.labels else truth.array > 0
        truth = truth.with_array(inside.astype(np.uint8))
        row["metrics"] = metrics.evaluate(labels, truth).to_dict()
        window = best_window(image.as_float32(), truth.array > 0)
        row["best_threshold"] = window._asdict()
        if options.peers > 0:
            starts = tuple(word for i, word in enumerate(typed) if typed[i - 1] == "--start")
            row["peers"] = compare_peers(image, truth.array > 0, starts, window, options.peers)
            row["peers"]["threads"] = options.threads
    picture(PICTURES / f"real-{target.name}.png", name, image, labels, truth)
    row["memory_of_study_mb"] = peak_rss_mb()
    return row


def seeds(truth: Volume, radius: float, path: Path) -> None:
    """A table for --objects: a ball of ``radius`` mm on the centroid of each label."""
    ids = [int(own) for own in np.unique(truth.array) if own > 0]
    places = truth.geometry.index_to_world(np.array(ndimage.center_of_mass(truth.array > 0, truth.array, ids)))
    rows = [f"{own},{x:.4f},{y:.4f},{z:.4f},{radius:g}" for own, (x, y, z) in zip(ids, places, strict=True)]
    path.write_text("\n".join(["id,x,y,z,r", *rows, ""]))


def each(labels: Volume, truth: Volume) -> dict[str, Any]:
    """Means over the labels of the reference of what each has in common with the object of its id."""
    ids = [int(own) for own in np.unique(truth.array) if own > 0]
    pairs = [[one.with_array((one.array == own).astype(np.uint8)) for one in (labels, truth)] for own in ids]
    found = [metrics.evaluate(*pair).to_dict() for pair in pairs if pair[0].array.any()]
    means = {key: float(np.mean([one[key] for one in found])) for key in ("hd95_mm", "mean_surface_distance_mm")}
    whole = metrics.dice(labels.array > 0, truth.array > 0)
    own = mean_dice(labels.array, truth.array)
    return {"dice": own, **means, "found": len(found), "of": len(ids), "all_as_one": whole}


def text_of(cases: dict[str, dict[str, Any]]) -> str:
    """The table and the commands, as Markdown."""
    lines = head_of(COLUMNS)
    for name, row in cases.items():
        if "error" in row:
            lines.append(f"| {name} | | {row['error'].splitlines()[0]} |" + " |" * (len(COLUMNS) - 3))
            continue
        found, best = row.get("metrics"), max((row.get("peers") or {}).get("best", {}).items(), key=_dice, default=None)
        wanted, stop = CASES[name].wanted, row["stop"]
        cells = [name, f"{wanted:.2f}" if wanted else ""]
        keys = (("dice", ".3f"), ("hd95_mm", ".1f"), ("mean_surface_distance_mm", ".2f"))
        cells += [format(found[key], form) for key, form in keys] if found else ["no reference", "", ""]
        cells.append(f"{row['best_threshold']['dice']:.3f}" if found else "")
        cells.append(f"{best[1]['dice']:.3f} in {best[1]['seconds']:.1f} s ({best[0]})" if best else "")
        levels = f" on {row['levels']} grids" if row["levels"] > 1 else ""
        cells += [f"{stop['steps']}{levels}", f"{row['seconds']:.0f}", stop["reason"]]
        lines.append(row_of(cells))
    commands = [f"    {row['command']}" for row in cases.values()]
    shown = [name for name, row in cases.items() if "error" not in row]
    pictures = [f"![{name}](../images/real-{slug(name)}.png)" for name in shown]
    return "\n".join([*lines, "", *commands, "", *pictures, ""])


def slug(name: str) -> str:
    """A case's name as part of a file's."""
    return name.replace(", ", "_").replace(" ", "_")


def _dice(item: tuple[str, dict[str, Any]]) -> float:
    return float(item[1]["dice"])


def picture(path: Path, title: str, image: Volume, labels: Volume, truth: Volume | None) -> None:
    """The slice with most of the object, across its z axis: ours solid, the reference dashed."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from PIL import Image

    inside = (truth if truth is not None else labels).array > 0
    k = int(inside.sum(axis=(1, 2)).argmax())
    rows, columns = (np.flatnonzero((inside | (labels.array > 0)).any(axis=axes)) for axes in ((0, 2), (0, 1)))
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
    axes.set_title(f"{title}: ours solid" + (", reference dashed" if truth is not None else ""), fontsize=9)
    axes.axis("off")
    figure.tight_layout(pad=0.3)
    figure.canvas.draw()
    # As a palette: small enough to lie beside the table.
    drawn = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
    drawn.quantize(COLOURS).save(path, optimize=True)
    pyplot.close(figure)


def mesh_beyond_labels(path: Path, labels: Volume) -> float:
    """Largest distance, in voxels, of a vertex outside the box of the labelled voxels (their outer faces).

    Below 0.5: a surface between an inside and an outside voxel centre lies less than one voxel from the former.
    """
    import pyvista

    index = labels.geometry.world_to_index(np.asarray(pyvista.read(path).points, dtype=np.float64))
    where = np.argwhere(labels.array > 0)
    low, high = where.min(axis=0) - 0.5, where.max(axis=0) + 0.5
    return float(max((low - index).max(), (index - high).max(), 0.0))


if __name__ == "__main__":
    main()
