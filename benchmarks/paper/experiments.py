"""The runs of each experiment."""

from __future__ import annotations

import itertools

from benchmarks.paper.landscapes import CORES, LANDSCAPES, THREE
from benchmarks.paper.runs import AREA_WEIGHT, DESCENT, MOMENTUM, SMEARED, SOBOLEV, Task

SEEDS = range(5)
COMPARED = (DESCENT, "heavy ball", SOBOLEV, MOMENTUM)
#: Where descent is trapped: run with the vector form as well, three times as dear, and with short steps.
TRAPS = ("several phases",)
#: Where the interface of the energy decides; of those, where all flows are compared.
SMEARED_LANDSCAPES = ("core 2.6", "several phases", "thin wall")
SMEARED_TRAPS = ("core 2.6",)
#: The trap that is there with the program's interface: what frees descent from it?
HELD = "core 2.6"
REMEDIES = ("none", "smoothed", "grown", "starts")
#: Where the question is whether a wall holds.
LEAKS = ("thin wall",)
#: tau of the random acceleration, mm per unit of flow time^1.5.
STRENGTHS = (0.0, 1.0, 3.0, 10.0)


def landscape(name: str) -> list[Task]:
    """Every flow from inside, on every seed."""
    runs = [(method, "default") for method in ((DESCENT, MOMENTUM) if name in LEAKS else COMPARED)]
    if name in TRAPS:
        runs += [("Sobolev, vector", "default"), (DESCENT, "short"), (MOMENTUM, "short")]
    seeded = itertools.product(runs, SEEDS)
    return [Task(name, name, "inside", method, seed, limits) for (method, limits), seed in seeded]


#: Each is named after its landscape, or by what is asked.
EXPERIMENTS: dict[str, list[Task]] = {
    **{name: landscape(name) for name in LANDSCAPES},
    "three starts": [
        Task("three starts", "white noise", start, method, seed)
        for method, seed, start in itertools.product((DESCENT, MOMENTUM), SEEDS, THREE)
    ],
    "corners": [
        Task("corners", "white noise", "around", method, seed)
        for method, seed in itertools.product((DESCENT, AREA_WEIGHT, SOBOLEV, MOMENTUM), SEEDS)
    ],
    "smeared": [
        Task("smeared", name, "inside", method, seed, epsilon=SMEARED)
        for name in SMEARED_LANDSCAPES
        for method in (COMPARED if name in SMEARED_TRAPS else (DESCENT, MOMENTUM))
        for seed in SEEDS
    ],
    "cores": [
        Task("cores", name, "inside", method, seed, epsilon=epsilon)
        for name, epsilon, method, seed in itertools.product(
            CORES, (0.0, SMEARED), (DESCENT, MOMENTUM), SEEDS
        )
    ],
    "ridge": [
        Task("ridge", name, "inside", DESCENT, seed, epsilon=epsilon)
        for name, epsilon, seed in itertools.product(
            ("several phases", "core 2.6"), (0.0, SMEARED), SEEDS
        )
    ],
    "remedies": [
        Task("remedies", HELD, "inside", method, seed, epsilon=SMEARED, remedy=remedy)
        for remedy, method, seed in itertools.product(REMEDIES, (DESCENT, MOMENTUM), SEEDS)
        if method == DESCENT or remedy != "starts"
    ],
    "random acceleration": [
        Task("random acceleration", "several phases", start, MOMENTUM, seed, noise=strength)
        for start, strength, seed in itertools.product(("inside", "at the core"), STRENGTHS, SEEDS)
    ],
}
