"""What the defaults give: `accelsurf segment INPUT --start ball:... -o DIR`, nothing else, on all phantoms and scans.

The phantoms are those of `accelsurf synth`, without noise and with noise of 0.3 and 1 of their contrast, and as the
recipe has it. The ball is put in by a rule, not by hand: half as deep as the object at its deepest voxel, at least
2 voxels. One call makes the table of docs/explanation/defaults.md and docs/explanation/defaults.json beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf import io
from accelsurf.analysis import metrics
from accelsurf.grid.volume import Volume
from accelsurf.phantoms import recipes
from accelsurf.report.environment import versions
from benchmarks.pages import head_of, put_table, row_of

ROOT = Path(__file__).resolve().parent.parent
PAGE, FACTS = ROOT / "docs" / "explanation" / "defaults.md", ROOT / "docs" / "explanation" / "defaults.json"
#: Noise in parts of the contrast; None is the recipe's own.
NOISE = (0.0, 0.3, 1.0, None)
#: Scans: file, ball in voxels, and whether there is a reference (all of its labels above 0).
SCANS = {
    "T1 brain": ("mri_brain256", "ball:126,110,130,30vox", True),
    "T1 brain, oblique": ("mri_brain_oblique", "ball:71,89,71,30vox", True),
    "T2 cord": ("mri_cord_iso", "ball:30.3,27,25.0,2.5vox", True),
    "CT of a head phantom": ("ct_phantom_oblique", "ball:83,108,7,8vox", False),
}
COLUMNS = ("input", "noise", "Dice", "HD95 voxels", "volume", "steps", "stop", "grids", "presmooth", "warnings")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", default="", help="names of phantoms and scans, separated by semicolons")
    options = parser.parse_args()
    names = [name.strip() for name in options.only.split(";") if name.strip()] or [*recipes.recipe_names(), *SCANS]
    facts = json.loads(FACTS.read_text()) if FACTS.exists() else {"rows": {}}
    for name in names:
        rows = scan(name, options.threads) if name in SCANS else phantom(name, options.threads)
        others = {key: row for key, row in facts["rows"].items() if row["input"] != name}
        facts["rows"] = others | {f"{name} {row['noise']}": row for row in rows}
        write(facts)


def write(facts: dict[str, Any]) -> None:
    """The JSON and the page's table."""
    facts["versions"] = {key: value for key, value in versions().items() if key != "platform"}
    order = [*recipes.recipe_names(), *SCANS]
    facts["rows"] = dict(sorted(facts["rows"].items(), key=lambda item: order.index(item[1]["input"])))
    FACTS.write_text(json.dumps(facts, indent=1) + "\n")
    put_table(PAGE, "defaults", text_of(facts["rows"].values()))


def phantom(name: str, threads: int) -> list[dict[str, Any]]:
    """Runs on a phantom, a noise each; the same ball for all."""
    recipe, rows = recipes.load_recipe(name), []
    for noise in NOISE:
        if noise is None and recipe.noise == 0:
            continue
        amount = recipe.noise if noise is None else noise * abs(recipe.contrast)
        made = recipes.make(recipe.changed(noise=amount))
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / f"{name}.nii.gz"
            io.write(made.image, source)
            row = run(source, ball_in(made.truth), made.truth, threads)
        rows.append({"input": name, "noise": amount / abs(recipe.contrast), "exact_mm3": made.volume_mm3, **row})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def scan(name: str, threads: int) -> list[dict[str, Any]]:
    """The run on a scan; none where the folder with the scans is not given."""
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        print(f"{name}: left out, ACCELSURF_VOLUMES is not set", file=sys.stderr)
        return []
    stem, ball, known = SCANS[name]
    truth = None
    if known:
        truth = io.read_labels(Path(folder) / f"{stem}_ref.nii.gz")
        truth = truth.with_array((truth.array > 0).astype(np.uint8))
    row = {"input": name, "noise": None, **run(Path(folder) / f"{stem}.nii.gz", ball, truth, threads)}
    print(json.dumps(row), flush=True)
    return [row]


def ball_in(truth: Volume) -> str:
    """A ball half as deep as the object is, around the voxel where it is deepest, as `--start` takes it."""
    padded = np.pad(truth.array > 0, [(1, 1) if n > 1 else (0, 0) for n in truth.array.shape])
    depth = ndimage.distance_transform_edt(padded, sampling=truth.geometry.spacing)
    index = np.array(np.unravel_index(depth.argmax(), depth.shape)) - [n > 1 for n in truth.array.shape]
    x, y, z = truth.geometry.index_to_world(index.astype(float))
    radius = max(0.5 * float(depth.max()), 2.0 * min(truth.geometry.steps))
    return f"ball:{x:.2f},{y:.2f},{z:.2f},{radius:.2f}"


def run(source: Path, ball: str, truth: Volume | None, threads: int) -> dict[str, Any]:
    """One run of the command, and what it reached."""
    with tempfile.TemporaryDirectory() as folder:
        typed = [sys.executable, "-m", "accelsurf", "segment", str(source), "--start", ball, "-o", folder]
        began = time.perf_counter()
        done = subprocess.run([*typed, "--threads", str(threads), "--quiet"], capture_output=True, text=True)
        row: dict[str, Any] = {"start": ball, "exit_code": done.returncode, "seconds": time.perf_counter() - began}
        if done.returncode:
            return row | {"error": done.stderr.strip()}
        name = source.name.removesuffix(".nii.gz")
        report = json.loads((Path(folder) / f"{name}_report.json").read_text())
        labels = io.read_labels(Path(folder) / f"{name}_seg.nii.gz")
    row |= {key: report[key] for key in ("stop", "resolved_settings", "quality", "volume_mm3")}
    if truth is not None:
        row["metrics"] = metrics.evaluate(labels, truth).to_dict()
        row["hd95_voxels"] = row["metrics"]["hd95_mm"] / min(labels.geometry.steps)
    return row


def text_of(rows: Any) -> str:
    """The table, as Markdown."""
    lines = head_of(COLUMNS)
    for row in rows:
        noise = "" if row["noise"] is None else f"{row['noise']:g}"
        if "error" in row:
            lines.append(f"| {row['input']} | {noise} | {row['error'].splitlines()[0]} |" + " |" * (len(COLUMNS) - 3))
            continue
        found, stop, resolved = row.get("metrics"), row["stop"], row["resolved_settings"]
        cells = [row["input"], noise]
        cells += [f"{found['dice']:.3f}", f"{row['hd95_voxels']:.1f}"] if found else ["no reference", ""]
        # Of the surface against the object itself: Dice has the voxels that it passes through as inside or outside.
        exact = row.get("exact_mm3")
        cells.append(f"{row['volume_mm3'] / exact - 1:+.1%}" if exact else "")
        words = ", ".join(text.split(":")[0] for text in row["quality"]["warnings"])
        cells += [str(stop["steps"]), stop["reason"], str(resolved["levels"]), f"{resolved['presmooth_mm']:g}", words]
        lines.append(row_of(cells))
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
