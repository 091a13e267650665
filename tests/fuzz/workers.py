"""Processes that judge inputs: each lives on from input to input, is watched, and is replaced when it dies or hangs."""

import contextlib
import importlib
import multiprocessing as mp
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.corpus import input_of, seeds
from tests.fuzz.inputs import Input
from tests.fuzz.verdict import Verdict, judge

#: Seconds for an input, and what a process may have of memory at the most.
SECONDS, RSS_BYTES = 20.0, 1 << 30
#: What a process may map (RLIMIT_AS) beyond what the libraries map when they are imported.
ADDRESS_BYTES = 2 << 30
#: Libraries that readers import when they need them.
LIBRARIES = (
    *(
        "SimpleITK",
        "nibabel",
        "tifffile",
        "zarr",
        "numcodecs",
        "pydicom",
        "highdicom",
        "trimesh",
        "PIL",
    ),
    *(
        "PIL.Image",
        "scipy.ndimage",
        "scipy.spatial",
        "numba",
        "skimage.measure",
        "fast_simplification",
    ),
    *("accelsurf.api.segment", "accelsurf.track.track", "accelsurf.viewer.movie_file"),
)
#: Kinds whose judging compiles kernels, which takes longer than an input may.
COMPILED = frozenset({"run", "state", "checkpoint-file"})


class Judged(NamedTuple):
    """An input by its number, what became of it, and in what time."""

    number: int
    verdict: Verdict
    seconds: float


class Limits(NamedTuple):
    """Of one process: seconds for an input, and bytes that it may map beyond what its libraries do."""

    seconds: float = SECONDS
    address_bytes: int = ADDRESS_BYTES


LIMITS = Limits()


def mapped_bytes() -> int:
    """Bytes that this process maps."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _limit(beyond: int) -> None:
    """Import what readers import, and limit what is mapped from here on."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    limit = mapped_bytes() + beyond
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _work(
    pipe: Connection, seed: int, inputs: tuple[Input, ...], is_replay: bool, address_bytes: int
) -> None:
    """Judge inputs as their numbers come in; of replays the number is a place in the list."""
    _limit(address_bytes)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with tempfile.TemporaryDirectory() as base, tempfile.TemporaryFile() as said:
        for stream in (1, 2):  # libraries in C print there
            os.dup2(said.fileno(), stream)
        while True:
            number = pipe.recv()
            if number is None:
                return
            folder = Path(base) / "input"
            folder.mkdir()
            given = inputs[number] if is_replay else input_of(seed, number, inputs)
            verdict = judge(given, folder)
            shutil.rmtree(folder)
            sys.stderr.flush()
            if size := os.lseek(said.fileno(), 0, os.SEEK_END):
                text = os.pread(said.fileno(), 300, 0).decode("utf-8", "replace")
                said.truncate(0)
                os.lseek(said.fileno(), 0, os.SEEK_SET)
                if not verdict.is_fault:
                    outcome = (
                        "traceback"
                        if "Traceback" in text or "Warning:" in text and ".py:" in text
                        else verdict.outcome
                    )
                    verdict = Verdict(
                        outcome, f"{verdict.text} (a library printed {size} bytes: {text})"
                    )
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            if most > RSS_BYTES:
                pipe.send((Verdict("memory", f"{most >> 20} MiB"), True))
                return
            pipe.send((verdict, False))


class _Worker:
    """One process, its pipe, and the number that it is at."""

    def __init__(
        self,
        context: mp.context.BaseContext,
        seed: int,
        inputs: tuple[Input, ...],
        is_replay: bool,
        limits: Limits,
    ) -> None:
        self._seconds = limits.seconds
        self._make = lambda: self._started(context, (seed, inputs, is_replay, limits.address_bytes))
        self._make()

    def _started(self, context: mp.context.BaseContext, arguments: tuple) -> None:
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, *arguments), daemon=True)
        self.process.start()
        theirs.close()
        self.number, self.began = -1, 0.0

    def give(self, number: int) -> None:
        self.number, self.began = number, time.monotonic()
        self.pipe.send(number)

    def outcome(self) -> Verdict | None:
        """What became of the input; None while it is being judged. A process that is of no more use is replaced."""
        if self.pipe.poll():
            try:
                verdict, last = self.pipe.recv()
            except (EOFError, ConnectionError):
                self.process.join()
                code = self.process.exitcode
                name = signal.Signals(-code).name if code and code < 0 else f"exit {code}"
                verdict, last = Verdict("crash", name), True
        elif time.monotonic() - self.began > self._seconds:
            self.process.kill()
            verdict, last = Verdict("hang", f"more than {self._seconds:g} s"), True
        else:
            return None
        if last:
            self.process.join()
            self._make()
        return verdict

    def end(self) -> None:
        self.process.kill()
        self.process.join()


def warm_up(inputs: tuple[Input, ...]) -> None:
    """Judge the valid runs once, in a process of its own without a limit: kernels are compiled and stored then."""
    process = mp.get_context("spawn").Process(target=_warm, args=(inputs,))
    process.start()
    process.join()


def _warm(inputs: tuple[Input, ...]) -> None:
    for given in inputs:
        if given.kind in COMPILED:
            with tempfile.TemporaryDirectory() as folder:
                judge(given, Path(folder))


def judged(
    numbers: Iterator[int],
    seed: int,
    processes: int,
    go_on: Callable[[], bool],
    inputs: tuple[Input, ...] = (),
    is_replay: bool = False,
    limits: Limits = LIMITS,
) -> Iterator[Judged]:
    """Judge the inputs of these numbers, in whatever order they are done.

    Parameters
    ----------
    numbers : iterator of int
    seed, processes : int
    go_on : callable
        Whether another input is to be judged.
    inputs : tuple of Input, optional
        The valid ones to mutate, by default all; or with ``is_replay`` those to judge as they are, by their places.
    is_replay : bool, optional
    limits : Limits, optional
    """
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(["tests.fuzz.verdict", "tests.fuzz.corpus", *LIBRARIES])
    inputs = inputs or seeds()
    workers = [_Worker(context, seed, inputs, is_replay, limits) for _ in range(processes)]
    busy: list[_Worker] = []
    try:
        for worker in workers:
            if (number := next(numbers, None)) is not None:
                worker.give(number)
                busy.append(worker)
        while busy:
            wait([worker.pipe for worker in busy], timeout=0.5)
            for worker in tuple(busy):
                number, began = worker.number, worker.began
                verdict = worker.outcome()
                if verdict is None:
                    continue
                busy.remove(worker)
                yield Judged(number, verdict, time.monotonic() - began)
                if go_on() and (number := next(numbers, None)) is not None:
                    worker.give(number)
                    busy.append(worker)
    finally:
        for worker in workers:
            worker.end()
