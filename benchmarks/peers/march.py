"""`march`: distances and extended fields against scikit-fmm, in growing volumes; arrival times against eikonalfm."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from accelsurf.clicks.kernels.arrival import Appearance
from accelsurf.clicks.model.fronts import times_from
from accelsurf.levelset import LevelSet
from benchmarks.peers.measure import (
    Options,
    Timing,
    goal,
    in_turn,
    repeated,
    set_threads,
    table,
    timed,
)
from benchmarks.peers.work import ball, bumpy, perturbed

HALF_WIDTH = 4.0


def march(options: Options) -> dict[str, Any]:
    """Time both on a ball of radius 80 in 256^3, then accelsurf alone on one of 40 in growing volumes."""
    set_threads(1)
    side, radius = (48, 15.0) if options.quick else (256, 80.0)
    psi = ball(side, radius)
    surface = perturbed(psi, HALF_WIDTH)
    fields = two_fields(surface)
    dense, spread = surface.psi.copy(), [scattered(surface, f) for f in fields]
    redistance(surface, fields)
    cells = surface.size
    works: dict[str, Any] = {}
    if importlib.util.find_spec("skfmm") is None:
        options.say("scikit-fmm: skipped, scikit-fmm is not installed (pip install scikit-fmm)")
    else:
        import skfmm

        works["scikit-fmm, two fields"] = lambda: [
            skfmm.extension_velocities(dense, f, narrow=HALF_WIDTH) for f in spread
        ]
        works["scikit-fmm, one field"] = lambda: skfmm.extension_velocities(
            dense, spread[0], narrow=HALF_WIDTH
        )
        works["scikit-fmm, distance only"] = lambda: skfmm.distance(dense, narrow=HALF_WIDTH)
    own = repeated(lambda made: redistance(*made), options.repeats, lambda: ready(psi))
    times = {"accelsurf": own, **in_turn(works, dict.fromkeys(works, options.repeats))}
    sizes, scaling = growing(options)
    goals, pairs = [], []
    if "scikit-fmm, two fields" in times:
        ratio = times["scikit-fmm, two fields"].median / own.median
        pairs.append({"pair": "scikit-fmm, two fields / accelsurf", "ratio": ratio})
        goals.append(goal("times faster than scikit-fmm", 20.0, ratio))
    else:
        goals.append(goal("times faster than scikit-fmm", 20.0, None))
    goals.append(goal("spread of the cost over the volumes", 15.0, scaling, "<=", "%"))
    rows = [(name, t.median, 1e9 * t.median / cells) for name, t in times.items()]
    fronts = arrivals(options)
    return {
        "work": f"redistance and extend two fields, half width 4, ball of radius {radius:g} in {side}^3, 1 thread",
        "threads": 1,
        "goals": goals,
        "pairs": pairs,
        "band_cells": cells,
        "times": {name: t.to_dict() for name, t in times.items()},
        "sizes": sizes,
        "arrivals": fronts,
        "tables": [
            table("The same work", ("program", "seconds", "ns per band cell"), rows),
            table(
                f"Arrival times from the middle voxel at constant speed, {fronts[0]['side']}^3",
                ("program", "seconds", "ns per voxel", "mean error, part of the time"),
                [(f["program"], f["median_s"], f["ns_per_voxel"], f["mean_error"]) for f in fronts],
            ),
            table(
                "accelsurf, equal surface in growing volumes",
                ("volume", "band cells", "seconds", "ns per band cell"),
                [
                    (f"{s['side']}^3", s["band_cells"], s["median_s"], s["ns_per_cell"])
                    for s in sizes
                ],
            ),
        ],
        "bars": [[name, t.median] for name, t in times.items()],
    }


def ready(psi: np.ndarray) -> tuple[LevelSet, list[np.ndarray]]:
    """A perturbed surface and its two fields: what is not timed."""
    surface = perturbed(psi, HALF_WIDTH)
    return surface, two_fields(surface)


def two_fields(surface: LevelSet) -> list[np.ndarray]:
    """Two fields on the band."""
    field = bumpy(surface)
    return [field, (field * field).astype(np.float32)]


def scattered(surface: LevelSet, field: np.ndarray) -> np.ndarray:
    """A field in the volume, as scikit-fmm wants it (double; converted beforehand, untimed)."""
    dense = np.zeros(surface.shape)
    dense.reshape(-1)[surface.band.cells] = field
    return dense


def redistance(surface: LevelSet, fields: list[np.ndarray]) -> Any:
    """What is timed."""
    return surface.redistance(fields)


def arrivals(options: Options) -> list[dict[str, Any]]:
    """Times of a front at constant speed from the middle voxel: what a click's model marches, and eikonalfm."""
    side = 32 if options.quick else 128
    middle = (side // 2,) * 3
    exact = np.sqrt(sum((axis - side // 2) ** 2 for axis in np.ogrid[:side, :side, :side]))
    image = np.zeros(exact.shape, np.float32)
    appearance = Appearance(
        np.zeros(1), np.ones(1), np.ones(1), np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    )
    works: dict[str, Any] = {
        "accelsurf": lambda: times_from(exact == 0, image, (1.0, 1.0, 1.0), appearance)
    }
    if importlib.util.find_spec("eikonalfm") is None:
        options.say("eikonalfm: skipped, it is not installed (pip install eikonalfm)")
    else:
        import eikonalfm

        for order in (1, 2):
            works[f"eikonalfm, order {order}"] = lambda order=order: eikonalfm.fast_marching(
                np.ones(exact.shape), middle, (1.0,) * 3, order
            )
    far, lines = exact > 6.0, []
    for name, timing in in_turn(works, dict.fromkeys(works, options.repeats)).items():
        wrong = float(np.mean(np.abs(works[name]()[far] - exact[far]) / exact[far]))
        lines.append(
            {
                "program": name,
                "side": side,
                **timing.to_dict(),
                "ns_per_voxel": 1e9 * timing.median / side**3,
                "mean_error": wrong,
            }
        )
    return lines


def growing(options: Options) -> tuple[list[dict[str, Any]], float]:
    """Cost at equal surface in volumes of 128^3 to 512^3, and its spread in percent of the least."""
    radius, sides = (12.0, (40, 56)) if options.quick else (40.0, (128, 256, 512))
    made = {side: ready(ball(side, radius)) for side in sides}
    seconds: dict[int, list[float]] = {side: [] for side in sides}
    cells = {side: pair[0].size for side, pair in made.items()}
    for turn in range(2 * options.repeats + 1):
        for side, (surface, fields) in made.items():
            taken, change = timed(
                lambda surface=surface, fields=fields: redistance(surface, fields)
            )
            # The surface moves a little in and out, so that no redistancing finds its work done.
            surface.advance(bumpy(surface), -0.5 if turn % 2 == 0 else 0.5)
            made[side] = surface, change.fields
            if turn:
                seconds[side].append(taken)
    lines = []
    for side in sides:
        t = Timing(seconds[side])
        lines.append(
            {
                "side": side,
                "band_cells": cells[side],
                **t.to_dict(),
                "ns_per_cell": 1e9 * t.median / cells[side],
            }
        )
    medians = [line["median_s"] for line in lines]
    return lines, 100.0 * (max(medians) / min(medians) - 1.0)
