"""Tables of the page: medians over the seeds, and what descent's rest is beside momentum's."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pages import head_of, put_table, row_of
from benchmarks.paper.landscapes import ALL
from benchmarks.paper.runs import DESCENT, GROWN, MOMENTUM, SMOOTHED, STARTS

COMMAND = "python -m benchmarks.paper"
#: Dice from which the object is found.
FOUND = 0.9
#: Dice that makes a difference; Dice that a surface at rest gains at most in as many steps again; and the factor of the
#: steps from which descent is slow.
DIFFERENT, AT_REST, SLOW = 0.02, 0.01, 1.5
#: Experiments other than landscapes that have a picture.
PICTURED = ("three starts", "corners")
#: What each remedy is called in its table.
REMEDY_WORDS = {
    "none": "as it is",
    "smoothed": f"image smoothed by {SMOOTHED:g} voxel",
    "grown": f"surface at rest grown by {GROWN:g} voxel",
    "starts": f"the lowest energy of {STARTS} starts drawn in the box",
}
Run = dict[str, Any]


def write(page: Path, runs: list[Run]) -> None:
    """Write the tables, of what has been run, each of an experiment of its own with its picture."""
    alone = {
        "three starts": three_starts,
        "corners": corners,
        "random acceleration": by_strength,
        "smeared": landscapes,
        "cores": cores,
        "ridge": ridges,
        "remedies": remedies,
    }
    for name, table in alone.items():
        group = [e for e in runs if e["experiment"] == name]
        lines = table(group) if group else ["Not run yet."]
        if group and name in PICTURED:
            lines += [
                "",
                f"![{name}: middle slice at rest](../figures/paper-{name.replace(' ', '-')}.png)",
            ]
        put_table(page, name, "\n".join(lines), COMMAND)
    for limits in ("default", "short"):
        group = [e for e in runs if e["experiment"] not in alone and e["limits"] == limits]
        put_table(page, f"landscapes, {limits} steps", "\n".join(landscapes(group)), COMMAND)


def groups(runs: list[Run], *keys: str) -> dict[tuple[Any, ...], list[Run]]:
    """The runs that agree in ``keys``, in the order in which they came."""
    found: dict[tuple[Any, ...], list[Run]] = {}
    for entry in runs:
        found.setdefault(tuple(entry[key] for key in keys), []).append(entry)
    return found


def spread(values: list[float], digits: int = 3) -> str:
    """Median, and least to most in brackets."""
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def gap(entry: Run, key: str = "energy") -> float:
    """Energy above that of the truth, in parts of the start's; below 0 the surface fits noise."""
    return float(
        (entry[key] - entry["true_energy"]) / (entry["first_energy"] - entry["true_energy"])
    )


def found(runs: list[Run]) -> str:
    """Count the runs that found the object."""
    return f"{sum(entry['dice'] >= FOUND for entry in runs)} of {len(runs)}"


def cost(runs: list[Run]) -> list[str]:
    """Cells of a table: energy, steps, processor seconds, and how many runs came to rest by the stop rule."""
    return [
        f"{100.0 * np.median([gap(entry) for entry in runs]):.1f} %",
        f"{np.median([entry['steps'] for entry in runs]):.0f}",
        f"{np.median([entry['seconds'] for entry in runs]):.1f}",
        f"{sum(entry['stop'] == 'converged' for entry in runs)} of {len(runs)}",
    ]


def verdict(descent: Run, momentum: Run) -> str:
    """Classify a rest of descent beside the rest of momentum on the same image from the same start."""
    behind = momentum["dice"] - descent["dice"]
    creeps = descent["later_dice"] - descent["dice"] > AT_REST
    if behind < -DIFFERENT:
        return "momentum worse"
    if behind <= DIFFERENT:
        return "slow" if descent["steps"] > SLOW * momentum["steps"] else "the same"
    if creeps:
        return "stopped on its way"
    return "trapped" if descent["energy"] > momentum["energy"] else "rougher, lower energy"


def corners(runs: list[Run]) -> list[str]:
    """Figure 1: a row for each flow."""
    lines = head_of(("flow", "Dice", "at the edges", "energy", "steps", "seconds", "at rest"))
    for (method,), group in groups(runs, "method").items():
        dices = [spread([entry[key] for entry in group]) for key in ("dice", "corner_dice")]
        lines.append(row_of([method, *dices, *cost(group)]))
    return lines


def three_starts(runs: list[Run]) -> list[str]:
    """Figures 2 and 3: a row for each flow."""
    starts = list(groups(runs, "start"))
    lines = head_of(
        (
            "flow",
            *(f"Dice, {start}" for (start,) in starts),
            "agreement",
            "energy",
            "steps",
            "seconds",
            "at rest",
        )
    )
    for (method,), group in groups(runs, "method").items():
        dices = [
            f"{np.median([e['dice'] for e in group if e['start'] == start]):.3f}"
            for (start,) in starts
        ]
        agreements = [min(e["agreement"] for e in same) for same in groups(group, "seed").values()]
        lines.append(row_of([method, *dices, spread(agreements), *cost(group)]))
    return lines


def landscapes(runs: list[Run]) -> list[str]:
    """A row for each landscape and flow; that of descent has the verdict."""
    columns = (
        "landscape",
        "flow",
        "Dice",
        "found",
        "later",
        "energy",
        "steps",
        "seconds",
        "at rest",
        "descent is",
    )
    lines = head_of(columns)
    for (name, method), group in groups(runs, "landscape", "method").items():
        first = method == DESCENT
        momentum = {e["seed"]: e for e in runs if (e["landscape"], e["method"]) == (name, MOMENTUM)}
        verdicts = (
            Counter(verdict(e, momentum[e["seed"]]) for e in group) if first else Counter[str]()
        )
        words = ", ".join(f"{word} {count}" for word, count in verdicts.most_common())
        laters = [e["later_dice"] for e in group if "later_dice" in e]
        later = f"{np.median(laters):.3f}" if laters else ""
        place = f"{name}: {ALL[name].words}" if first else ""
        dices = spread([e["dice"] for e in group])
        lines.append(row_of([place, method, dices, found(group), later, *cost(group), words]))
    return lines


def by_strength(runs: list[Run]) -> list[str]:
    """A row for each start and strength."""
    lines = head_of(
        ("landscape, start", "tau", "Dice", "found", "energy", "steps", "seconds", "at rest")
    )
    for (name, start, strength), group in groups(runs, "landscape", "start", "noise").items():
        dices = spread([entry["dice"] for entry in group])
        lines.append(
            row_of([f"{name}, {start}", f"{strength:g}", dices, found(group), *cost(group)])
        )
    return lines


def interface_of(epsilon: float) -> str:
    """Name the interface of an energy."""
    return "sharp" if epsilon == 0 else f"smeared, {epsilon:g}"


def cores(runs: list[Run]) -> list[str]:
    """A row for each brightness of the core: how many runs found the box, by interface and flow."""
    columns = list(groups(runs, "epsilon", "method"))
    lines = head_of(("core", *(f"{interface_of(width)}: {flow}" for width, flow in columns)))
    for (name,), group in groups(runs, "landscape").items():
        cells = groups(group, "epsilon", "method")
        lines.append(row_of([name, *(found(cells[column]) for column in columns)]))
    return lines


def ridges(runs: list[Run]) -> list[str]:
    """A row for each landscape, interface and seed: energies of balls about the core."""
    columns = ("landscape", "interface", "seed", "start", "won", "least", "crest", "rise", "box")
    lines = head_of(columns)
    for e in runs:
        name, rise = f"{e['landscape']}", e["crest"] - e["least"]
        places = [f"{e[key]:,.0f} at {e[f'{key}_radius']:g}" for key in ("least", "crest")]
        lines.append(
            row_of(
                [
                    name,
                    interface_of(e["epsilon"]),
                    str(e["seed"]),
                    f"{e['first_energy']:,.0f}",
                    *(
                        [f"{e['first_energy'] - e['least']:,.0f}", *places, f"{rise:,.0f}"]
                        if rise > 0
                        else ["", "none", "none", "0"]
                    ),
                    f"{e['true_energy']:,.0f}",
                ]
            )
        )
    return lines


def remedies(runs: list[Run]) -> list[str]:
    """A row for each landscape, remedy and flow."""
    lines = head_of(("landscape, interface", "remedy", "flow", "Dice", "found", "of all starts"))
    for (name, epsilon, remedy, method), group in groups(
        runs, "landscape", "epsilon", "remedy", "method"
    ).items():
        every = [value for entry in group for value in entry["dice_of_starts"]]
        of_all = f"{sum(value >= FOUND for value in every)} of {len(every)}"
        lines.append(
            row_of(
                [
                    f"{name}, {interface_of(epsilon)}",
                    REMEDY_WORDS[remedy],
                    method,
                    spread([entry["dice"] for entry in group]),
                    found(group),
                    of_all if remedy == "starts" else "",
                ]
            )
        )
    return lines
