"""What became slower since another commit: both run the same works in turns on this machine.

scripts/benchmark --check [COMMIT] [--rounds N] [--only WORK...]

COMMIT is by default the one before (HEAD~1) and is checked out in a temporary folder. Each tree has a process with
compiled code, which does each work once before it counts; then the two take turns, and in every round another begins.
Processor seconds on one thread, the median of the rounds; exit 1 where a work takes more than 15 % longer.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: A work that takes longer by more than this part is named.
SLOWER = 0.15
#: Names of the works, in the order in which they run.
WORKS = ("import", "advance", "start", "click", "correction", "thick slices", "objects")
#: So often are the short ones done in a turn.
REPEATS = {"advance": 10, "click": 3, "correction": 3, "thick slices": 3}
#: The word that makes a process a child, and how its reply to each work begins.
SERVE, REPLY = "serve", "processor seconds:"


def main(arguments: list[str] | None = None) -> int:
    """Compare the tree here with a commit; 1 when a work became slower."""
    parser = argparse.ArgumentParser(
        prog="scripts/benchmark --check", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "commit", nargs="?", default="HEAD~1", help="the commit to compare with (HEAD~1)"
    )
    parser.add_argument(
        "--rounds", type=int, default=5, help="turns of each tree, of which the median counts (5)"
    )
    parser.add_argument(
        "--only", nargs="+", choices=WORKS, default=WORKS, metavar="WORK", help=", ".join(WORKS)
    )
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error(f"--rounds {options.rounds}: give at least 1")
    with checked_out(options.commit) as before:
        found = in_turns(before, ROOT, options.only, options.rounds)
    print(f"processor seconds, {options.commit} and here, median of {options.rounds}")
    for work, (old, new) in found.items():
        print(
            f"{work:14} {old:8.3f} {new:8.3f}  {new / old:5.2f}{'  SLOWER' if is_slower(old, new) else ''}"
        )
    return 1 if any(is_slower(*pair) for pair in found.values()) else 0


def is_slower(old: float, new: float) -> bool:
    """Return True if a work that took ``old`` seconds takes too many more."""
    return new > (1.0 + SLOWER) * old


@contextlib.contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """Folder with the files of a commit, which is removed at the end."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(
            ["git", "archive", commit, "accelsurf"], cwd=ROOT, stdout=subprocess.PIPE, check=False
        )
        if archive.returncode:
            raise SystemExit(
                f"error: {commit}: git has no such commit here\nhint: fetch it, or name another"
            )
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def in_turns(
    before: Path, now: Path, works: tuple[str, ...], rounds: int
) -> dict[str, tuple[float, float]]:
    """Median processor seconds of each work in two trees."""
    with Child(before) as old, Child(now) as new:
        found = {}
        for work in works:
            pair = (old, new)
            for child in pair:
                child.seconds(work)
            times: dict[Child, list[float]] = {old: [], new: []}
            for number in range(rounds):
                for child in pair if number % 2 else pair[::-1]:
                    times[child].append(child.seconds(work))
            found[work] = statistics.median(times[old]), statistics.median(times[new])
    return found


class Child:
    """A process that does works with the package of one tree."""

    def __init__(self, tree: Path) -> None:
        threads = dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
        )
        self._tree = tree
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, SERVE],
            cwd=tree,
            env={**os.environ, **threads, "PYTHONPATH": str(tree)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.communicate()

    def seconds(self, work: str) -> float:
        """Processor seconds of a turn of a work: once, or as often as `REPEATS` has it."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(work + "\n")
        self._process.stdin.flush()
        for line in self._process.stdout:
            if line.startswith(REPLY):
                return float(line.removeprefix(REPLY))
        raise SystemExit(f"error: {work!r} failed with the package of {self._tree}")


def works() -> dict[str, Callable[[], object]]:
    """Works by name; they use only what has long been public, so that an older tree can do them."""
    import numpy as np
    from scipy import ndimage

    import accelsurf
    from accelsurf.levelset import LevelSet

    z, y, x = np.indices((64, 64, 64)) - 31.5
    noise = np.random.default_rng(0).standard_normal((64, 64, 64))
    cube = ((abs(z) < 18) & (abs(y) < 18) & (abs(x) < 18)) + 0.5 * noise
    thick = cube[::8].repeat(3, 1).repeat(3, 2)
    away = sum(((axis + 31.5) % 21 - 10) ** 2 for axis in (z, y, x))
    seeds = ndimage.label(away < 9)[0]
    ball = (np.sqrt(z**2 + y**2 + x**2) - 16.0).astype(np.float32)
    image, slices = cube.astype(np.float32), thick.astype(np.float32)
    cells = ((away < 64) + 0.1 * noise).astype(np.float32)
    fresh = "import accelsurf, accelsurf.api.segment, accelsurf.run.run"

    def advance() -> None:
        surface = LevelSet(ball, (1.0, 1.0, 1.0), 3.0)
        for _ in range(30):
            surface.advance(np.ones(surface.size, np.float32), 0.3)
            surface.redistance()

    return {
        "import": lambda: subprocess.run([sys.executable, "-P", "-c", fresh], check=True),
        "advance": advance,
        "start": lambda: accelsurf.segment(image, start="ball:28,32,32,10vox", levels=1),
        "click": lambda: accelsurf.segment(image, inside="ball:32,32,32,4vox"),
        "correction": lambda: accelsurf.refine(
            accelsurf.segment(image, inside="ball:32,32,32,4vox"), outside="point:55,32,32vox"
        ),
        "thick slices": lambda: accelsurf.segment(
            slices, spacing=(8.0, 1.0, 1.0), inside="ball:96,96,4,4vox"
        ),
        "objects": lambda: accelsurf.segment_objects(cells, seeds),
    }


def serve() -> None:
    """Do the works whose names are given, line by line."""
    done = works()
    for line in sys.stdin:
        began = processor_seconds()
        for _ in range(REPEATS.get(line.strip(), 1)):
            done[line.strip()]()
        print(REPLY, processor_seconds() - began, flush=True)


def processor_seconds() -> float:
    """Processor seconds of this process and of those that it waited for."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


if __name__ == "__main__":
    sys.exit(serve() if sys.argv[1:] == [SERVE] else main())
