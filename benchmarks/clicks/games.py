"""A game: the simulated person and one segmenter on one object, click after click, and the figures that follow."""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError
from accelsurf.grid.boxes import Box
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks.measures import surfaces
from benchmarks.clicks.objects import Scene
from benchmarks.clicks.person import (
    PersonClick,
    click_in_box,
    click_of_challenge,
    drawn_box,
    first_stroke,
    next_click,
)
from benchmarks.clicks.references import within

Mask = NDArray[np.bool_]
#: Numbers of clicks at which the Dice is shown, and the Dice that must be reached for "number of clicks".
BUDGETS, LEVELS = (1, 2, 3, 5, 10), (0.80, 0.85, 0.90)
#: A click after which the Dice is lower by more than this did harm.
FALL = 0.02
#: From this probability on a result is said to be good; it is good from the second, a Dice, on, and failed below the
#: third.
SAID, GOOD, FAILED = 0.7, 0.8, 0.6
#: Click k of the jittered game with seed s draws from the generator (BASE, s, k): the same for all methods.
SEEDS, BASE = (0, 1, 2, 3, 4), 16
#: Games: exact clicks; the same, where another answer may be taken in place of the second click; with a size; jittered
#: clicks; first a box or a stroke; the protocol of the CVPR 2025 challenge from a click in the middle or from a box.
KINDS = ("plain", "answers", "size", "jitter", "box", "stroke", "cvpr", "cvpr-box")
#: Interactions of the challenge: the first, and five corrections.
CHALLENGE = 6


class Hints(NamedTuple):
    """What a person gives before the first click: a size (mm3), a box (voxels z, y, x); None where not given.

    ``points``: all clicks are single voxels, and say nothing of the object's width.
    """

    size_mm3: float | None = None
    box: Box | None = None
    points: bool = False


class Session(Protocol):
    """One object being segmented: knows the scan, takes clicks, gives the labels so far on the whole grid.

    Its attribute ``confidence``, if any, is its probability (0 to 1) that the labels are good, or None. Its method
    ``other_answers``, if it has one, returns labels that a person may choose in place of those after the first click;
    ``take`` goes on from one of them, by its number.
    """

    def click(self, click: PersonClick) -> Mask:
        """Labels (nz, ny, nx) after one more click."""


#: Makes a session on a scan.
Segmenter = Callable[[Volume, Hints], Session]


def variants(names: Sequence[str]) -> list[str]:
    """Games on each object, by the names of `KINDS`: "jitter" is one for each seed.

    Examples
    --------
    >>> variants(["plain", "jitter"])
    ['plain', 'jitter0', 'jitter1', 'jitter2', 'jitter3', 'jitter4']
    """
    return [
        each
        for name in names
        for each in ([f"jitter{seed}" for seed in SEEDS] if name == "jitter" else [name])
    ]


def play(
    segmenter: Segmenter,
    scene: Scene,
    clicks: int = 10,
    variant: str = "plain",
    size_factor: float = 1.0,
    watch: Callable[[PersonClick, Mask], None] | None = None,
    surface: bool = True,
) -> dict[str, Any]:
    """Play until ``clicks`` are spent or nothing is wrong.

    Parameters
    ----------
    segmenter : callable
    scene : Scene
        Outside of its region nothing is compared.
    clicks : int
        The challenge's games end after `CHALLENGE`.
    variant : str
        See `variants`.
    size_factor : float
        The size that is stated, as a part of the true one.
    watch : callable, optional
        Called with each click and the labels after it.
    surface : bool
        Surface distances and surface Dice too, after the clicks of `BUDGETS` (all of the challenge's).

    Returns
    -------
    dict
        ``clicks``: for each the side, the voxel, the radius (mm), ``dice`` after it, the `surfaces`, ``confidence``,
        ``wall_s`` and ``cpu_s``, and ``error`` where the segmenter refused it (the labels before stand); of the first,
        where the segmenter has other answers, ``best_of_answers``: the Dice of the best of all. ``answer`` in place of
        side, voxel and radius where another answer was taken, of the game ``answers``: by a person who sees that its
        Dice is higher by more than .02. ``perfect``: nothing is wrong any more.
    """
    image, truth = scene.image, scene.truth
    hints = hints_of(scene, variant, size_factor)
    out: list[dict[str, Any]] = []
    labels: Mask | None = None
    session: Session | None = None
    better: int | None = None
    for number in range(min(clicks, CHALLENGE) if variant.startswith("cvpr") else clicks):
        click = None if better is not None else click_of(scene, labels, variant, number)
        if click is None and better is None:
            break
        record: dict[str, Any] = {"answer": better}
        if click is not None:
            record = {"side": click.side, "index": list(click.index), "radius": click.radius}
        wall, cpu = time.perf_counter(), _cpu_seconds()
        try:
            session = session or segmenter(image, hints)
            found = session.take(better) if click is None else session.click(click)  # type: ignore[attr-defined]
        except AccelsurfError as refused:
            record["error"] = str(refused)
            found = np.zeros_like(truth) if labels is None else labels
        record |= {"wall_s": time.perf_counter() - wall, "cpu_s": _cpu_seconds() - cpu}
        labels, better = within(found, scene.region), None
        record |= {"dice": dice(labels, truth), "sureness": getattr(session, "confidence", None)}
        if number == 0 and (others := getattr(session, "other_answers", None)) is not None:
            dices = [dice(within(other, scene.region), truth) for other in others()]
            record["best_of_answers"] = max(record["dice"], *dices, 0.0)
            if variant == "answers" and max(dices, default=0.0) > record["dice"] + FALL:
                better = dices.index(max(dices))
        if surface and (variant.startswith("cvpr") or number + 1 in BUDGETS):
            record |= surfaces(labels, truth, image.geometry.spacing)
        out.append(record)
        if watch is not None and click is not None:
            watch(click, labels)
    return {"clicks": out, "perfect": bool(out) and out[-1]["dice"] == 1.0}


def hints_of(scene: Scene, variant: str, size_factor: float = 1.0) -> Hints:
    """Hints that a variant gives."""
    if variant == "size":
        return Hints(
            size_factor * float(np.count_nonzero(scene.truth)) * scene.image.geometry.voxel_volume
        )
    box = drawn_box(scene.truth) if variant in ("box", "cvpr-box") else None
    return Hints(box=box, points=variant.startswith("cvpr"))


def click_of(scene: Scene, labels: Mask | None, variant: str, number: int) -> PersonClick | None:
    """Next click of a variant; None where nothing is wrong."""
    truth, geometry = scene.truth, scene.image.geometry
    if number == 0 and variant == "stroke":
        return first_stroke(truth, geometry)
    if number == 0 and variant in ("box", "cvpr-box"):
        return click_in_box(truth, geometry)
    if variant.startswith("cvpr"):
        return click_of_challenge(truth, labels, geometry)
    random = (
        np.random.default_rng([BASE, int(variant[6:]), number])
        if variant.startswith("jitter")
        else None
    )
    return next_click(truth, labels, geometry, random)


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
    return next((k for k, click in enumerate(game["clicks"], 1) if click["dice"] >= level), None)


def falls(game: dict[str, Any]) -> tuple[int, int]:
    """Clicks after which the Dice fell by more than `FALL`, of how many that could (all but the first).

    Examples
    --------
    >>> falls({"clicks": [{"dice": 0.9}, {"dice": 0.87}, {"dice": 0.86}], "perfect": False})
    (1, 2)
    """
    values = [click["dice"] for click in game["clicks"]]
    return sum(
        after < before - FALL for before, after in zip(values, values[1:], strict=False)
    ), len(values) - 1


def summary(games: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the objects, of as many clicks as all of them were played.

    Returns
    -------
    dict
        ``dice`` and ``mean``: medians and means by budget. ``surface``: medians of the `surfaces` by budget, where they
        were measured. ``noc``: by level, the median of the clicks needed, ``played`` + 1 where it was never reached;
        ``never``: how many did not. ``within5``: share of the objects at .85 within five clicks. ``fell``: share of
        clicks. ``best_of_answers``: see `best_of_answers`. ``confidence``: see `confidence`. ``refused``: clicks that
        the segmenter refused. Seconds, medians: of first and later clicks.
    """
    played = min(
        (len(game["clicks"]) for game in games if not game["perfect"]), default=max(BUDGETS)
    )
    games = [{**game, "clicks": game["clicks"][:played]} for game in games]
    counts = [falls(game) for game in games]
    needed = {level: [clicks_to(game, level) for game in games] for level in LEVELS}
    return {
        "objects": len(games),
        "played": played,
        "dice": {
            n: statistics.median(_known(game, n) for game in games) for n in BUDGETS if n <= played
        },
        "mean": {
            n: statistics.fmean(_known(game, n) for game in games) for n in BUDGETS if n <= played
        },
        "surface": {
            n: found for n in BUDGETS if n <= played and (found := _surfaces_after(games, n))
        },
        "noc": {
            level: statistics.median(n or played + 1 for n in found)
            for level, found in needed.items()
        },
        "never": {level: found.count(None) for level, found in needed.items()},
        "within5": sum(n is not None and n <= 5 for n in needed[0.85]) / len(games)
        if played >= 5
        else None,
        "fell": sum(n for n, _ in counts) / max(sum(n for _, n in counts), 1),
        "best_of_answers": best_of_answers(games),
        "confidence": confidence(games)._asdict(),
        "refused": sum("error" in click for game in games for click in game["clicks"]),
        **seconds(games),
    }


def best_of_answers(games: Sequence[dict[str, Any]]) -> tuple[float, float] | None:
    """Median and mean of the Dice after the first click where the person takes the best answer; None unless all games
    have it.

    Examples
    --------
    >>> answered = [{"clicks": [{"dice": 0.5, "best_of_answers": value}]} for value in (0.5, 0.75, 1.0)]
    >>> best_of_answers(answered), best_of_answers([*answered, {"clicks": [{"dice": 0.5}]}])
    ((0.75, 0.75), None)
    """
    values = [game["clicks"][0].get("best_of_answers") for game in games]
    known = [float(value) for value in values if value is not None]
    return (
        (statistics.median(known), statistics.fmean(known))
        if known and len(known) == len(values)
        else None
    )


def _surfaces_after(games: Sequence[dict[str, Any]], budget: int) -> dict[str, float | None]:
    """Medians of the surface measures after a click; an answer without a surface counts as infinitely far (None)."""
    clicks = [game["clicks"][min(budget, len(game["clicks"])) - 1] for game in games]
    measured = [click for click in clicks if "nsd" in click]
    keys = ("nsd", "mean_mm", "p95_mm", "mean_voxels", "p95_voxels")
    if not measured:
        return {}
    middle = {
        key: statistics.median(math.inf if click[key] is None else click[key] for click in measured)
        for key in keys
    }
    return {key: None if math.isinf(value) else value for key, value in middle.items()}


def challenge(games: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Means over objects of the challenge's figures: areas under the curves of DSC and NSD, and their last values.

    The area is by the trapezoid rule over `CHALLENGE` interactions, so that 5 is the most. Once nothing is wrong the
    values stay at 1.

    Examples
    --------
    >>> game = {"clicks": [{"dice": 0.5, "nsd": 0.0}, {"dice": 1.0, "nsd": 1.0}], "perfect": True}
    >>> challenge([game])["dsc_auc"], challenge([game])["nsd_final"]
    (4.75, 1.0)
    """
    out = {}
    for name, key in (("dsc", "dice"), ("nsd", "nsd")):
        courses = [[float(click[key]) for click in game["clicks"]] for game in games]
        full = [course + [course[-1]] * (CHALLENGE - len(course)) for course in courses]
        out[f"{name}_auc"] = statistics.fmean(
            sum(course) - 0.5 * (course[0] + course[-1]) for course in full
        )
        out[f"{name}_final"] = statistics.fmean(course[-1] for course in full)
    return out


class Confidence(NamedTuple):
    """How far a method's own probability can be trusted.

    ``results`` that have one; of those said to be good the share that is; of those that failed the share that is said
    to be good (None where there are none).
    """

    results: int
    good_of_said: float | None
    said_of_failed: float | None


def confidence(games: Sequence[dict[str, Any]]) -> Confidence:
    """Confidence over the results after all clicks.

    A result is said to be good at a probability of `SAID`, is good at a Dice of `GOOD`, and failed below `FAILED`.

    Examples
    --------
    >>> clicks = [{"dice": 0.5, "sureness": 0.9}, {"dice": 0.9, "sureness": 0.8}, {"dice": 0.9, "sureness": 0.1}]
    >>> confidence([{"clicks": clicks, "perfect": False}])
    Confidence(results=3, good_of_said=0.5, said_of_failed=1.0)
    """
    rows = [
        (click["dice"], click["sureness"])
        for game in games
        for click in game["clicks"]
        if click.get("sureness") is not None
    ]
    said = [dice_now for dice_now, probability in rows if probability >= SAID]
    failed = [probability for dice_now, probability in rows if dice_now < FAILED]
    return Confidence(
        len(rows),
        sum(value >= GOOD for value in said) / len(said) if said else None,
        sum(probability >= SAID for probability in failed) / len(failed) if failed else None,
    )


def _known(game: dict[str, Any], budget: int) -> float:
    """Dice after a click that was played."""
    value = dice_after(game, budget)
    assert value is not None
    return value


def seconds(games: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Median seconds of first and of later clicks, by the wall clock and of the processor."""
    first = [game["clicks"][0] for game in games]
    later = [click for game in games for click in game["clicks"][1:]]
    return {
        f"{key}_{unit}": statistics.median(click[unit] for click in clicks) if clicks else None
        for key, clicks in (("first", first), ("later", later))
        for unit in ("wall_s", "cpu_s")
    }


def score(games: Sequence[dict[str, Any]]) -> float:
    """What settings are selected by: the mean Dice over clicks 1, 2, 3 and 5 and over the objects."""
    values = [
        value for game in games for n in BUDGETS[:4] if (value := dice_after(game, n)) is not None
    ]
    return statistics.fmean(values) if values else 0.0
