"""The whole pipeline against the Lagrangian reference: orders, topology, border, invariances.

The reference (`tests/support/lagrangian.py`) has no grid; the fast tests hold a few of these cases on coarse grids.
What is known to be wrong is measured here too, so that a cure can be seen: velocity diffusion in motion, an object that
retreats from the border, short waves of flowable mass without an area weight. Errors are in voxels. One call makes
benchmarks/results/lagrangian.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from accelsurf.output.document import versions
from benchmarks.figures.common import plain
from tests.support import exact
from tests.support.follow import WIDTH, lattice, surface_points
from tests.support.follow_curve import UPRIGHT, Run, Setup
from tests.support.invariances import body, differences, rotations, shifts, spread
from tests.support.lagrangian import Law
from tests.support.lagrangian_cases import (
    CONSTANT,
    DESCENT,
    DRAWN_OUT,
    FLOWABLE,
    OBLIQUE,
    PLANE,
    SPACE,
    STRETCHED,
    Problem,
    diffusing,
)
from tests.support.offsets import CLOSE, MERGE, SPLIT, grow

ROOT = Path(__file__).resolve().parent.parent
RESULTS_FILE = ROOT / "benchmarks" / "results" / "lagrangian.json"
Row = dict[str, Any]
#: A row of the study: its section, its name, the function that makes it and what that is called with.
Job = tuple[str, str, Callable[..., Row], tuple[Any, ...]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", default="", help="sections, separated by commas: " + ", ".join(SECTIONS)
    )
    parser.add_argument(
        "--quick", action="store_true", help="coarse grids, to see that all works; writes nothing"
    )
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    names = [name.strip() for name in options.only.split(",") if name.strip()] or list(SECTIONS)
    results: dict[str, Any] = json.loads(RESULTS_FILE.read_text()) if RESULTS_FILE.exists() else {}
    jobs = [job for name in names for job in SECTIONS[name](options.quick)]
    with ProcessPoolExecutor(options.processes) as pool:
        found = [(job, pool.submit(job[2], *job[3])) for job in jobs]
        for name in names:
            results[name] = {}
        for (section, name, _, _), row in found:
            results[section][name] = plain(row.result())
            print(f"{section:12s} {name:40s} {told(results[section][name])}", flush=True)
    results["versions"] = {key: value for key, value in versions().items() if key != "platform"}
    if not options.quick:
        RESULTS_FILE.write_text(json.dumps(results, indent=1) + "\n")
        print(f"written: {RESULTS_FILE.relative_to(ROOT)}")


def told(row: Row) -> str:
    """A row in one line."""
    return "  ".join(f"{key} {value}" for key, value in row.items() if value is not None)


# ------------------------------------------------------------------------------------------------------ sections


def smooth(quick: bool) -> Iterator[Job]:
    """Both mass models, k, lambda, rho, friction, area weight, spacing, oblique axes, descent: errors and orders."""
    plane, space = ((32, 48), (24, 32)) if quick else ((32, 48, 64, 96, 128), (32, 48, 64))
    for group, sizes in ((PLANE, plane), (STRETCHED, plane), (SPACE, space)):
        for name, problem in group.items():
            yield (
                "smooth",
                ("3D, " if group is SPACE else "") + name,
                Problem.study,
                (problem, sizes),
            )
    yield "smooth", "descent", Problem.study, (DESCENT, plane)
    yield "smooth", "density varies fivefold", Problem.study, (DRAWN_OUT, plane[1:])


def invariances(quick: bool) -> Iterator[Job]:
    """The same problem in other words; shifts and rotations of the grid."""
    for model in (CONSTANT, FLOWABLE):
        law = Law(model, alpha=0.03)
        yield "invariances", f"{model}, in other words", other_words, (law, 20 if quick else 48)
        for n in (32,) if quick else (32, 64, 128):
            yield "invariances", f"{model}, plane, {n}", places, (law, n, False)
        yield (
            "invariances",
            f"{model}, 3D, {24 if quick else 48}",
            places,
            (law, 24 if quick else 48, True),
        )


def topology(quick: bool) -> Iterator[Job]:
    """Bodies that merge, part, close a hole at constant speed: relative error of the volume."""
    for name, problem in {
        "two balls merge": MERGE,
        "torus closes": CLOSE,
        "dumbbell parts": SPLIT,
    }.items():
        for way, frame in {"upright": UPRIGHT, "oblique": OBLIQUE}.items():
            yield (
                "topology",
                f"{name}, {way}",
                volumes,
                (problem, frame, (24, 32) if quick else (48, 64, 96)),
            )


def diffusion(quick: bool) -> Iterator[Job]:
    """Velocity diffusion on a moving curve: with D fixed the error should fall with h."""
    for amount in (0.01, 0.03, 0.1):
        yield (
            "diffusion",
            f"D = {amount}",
            Problem.study,
            (diffusing(amount), (32, 48) if quick else (64, 128, 256)),
        )


def border(quick: bool) -> Iterator[Job]:
    """Objects that leave through the border, and one that retreats from it."""
    for model in ("descent", CONSTANT, FLOWABLE):
        for n in (24,) if quick else (32, 48):
            yield "border", f"{model}, grows out, {n}", growing_out, (model, n)
    for n in (32,) if quick else (32, 64, 128):
        yield "border", f"descent, retreats, {n}", retreating, (n,)


def short_waves(quick: bool) -> Iterator[Job]:
    """Flowable mass under a force: short waves grow without an area weight (ill-posed), and hardly with one."""
    for alpha in (0.0, 0.03):
        problem = Problem(Law(FLOWABLE, alpha=alpha))
        yield (
            "short waves",
            f"area weight {alpha}",
            Problem.study,
            (problem, (32, 48) if quick else (128, 256, 384)),
        )


SECTIONS: dict[str, Callable[[bool], Iterator[Job]]] = {
    "smooth": smooth,
    "invariances": invariances,
    "topology": topology,
    "diffusion": diffusion,
    "border": border,
    "short waves": short_waves,
}


# ---------------------------------------------------------------------------------------------------------- rows


def other_words(law: Law, n: int) -> Row:
    """Largest difference of psi for each variant, voxels."""
    return dict(differences(body(n), law, 1.0))


def places(law: Law, n: int, revolved: bool) -> Row:
    """How far the surface moves with the grid, voxels: mean and largest, over shifts and over rotations."""
    moved = [replace(OBLIQUE, shift=frame.shift) for frame in shifts(n)] if revolved else shifts(n)
    found: Row = {}
    for name, frames in (("shift", moved), ("rotation", rotations(revolved))):
        found[f"{name}_mean"], found[f"{name}_largest"] = spread(frames, law, n, 1.5, revolved)
    return found


def volumes(problem: Any, frame: Any, sizes: tuple[int, ...]) -> Row:
    """Relative errors of the volume, and mean distances in voxels."""
    found = [grow(problem, n, frame) for n in sizes]
    return {
        "sizes": list(sizes),
        "volume_relative": [one.volume for one in found],
        "mean_voxels": [one.mean for one in found],
        "components": [one.inside for one in found],
    }


def growing_out(model: str, n: int) -> Row:
    """A ball that grows out through three faces under a constant force: largest and mean error, voxels."""
    force = -0.5
    centre = np.array([0.75, 0.85, 0.8])
    r0 = 0.45
    h, on = WIDTH / (n - 1), lattice(n)
    radius = np.sqrt(((on.points - centre[:, None, None, None]) ** 2).sum(axis=0))
    path = exact.path(
        exact.Case("growing", r0, lambda r: force, t_end=1.2, flowable=model == FLOWABLE)
    )
    run = Run(Setup(radius - r0, np.full(radius.shape, force), on.spacing), Law(model))
    worst, means = 0.0, 0.0
    for t in (0.4, 0.8, 1.2):
        run.until(t, 0.5 * h)
        points = surface_points(run.surface, on)
        points = points[(np.abs(points) <= 0.5 * WIDTH).all(axis=1)]
        r = r0 - force * t if model == "descent" else path(t)
        off = np.abs(np.linalg.norm(points - centre, axis=1) - r) / h
        worst, means = max(worst, float(off.max())), max(means, float(off.mean()))
    return {"point_voxels": worst, "mean_voxels": means}


def retreating(n: int) -> Row:
    """A disc cut by two sides shrinks at constant speed: its points lie c t from the circle's arc in the slice."""
    force = 0.5
    centre = np.array([0.75, 0.6])
    r0 = 1.1
    t = 0.8
    h, on = WIDTH / (n - 1), lattice(n, flat=True)
    radius = np.sqrt(((on.points[1:] - centre[:, None, None, None]) ** 2).sum(axis=0))
    run = Run(Setup(radius - r0, np.full(radius.shape, force), on.spacing), Law("descent"))
    run.until(t, 0.5 * h)
    angle = np.linspace(0.0, 2.0 * np.pi, 200_001)
    arc = centre + r0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arc = arc[(arc <= 0.5 * (WIDTH + h)).all(axis=1)]
    points = surface_points(run.surface, on)[:, 1:]
    points = points[(np.abs(points) <= 0.5 * WIDTH).all(axis=1)]
    off = np.abs(cKDTree(arc).query(points)[0] - force * t) / h
    return {"point_voxels": float(off.max()), "mean_voxels": float(off.mean())}


if __name__ == "__main__":
    main()
