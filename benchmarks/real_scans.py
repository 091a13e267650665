"""Real scans: agreement with their references, seconds, and that the mesh lies where the label map does.

The volumes are public (see docs/real-scans.md for their sources); the folder that ACCELSURF_VOLUMES names holds them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from accelsurf import io, metrics
from accelsurf.volume import Volume

#: Name -> (file, options of `accelsurf segment`, reference or None). Starts are world mm (LPS).
CASES: dict[str, tuple[str, list[str], str | None]] = {
    "brain": ("mri_brain256.nii.gz", ["--start", "ball:{center},30"], "mri_brain256_ref.nii.gz"),
    "brain, balance 2": (
        "mri_brain256.nii.gz",
        ["--start", "ball:{center},30", "--balance", "2", "--epsilon", "0"],
        "mri_brain256_ref.nii.gz",
    ),
    "head phantom": ("ct_phantom_oblique.nii.gz", ["--start", "ball:{center},40"], None),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    options = parser.parse_args()
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        sys.exit("ACCELSURF_VOLUMES is not set: name the folder with the scans (sources: docs/real-scans.md)")
    options.output.mkdir(parents=True, exist_ok=True)
    rows = [
        run(name, Path(folder), *case, options.output, options.threads)
        for name, case in CASES.items()
        if options.only in name
    ]
    facts = {"machine": {"processor": platform.machine(), "threads": options.threads}, "cases": rows}
    (options.output / "real_scans.json").write_text(json.dumps(facts, indent=1) + "\n")
    print(f"written: {options.output / 'real_scans.json'}")


def run(
    name: str, folder: Path, file: str, arguments: list[str], reference: str | None, output: Path, threads: int
) -> dict:
    image = io.read(folder / file)
    center = ",".join(f"{v:.2f}" for v in image.geometry.center_world())
    arguments = [argument.replace("{center}", center) for argument in arguments]
    target = output / name.replace(", ", "_").replace(" ", "_")
    command = ["accelsurf", "segment", file, "-o", target.name, *arguments, "--threads", str(threads)]
    began = time.perf_counter()
    call = [sys.executable, "-m", *command, "--overwrite", "--quiet"]
    call[call.index(file)], call[call.index(target.name)] = str(folder / file), str(target)
    done = subprocess.run(call, capture_output=True, text=True)
    row: dict = {"name": name, "command": " ".join(command), "exit_code": done.returncode}
    row["seconds"] = time.perf_counter() - began
    if done.returncode:
        row["error"] = done.stderr.strip()
        print(f"{name}: exit {done.returncode}: {row['error']}")
        return row
    stem = file.removesuffix(".nii.gz")
    report = json.loads((target / f"{stem}_report.json").read_text())
    row |= {key: report[key] for key in ("stop", "volume_mm3", "area_mm2", "peak_rss_mb", "components", "warnings")}
    labels = io.read_labels(target / f"{stem}_seg.nii.gz")
    row["same_grid"] = labels.geometry.matches(image.geometry)
    row["mesh_beyond_labels_voxels"] = mesh_beyond_labels(target / f"{stem}_surface.ply", labels)
    if reference is not None:
        truth = io.read_labels(folder / reference)
        truth = truth.with_array((truth.array > 0).astype(np.uint8))
        row["metrics"] = metrics.evaluate(labels, truth).to_dict()
        row["best_threshold_dice"] = best_threshold(image.array, truth.array)
    print(json.dumps({key: value for key, value in row.items() if key != "warnings"}))
    return row


def best_threshold(image: np.ndarray, truth: np.ndarray) -> float:
    """Dice of the best global threshold among 64: the least that a segmentation should beat."""
    levels = np.percentile(image[image > image.min()], np.linspace(1, 99, 64))
    return max(metrics.dice(image > level, truth) for level in levels)


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
