"""What the defaults give, on all phantoms and some scans: clicks, and a ball as start, with no other option.

`accelsurf segment INPUT --inside ball:...`, corrected by two clicks of the simulated person (`benchmarks/typed.py`),
and `accelsurf segment INPUT --start ball:...` with the same ball. The phantoms are those of `accelsurf synth`, without
noise and with noise of 0.3 and 1 of their contrast, and as the recipe has it. One call makes the table of
docs/explanation/defaults.md and docs/explanation/defaults.json beside it; rows that are not run again stay.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.image.volume import Volume
from accelsurf.measure import metrics
from accelsurf.output.document import versions
from accelsurf.phantoms import recipe_files, recipes
from benchmarks import typed
from benchmarks.clicks.person import next_click
from benchmarks.pages import head_of, put_table, row_of

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS_FILE = (
    ROOT / "docs" / "explanation" / "defaults.md",
    ROOT / "docs" / "explanation" / "defaults.json",
)
#: Noise in parts of the contrast; None is the recipe's own.
NOISE = (0.0, 0.3, 1.0, None)
#: Scans: file, labels of the object (all above 0 unless given), and whether there is a reference; else the ball.
SCANS: dict[str, tuple[str, tuple[int, ...], str]] = {
    "T1 brain": ("mri_brain256", (), ""),
    "T1 brain, oblique": ("mri_brain_oblique", (), ""),
    "T2 cord": ("mri_cord_iso", (), ""),
    "CT of a head phantom": ("ct_phantom_oblique", (), "ball:83,108,7,8vox"),
}
#: Clicks of a run.
CLICKS = 3
COLUMNS = (
    "input",
    "noise",
    "click: Dice",
    "HD95 voxels",
    "volume",
    "good",
    "2 clicks",
    "3 clicks",
    "start: Dice",
    "HD95 voxels",
    "volume",
    "steps",
    "stop",
    "grids",
    "warnings",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--only", default="", help="names of phantoms and scans, separated by semicolons"
    )
    options = parser.parse_args()
    names = [name.strip() for name in options.only.split(";") if name.strip()] or [
        *recipe_files.recipe_names(),
        *SCANS,
    ]
    results = json.loads(RESULTS_FILE.read_text()) if RESULTS_FILE.exists() else {"rows": {}}
    for name in names:
        rows = scan(name, options.threads) if name in SCANS else phantom(name, options.threads)
        others = {key: row for key, row in results["rows"].items() if row["input"] != name}
        results["rows"] = others | {f"{name} {row['noise']}": row for row in rows}
        write(results)


def write(results: dict[str, Any]) -> None:
    """The JSON and the page's table."""
    results["versions"] = {key: value for key, value in versions().items() if key != "platform"}
    order = [*recipe_files.recipe_names(), *SCANS]
    results["rows"] = dict(
        sorted(results["rows"].items(), key=lambda item: order.index(item[1]["input"]))
    )
    RESULTS_FILE.write_text(json.dumps(results, indent=1) + "\n")
    put_table(PAGE, "defaults", text_of(results["rows"].values()))


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
            row = run(source, made.truth, "", threads)
        rows.append(
            {
                "input": name,
                "noise": amount / abs(recipe.contrast),
                "exact_mm3": made.volume_mm3,
                **row,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def scan(name: str, threads: int) -> list[dict[str, Any]]:
    """The run on a scan; none where the folder with the scans is not given."""
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        print(f"{name}: left out, ACCELSURF_VOLUMES is not set", file=sys.stderr)
        return []
    stem, labels, ball = SCANS[name]
    truth = None
    if not ball:
        truth = io.read_labels(Path(folder) / f"{stem}_ref.nii.gz")
        inside = np.isin(truth.array, labels) if labels else truth.array > 0
        truth = truth.with_array(inside.astype(np.uint8))
    row = {
        "input": name,
        "noise": None,
        **run(Path(folder).resolve() / f"{stem}.nii.gz", truth, ball, threads),
    }
    print(json.dumps(row), flush=True)
    return [row]


def run(source: Path, truth: Volume | None, ball: str, threads: int) -> dict[str, Any]:
    """Runs from clicks and from a start; the ball is that of the first click unless given."""
    if truth is not None:
        first = next_click(truth.array > 0, None, truth.geometry)
        assert first is not None  # phantoms and references are not empty
        # As a start it is as large as a start can be seen: two voxels at least.
        radius = max(first.radius, 2.0 * min(truth.geometry.steps))
        ball = typed.text_of(first._replace(radius=radius), truth.geometry)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "out"
        clicked = (
            []
            if truth is None
            else typed.play(source, target, truth, clicks=CLICKS, threads=threads)
        )
        words = [
            "segment",
            str(source),
            "--start",
            ball,
            "-o",
            str(target),
            "--threads",
            str(threads),
        ]
        row: dict[str, Any] = {"start": ball} | typed.call(
            [*words, "--overwrite", "--quiet"], Path(folder)
        )
        if "error" not in row:
            name = source.name.removesuffix(".nii.gz")
            row |= typed.results_of(target, name)
            if truth is not None:
                found = io.read_labels(target / f"{name}_seg.nii.gz")
                row["metrics"] = metrics.evaluate(found, truth).to_dict()
    if truth is not None:
        row["finest_mm"] = min(truth.geometry.steps)
    return {"clicks": clicked, **row}


def text_of(rows: Any) -> str:
    """The table, as Markdown."""
    lines = head_of(COLUMNS)
    for row in rows:
        noise = "" if row["noise"] is None else f"{row['noise']:g}"
        first, *later = [*row["clicks"], {}, {}, {}][:CLICKS]
        cells = [row["input"], noise, *found_of(first, row)]
        good = first.get("quality", {}).get("probability")
        cells.append("" if good is None else f"{good:.0%}")
        cells += [found_of(one, row)[0] for one in later]
        cells += found_of(row, row)
        if "error" in row:
            cells += [""] * 4
        else:
            words = ", ".join(text.split(":")[0] for text in row["quality"]["warnings"])
            cells += [str(row["stop"]["steps"]), row["stop"]["reason"], str(row["levels"]), words]
        lines.append(row_of(cells))
    return "\n".join([*lines, ""])


def found_of(one: dict[str, Any], row: dict[str, Any]) -> list[str]:
    """Dice, distance and volume of a run of a row; the volume is the surface's, against that of the object itself.

    Dice has the voxels that the surface passes through as inside or outside.
    """
    if "error" in one:
        return [f"exit {one['exit_code']}", "", ""]
    if "metrics" not in one:
        return ["no reference" if one else "", "", ""]
    exact, found = row.get("exact_mm3"), one["metrics"]
    volume = f"{one['volume_mm3'] / exact - 1:+.1%}" if exact else ""
    return [f"{found['dice']:.3f}", f"{found['hd95_mm'] / row['finest_mm']:.1f}", volume]


if __name__ == "__main__":
    main()
