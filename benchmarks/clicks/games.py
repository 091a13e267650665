"""A game: the simulated person and one segmenter on one object, click after click, and the figures that follow."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks.person import PersonClick, next_click

Mask = NDArray[np.bool_]
#: Numbers of clicks at which the Dice is shown, and the Dice that must be reached for "number of clicks".
BUDGETS, LEVELS = (1, 2, 3, 5, 10, 20), (0.80, 0.85, 0.90)
#: A click after which the Dice is lower by more than this did harm.
FALL = 0.02
#: Click k of the jittered game with seed s draws from the generator (BASE, s, k): the same for all methods.
SEEDS, BASE = (0, 1, 2, 3, 4), 16


class Session(Protocol):
    """One object being segmented: knows the scan, takes clicks, gives the labels so far on the whole grid."""

    def click(self, click: PersonClick) -> Mask:
        """Labels (nz, ny, nx) after one more click."""


#: Makes a session on a scan; the second argument is the size (mm3) that the person states, or None.
Segmenter = Callable[[Volume, float | None], Session]


def variants(names: Sequence[str]) -> list[str]:
    """What is played on each object: "plain", "size" (a size beside the first click), "jitter" as one per seed.

    Examples
    --------
    >>> variants(["plain", "jitter"])
    ['plain', 'jitter0', 'jitter1', 'jitter2', 'jitter3', 'jitter4']
    """
    return [one for name in names for one in ([f"jitter{seed}" for seed in SEEDS] if name == "jitter" else [name])]


def play(
    segmenter: Segmenter, image: Volume, truth: Mask, clicks: int, variant: str = "plain", size_factor: float = 1.0,
    watch: Callable[[PersonClick, Mask], None] | None = None,
) -> dict[str, Any]:
    """Play until ``clicks`` are spent or nothing is wrong; ``watch`` is called with each click and the labels after it.

    Returns
    -------
    dict
        ``clicks``: for each the side, the voxel, the radius (mm), ``dice`` after it, ``wall_s`` and ``cpu_s``, and
        ``error`` where the segmenter refused it (the labels before stand). ``perfect``: nothing is wrong any more.
    """
    size = size_factor * float(np.count_nonzero(truth)) * image.geometry.voxel_volume if variant == "size" else None
    out: list[dict[str, Any]] = []
    labels: Mask | None = None
    session: Session | None = None
    for number in range(clicks):
        click = next_click(truth, labels, image.geometry, _random(variant, number))
        if click is None:
            break
        record: dict[str, Any] = {"side": click.side, "index": list(click.index), "radius": click.radius}
        wall, cpu = time.perf_counter(), _cpu_seconds()
        try:
            session = session or segmenter(image, size)
            labels = session.click(click)
        except AccelsurfError as refused:
            record["error"] = str(refused)
            labels = np.zeros_like(truth) if labels is None else labels
        record |= {"wall_s": time.perf_counter() - wall, "cpu_s": _cpu_seconds() - cpu, "dice": dice(labels, truth)}
        out.append(record)
        if watch is not None:
            watch(click, labels)
    return {"clicks": out, "perfect": bool(out) and out[-1]["dice"] == 1.0}


def _random(variant: str, number: int) -> np.random.Generator | None:
    """The generator of a jittered game's next click; None where the person is exact."""
    return np.random.default_rng([BASE, int(variant[6:]), number]) if variant.startswith("jitter") else None


def _cpu_seconds() -> float:
    """Seconds of processor time of this process and of those that it waited for."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


# -- figures ------------------------------------------------------------------------------------------------


def dice_after(game: dict[str, Any], budget: int) -> float | None:
    """Dice after so many clicks; after the last one where nothing was wrong any more; None if not played so far.

    Examples
    --------
    >>> game = {"clicks": [{"dice": 0.5}, {"dice": 1.0}], "perfect": True}
    >>> [dice_after(game, n) for n in (1, 5)]
    [0.5, 1.0]
    >>> dice_after({"clicks": [{"dice": 0.5}], "perfect": False}, 2)
    """
    clicks = game["clicks"]
    if len(clicks) >= budget:
        return float(clicks[budget - 1]["dice"])
    return float(clicks[-1]["dice"]) if game["perfect"] else None


def clicks_to(game: dict[str, Any], level: float) -> int | None:
    """Clicks until the Dice is at or above ``level`` for the first time; None where it never is.

    Examples
    --------
    >>> clicks_to({"clicks": [{"dice": 0.5}, {"dice": 0.9}], "perfect": False}, 0.85)
    2
    """
    return next((k for k, one in enumerate(game["clicks"], 1) if one["dice"] >= level), None)


def falls(game: dict[str, Any]) -> tuple[int, int]:
    """Clicks after which the Dice fell by more than `FALL`, of how many that could (all but the first).

    Examples
    --------
    >>> falls({"clicks": [{"dice": 0.9}, {"dice": 0.87}, {"dice": 0.86}], "perfect": False})
    (1, 2)
    """
    values = [one["dice"] for one in game["clicks"]]
    return sum(after < before - FALL for before, after in zip(values, values[1:], strict=False)), len(values) - 1


def summary(games: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the objects, of as many clicks as all of them were played.

    Returns
    -------
    dict
        ``dice``: by budget. ``noc``: by level, the median of the clicks needed, ``played`` + 1 where it was never
        reached; ``never``: how many did not. ``within5``: share of the objects at .85 within five clicks. ``fell``:
        share of clicks. ``refused``: clicks that the segmenter refused. Seconds, medians: of first and later clicks.
    """
    played = min((len(game["clicks"]) for game in games if not game["perfect"]), default=max(BUDGETS))
    games = [{**game, "clicks": game["clicks"][:played]} for game in games]
    counts = [falls(game) for game in games]
    needed = {level: [clicks_to(game, level) for game in games] for level in LEVELS}
    return {
        "objects": len(games),
        "played": played,
        "dice": {n: statistics.median(_known(game, n) for game in games) for n in BUDGETS if n <= played},
        "noc": {level: statistics.median(n or played + 1 for n in found) for level, found in needed.items()},
        "never": {level: found.count(None) for level, found in needed.items()},
        "within5": sum(n is not None and n <= 5 for n in needed[0.85]) / len(games) if played >= 5 else None,
        "fell": sum(n for n, _ in counts) / max(sum(n for _, n in counts), 1),
        "refused": sum("error" in one for game in games for one in game["clicks"]),
        **seconds(games),
    }


def _known(game: dict[str, Any], budget: int) -> float:
    """Dice after a click that was played."""
    value = dice_after(game, budget)
    assert value is not None
    return value


def seconds(games: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Median seconds of first and of later clicks, by the wall clock and of the processor."""
    first = [game["clicks"][0] for game in games]
    later = [one for game in games for one in game["clicks"][1:]]
    return {
        f"{key}_{unit}": statistics.median(one[unit] for one in clicks) if clicks else None
        for key, clicks in (("first", first), ("later", later)) for unit in ("wall_s", "cpu_s")
    }


def score(games: Sequence[dict[str, Any]]) -> float:
    """What settings are chosen by: the mean Dice over clicks 1, 2, 3 and 5 and over the objects."""
    values = [value for game in games for n in BUDGETS[:4] if (value := dice_after(game, n)) is not None]
    return statistics.fmean(values) if values else 0.0
