"""Runs that are killed, interrupted or out of space at seeded moments, and whether their files still belong together.

Each trial runs ``accelsurf segment --overwrite`` on a small image, into a folder with an earlier result. The settings
change from run to run, so that old and new files differ, and so do their names.

* kill: SIGKILL at a random moment of the whole run, or while files are written, or while they are put in place.
* interrupt: SIGINT, once or twice, or SIGTERM at such a moment.
* disk: no file may grow beyond a random size, as on a full disk.
* resumed: SIGKILL at random moments of a run that writes its state; repeated with ``--resume`` it must end with the
  files of one that was not killed (`benchmarks.resumed`).
* batch: the same for batches of several workers: all processes, the parent, or one worker (`benchmarks.batch_kills`).
* refine, track, movie: signals to commands that replace an earlier result (`benchmarks.command_kills`).

After each the files must be those that one report names, by their checksums: all old or all new. Or no report stands:
then the next command says that the files are unfinished, and the next run with ``--overwrite`` makes all of them anew.
Whatever is hidden must go with the next run. ``python -m benchmarks.kills --help`` lists the options; the table in
docs/how-to/files-of-a-run.md says what is promised.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelsurf import io
from accelsurf.phantoms import recipes
from benchmarks import batch_kills, command_kills, resumed
from benchmarks.case_files import fault_of

NAME = "ball"
FORMATS = ("nii.gz", "nii", "nrrd", "mha", "mhd", "tif")
MESHES = ("ply", "stl", "obj,vtp")
#: Exit code of a run that could not write.
CANNOT_WRITE = 7
SMALLEST, LARGEST = 60, 400_000  # bytes, of the limits of a file's size
#: How long after the last draft a run may be killed: its files are synced and put in place meanwhile.
MOVING_SECONDS = 0.06
#: A signal that comes within this time of the end may be too late to change anything.
TOO_LATE_SECONDS = 0.05


@dataclass
class Bench:
    """A folder with an image and with results, in which runs are disturbed.

    Attributes
    ----------
    folder : Path
    random : random.Random
    seconds : float
        Duration of an undisturbed run.
    writing : float
        The part of it from the first draft on.
    """

    folder: Path
    random: random.Random
    seconds: float = 0.0
    writing: float = 0.0
    runs: int = 0

    @property
    def results(self) -> Path:
        return self.folder / "out"

    @classmethod
    def prepared(cls, folder: Path, seed: int) -> Bench:
        """With an image and a first result."""
        recipe = recipes.Recipe(kind="ball", shape=(24, 22, 20), radius=7, noise=0.1)
        io.write(recipes.make(recipe).image, folder / f"{NAME}.nii.gz")
        bench = cls(folder, random.Random(seed))
        bench.finish()  # compiles what is not compiled yet
        began = time.perf_counter()
        program = bench.start()
        bench.wait_for_staging(program)
        first = time.perf_counter()
        program.communicate(timeout=600)
        bench.seconds, bench.writing = time.perf_counter() - began, time.perf_counter() - first
        return bench

    def words(self) -> list[str]:
        """A command line that differs from the one before."""
        self.runs += 1
        form, mesh = FORMATS[self.runs % len(FORMATS)], MESHES[self.runs % len(MESHES)]
        words = [
            "segment",
            str(self.folder / f"{NAME}.nii.gz"),
            "-o",
            str(self.results),
            "--overwrite",
        ]
        words += [
            "--start",
            "ball:0,0,0,4",
            "--max-steps",
            str(2 + self.runs % 5),
            "--format",
            form,
            "--mesh",
            mesh,
        ]
        return [*words, "--save-sdf"] if self.runs % 2 else words

    def start(self, limit: int | None = None) -> subprocess.Popen[str]:
        """Start a run; with a limit no file can have more bytes."""

        def limited() -> None:
            signal.signal(
                signal.SIGINT, signal.default_int_handler
            )  # a shell may ignore it for background jobs
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        return subprocess.Popen(
            [sys.executable, "-m", "accelsurf", *self.words()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=limited,
        )

    def finish(self) -> None:
        """Run undisturbed."""
        program = self.start()
        _, error = program.communicate(timeout=600)
        if program.returncode != 0:
            raise RuntimeError(f"an undisturbed run ended with {program.returncode}: {error}")

    def hidden(self) -> list[Path]:
        """What is left of runs."""
        return sorted(self.results.glob(".*"))

    def wait_for_staging(self, program: subprocess.Popen[str]) -> None:
        """Wait until a run writes its first file, or ends."""
        while program.poll() is None and not any(self.results.glob(".*/*/*")):
            time.sleep(0.002)

    def wait(self, program: subprocess.Popen[str]) -> str:
        """Wait for a random moment: of the whole run, while files are written, or while they are put in place."""
        part = self.random.choice(("start", "first draft", "last draft"))
        longest = {
            "start": self.seconds,
            "first draft": self.writing,
            "last draft": MOVING_SECONDS,
        }[part]
        moment = self.random.uniform(0.0, longest)
        if part == "first draft":
            self.wait_for_staging(program)
        elif part == "last draft":
            while program.poll() is None and not any(self.results.glob(f".*/*/{NAME}_report.json")):
                time.sleep(0.0002)
        time.sleep(moment)
        return f"{moment:.4f} s after the {part}"

    def report(self) -> bytes:
        """The report, or nothing."""
        path = self.results / f"{NAME}_report.json"
        return path.read_bytes() if path.exists() else b""


@dataclass
class Outcome:
    """Counts of one kind of trials.

    Attributes
    ----------
    runs : int
    counts : dict of str to int
        How often what was the case.
    faults : list of str
    """

    runs: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    def count(self, what: str) -> None:
        self.counts[what] = self.counts.get(what, 0) + 1

    def as_json(self) -> dict[str, Any]:
        return {"runs": self.runs, **dict(sorted(self.counts.items())), "faults": self.faults}


def kill(bench: Bench, outcome: Outcome) -> None:
    """One run that is killed."""
    outcome.runs += 1
    before, program = bench.report(), bench.start()
    moment = bench.wait(program)
    program.kill()
    program.communicate()
    if bench.hidden():
        outcome.count("left to the next command")
        if command_kills.look_at(bench.results):
            outcome.count("killed between two renames, named as unfinished")
            bench.finish()
        if left := bench.hidden():
            outcome.faults.append(
                f"kill {moment}: left after the next command: {', '.join(map(str, left))}"
            )
    if fault := fault_of(bench.results):
        outcome.faults.append(f"kill {moment}: {fault}")
    outcome.count("old files" if bench.report() == before else "new files")


def interrupt(bench: Bench, outcome: Outcome) -> None:
    """One run with Ctrl-C, pressed once or twice, or with SIGTERM."""
    outcome.runs += 1
    before, program = bench.report(), bench.start()
    how = bench.random.choice(("SIGINT", "SIGINT", "SIGINT twice", "SIGTERM"))
    number = signal.Signals[how.split()[0]]
    moment = f"by {how} {bench.wait(program)}"
    alive = program.poll() is None
    program.send_signal(number)
    if how == "SIGINT twice":
        time.sleep(bench.random.uniform(0.0, 0.2))
        program.send_signal(number)
    sent = time.perf_counter()
    _, error = program.communicate(timeout=600)
    late = time.perf_counter() - sent < TOO_LATE_SECONDS
    if program.returncode == 0 and (late or not alive):
        outcome.count("ended before the signal")
    elif (
        program.returncode in (-number, 1) and "accelsurf" not in error
    ):  # Python itself was starting
        outcome.count("before the first line of the program")
    elif program.returncode != 128 + number or "interrupted" not in error or "Traceback" in error:
        outcome.faults.append(
            f"interrupt {moment}: exit {program.returncode}, {error.strip()[-300:]!r}"
        )
    if fault := fault_of(bench.results) or ", ".join(map(str, bench.hidden())):
        outcome.faults.append(f"interrupt {moment}: {fault}")
    outcome.count("old files" if bench.report() == before else "new files")


def fill_disk(bench: Bench, outcome: Outcome) -> None:
    """One run in which no file may be larger than a random size."""
    outcome.runs += 1
    limit = round(math.exp(bench.random.uniform(math.log(SMALLEST), math.log(LARGEST))))
    before, program = bench.report(), bench.start(limit)
    _, error = program.communicate(timeout=600)
    replaced = bench.report() != before
    outcome.count(f"exit {program.returncode}")
    if program.returncode != (0 if replaced else CANNOT_WRITE) or "Traceback" in error:
        said = error.strip()[-300:]
        outcome.faults.append(
            f"limit {limit}: exit {program.returncode}, replaced {replaced}, {said!r}"
        )
    if fault := fault_of(bench.results) or ", ".join(map(str, bench.hidden())):
        outcome.faults.append(f"limit {limit}: {fault}")


KINDS = {"kills": kill, "interrupts": interrupt, "full disks": fill_disk}


def run_trials(bench: Bench, counts: dict[str, int], every: int = 5) -> dict[str, Any]:
    """Run trials; after ``every`` so many, and at the end, a run that is not disturbed must leave nothing hidden.

    Parameters
    ----------
    bench : Bench
    counts : dict of str to int
        How many of each of `KINDS`.
    every : int, optional
    """
    found: dict[str, Any] = {}
    for kind, count in counts.items():
        outcome = Outcome()
        for number in range(1, count + 1):
            KINDS[kind](bench, outcome)
            if number % every == 0 or number == count:
                bench.finish()
                if left := bench.hidden() or list(bench.results.glob("*_failed*")):
                    outcome.faults.append(f"left after the next run: {', '.join(map(str, left))}")
                if fault := fault_of(bench.results):
                    outcome.faults.append(f"after the next run: {fault}")
            if number % 10 == 0:
                print(
                    f"{kind}: {number} of {count}, {len(outcome.faults)} faults",
                    file=sys.stderr,
                    flush=True,
                )
        found[kind] = outcome.as_json()
    return found


#: What is killed, and its share of the kills.
SHARES = {"segment": 0.3, "refine": 0.2, "track": 0.2, "movie": 0.15, "batch": 0.15}


def shared_out(kills: int) -> dict[str, int]:
    """So many kills among the commands; what is left over is of the first."""
    counts = {name: int(share * kills) for name, share in SHARES.items()}
    return {**counts, "segment": counts["segment"] + kills - sum(counts.values())}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/kills", description="Kill runs, and check their files."
    )
    shares = ", ".join(f"{share:.0%} {name}".replace("%", "%%") for name, share in SHARES.items())
    parser.add_argument("--runs", type=int, default=100, help=f"kills, default 100: {shares}")
    parser.add_argument("--interrupts", type=int, default=0, help="runs with Ctrl-C, default 0")
    parser.add_argument("--disks", type=int, default=0, help="runs on a full disk, default 0")
    parser.add_argument(
        "--resumed", type=int, default=0, help="runs that are killed and go on, default 0"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the moments and sizes, default 0")
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).parent / "results" / "kills.json"
    )
    given = parser.parse_args(argv)
    kills, began = shared_out(given.runs), time.perf_counter()
    counts = {"kills": kills["segment"], "interrupts": given.interrupts, "full disks": given.disks}
    with tempfile.TemporaryDirectory(prefix="accelsurf-kills-") as base:
        folder = Path(base)
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        bench = Bench.prepared(folder, given.seed)
        found = {
            "seed": given.seed,
            "seconds_of_a_run": round(bench.seconds, 2),
            **run_trials(bench, counts),
        }
        found["resumed"] = resumed.trials(folder / "resumed", given.resumed, given.seed)
        found["batch"] = batch_kills.trials(folder / "batch", kills["batch"], given.seed)
        commands = {name: kills[name] for name in ("refine", "track", "movie")}
        found |= command_kills.trials(folder / "commands", commands, given.seed)
    found["seconds"] = round(time.perf_counter() - began)
    given.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=2))
    return 1 if any(entry["faults"] for entry in found.values() if isinstance(entry, dict)) else 0


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    sys.exit(main())
