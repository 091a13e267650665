"""The best setting of every program, timed in turn, and who is faster at no lower Dice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.peers.baselines import BASELINES
from benchmarks.peers.measure import (
    LONG,
    Options,
    Timing,
    Trial,
    best,
    goal,
    in_turn,
    repeats_for,
    table,
)
from benchmarks.peers.programs import PEERS, Peer

OWN = "accelsurf"
#: Its fastest setting whose Dice is no lower than any peer's best: peers stop where they are best, so is their pace.
LEVEL = "accelsurf, level with the best peer"
#: A peer this far below the best Dice, or this many times slower than the fastest that is not, cannot be the best one:
#: it is timed twice only.
BEHIND, SLOWER = 0.02, 3.0
#: Seconds after which a search begins no new setting: on the small problem, on the large one.
SEARCH_S = (60.0, 40.0)
#: How many of the best settings of the small problem are tried on the large one.
TRANSFERRED = 2


def available(options: Options, peers: Mapping[str, Peer] | None = None) -> list[Peer]:
    """The programs of `PEERS`, or of others, that are installed; a message names each that is not, once."""
    peers = PEERS if peers is None else peers
    for peer in peers.values():
        if peer.missing and peer.missing not in options.messages:
            options.say(peer.missing)
    return [peer for peer in peers.values() if not peer.missing]


def reporter(name: str, options: Options) -> Callable[[str], None]:
    """Return a function that prints a message of a search with the program's name."""
    return lambda text: options.say(f"{name}: {text}")


def report(name: str, trial: Trial) -> None:
    """Print the result of a search."""
    print(
        f"   {name}: Dice {trial.dice:.4f} in {trial.seconds:.2f} s with {trial.settings}",
        flush=True,
    )


def time_best(
    trials: Mapping[str, list[Trial]],
    calls: Mapping[str, Callable[[Mapping[str, Any]], Any]],
    options: Options,
) -> dict[str, dict[str, Any]]:
    """Time the best setting of every program in turn, and collect its results."""
    trials, calls = dict(trials), dict(calls)
    tops = {name: best(tried) for name, tried in trials.items()}
    for trial in (trial for trial in level(trials) if trial.settings != tops[OWN].settings):
        tops[LEVEL] = trial
        trials[LEVEL] = trials[OWN]
        calls[LEVEL] = calls[OWN]
    highest = max(top.dice for name, top in tops.items() if name not in BASELINES)
    good = [t.seconds for n, t in tops.items() if n in PEERS and t.dice >= highest - BEHIND]
    slow = SLOWER * min(good, default=float("inf"))
    repeats = {}
    for name, top in tops.items():
        hopeless = name in PEERS and (top.dice < highest - BEHIND or top.seconds > slow)
        repeats[name] = repeats_for(top, options, hopeless)
    works = {name: (lambda c=calls[name], s=top.settings: c(s)) for name, top in tops.items()}
    times = in_turn(works, repeats)
    programs = {}
    for name, top in tops.items():
        timing = times[name]
        if top.seconds > LONG and not options.again:
            options.say(f"{name}: a run takes {top.seconds:.0f} s, timed once more only")
            timing = Timing([top.seconds, *timing.seconds])
        programs[name] = {
            "settings": top.settings,
            "dice": top.dice,
            **timing.to_dict(),
            "highest_dice": max(t.dice for t in trials[name]),
            "search": [t.to_dict() for t in trials[name]],
        }
    return programs


def level(trials: Mapping[str, list[Trial]]) -> list[Trial]:
    """The fastest trial of accelsurf with a Dice no lower than any peer's best, if there is one."""
    highest = max(
        (best(tried).dice for name, tried in trials.items() if name in PEERS), default=1.0
    )
    good = [trial for trial in trials[OWN] if trial.dice >= highest]
    return [min(good, key=lambda trial: trial.seconds)] if good else []


def judge(
    programs: Mapping[str, Mapping[str, Any]], label: str, wanted: float = 10.0
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Goals and pairs: Dice and seconds against the best program that moves a surface, Dice against baselines."""
    own = programs[OWN]
    others = {name: results for name, results in programs.items() if name not in (OWN, LEVEL)}
    pairs = [
        {
            "pair": f"{label}: {name} / accelsurf",
            "ratio": f["median_s"] / own["median_s"],
            "dice": f["dice"],
        }
        for name, f in others.items()
    ]
    peers = {name: results for name, results in others.items() if name in PEERS}
    if not peers:
        return [goal(f"{label}: times faster than the best peer", wanted, None)], pairs
    top = best(
        Trial({"name": name}, results["dice"], results["median_s"])
        for name, results in peers.items()
    )
    highest = max(results["dice"] for results in peers.values())
    name, as_good = (
        top.settings["name"],
        programs.get(LEVEL, own if own["dice"] >= highest else None),
    )
    faster = None if as_good is None else top.seconds / as_good["median_s"]
    return [
        goal(f"{label}: Dice less the best peer's", 0.0, own["dice"] - highest, unit=""),
        goal(
            f"{label}: times faster than the best peer ({name}), at no lower Dice than any",
            wanted,
            faster,
        ),
        goal(f"{label}: the same at its own best Dice", wanted, top.seconds / own["median_s"]),
        *_beside_baselines(
            own, {name: results for name, results in others.items() if name in BASELINES}, label
        ),
    ], pairs


def _beside_baselines(
    own: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]], label: str
) -> list[dict[str, Any]]:
    """Goals beside what a person would take who needs no surface that moves."""
    if not baselines:
        return []
    top = best(
        Trial({"name": name}, results["dice"], results["median_s"])
        for name, results in baselines.items()
    )
    name = top.settings["name"]
    return [
        goal(
            f"{label}: Dice less the best baseline's ({name})", 0.0, own["dice"] - top.dice, unit=""
        ),
        goal(f"{label}: times faster than it", 1.0, top.seconds / own["median_s"]),
    ]


def program_table(title: str, programs: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What every program reached, best first."""
    rows = []
    for name, f in sorted(programs.items(), key=lambda item: -item[1]["dice"]):
        settings = ", ".join(f"{k} {v}" for k, v in f["settings"].items())
        ratio = f["median_s"] / programs[OWN]["median_s"]
        counts = len(f["seconds"]), len(f["search"])
        rows.append((name, f["dice"], f["highest_dice"], f["median_s"], ratio, *counts, settings))
    columns = (
        "program",
        "Dice",
        "highest tried",
        "seconds",
        "/ accelsurf's",
        "runs",
        "settings tried",
        "settings",
    )
    return table(title, columns, rows)
