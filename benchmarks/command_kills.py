"""Commands that replace an earlier result and are ended at seeded moments: refine, track and movie.

Each trial begins with the files of an earlier result and ends the command that replaces them by SIGKILL, SIGINT or
SIGTERM. The next command looks at the folder. Then the files must be all old or all new, byte for byte, and nothing may
be left beside them; or the next command says that they are unfinished, no report stands, and the same commands with
--overwrite must end with the new files. Every few trials the command is given once more: it must end with the files of
one that was never ended.
"""

from __future__ import annotations

import hashlib
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.image.volume import Volume
from benchmarks.resumed import without_effort

SHAPE = (20, 24, 28)
#: Files that tell seconds: their names must be the same; their checksums of the other files are compared.
TOLD = (".json", ".html")
#: What a tracking goes on from after it was killed: neither old nor new files.
TRACK_STATE = ("*_frames", "*_checkpoint.npz")
#: Every so many trials the command is repeated to its end.
EVERY = 4
#: How long after the first draft a command may be killed: its files are written, synced and put in place meanwhile.
WRITING_SECONDS = 0.3


@dataclass(frozen=True)
class Command:
    """A command whose result replaces that of another.

    Attributes
    ----------
    old : callable
        Of the output folder, the command lines that make an earlier result.
    new : callable
        Of the output folder, the command line that is killed.
    signals : tuple of int
        Those that must leave old files or new ones.
    """

    old: Callable[[Path], list[list[str]]]
    new: Callable[[Path], list[str]]
    signals: tuple[int, ...] = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)


def prepared(folder: Path) -> dict[str, Command]:
    """Make the images; return the commands by their names."""
    folder.mkdir(parents=True, exist_ok=True)
    image, sequence = folder / "ball.nii.gz", folder / "cells.nii"
    ball = [_ball(n) for n in range(4)]
    io.write(Volume.from_array(ball[0], 1.0), image)
    grid, times = Volume.from_array(ball[0], 1.0).geometry, (0.0, 1.0, 2.0, 3.0)
    with io.SequenceWriter(sequence, grid, times, "s", np.dtype(np.float32)) as out:
        for number, frame in enumerate(ball):
            out.write(number, frame)
    run = ["--levels", "1", "--threads", "1", "--start", "ball:12,12,10,4vox"]
    segment = ["segment", str(image), "--max-steps", "15", *run, "--keep-state", "yes", "-o"]
    click = ["--inside", "point:17,12,10"]
    track = ["track", str(sequence), *run, "--mesh", "ply"]
    movie = ["movie", str(image), *run, "--size", "160x160", "--hold", "0", "--overwrite"]
    return {
        "refine": Command(
            lambda out: [[*segment, str(out)]], lambda out: ["refine", str(out), *click]
        ),
        "track": Command(
            lambda out: [[*track, "--max-steps", "3", "-o", str(out)]],
            lambda out: [*track, "--max-steps", "8", "--overwrite", "-o", str(out)],
        ),
        "movie": Command(
            lambda out: [[*movie, "--max-steps", "3", "-o", str(out / "a.gif")]],
            lambda out: [*movie, "--max-steps", "8", "-o", str(out / "a.gif")],
            (signal.SIGKILL,),  # at the others it writes the steps so far
        ),
    }


def _ball(number: int) -> np.ndarray:
    """A ball in noise that moves on from frame to frame."""
    z, y, x = np.indices(SHAPE)
    inside = (z - 10) ** 2 + (y - 12) ** 2 + (x - 12 - number) ** 2 < 6**2
    return (100.0 * inside + np.random.default_rng(number).normal(0, 15, SHAPE)).astype(np.float32)


def started(words: list[str]) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(words: list[str]) -> str:
    """Run a command undisturbed; return what is wrong with how it ended."""
    program = started(words)
    _, error = program.communicate(timeout=600)
    return "" if program.returncode == 0 else f"exit {program.returncode}: {error[-300:]}"


def look_at(folder: Path) -> bool:
    """Give the next command that reads results there; return whether it calls the files unfinished.

    It removes new files that a killed one has left, and changes nothing where some of them are in place.
    """
    absent = str(folder / "absent.nii")
    said = subprocess.run(
        [sys.executable, "-m", "accelsurf", "evaluate", absent, absent],
        capture_output=True,
        timeout=600,
        text=True,
    )
    return "is unfinished" in said.stderr and "--overwrite" in said.stderr


def content(folder: Path) -> dict[str, str]:
    """SHA-256 of all files that are not hidden, without seconds; of a file that tells them its name alone."""
    states = {path for pattern in TRACK_STATE for path in folder.glob(pattern)}
    found = {}
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in relative.parts)
        if path.is_file() and not hidden and not states & {path, *path.parents}:
            told = path.suffix in TOLD
            found[str(relative)] = "" if told else hashlib.sha256(without_effort(path)).hexdigest()
    return found


def left(folder: Path, with_states: bool) -> list[str]:
    """What no command may leave: hidden files, and after one that has ended also states and failures."""
    patterns = (".*", *((*TRACK_STATE, "*_failed*") if with_states else ()))
    return sorted(path.name for pattern in patterns for path in folder.glob(pattern))


@dataclass
class Trial:
    """A command with its results when it is not disturbed, and the seconds that it takes."""

    command: Command
    folder: Path
    old: dict[str, str]
    new: dict[str, str]
    seconds: float

    @classmethod
    def prepared(cls, command: Command, folder: Path) -> Trial:
        """Make the earlier result, and the later one in a copy."""
        old, new = folder / "old", folder / "out"
        old.mkdir(parents=True)
        for words in command.old(old):
            _refuse(finished(words))
        seconds = 0.0
        for _ in range(2):  # the first compiles
            cls._copied(old, new)
            began = time.perf_counter()
            _refuse(finished(command.new(new)))
            seconds = time.perf_counter() - began
        trial = cls(command, folder, content(old), content(new), seconds)
        if trial.old == trial.new:
            raise RuntimeError(
                "the command makes what was there already: no trial could tell old from new"
            )
        return trial

    @staticmethod
    def _copied(old: Path, out: Path) -> None:
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(old, out)

    def run(self, chance: random.Random, to_the_end: bool, counts: Counter[str]) -> list[str]:
        """Kill the command once; return the faults."""
        out = self.folder / "out"
        self._copied(self.folder / "old", out)
        program = started(self.command.new(out))
        moment = self._wait(program, chance, out)
        number = chance.choice(self.command.signals)
        program.send_signal(number)
        _, error = program.communicate(timeout=600)
        counts[
            signal.Signals(number).name if program.returncode else "ended before the signal"
        ] += 1
        faults = self._faults(out, to_the_end, counts)
        if program.returncode not in (0, -number, 128 + number) or "Traceback" in error:
            faults.append(f"exit {program.returncode}: {error[-300:]}")
        return [f"{signal.Signals(number).name} {moment}: {fault}" for fault in faults]

    def _wait(self, program: subprocess.Popen[str], chance: random.Random, out: Path) -> str:
        """Wait for a random moment: of the whole command, or from its first draft on."""
        if chance.random() < 0.5:
            moment = chance.uniform(0.0, 1.05 * self.seconds)
            wait_until(program, lambda: False, moment)
            return f"after {moment:.3f} s"
        wait_until(program, lambda: any(out.glob(".*/*/*")), 60.0)
        moment = chance.uniform(0.0, WRITING_SECONDS)
        wait_until(program, lambda: False, moment)
        return f"{moment:.4f} s after the first draft"

    def _faults(self, out: Path, to_the_end: bool, counts: Counter[str]) -> list[str]:
        faults = []
        if left(out, False):
            counts["left to the next command"] += 1
            if look_at(out):
                counts["named as unfinished"] += 1
                if list(out.glob("*_report.json")) and content(out) != self.old:
                    faults.append("unfinished, and a report stands")
                for words in (*self.command.old(out), self.command.new(out)):
                    if ended := finished([*words, "--overwrite"]):
                        faults.append(f"mended: {ended}")
        found = content(out)
        if found not in (self.old, self.new):
            faults.append(f"neither the old files nor the new ones: {difference(found, self.old)}")
        else:
            counts["old files" if found == self.old else "new files"] += 1
        if hidden := left(out, False):
            faults.append(f"left after the next command: {', '.join(hidden)}")
        if to_the_end and found != self.new:
            if ended := finished(self.command.new(out)):
                faults.append(f"once more: {ended}")
            elif wrong := difference(content(out), self.new):
                faults.append(f"once more: {wrong}")
            if there := left(out, True):
                faults.append(f"left by the command that was given once more: {', '.join(there)}")
        return faults


def wait_until(program: subprocess.Popen[str], is_so: Callable[[], bool], longest: float) -> None:
    """Wait for something, the end of a program or some seconds, whatever comes first."""
    end = time.perf_counter() + longest
    while program.poll() is None and time.perf_counter() < end and not is_so():
        time.sleep(min(0.002, max(end - time.perf_counter(), 0.0)))


def difference(found: dict[str, str], expected: dict[str, str]) -> str:
    """Which files are missing, too many, or other ones; nothing where all are as expected."""
    return ", ".join(
        sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
    )


def trials(folder: Path, counts: Mapping[str, int], seed: int) -> dict[str, Any]:
    """Kill each of the commands so many times; return counts and faults of each."""
    commands, every = prepared(folder), {}
    for name, count in counts.items():
        chance, faults = random.Random(f"{seed} {name}"), []
        found: Counter[str] = Counter()
        seconds = 0.0
        if count:
            trial = Trial.prepared(commands[name], folder / name)
            seconds = trial.seconds
            for number in range(1, count + 1):
                faults += trial.run(chance, number % EVERY == 0 or number == count, found)
                if number % 5 == 0:
                    print(
                        f"{name}: {number} of {count}, {len(faults)} faults",
                        file=sys.stderr,
                        flush=True,
                    )
        told = {"runs": count, "seconds_of_a_run": round(seconds, 2)}
        every[name] = {**told, **dict(sorted(found.items())), "faults": faults}
    return every


def _refuse(ended: str) -> None:
    if ended:
        raise RuntimeError(f"an undisturbed command ended wrongly: {ended}")
