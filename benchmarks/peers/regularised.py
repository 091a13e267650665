"""`regularised`: the scaling study. Descent and momentum to the minimum of an energy with an area weight."""

from __future__ import annotations

from typing import Any

import numpy as np

from accelsurf.flows import ConstantDensity, Gradient
from benchmarks.figures import speed
from benchmarks.peers.measure import Options, goal, set_threads, table

GRADIENT, MOMENTUM = "gradient", "constant density"
#: Within this part of all that is to be won from the energy a run has arrived.
GAP = 0.01


def regularised(options: Options) -> dict[str, Any]:
    """Steps and seconds against the grid, 48 to 160 voxels a side.

    Momentum runs until it has settled; descent until it is within `GAP` of the energy found. (The figure `speed` lets
    descent settle too, which takes twice as long and changes the count by a step or two.)
    """
    set_threads(1)
    sizes, compared = ((24, 32), 32) if options.quick else ((48, 64, 96, 128, 160), 128)
    speed.history(ConstantDensity(), sizes[0], 3, 3)  # compile
    lines: list[dict[str, Any]] = []
    for n in sizes:
        momentum = speed.history(ConstantDensity(), n, 3, speed.BUDGET)
        least, first = float(momentum["energy"].min()), float(momentum["energy"][0])
        # A hair below the line, so that the line itself has been crossed.
        enough = least + 0.999 * GAP * (first - least)
        gradient = speed.history(Gradient(), n, 3, speed.BUDGET, enough)
        for name, run in ((GRADIENT, gradient), (MOMENTUM, momentum)):
            lines.append(speed.line(name, n, 3, run, least))
            print(f"   {speed.text(lines[-1])}", flush=True)
    slopes = {name: slope(lines, name) for name in (GRADIENT, MOMENTUM)}
    at = {entry["flow"]: entry for entry in lines if entry["n"] == compared}
    seconds = [at[name]["seconds"] for name in (GRADIENT, MOMENTUM)]
    ratio = seconds[0] / seconds[1] if all(seconds) else None
    return {
        "work": f"Chan-Vese with area weight {speed.ALPHA:g} mm, {sizes[0]} to {sizes[-1]} voxels a side, to 1 % "
        "of the energy gap, 1 thread",
        "threads": 1,
        "lines": lines,
        "slopes": slopes,
        "pairs": [
            {"pair": f"gradient / constant density at {compared}^3, seconds", "ratio": ratio}
        ],
        "goals": [
            goal("slope of momentum's steps", 1.3, slopes[MOMENTUM], "<=", ""),
            goal("slope of descent's steps", 1.7, slopes[GRADIENT], ">=", ""),
            goal(f"times faster at {compared}^3", 5.0, ratio),
        ],
        "tables": [
            table(
                "Steps and seconds to the minimum",
                ("voxels a side", "flow", "steps", "seconds", "ms per step"),
                [
                    (e["n"], e["flow"], e["steps"], e["seconds"], e["milliseconds_per_step"])
                    for e in lines
                ],
            )
        ],
        "curves": {
            "x": "voxels a side",
            "y": "steps to 1 % of the energy gap",
            "lines": {
                f"{name}: n^{slopes[name]:.2f}" if slopes[name] is not None else name: [
                    [e["n"], e["steps"]] for e in lines if e["flow"] == name and e["steps"]
                ]
                for name in slopes
            },
        },
    }


def slope(lines: list[dict[str, Any]], name: str) -> float | None:
    """Exponent with which a flow's steps grow, by least squares."""
    found = [(e["n"], e["steps"]) for e in lines if e["flow"] == name and e["steps"]]
    return float(np.polyfit(*np.log(np.array(found, float)).T, 1)[0]) if len(found) >= 2 else None
