"""Batches that are killed at seeded moments, and go on: do they end with the same bytes, and is nothing left behind?

Each trial kills once or twice, at any moment from the first to the last: all processes of the batch, its parent alone
(the workers must end with it), or one worker alone (its case fails and the others go on); or the parent gets Ctrl-C,
and what runs keeps its state. Then ``--resume`` must make what an undisturbed batch makes.
"""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.image.volume import Volume
from benchmarks import case_files
from benchmarks.resumed import without_effort

SHAPE, CASES = (36, 40, 44), 5
KINDS = ("all processes", "parent", "worker", "Ctrl-C")
#: Kills of one batch before it may end, at the most.
MAX_KILLS = 2
#: Seconds that workers have to end with their parent.
LEAVE_SECONDS = 10.0
#: Files that tell seconds: their names must be the same, what they say of the others is checked by checksums.
TOLD = (".json", ".html")


def prepared(folder: Path) -> list[str]:
    """Make the images; return the words of the command, without its output folder."""
    scans = folder / "scans"
    scans.mkdir(parents=True)
    places = np.indices(SHAPE)
    for number in range(CASES):
        squares = sum((p - n / 2 - number + 2) ** 2 for p, n in zip(places, SHAPE, strict=True))
        image = 100.0 * (squares < (9 + number) ** 2) + np.random.default_rng(number).normal(
            0, 30, SHAPE
        )
        io.write(Volume.from_array(image.astype(np.float32), 1.0), scans / f"ball{number}.nii.gz")
    words = [
        "batch",
        str(scans),
        "--levels",
        "2",
        "--noise",
        "0.05",
        "--seed",
        "7",
        "--max-steps",
        "60",
    ]
    return [*words, "--threads", "1", "--jobs", "2", "--checkpoint", "2"]


def trials(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Kill ``count`` batches and let them go on; return counts and faults."""
    counts = {
        "batches": 0,
        "kills": 0,
        **dict.fromkeys(KINDS, 0),
        "nothing to kill": 0,
        "checkpoints found": 0,
    }
    faults: list[str] = []
    if count == 0:
        return {**counts, "faults": faults}
    chance, words = random.Random(seed), prepared(folder)
    finished(words, folder / "first")  # compiles
    began = time.perf_counter()
    if (ended := finished(words, folder / "whole")) or (fault := fault_of(folder / "whole")):
        raise RuntimeError(f"an undisturbed batch ended wrongly: {ended or fault}")
    seconds, whole = time.perf_counter() - began, content(folder / "whole")
    for number in range(1, count + 1):
        out, said = folder / "out", []
        shutil.rmtree(out, ignore_errors=True)
        counts["batches"] += 1
        for _ in range(chance.randint(1, MAX_KILLS)):
            kind, moment = chance.choice(KINDS), chance.uniform(0.0, 1.1 * seconds)
            said.append(f"{kind} after {moment:.3f} s")
            program = started([*words, "--resume"], out)
            struck, left = killed(program, kind, moment, chance)
            counts["kills" if struck else "nothing to kill"] += 1
            counts[kind] += struck
            counts["checkpoints found"] += len(list(out.glob("*/*_checkpoint.npz")))
            faults += [f"{said}: processes are left: {left}"] if left else []
        ended = finished([*words, "--resume"], out)
        if problem := ended or fault_of(out) or difference(content(out), whole):
            faults.append(f"{'; '.join(said)}: {problem}")
        if number % 5 == 0:
            print(
                f"batches: {number} of {count}, {len(faults)} faults", file=sys.stderr, flush=True
            )
    return {**counts, "seconds_of_a_batch": round(seconds, 2), "faults": faults}


def started(words: Sequence[str], out: Path) -> subprocess.Popen[bytes]:
    """A batch in a session of its own, so that all its processes can be found."""
    return subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words, "-o", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def killed(
    program: subprocess.Popen[bytes], kind: str, moment: float, chance: random.Random
) -> tuple[bool, list[int]]:
    """Kill after some seconds; whether something was killed, and which processes of the batch do not end."""
    struck = False
    with suppress(subprocess.TimeoutExpired):
        program.wait(moment)
    if program.poll() is None:
        if kind == "worker":
            if workers := workers_of(program.pid):
                with suppress(ProcessLookupError):
                    os.kill(chance.choice(workers), signal.SIGKILL)
                    struck = True
            program.wait(300)  # it goes on without the case
        else:
            struck = True
            number = signal.SIGINT if kind == "Ctrl-C" else signal.SIGKILL
            (os.killpg if kind == "all processes" else os.kill)(program.pid, number)
            program.wait()
    deadline = time.perf_counter() + LEAVE_SECONDS
    while (left := session_of(program.pid)) and time.perf_counter() < deadline:
        time.sleep(0.05)
    return struck, left


def processes() -> list[tuple[int, int, int]]:
    """(pid, parent, session) of all processes that have not ended."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent, _, session = (place / "stat").read_text().rpartition(")")[2].split()[:4]
            if state not in "ZX":
                found.append((int(place.name), int(parent), int(session)))
    return found


def session_of(pid: int) -> list[int]:
    """Processes of the session that a process leads, or led."""
    return [one for one, _, session in processes() if session == pid]


def workers_of(pid: int) -> list[int]:
    """Worker processes of a batch."""
    found = []
    for one, parent, _ in processes():
        with suppress(OSError):
            if parent == pid and b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes():
                found.append(one)
    return found


def finished(words: Sequence[str], out: Path) -> str:
    """Run a batch undisturbed; return what is wrong with how it ended."""
    command = [sys.executable, "-m", "accelsurf", *words, "-o", str(out)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    return "" if ended.returncode == 0 else f"exit {ended.returncode}: {ended.stderr[-300:]}"


def content(out: Path) -> dict[str, str]:
    """SHA-256 of all files, without seconds; of a file that tells them its name alone."""
    paths = sorted(path for path in out.rglob("*") if path.is_file())
    return {
        str(path.relative_to(out)): ""
        if path.suffix in TOLD
        else hashlib.sha256(without_effort(path)).hexdigest()
        for path in paths
    }


def difference(found: dict[str, str], expected: dict[str, str]) -> str:
    """Which files are missing, too many, or other ones."""
    names = sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
    return f"not as in an undisturbed batch: {', '.join(names)}" if names else ""


def fault_of(out: Path) -> str:
    """What is wrong within a finished batch: files that are not those of their reports, or something left."""
    for number in range(CASES):
        name = f"ball{number}"
        if fault := case_files.fault_of(out / name, name, beside=[f"{name}_case.json"]):
            return f"{name}: {fault}"
    patterns = (".*", "*_checkpoint.npz", "*_failed*")
    left = sorted(str(path.relative_to(out)) for pattern in patterns for path in out.rglob(pattern))
    return f"left: {', '.join(left)}" if left else ""
