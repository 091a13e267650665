"""What every benchmark shares: the machine, repeated timing, the grid search, and the form of a result."""

from __future__ import annotations

import gc
import hashlib
import importlib.metadata
import itertools
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent.parent
#: Distributions whose version a result names.
PACKAGES = (
    "accelsurf",
    "numpy",
    "scipy",
    "numba",
    "SimpleITK",
    "scikit-image",
    "scikit-fmm",
    "picsl-c3d",
    "pyvista",
    "vtk",
)
#: Settings whose Dice is this close to the best count as equally good: the fastest of them is taken.
AS_GOOD = 0.002
#: A run longer than this is timed once more after the search, not `Options.repeats` times.
LONG = 60.0
#: Variables by which libraries choose their number of threads when they are loaded.
THREAD_VARIABLES = (
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)


@dataclass
class Options:
    """How a benchmark is run.

    ``quick``: tiny sizes, to see that everything works; ``repeats``: timed runs of which the median counts;
    ``threads``: for the benchmarks of whole segmentations; ``volumes``: folder of the scans, if there is one;
    ``search``: file of the search of segment-real; ``again``: read it instead of searching.
    """

    quick: bool = False
    repeats: int = 5
    threads: int = 2
    volumes: Path | None = None
    search: Path | None = None
    again: bool = False
    messages: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Print a message and add it to the result: what was skipped or stopped early, and why."""
        print(f"   {text}", flush=True)
        self.messages.append(text)


class MissingError(Exception):
    """Something that a benchmark needs is not there; the text says what, in one line."""


def scans_folder() -> Path | None:
    """The folder of scans that ACCELSURF_VOLUMES names; None where it names none."""
    folder = os.environ.get("ACCELSURF_VOLUMES")
    return Path(folder) if folder else None


def goal(
    what: str, wanted: float, measured: float | None, sense: str = ">=", unit: str = "x"
) -> dict[str, Any]:
    """One thing to reach, for the table: ``measured`` should be >= or <= ``wanted``."""
    return {"what": what, "wanted": wanted, "measured": measured, "sense": sense, "unit": unit}


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> dict[str, Any]:
    """A table of a result; numbers are rounded when it is rendered."""
    return {"title": title, "columns": list(columns), "rows": [list(row) for row in rows]}


def set_threads(threads: int) -> None:
    """Give all libraries the same number of threads; SimpleITK also when it is loaded already."""
    for name in THREAD_VARIABLES:
        os.environ[name] = str(threads)
    if "SimpleITK" in sys.modules:
        sys.modules["SimpleITK"].ProcessObject.SetGlobalDefaultNumberOfThreads(threads)


# -- timing ------------------------------------------------------------------------------------------------


@dataclass
class Timing:
    """Seconds of repeated runs."""

    seconds: list[float]

    @property
    def median(self) -> float:
        """What counts."""
        return statistics.median(self.seconds)

    def to_dict(self) -> dict[str, Any]:
        """All raw times and the median."""
        return {"median_s": self.median, "seconds": self.seconds}


def timed(work: Callable[[], Any], setup: Callable[[], Any] | None = None) -> tuple[float, Any]:
    """Seconds of one run, and what it returned; what ``setup`` returns, untimed, is passed to it."""
    given = () if setup is None else (setup(),)
    gc.collect()
    began = time.perf_counter()
    out = work(*given)
    return time.perf_counter() - began, out


def repeated(
    work: Callable[..., Any],
    repeats: int,
    setup: Callable[[], Any] | None = None,
    warm: bool = True,
) -> Timing:
    """Time ``repeats`` runs, after one that warms up."""
    if warm:
        timed(work, setup)
    return Timing([timed(work, setup)[0] for _ in range(repeats)])


def in_turn(
    works: Mapping[str, Callable[[], Any]], repeats: Mapping[str, int]
) -> dict[str, Timing]:
    """Time several programs in turn, so that what disturbs the machine disturbs all of them alike."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(max(repeats.values(), default=0)):
        for name, work in works.items():
            if turn < repeats[name]:
                seconds[name].append(timed(work)[0])
    return {name: Timing(values) for name, values in seconds.items()}


# -- grid search -------------------------------------------------------------------------------------------


@dataclass
class Trial:
    """One setting of a program, what it reached, and the seconds that it took, once."""

    settings: dict[str, Any]
    dice: float
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"settings": self.settings, "dice": self.dice, "seconds": self.seconds}


def combinations(**values: Iterable[Any]) -> list[dict[str, Any]]:
    """Every combination of the values, as settings.

    Examples
    --------
    >>> combinations(sigma=(1, 2), weight=(0,))
    [{'sigma': 1, 'weight': 0}, {'sigma': 2, 'weight': 0}]
    """
    return [
        dict(zip(values, combination, strict=True))
        for combination in itertools.product(*values.values())
    ]


def best(trials: Iterable[Trial]) -> Trial:
    """The documented rule: the highest Dice, and of the settings within `AS_GOOD` of it the fastest."""
    trials = list(trials)
    highest = max(trial.dice for trial in trials)
    return min((t for t in trials if t.dice >= highest - AS_GOOD), key=lambda trial: trial.seconds)


def ranked(trials: Iterable[Trial]) -> list[Trial]:
    """Trials from the best down, each by the rule of `best` among those that are left."""
    left, order = list(trials), []
    while left:
        order.append(best(left))
        left.remove(order[-1])
    return order


def search(
    run: Callable[[dict[str, Any]], float],
    coarse: Iterable[dict[str, Any]],
    fine: Mapping[str, Iterable[float]] | None = None,
    limit_s: float = float("inf"),
    say: Callable[[str], None] = print,
) -> list[Trial]:
    """Try settings once each; ``run`` returns the Dice of one.

    Parameters
    ----------
    run : callable
    coarse : list of dict
        All of them are tried.
    fine : dict, optional
        Setting -> factors, tried on the best of the coarse ones, one setting after the other (whole numbers stay so).
    limit_s : float
        No new setting is begun after this many seconds, no new coarse one after 0.7 of them where there are fine ones;
        ``say`` is called with what was not tried. The first one always runs.
    """
    trials: list[Trial] = []
    began = time.perf_counter()

    def attempt(settings_list: list[dict[str, Any]], limit_s: float) -> None:
        for i, settings in enumerate(settings_list):
            if any(trial.settings == settings for trial in trials):
                continue
            if trials and time.perf_counter() - began > limit_s:
                say(
                    f"search stopped after {limit_s:.0f} s, {len(settings_list) - i} settings not tried"
                )
                return
            seconds, dice = timed(lambda settings=settings: run(settings))
            trials.append(Trial(settings, float(dice), seconds))

    # The iterations decide most about the seconds: time is left for them.
    attempt(list(coarse), 0.7 * limit_s if fine else limit_s)
    for key, factors in (fine or {}).items():
        top = best(trials).settings
        attempt([{**top, key: type(top[key])(round(top[key] * f, 6))} for f in factors], limit_s)
    return trials


def repeats_for(trial: Trial, options: Options, hopeless: bool = False) -> int:
    """How often a setting is timed: once more (again: twice) when a run is long, twice when it loses in Dice anyway."""
    if trial.seconds > LONG:
        return 2 if options.again else 1
    return min(2, options.repeats) if hopeless else options.repeats


# -- machine -----------------------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Processor, memory, system, versions, date; and how busy the machine was when the benchmark began."""
    return {
        "processor": _first_line("/proc/cpuinfo", "model name")
        or platform.processor()
        or platform.machine(),
        "cores": os.cpu_count(),
        "memory_gb": _memory_gb(),
        "caches": _caches(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": versions(),
        "commit": _commit(),
        "date": time.strftime("%Y-%m-%d %H:%M", time.gmtime()) + " UTC",
        "load_before": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


def versions() -> dict[str, str | None]:
    """Version of every package that matters; None where it is not installed."""
    found: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None
    return found


def _first_line(path: str, key: str) -> str | None:
    try:
        for line in Path(path).read_text().splitlines():
            if line.startswith(key):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return None


def _memory_gb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (ValueError, OSError, AttributeError):
        return None


def _caches() -> dict[str, str]:
    found = {}
    for index in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        try:
            level, kind, size = (
                (index / name).read_text().strip() for name in ("level", "type", "size")
            )
        except OSError:
            continue
        if kind != "Instruction":
            found[f"L{level}"] = size
    return found


def _commit() -> str | None:
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=10"],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
    except OSError:
        return None
    return done.stdout.strip() or None


def digest(array: np.ndarray) -> str:
    """Hash of an array's bytes."""
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()


def child_environment(threads: int, **more: str) -> dict[str, str]:
    """Environment of a process that is timed: the package found, the threads set."""
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
    # What is warm has its bytecode, too.
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**usual, "PYTHONPATH": path, **dict.fromkeys(THREAD_VARIABLES, str(threads)), **more}


def run_process(command: list[str], threads: int, **more: str) -> tuple[float, str]:
    """Seconds of a whole process, and what it printed.

    Raises
    ------
    MissingError
        When it fails, with the last line of what it said.
    """
    began = time.perf_counter()
    done = subprocess.run(
        command, env=child_environment(threads, **more), capture_output=True, text=True
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise MissingError(
            f"{Path(command[0]).name} ended with {done.returncode}: {said[-1] if said else ''}"
        )
    return seconds, done.stdout
