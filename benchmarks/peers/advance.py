"""`advance`: a ball grows from radius 60 to 70 at constant speed, against the sparse-field filters of SimpleITK."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from accelsurf.levelset import LevelSet, Workers
from benchmarks.peers.measure import Options, goal, in_turn, table, timed
from benchmarks.peers.work import ball, radius_error

CFL = 0.9
THREADS = (1, 2)
FILTERS = ("GeodesicActiveContour", "ThresholdSegmentation")


def advance(options: Options) -> dict[str, Any]:
    """Time the growth on one thread and on two, and measure the radius in the same way for all."""
    side, first, last = (48, 12.0, 15.0) if options.quick else (256, 60.0, 70.0)
    start = ball(side, first)
    settings: dict[str, str] = {"accelsurf": f"steps of {CFL} voxel"}
    searches: dict[str, list[dict[str, Any]]] = {}
    works: dict[str, Callable[[int], np.ndarray]] = {
        "accelsurf": lambda n: grow_on(n, start, last - first)
    }
    if importlib.util.find_spec("SimpleITK") is None:
        options.say("SimpleITK: skipped, SimpleITK is not installed (pip install SimpleITK)")
    else:
        for name in FILTERS:
            iterations, searches[f"SimpleITK {name}"] = calibrate(name, start, first, last)
            settings[f"SimpleITK {name}"] = f"{iterations} iterations"
            works[f"SimpleITK {name}"] = lambda n, name=name, count=iterations: sparse_field(
                name, start, count, n
            )
    found: dict[str, dict[str, Any]] = {}
    for name, work in works.items():
        seconds, psi = timed(lambda work=work: work(1))
        found[name] = radius_error(psi, last) | {"setting": settings[name], "first_s": seconds}
        found[name] |= {"search": searches[name]} if name in searches else {}
    jobs = {(name, n): partial(work, n) for name, work in works.items() for n in THREADS}
    times = in_turn(jobs, dict.fromkeys(jobs, options.repeats))
    for name, results in found.items():
        results["threads"] = {str(n): times[name, n].to_dict() for n in THREADS}
    # The sum of the surface's voxels over the way: what the ball gains.
    swept = 4.0 / 3.0 * np.pi * (last**3 - first**3)
    return {
        "work": f"ball of radius {first:g} grown to {last:g} in {side}^3, start to result, 1 and 2 threads",
        "threads": list(THREADS),
        "programs": found,
        **_compared(found, swept),
        "tables": [
            table(
                "Growth at constant speed",
                (
                    "program",
                    "setting",
                    "seconds, 1 thread",
                    "2 threads",
                    "ns per surface voxel and voxel travelled",
                    "radius by volume",
                    "error of it",
                    "rms error of the surface",
                ),
                [
                    (
                        n,
                        f["setting"],
                        _seconds(f, 1),
                        _seconds(f, 2),
                        1e9 * _seconds(f, 1) / swept,
                        f["radius"],
                        f["volume_error"],
                        f["rms_error"],
                    )
                    for n, f in found.items()
                ],
            )
        ],
        "bars": [
            [f"{name}, {n} thread{'s' * (n > 1)}", _seconds(f, n)]
            for name, f in found.items()
            for n in THREADS
        ],
    }


def _seconds(results: dict[str, Any], threads: int) -> float:
    return float(results["threads"][str(threads)]["median_s"])


def _compared(found: dict[str, dict[str, Any]], swept: float) -> dict[str, Any]:
    """Pairs and goals, each with as many threads on both sides."""
    own, peers = (
        found["accelsurf"],
        {name: results for name, results in found.items() if name != "accelsurf"},
    )
    pairs, goals = [], []
    for n in THREADS:
        many = f"{n} thread{'s' * (n > 1)}"
        ratios = {name: _seconds(results, n) / _seconds(own, n) for name, results in peers.items()}
        pairs += [
            {"pair": f"{name} / accelsurf, {many}", "ratio": ratio}
            for name, ratio in ratios.items()
        ]
        goals.append(
            goal(
                f"times faster than the faster filter, {many}",
                10.0,
                min(ratios.values(), default=None),
            )
        )
    least = min((results["rms_error"] for results in peers.values()), default=None)
    share = None if least is None else own["rms_error"] / least
    goals.append(goal("radius error (rms) over the best filter's", 1.0, share, "<=", ""))
    per_voxel = 1e9 * _seconds(own, 1) / swept
    return {
        "pairs": pairs,
        "goals": [
            *goals,
            goal(
                "ns per surface voxel and voxel travelled, 1 thread", 1000.0, per_voxel, "<=", "ns"
            ),
        ],
    }


def grow_on(threads: int, start: np.ndarray, distance: float) -> np.ndarray:
    """`grow` with so many threads."""
    with Workers(threads) as workers:
        return grow(start, distance, workers)


def grow(start: np.ndarray, distance: float, workers: Workers | None = None) -> np.ndarray:
    """From the start's distance function to the end's: construction included."""
    surface = LevelSet(start, (1.0, 1.0, 1.0), 3.0, workers)
    left = distance
    while left > 1e-9:
        dt = min(CFL, left)
        surface.advance(np.full(surface.size, -1.0, np.float32), dt)
        surface.redistance()
        left -= dt
    return surface.psi


def sparse_field(name: str, start: np.ndarray, iterations: int, threads: int = 1) -> np.ndarray:
    """A filter of SimpleITK with propagation only, outwards at the same speed everywhere."""
    import SimpleITK as sitk

    if name == "GeodesicActiveContour":
        solver = sitk.GeodesicActiveContourLevelSetImageFilter()
        solver.SetAdvectionScaling(0.0)
    else:
        solver = sitk.ThresholdSegmentationLevelSetImageFilter()
        # The speed is min(I - lower, upper - I): 1 everywhere for an image of ones.
        solver.SetLowerThreshold(0.0)
        solver.SetUpperThreshold(2.0)
    solver.SetNumberOfThreads(threads)
    solver.SetPropagationScaling(1.0)
    solver.SetCurvatureScaling(0.0)
    solver.SetMaximumRMSError(0.0)
    solver.SetNumberOfIterations(iterations)
    ones = sitk.Image(start.shape[::-1], sitk.sitkFloat32) + 1.0
    return np.asarray(sitk.GetArrayFromImage(solver.Execute(sitk.GetImageFromArray(start), ones)))


def calibrate(
    name: str, start: np.ndarray, first: float, last: float
) -> tuple[int, list[dict[str, Any]]]:
    """Iterations after which a filter's radius is closest to the wanted one, by the pace that it shows itself."""
    # The filters move the surface by 1/(2 x dimension) voxel in an iteration.
    n = round(6 * (last - first))
    trials: dict[int, float] = {}
    for _ in range(2):
        trials[n] = radius_error(sparse_field(name, start, n), last)["radius"]
        pace = (trials[n] - first) / n
        n = max(1, round((last - first) / pace)) if pace > 0 else 2 * n
        if n in trials:
            break
    else:
        trials[n] = radius_error(sparse_field(name, start, n), last)["radius"]
    nearest = min(trials, key=lambda i: abs(trials[i] - last))
    return nearest, [{"iterations": i, "radius": r} for i, r in trials.items()]
