"""`segment-hard`: works where no global threshold helps, beside what a person would take for each."""

from __future__ import annotations

import warnings
from typing import Any

from benchmarks.peers.comparison import report, reporter
from benchmarks.peers.hard_programs import OWN, PROGRAMS, Program, missing
from benchmarks.peers.hard_works import WORKS, Work
from benchmarks.peers.measure import Options, Trial, best, goal, in_turn, search, set_threads, table

#: Settings are searched on the first seed; the table has means over the others.
SEEDS = (1, 2, 3, 4)
#: Seconds after which a search begins no new setting.
SEARCH_S = 60.0


def segment_hard(options: Options) -> dict[str, Any]:
    """Each work: every program's best setting on one seed, Dice and seconds on the others."""
    set_threads(options.threads)
    warnings.filterwarnings("ignore", "The probability range is outside")
    side, seeds = (40, SEEDS[:2]) if options.quick else (96, SEEDS)
    cases = {}
    goals = []
    pairs = []
    tables = []
    bars = []
    for name in WORKS:
        works = [WORKS[name](seed, side) for seed in seeds]
        programs = [program for program in PROGRAMS[name] if _there(program, options)]
        case = {program.name: _played(program, works, options) for program in programs}
        cases[name] = case
        more, ratio = _goals(name, case)
        goals += more
        pairs.append(ratio)
        rows = sorted(
            ((n, f["dice"], f["median_s"], str(f["settings"])) for n, f in case.items()),
            key=lambda row: -row[1],
        )
        columns = ("program", "mean Dice", "seconds", "settings")
        tables.append(
            table(f"{name}: {(WORKS[name].__doc__ or '').splitlines()[0]}", columns, rows)
        )
        bars += [[f"{n}, {name}", f["median_s"]] for n, f in case.items()]
    return {
        "work": f"works without a global threshold, {side} voxels a side, library calls, {options.threads} threads",
        "threads": options.threads,
        "cases": cases,
        "goals": goals,
        "pairs": pairs,
        "tables": tables,
        "bars": bars,
    }


def _there(program: Program, options: Options) -> bool:
    if missing(program):
        options.say(f"{program.name}: skipped, {program.module} is not installed")
    return not missing(program)


def _played(program: Program, works: list[Work], options: Options) -> dict[str, Any]:
    grid = program.grid[:1] if options.quick else program.grid
    say = reporter(program.name, options)
    program.run(
        works[0], grid[0]
    )  # what is compiled or loaded at the first call is no cost of a setting
    trials = search(lambda s: works[0].score(program.run(works[0], s)), grid, None, SEARCH_S, say)
    top = best(trials)
    report(program.name, top)
    found: list[float] = []
    turns = {
        str(i): lambda work=work: found.append(work.score(program.run(work, top.settings)))
        for i, work in enumerate(works[1:])
    }
    seconds = [timing.median for timing in in_turn(turns, dict.fromkeys(turns, 1)).values()]
    return {
        "settings": top.settings,
        "dice": sum(found) / len(found),
        "each": found,
        "seconds": seconds,
        "median_s": sorted(seconds)[len(seconds) // 2],
        "search": [trial.to_dict() for trial in trials],
    }


def _goals(
    name: str, case: dict[str, dict[str, Any]]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """accelsurf's best row beside the best of the others: goals of Dice and seconds, and the ratio of these."""
    rows = {n: Trial({"name": n}, f["dice"], f["median_s"]) for n, f in case.items()}
    own = best(row for n, row in rows.items() if n.startswith(OWN))
    other = best(row for n, row in rows.items() if not n.startswith(OWN))
    ratio = other.seconds / own.seconds
    return [
        goal(
            f"{name}: Dice less the best other's ({other.settings['name']})",
            0.0,
            own.dice - other.dice,
            unit="",
        ),
        goal(f"{name}: times faster than it", 10.0, ratio),
    ], {"pair": f"{name}: {other.settings['name']} / {own.settings['name']}", "ratio": ratio}
