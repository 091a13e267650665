"""Closest points or a fast march: accuracy, drift, Dice and cost of both settings of ``extension``, side by side.

Distances and a field extended from the surface against their exact values; the exact solutions of the tests; surfaces
at rest in 100 redistances; a ball and a cube in noise as strong as the contrast, five seeds; with ``--volumes`` the
cord of docs/explanation/real-scans.md; and process time per band cell, the two settings in turn on one thread.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf import io, segment
from accelsurf.levelset import LevelSet
from accelsurf.measure import metrics
from benchmarks.real_scans import CASES
from tests.support import exact
from tests.support.follow import STEP, WIDTH, follow, lattice, order

Floats = NDArray[np.floating[Any]]
EXTENSIONS = ("closest-point", "fast-marching")
UNIT = (1.0, 1.0, 1.0)
#: Normal of the plane, z y x.
NORMAL = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument(
        "--volumes",
        type=Path,
        help="folder of the real scans; without it that part is kept as it is",
    )
    parser.add_argument("--only", nargs="+", choices=sorted(PARTS), default=sorted(PARTS))
    options = parser.parse_args()
    path = options.output / "extension.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    for name in options.only:
        if name == "cord" and options.volumes is None:
            continue
        results[name] = (
            {one: PARTS[name](one, options) for one in EXTENSIONS} if name != "cost" else cost()
        )
        print(name, json.dumps(results[name], indent=1), flush=True)
        path.write_text(json.dumps(results, indent=1) + "\n")


def grid(shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> Floats:
    """Coordinates (3, nz, ny, nx), mm, from a point near the middle."""
    axes = [
        (np.arange(n) - 0.5 * (n - 1) - (0.13 if n > 1 else 0)) * h
        for n, h in zip(shape, spacing, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def coordinates_of(surface: LevelSet, points: Floats) -> Floats:
    """Those (n, 3) of the band cells."""
    return points.reshape(3, -1)[:, surface.band.cells].T


def fields(extension: str, _: argparse.Namespace) -> dict[str, Any]:
    """Largest and mean error of distances, closest points (both voxels) and a field sin(3 n_x) + n_y n_z; no centre."""
    found = {}
    for radius in (10.0, 20.0):
        points = grid((int(2 * radius) + 12,) * 3, UNIT)
        surface = LevelSet(np.sqrt((points**2).sum(axis=0)) - radius, UNIT, extension=extension)
        at = coordinates_of(surface, points)
        r = np.linalg.norm(at, axis=1)
        n = at / r[:, None]
        truth = np.sin(3 * n[:, 2]) + n[:, 1] * n[:, 0]
        known, front = truth.astype(np.float32), surface.front()
        surface.extend_outwards(known, front)
        off = ~front
        distance, apart = (
            np.abs(surface.band.psi - (r - radius)),
            np.linalg.norm(at + surface.band.to_closest - radius * n, axis=1),
        )
        found[f"ball {radius:g}"] = {
            "distance": sizes(distance),
            "closest point": sizes(apart),
            "field beyond 2 voxels": sizes(np.abs(known - truth)[off]),
        }
    return found


def sizes(errors: Floats) -> dict[str, float]:
    return {"mean": float(errors.mean()), "largest": float(errors.max())}


def solutions(extension: str, _: argparse.Namespace) -> dict[str, Any]:
    """Errors of the exact cases, in voxels on 64^3: of the mean radius and of any point; order of the former."""
    found = {}
    for name in "ABCDJ":
        case = exact.CASES[name]
        runs = [
            follow(
                case,
                lattice(n, flat=case.dim == 2),
                STEP[name] * WIDTH / (n - 1),
                extension=extension,
            )
            for n in (32, 48, 64)
        ]
        per = 63 / WIDTH
        found[name] = {
            "mean": runs[-1].mean * per,
            "point": runs[-1].point * per,
            "order": order([run.mean for run in runs]),
        }
    return found


def rest(extension: str, _: argparse.Namespace) -> dict[str, float]:
    """Mean distance (voxels) from the start after 100 redistances."""
    points = grid((48, 48, 48), UNIT)
    radius, across = np.sqrt((points**2).sum(axis=0)), np.tensordot(NORMAL, points, 1)
    axis = np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    shapes = {"ball 20": radius - 20, "ball 9.5": radius - 9.5, "plane": across - 0.2}
    shapes |= {f"slab {w:g}": np.abs(across) - w / 2 for w in (1.5, 2.0, 3.0)}
    shapes |= {f"cylinder {w:g}": axis - w for w in (1.0, 1.5, 2.0, 3.0)}
    found = {}
    for name, psi in shapes.items():
        surface = LevelSet(psi, UNIT, extension=extension)
        before = surface.snapshot()
        for _step in range(100):
            surface.redistance()
        found[name] = surface.distance_from(before).mean
    return found


def noise(extension: str, _: argparse.Namespace) -> dict[str, Any]:
    """Dice and steps of a ball and a cube in noise of their contrast, one level, five seeds."""
    points = grid((48, 48, 48), UNIT)
    found: dict[str, Any] = {}
    for name, truth in (
        ("ball", np.sqrt((points**2).sum(axis=0)) < 15),
        ("cube", np.abs(points).max(axis=0) < 13),
    ):
        for flow in ("constant-density", "gradient"):
            dice, steps = [], []
            for seed in range(5):
                image = truth + np.random.default_rng(seed).normal(0, 1, truth.shape)
                result = segment(
                    image.astype(np.float32),
                    start="ball:23,23,23,8vox",
                    energy="chan-vese:area=0",
                    levels=1,
                    flow=flow,
                    extension=extension,
                )
                dice.append(metrics.dice(np.asarray(result.labels) > 0, truth))
                steps.append(len(result.history))
            row = {"dice": float(np.mean(dice)), "least": min(dice), "steps": float(np.mean(steps))}
            found[f"{name}, {flow}"] = row
    return found


def cord(extension: str, options: argparse.Namespace) -> dict[str, float]:
    """Dice of the cord by the command of docs/explanation/real-scans.md."""
    case = CASES["cord"]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [
                sys.executable,
                "-m",
                "accelsurf",
                "segment",
                str(options.volumes / f"{case.image}.nii.gz"),
                *shlex.split(case.options),
                "--extension",
                extension,
                "-o",
                folder,
                "--threads",
                "1",
            ],
            check=True,
            capture_output=True,
        )
        (labels,) = Path(folder).glob("*.nii.gz")
        truth = io.read_labels(options.volumes / f"{case.image}_ref.nii.gz").array > 0
        return {"dice": metrics.dice(io.read_labels(labels).array > 0, truth)}


def cost() -> dict[str, Any]:
    """Process time (ns) per band cell of a redistancing with one field, and of a step; medians of 7 in turn."""
    points = grid((72, 72, 72), UNIT)
    ball = np.sqrt((points**2).sum(axis=0)) - 28
    rough = ball + 2.0 * np.random.default_rng(0).normal(size=ball.shape)
    found: dict[str, Any] = {}
    for name, psi in (("ball", ball), ("noise", rough)):
        surfaces = {one: LevelSet(psi, UNIT, extension=one) for one in EXTENSIONS}
        times: dict[str, list[float]] = {one: [] for one in EXTENSIONS}
        for turn in range(8):
            for one, surface in surfaces.items():
                speed = np.full(surface.size, 0.1 if turn % 2 else -0.1, np.float32)
                began, cells = time.process_time(), surface.size
                surface.advance(speed, 1.0)
                surface.redistance([speed])
                times[one].append((time.process_time() - began) / cells * 1e9)
        # The first turn compiles.
        found[name] = {one: float(np.median(each[1:])) for one, each in times.items()}
    return found


PARTS: dict[str, Any] = {
    "fields": fields,
    "solutions": solutions,
    "rest": rest,
    "noise": noise,
    "cord": cord,
    "cost": cost,
}

if __name__ == "__main__":
    main()
