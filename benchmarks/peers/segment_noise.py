"""`segment-noise`: cubes in noise, every program at the best settings that a search finds."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from accelsurf.api.segment import segment
from accelsurf.measure.metrics import dice
from benchmarks.peers.baselines import BASELINES
from benchmarks.peers.comparison import (
    LEVEL,
    OWN,
    SEARCH_S,
    TRANSFERRED,
    available,
    judge,
    level,
    program_table,
    report,
    reporter,
    time_best,
)
from benchmarks.peers.measure import Options, Trial, best, combinations, ranked, search, set_threads
from benchmarks.peers.work import noisy_cube


def own_noise_grid() -> list[dict[str, Any]]:
    """Settings of accelsurf in noise."""
    return [
        *combinations(
            epsilon=(0.0,),
            presmooth=(1.5,),
            smoothness=(0.2, 0.1),
            tolerance=(0.1, 0.3, 0.5),
            levels=("auto", 3),
        ),
        *combinations(epsilon=(0.0, 1.5), presmooth=(1.5, 1.0, 2.0), smoothness=(0.1, 0.2, 0.0)),
        *combinations(flow=("gradient",), epsilon=(0.0,), presmooth=(1.5,), tolerance=(0.1, 0.3)),
    ]


def segment_noise(options: Options) -> dict[str, Any]:
    """Cubes in noise of their contrast: every program's best, the library call alone timed."""
    set_threads(options.threads)
    sides = (32, 40) if options.quick else (96, 128)
    transferred: dict[str, list[Trial]] = {}
    cases = []
    for i, side in enumerate(sides):
        cases.append(noise_case(side, options, transferred, SEARCH_S[min(i, 1)]))
    goals: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    tables = []
    for case in cases:
        label = f"{case['side']}^3"
        more, ratios = judge(case["programs"], label)
        goals += more
        pairs += ratios
        tables.append(program_table(f"Cube of {case['side'] // 2} in {label}", case["programs"]))
    bars = [[f"{n}, {c['side']}^3", p["median_s"]] for c in cases for n, p in c["programs"].items()]
    return {
        "work": f"cube in noise sigma 1 of the contrast, {sides[0]}^3 and {sides[1]}^3, off-centre ball, library call, "
        f"{options.threads} threads",
        "threads": options.threads,
        "cases": cases,
        "goals": goals,
        "pairs": pairs,
        "tables": tables,
        "bars": bars,
    }


def noise_case(
    side: int, options: Options, transferred: dict[str, list[Trial]], limit_s: float
) -> dict[str, Any]:
    """One size: search, then timing in turn. ``transferred`` brings the settings of a smaller size, and takes these."""
    image, truth, start, distance = noisy_cube(side)
    segment(image, start=start, threads=options.threads, max_steps=3)  # compile

    def own(settings: Mapping[str, Any]) -> np.ndarray:
        return segment(image, start=start, threads=options.threads, **settings).labels.astype(bool)

    calls: dict[str, Callable[[Mapping[str, Any]], np.ndarray]] = {OWN: own}
    grids: dict[str, tuple[list[dict[str, Any]], Any]] = {OWN: (own_noise_grid(), None)}
    for peer in (*available(options), *available(options, BASELINES)):
        calls[peer.name] = lambda settings, peer=peer: peer.run(
            image, distance, (1.0, 0.0), settings
        )
        grids[peer.name] = ([peer.scaled(s, side) for s in peer.coarse], peer.fine)
    if options.quick:
        grids = {name: (coarse[:2], None) for name, (coarse, _) in grids.items()}
    kept, trials = last_settings(side, options), {}
    if kept:
        options.say(f"{side}^3: the peers have the settings that their last search found")
    for name, (coarse, fine) in grids.items():
        if name in kept:
            coarse, fine = [kept[name]], None
        elif name in transferred:
            # Both sizes have the same noise: the best of the smaller one, iterations grown with the side.
            coarse, fine = from_smaller(transferred[name], side), None
        say = reporter(name, options)
        trials[name] = search(
            lambda s, c=calls[name]: dice(c(s), truth), coarse, fine, limit_s, say
        )
        report(name, best(trials[name]))
    transferred |= {
        name: [scaled_trial(t, 96 / side) for t in ranked(ts)[:TRANSFERRED]]
        for name, ts in trials.items()
    }
    transferred[OWN] += [scaled_trial(t, 96 / side) for t in level(trials)]
    programs = time_best(trials, calls, options)
    return {"side": side, "start": start, "programs": programs}


def last_settings(side: int, options: Options) -> dict[str, dict[str, Any]]:
    """The peers' settings that the last search found for a size, for ``--again``; else none."""
    if not options.again or options.search is None:
        return {}
    cases = json.loads(options.search.with_name("benchmark_segment-noise.json").read_text())[
        "cases"
    ]
    programs = next((case["programs"] for case in cases if case["side"] == side), {})
    return {name: found["settings"] for name, found in programs.items() if name not in (OWN, LEVEL)}


def scaled_trial(trial: Trial, factor: float) -> Trial:
    """A trial whose iterations are those of another size."""
    settings = dict(trial.settings)
    if "iterations" in settings:
        settings["iterations"] = max(2, round(settings["iterations"] * factor))
    return Trial(settings, trial.dice, trial.seconds)


def from_smaller(trials: Iterable[Trial], side: int) -> list[dict[str, Any]]:
    """Settings of the smaller problem, for ``side`` voxels."""
    return [scaled_trial(trial, side / 96).settings for trial in trials]
