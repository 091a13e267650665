"""`advance`: a ball grows from radius 60 to 70 at constant speed, against the sparse-field filters of SimpleITK."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from accelsurf.levelset import LevelSet, Workers
from benchmarks.peers.measure import Options, goal, in_turn, set_threads, table, timed
from benchmarks.peers.work import ball, radius_error

CFL = 0.9
FILTERS = ("GeodesicActiveContour", "ThresholdSegmentation")


def advance(options: Options) -> dict[str, Any]:
    """Time the growth on one thread and measure the radius in the same way for all."""
    set_threads(1)
    side, first, last = (48, 12.0, 15.0) if options.quick else (256, 60.0, 70.0)
    start = ball(side, first)
    found: dict[str, dict[str, Any]] = {"accelsurf": {"setting": f"steps of {CFL} voxel"}}
    works: dict[str, Any] = {"accelsurf": lambda: grow(start, last - first)}
    if importlib.util.find_spec("SimpleITK") is None:
        options.say("SimpleITK: skipped, SimpleITK is not installed (pip install SimpleITK)")
    else:
        for name in FILTERS:
            iterations, trials = calibrate(name, start, first, last)
            found[f"SimpleITK {name}"] = {"setting": f"{iterations} iterations", "search": trials}
            works[f"SimpleITK {name}"] = lambda name=name, n=iterations: sparse_field(name, start, n)
    for name, work in works.items():
        seconds, psi = timed(work)
        found[name] |= radius_error(psi, last) | {"first_s": seconds}
    times = in_turn(works, dict.fromkeys(works, options.repeats))
    for name, timing in times.items():
        found[name] |= timing.to_dict()
    own = found["accelsurf"]
    peers = {name: facts for name, facts in found.items() if name != "accelsurf"}
    pairs = [{"pair": f"{name} / accelsurf", "ratio": f["median_s"] / own["median_s"]} for name, f in peers.items()]
    least = min((f["rms_error"] for f in peers.values()), default=None)
    ratio = min((pair["ratio"] for pair in pairs), default=None)
    share = None if least is None else own["rms_error"] / least
    return {
        "work": f"ball of radius {first:g} grown to {last:g} in {side}^3, start to result, 1 thread",
        "threads": 1, "pairs": pairs, "programs": found,
        "goals": [
            goal("times faster than the faster filter", 10.0, ratio),
            goal("radius error (rms) over the best filter's", 1.0, share, "<=", ""),
        ],
        "tables": [table(
            "Growth at constant speed",
            ("program", "setting", "seconds", "radius by volume", "error of it", "rms error of the surface"),
            [
                (n, f["setting"], f["median_s"], f["radius"], f["volume_error"], f["rms_error"])
                for n, f in found.items()
            ],
        )],
        "bars": [[name, f["median_s"]] for name, f in found.items()],
    }


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


def sparse_field(name: str, start: np.ndarray, iterations: int) -> np.ndarray:
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
    solver.SetPropagationScaling(1.0)
    solver.SetCurvatureScaling(0.0)
    solver.SetMaximumRMSError(0.0)
    solver.SetNumberOfIterations(iterations)
    ones = sitk.Image(start.shape[::-1], sitk.sitkFloat32) + 1.0
    return np.asarray(sitk.GetArrayFromImage(solver.Execute(sitk.GetImageFromArray(start), ones)))


def calibrate(name: str, start: np.ndarray, first: float, last: float) -> tuple[int, list[dict[str, Any]]]:
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
