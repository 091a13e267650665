"""How long a click takes at 256^3, part by part: the first one, and those that correct its result.

scripts/benchmark refine [--objects A,B] [--clicks N] [--size N] [--threads N] [--volumes DIR] [--results DIR]
scripts/benchmark refine --render        the page again, from the JSON alone

The simulated person of `benchmarks.clicks` clicks into phantoms and, where the scans are there, into objects of
the brain. Each click is made several times from the same state: with all threads, for the seconds that a person waits;
and with one, for the processor seconds of each part. Both must give the same bytes. Kernels are compiled before.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.api.segment import segment
from accelsurf.image.volume import Volume
from accelsurf.interact.refiner import Refiner
from accelsurf.phantoms.recipes import load_recipe, make
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from benchmarks.clicks.objects import load, selected
from benchmarks.clicks.own import text_of
from benchmarks.clicks.person import PersonClick, next_click
from benchmarks.peers.measure import scans_folder

ROOT = Path(__file__).resolve().parent.parent
RESULTS, PAGE, NAME = (
    ROOT / "benchmarks/results",
    ROOT / "docs/explanation/latency.md",
    "refine.json",
)
#: The scan of 256^3 voxels whose objects are clicked.
#: Objects of one brain of that size.
IN_BRAIN = (
    "ventricle-left",
    "thalamus-left",
    "putamen-left",
    "third-ventricle",
    "brain-stem",
    "cerebellum-right",
    "caudate-right",
    "pallidum-right",
)
#: Wanted of a correction, s: the median, and what 95 % take at most; of a first click, the median.
WANTED = {"later": (0.5, 1.0), "first": (3.0, None)}
#: How often a click is made; the fastest counts, as what disturbs only adds.
REPEATS = 3
#: What is timed: module, name in it, part. Time in a part that another one calls counts for the inner one.
PARTS = (
    ("accelsurf.clicks.model.model", "first_model", "the model's object"),
    ("accelsurf.clicks.model.model", "with_click", "the model's object"),
    ("accelsurf.clicks.model.model", "window_around", "windows"),
    ("accelsurf.clicks.model.model", "features_of_first", "features"),
    ("accelsurf.clicks.model.model", "features_of_later", "features"),
    ("accelsurf.clicks.model.features", "Looks.arrival", "arrival times"),
    ("accelsurf.clicks.model.features", "Looks.paths", "paths"),
    ("accelsurf.clicks.model.features", "Looks.walk", "walks"),
    ("accelsurf.clicks.model.model", "at_boundary", "boundary"),
    ("accelsurf.clicks.model.network", "Network.probability", "network"),
    ("accelsurf.clicks.model.surface", "area_weight", "area's weight"),
    ("accelsurf.clicks.model.model", "mean_curvature", "area's weight"),
    ("accelsurf.interact.refiner", "basin_of", "region"),
    ("accelsurf.interact.refiner", "around_clicks", "region"),
    ("accelsurf.interact.local_evolution", "signed_distance", "region"),
    ("accelsurf.interact.local_evolution", "near_bounds", "region"),
    ("accelsurf.interact.local_evolution", "united", "region"),
    ("accelsurf.interact.local_evolution", "_distance_to", "region"),
    ("accelsurf.levelset.level_set", "LevelSet.__init__", "first band"),
    ("accelsurf.interact.local_evolution", "restore_psi", "first band"),
    ("accelsurf.levelset.level_set", "LevelSet.reinitialize", "first band"),
    ("accelsurf.evolution.loop", "Evolution.step", "steps"),
)
ORDER = (*dict.fromkeys(part for _, _, part in PARTS), "rest")


class Case(NamedTuple):
    """An object to be clicked: ``kind`` is phantom or scan, ``truth`` a mask on the image's grid."""

    name: str
    kind: str
    image: Volume
    truth: NDArray[np.bool_]


class Timer:
    """Processor seconds of each part, by thread; time in an inner part is not that of the outer one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._local, self._lock = threading.local(), threading.Lock()

    def timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        """The function, timed."""

        def call(*args: Any, **kwargs: Any) -> Any:
            inner = getattr(self._local, "inner", 0.0)
            self._local.inner, began = 0.0, time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.thread_time() - began
                with self._lock:
                    self.seconds[part] = self.seconds.get(part, 0.0) + whole - self._local.inner
                self._local.inner = inner + whole

        return call

    @contextmanager
    def measuring(self) -> Iterator[None]:
        """Time all parts."""
        before = []
        for module, name, part in PARTS:
            *owners, last = name.split(".")
            owner: Any = importlib.import_module(module)
            for one in owners:
                owner = getattr(owner, one)
            before.append((owner, last, getattr(owner, last)))
            setattr(owner, last, self.timed(getattr(owner, last), part))
        try:
            yield
        finally:
            for owner, last, function in before:
                setattr(owner, last, function)


def phantoms(size: int) -> Iterator[Case]:
    """Objects known exactly: a noisy torus, a vessel, and one of two balls that touch and look alike.

    Half as wide in the grid as their recipes have them, 15,000 to 160,000 voxels at 256^3: no organ fills its scan.
    """
    for name in ("torus", "vessel", "two_balls"):
        recipe = load_recipe(name)
        longest = max(recipe.shape)
        spacing = [2.0 * h * longest / size for h in recipe.spacing]
        made = make(recipe.changed(shape=[size] * 3, spacing=spacing, noise=recipe.noise or 0.3))
        truth = np.asarray(made.truth.array > 0)
        if name == "two_balls":
            half = np.argwhere(truth)[:, 2].mean()
            truth &= (np.arange(size) < half)[None, None, :]
        yield Case(name, "phantom", made.image, truth)


def scans(folder: Path, names: Sequence[str]) -> Iterator[Case]:
    """The objects in the brain."""
    for one in selected(names=IN_BRAIN):
        if not names or one.name in names:
            scene = load(one, folder)
            yield Case(one.name, "scan", scene.image, scene.truth)


def play(case: Case, clicks: int, threads: int) -> Iterator[dict[str, Any]]:
    """Click an object, and measure each click."""
    click = next_click(case.truth, None, case.image.geometry)
    assert click is not None
    runs = {
        n: RunConfig(inside=(text_of(click, case.image),), threads=n, keep_state="yes")
        for n in {threads, 1}
    }
    segment(case.image, config=runs[threads])  # compiles what is new
    waited = min(
        _seconds(lambda: segment(case.image, config=runs[threads]))[0] for _ in range(REPEATS)
    )
    results, parts, processor = _by_parts(lambda: segment(case.image, config=runs[1]))
    yield _row(case, 1, click, waited, processor, parts, len(results.history))
    refiners = {n: Refiner(segment(case.image, config=config)) for n, config in runs.items()}
    for number in range(2, clicks + 1):
        labels = _labels(refiners[threads], case.truth.shape)
        click = next_click(case.truth, labels, case.image.geometry)
        if click is None:
            return
        yield _corrected(case, number, click, refiners, threads)


def _corrected(
    case: Case, number: int, click: PersonClick, refiners: dict[int, Refiner], threads: int
) -> dict[str, Any]:
    refinement = Correction(**{click.side: (text_of(click, case.image),)})
    refiner = refiners[threads]
    before = len(refiner.surfaces[0].history)
    refiner.apply(refinement)
    waited = []
    for _ in range(REPEATS):
        refiner.undo()
        waited.append(_waited(refiner, refinement))
    alone = refiners[1]
    _, parts, processor = _by_parts(lambda: alone.apply(refinement))
    if refiner.surfaces[0].psi.tobytes() != alone.surfaces[0].psi.tobytes():
        raise AssertionError(
            f"{case.name}, click {number}: not the same bytes with {threads} threads and with one"
        )
    steps = max(len(alone.surfaces[0].history) - before, 0)
    whole, first = (min(times) for times in zip(*waited, strict=True))
    return _row(case, number, click, whole, processor, parts, steps) | {
        "first_step_s": round(first, 4)
    }


def _waited(refiner: Refiner, refinement: Correction) -> tuple[float, float]:
    """Seconds of a correction, and until its first step can be shown."""
    steps: list[float] = []
    began = time.perf_counter()
    refiner.apply(refinement, on_step=lambda record, own: steps.append(time.perf_counter()))
    ended = time.perf_counter()
    return ended - began, (steps[0] if steps else ended) - began


def _row(
    case: Case,
    number: int,
    click: PersonClick,
    waited: float,
    processor: float,
    parts: dict[str, float],
    steps: int,
) -> dict[str, Any]:
    parts = {name: round(parts.get(name, 0.0), 6) for name in ORDER}
    return {
        "object": case.name,
        "kind": case.kind,
        "shape": list(case.truth.shape),
        "click": number,
        "side": click.side,
        "wall_s": round(waited, 4),
        "cpu_s": round(processor, 4),
        "steps": steps,
        "parts": parts,
    }


def _seconds(call: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    found = call()
    return time.perf_counter() - began, found


def _by_parts(call: Callable[[], Any]) -> tuple[Any, dict[str, float], float]:
    """What is returned, processor seconds by part, and of all."""
    timer, began = Timer(), time.process_time()
    with timer.measuring():
        found = call()
    whole = time.process_time() - began
    return found, timer.seconds | {"rest": max(whole - sum(timer.seconds.values()), 0.0)}, whole


def _labels(refiner: Refiner, shape: Sequence[int]) -> NDArray[np.bool_]:
    (one,) = refiner.surfaces
    labels = np.zeros(tuple(shape), np.bool_)
    labels[tuple(slice(c, c + n) for c, n in zip(one.corner, one.psi.shape, strict=True))] = (
        one.psi < 0
    )
    return labels


# -- the page ----------------------------------------------------------------------------------------------


def page_of(record: dict[str, Any]) -> str:
    """The page of the documentation."""
    lines = [
        "# How long a click takes",
        "",
        "Made by `scripts/benchmark refine --render`; do not edit. A simulated person clicks where the result is most "
        "wrong (record 0023). Seconds are what a person waits with the compiled code in memory: of a first click the "
        "whole run, of a later one the correction. Each is the fastest of "
        f"{REPEATS}.",
        "",
        f"{record['threads']} threads, {record['cores']} cores, load {record['load']:.1f} at the beginning. Where that "
        "is more than the cores, a person would wait less on an idle machine, and the processor's seconds, of the same "
        "clicks with one thread, tell more. Scans: objects of a T1 brain (niivue's demo images).",
        "",
        "| clicks | number | median | 95 % | largest | first step shown, median | processor, median | 95 % | wanted |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    rows = record["clicks"]
    for kind in ("phantom", "scan"):
        for which in ("first", "later"):
            own = [
                row
                for row in rows
                if row["kind"] == kind and (row["click"] == 1) == (which == "first")
            ]
            if own:
                lines.append(_summary(f"{kind}s, {which}", own, WANTED[which]))
    lines += ["", "Processor seconds of one thread by part, the mean over the clicks:", ""]
    groups = {
        f"{kind}, {which}": [
            r for r in rows if r["kind"] == kind and (r["click"] == 1) == (which == "first")
        ]
        for kind in ("phantom", "scan")
        for which in ("first", "later")
    }
    groups = {name: own for name, own in groups.items() if own}
    lines += ["| part | " + " | ".join(groups) + " |", "|---" * (len(groups) + 1) + "|"]
    for part in ORDER:
        means = [float(np.mean([row["parts"][part] for row in own])) for own in groups.values()]
        if max(means) >= 0.0005:
            lines.append(f"| {part} | " + " | ".join(f"{mean:.3f}" for mean in means) + " |")
    lines += [
        "",
        "| object | click | side | seconds | processor | steps |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| {row['object']} | {row['click']} | {row['side']} | {row['wall_s']:.2f} | {row['cpu_s']:.2f} | "
            f"{row['steps']} |"
        )
    return "\n".join(lines) + "\n"


def _summary(name: str, rows: list[dict[str, Any]], wanted: tuple[float, float | None]) -> str:
    waited, used = (np.array([row[key] for row in rows]) for key in ("wall_s", "cpu_s"))
    shown = [row["first_step_s"] for row in rows if "first_step_s" in row]
    first = f"{np.median(shown):.2f}" if shown else "-"
    limit = f"{wanted[0]:g} median" + (f", {wanted[1]:g} for 95 %" if wanted[1] else "")
    return (
        f"| {name} | {len(rows)} | {np.median(waited):.2f} | {np.percentile(waited, 95):.2f} | {waited.max():.2f} | "
        f"{first} | {np.median(used):.2f} | {np.percentile(used, 95):.2f} | {limit} |"
    )


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write JSON and page."""
    options = parse(arguments)
    path = options.results / NAME
    if not options.render:
        record = {
            "threads": options.threads,
            "cores": len(os.sched_getaffinity(0)),
            "machine": platform.machine(),
            "load": os.getloadavg()[0],
            "size": options.size,
            "clicks": [],
        }
        cases = [phantoms(options.size)]
        if options.volumes is not None:
            cases.append(scans(options.volumes, options.objects))
        else:
            print("refine: without scans; ACCELSURF_VOLUMES names their folder", file=sys.stderr)
        for case in (one for some in cases for one in some):
            if options.objects and case.name not in options.objects:
                continue
            for row in play(case, options.clicks, options.threads):
                record["clicks"].append(row)
                line = f"{row['object']} {row['click']} {row['side']}: {row['wall_s']:.2f} s, cpu {row['cpu_s']:.2f} s"
                print(line, flush=True)
        options.results.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1) + "\n")
        print(f"written: {path}")
    # Results elsewhere are trials: the docs show those of the repository.
    if options.results == RESULTS:
        PAGE.write_text(page_of(json.loads(path.read_text())))
        print(f"written: {PAGE}")
    return 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="scripts/benchmark refine", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--objects", type=lambda text: text.split(","), default=[], help="only these"
    )
    parser.add_argument("--clicks", type=int, default=6, help="clicks on each object (6)")
    parser.add_argument(
        "--size", type=int, default=256, help="voxels of a phantom along each axis (256)"
    )
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--volumes", type=Path, default=scans_folder(), help="folder of the scans")
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help="folder of the JSON (benchmarks/results)"
    )
    parser.add_argument("--render", action="store_true", help="measure nothing")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
