"""`threads`: the growth of a ball and the brain scan on one and two threads; the labels must be the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.interact.finished import result_of
from accelsurf.levelset import Workers
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig
from benchmarks.peers.advance import grow
from benchmarks.peers.clock import Clock
from benchmarks.peers.measure import LONG, MissingError, Options, digest, goal, table, timed
from benchmarks.peers.work import BRAIN, ball, noisy_cube, scan

#: For how many cores the time is computed.
CORES = (2, 4, 8, 16)
BRAIN_SETTINGS: dict[str, Any] = {"balance": 2.0, "epsilon": 0.0}


def threads(options: Options) -> dict[str, Any]:
    """Time both pieces of work on 1 and 2 threads."""
    works: dict[str, Callable[[int], dict[str, Any]]] = {
        "advance": lambda n: advance_on(n, options)
    }
    try:
        volume = io.read(scan(options.volumes, BRAIN))
        world = ",".join(f"{v:.2f}" for v in volume.geometry.center_world())
        config = RunConfig(
            start=f"ball:{world},30", max_steps=3 if options.quick else 1000, **BRAIN_SETTINGS
        )
        works["brain scan"] = lambda n: segment_on(volume, config.replace(threads=n))
    except MissingError as missing:
        options.say(f"brain scan: skipped, {missing}")
        image, _, start, _ = noisy_cube(32 if options.quick else 128)
        cube = RunConfig(start=start, presmooth=1.0)
        works["noisy cube instead"] = lambda n: segment_on(image, cube.replace(threads=n))
    goals = []
    pairs = []
    rows = []
    more = []
    found = {}
    for name, work in works.items():
        work(2)  # compile
        runs = one_and_two(work, options.repeats)
        same = len({run["digest"] for both in runs.values() for run in both}) == 1
        middle = {
            n: sorted(both, key=lambda run: run["seconds"])[len(both) // 2]
            for n, both in runs.items()
        }
        parts = {n: run["parallel"] for n, run in middle.items()}
        whole = middle[1]["seconds"] / middle[2]["seconds"]
        parallel = parts[1] / parts[2]
        found[name] = {"runs": {str(n): both for n, both in runs.items()}, "same_bytes": same}
        goals.append(goal(f"{name}: whole, times faster on 2 threads", 1.65, whole))
        goals.append(goal(f"{name}: labels the same bytes (1 is yes)", 1.0, float(same), ">=", ""))
        pairs.append({"pair": f"{name}: 1 thread / 2 threads, whole", "ratio": whole})
        pairs.append({"pair": f"{name}: 1 thread / 2 threads, parallel parts", "ratio": parallel})
        more += [(name, n, *on_cores(n, middle[1], parallel)) for n in CORES]
        rows += [
            (name, n, run["seconds"], run["parallel"], run["digest"][:12])
            for n, run in middle.items()
        ]
        if not same:
            options.say(f"{name}: the labels differ between numbers of threads")
    return {
        "work": "a ball grown from radius 60 to 70 in 256^3, and the brain scan (library call), on 1 and 2 threads",
        "threads": [1, 2],
        "goals": goals,
        "pairs": pairs,
        "works": found,
        "tables": [
            table(
                "One thread and two",
                ("work", "threads", "seconds", "in parallel parts", "labels (hash)"),
                rows,
            ),
            table(
                "More cores, computed from the serial share",
                ("work", "cores", "seconds", "times faster"),
                more,
            ),
            table(
                "By part",
                ("work", "part", "1 thread (s)", "2 threads (s)", "ratio"),
                by_part(found),
            ),
        ],
        "bars": [
            [f"{name}, {n} thread{'s' if n > 1 else ''}", seconds]
            for name, n, seconds, _, _ in rows
        ],
    }


def on_cores(count: int, one: dict[str, Any], parallel: float) -> tuple[float, float]:
    """Seconds on so many cores and how many times faster, if parts scale as from one thread to two.

    Of a run on one thread the serial part stays as it is. The parallel part with ratio r from one to two threads is
    itself a serial and a parallel share (Amdahl): t(n) = t(1)(1 - p + p/n) with 1/r = 1 - p/2.

    Parameters
    ----------
    count : int
        Cores.
    one : dict
        The run on one thread: ``seconds`` and those in ``parallel`` parts.
    parallel : float
        r.

    Examples
    --------
    >>> on_cores(4, {"seconds": 10.0, "parallel": 8.0}, 2.0)
    (4.0, 2.5)
    """
    share = min(max(2.0 * (1.0 - 1.0 / parallel), 0.0), 1.0)
    seconds = one["seconds"] - one["parallel"] + one["parallel"] * (1.0 - share + share / count)
    return seconds, one["seconds"] / seconds


def one_and_two(
    work: Callable[[int], dict[str, Any]], repeats: int
) -> dict[int, list[dict[str, Any]]]:
    """Runs on one and on two threads in turn; a long one once only."""
    runs: dict[int, list[dict[str, Any]]] = {1: [], 2: []}
    for turn in range(repeats):
        for n, both in runs.items():
            both.append(work(n))
        if turn == 0 and runs[1][0]["seconds"] > LONG:
            break
    return runs


def by_part(found: dict[str, Any]) -> list[tuple[Any, ...]]:
    """Seconds of each stage (of each kernel where the package keeps no record), on 1 and 2 threads; the first runs'."""
    rows = []
    for name, results in found.items():
        one, two = (results["runs"][n][0]["parts"] for n in ("1", "2"))
        for part, seconds in sorted(one.items(), key=lambda item: -item[1])[:12]:
            other = two.get(part, 0.0)
            rows.append((name, part, seconds, other, seconds / other if other > 0 else None))
    return rows


def advance_on(count: int, options: Options) -> dict[str, Any]:
    """The growth of the benchmark `advance`."""
    side, first, last = (48, 12.0, 15.0) if options.quick else (256, 60.0, 70.0)
    start = ball(side, first)
    with Workers(count) as workers:
        clock = Clock(workers)
        seconds, psi = timed(lambda: grow(start, last - first, workers))
        return results_of(seconds, clock, (psi < 0).astype(np.uint8))


def segment_on(volume: Any, config: RunConfig) -> dict[str, Any]:
    """The library's run, its preparation included."""
    from accelsurf.image.volume import Volume

    volume = volume if isinstance(volume, Volume) else Volume.from_array(volume, 1.0)

    def work() -> tuple[Clock, np.ndarray]:
        run = Run(volume, config)
        clock = Clock(run.workers)
        with run.workers:
            for _ in run:
                pass
        return clock, result_of(run).labels

    seconds, (clock, labels) = timed(work)
    return results_of(seconds, clock, labels)


def results_of(seconds: float, clock: Clock, labels: np.ndarray) -> dict[str, Any]:
    """What the result has of a run."""
    parts = clock.stages or dict(clock.kernels)
    return {
        "seconds": seconds,
        "parallel": clock.parallel,
        "parts": parts,
        "digest": digest(labels),
    }
