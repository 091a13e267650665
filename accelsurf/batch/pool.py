"""Jobs on worker processes of this machine: what is submitted comes back as events, whatever happens to a worker.

The standard pool breaks when one worker dies, and neither it nor those built on it can end one that hangs (record
0063), so each worker is watched here: one that is gone, takes too long or too much memory is replaced, and its job
has failed. `Pool` is all that a batch asks for, so that another engine can take the place of `LocalPool`.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from accelsurf.batch.worker import READY, Failure, serve
from accelsurf.errors import AccelsurfError

#: A worker is replaced after so many jobs, so that memory which a library does not give back cannot pile up.
JOBS_PER_WORKER = 200
#: Seconds between two looks at the memory of the workers, and that a worker has to end by itself.
_LOOK_SECONDS, _LEAVE_SECONDS = 0.25, 5.0
#: So many workers in a row that die before they are ready: more would do the same.
_MAX_STILLBORN = 3


class Job(NamedTuple):
    """Something to do: its ``key``, the ``payload`` for the function, and the ``bytes`` that it is thought to take."""

    key: str
    payload: Any
    bytes: int = 0


class Started(NamedTuple):
    """A job has been given to a worker."""

    key: str


class Ended(NamedTuple):
    """A job has ended, with a ``value`` or a `Failure`."""

    key: str
    value: Any
    failure: Failure | None


class Interrupted(Exception):
    """Somebody does not want to wait for the rest of the jobs."""


class Pool(Protocol):
    """What a batch asks of whatever runs its cases."""

    def submit(self, job: Job) -> None:
        """Add a job."""
        ...

    def events(self) -> Iterator[Started | Ended]:
        """Yield events as they come, until all jobs have ended."""
        ...

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        ...

    def close(self) -> None:
        """End what still runs, and free everything."""
        ...


class _Worker:
    """A process, and the job that it has been given."""

    def __init__(self, function: Callable[[Any], Any], prepare: Callable[[], None] | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=serve, args=(theirs, function, prepare), daemon=True)
        with _signals_wait():
            self.process.start()
        theirs.close()
        self.ready, self.jobs_done = False, 0
        self.job: Job | None = None
        self.began = 0.0

    def give(self, job: Job) -> None:
        """Hand a job over; its time begins now, or when the worker has got ready."""
        self.job, self.began = job, time.monotonic()
        with suppress(OSError):  # it has died: the next look at it finds that
            self.connection.send((job.payload,))

    def kill(self) -> None:
        """End it; one that waits for a disk that is gone ends when it can."""
        self.process.kill()
        self.process.join(_LEAVE_SECONDS)
        self.connection.close()


class LocalPool:
    """Worker processes of this machine, started when there is something to do.

    Parameters
    ----------
    function : callable
        Of a payload; what a worker calls. Of a module's top level, as workers import it by its name.
    jobs : int
        Jobs at once.
    bytes : int, optional
        Estimates of the jobs that run together add up to this at most; a job that is larger fails.
    timeout : float, optional
        Seconds that a job may take.
    limit : int, optional
        Bytes that all workers together may have; beyond it the largest is ended. Only where the system says how large
        a process is (Linux).
    prepare : callable, optional
        What a worker calls before its first job, whose time does not count.
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        jobs: int,
        *,
        bytes: int | None = None,
        timeout: float | None = None,
        limit: int | None = None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._function, self._prepare = function, prepare
        self._jobs, self._bytes, self._timeout, self._limit = jobs, bytes, timeout, limit
        self._waiting: deque[Job] = deque()
        self._workers: list[_Worker] = []
        self._leaving: list[_Worker] = []
        self._stillborn = 0
        self._heard_bell, self._bell = multiprocessing.get_context("spawn").Pipe(duplex=False)

    def submit(self, job: Job) -> None:
        """Add a job."""
        self._waiting.append(job)

    def events(self) -> Iterator[Started | Ended]:
        """Yield events as they come, until all jobs have ended.

        Raises
        ------
        AccelsurfError
            When workers cannot be started.
        Interrupted
            After `interrupt`.
        """
        while self._waiting or any(worker.job for worker in self._workers):
            yield from self._refused()
            yield from self._started()
            yield from self._ended()

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        with suppress(OSError):  # it has been closed
            self._bell.send_bytes(b"now")

    def close(self) -> None:
        """End all workers at once, those at work too."""
        self._bell.close()
        self._heard_bell.close()
        for worker in (*self._workers, *self._leaving):
            worker.process.kill()
        for worker in (*self._workers, *self._leaving):
            worker.kill()
        self._workers, self._leaving = [], []
        self._waiting.clear()

    def _refused(self) -> Iterator[Ended]:
        """Jobs that are larger than everything that there is."""
        if self._bytes is None:
            return
        for job in [job for job in self._waiting if job.bytes > self._bytes]:
            self._waiting.remove(job)
            text = f"needs about {job.bytes / 1e9:.2f} GB of memory, {self._bytes / 1e9:.2f} GB may be used"
            yield Ended(job.key, None, Failure("memory", text))

    def _started(self) -> Iterator[Started]:
        """Give jobs to workers while there are both, and room for the job."""
        while (job := self._next()) is not None:
            for worker in [one for one in self._workers if one.job is None and not one.process.is_alive()]:
                self._workers.remove(worker)  # it was ended while it had nothing to do
            idle = next((worker for worker in self._workers if worker.job is None), None)
            if idle is None:
                if len(self._workers) >= self._jobs:
                    return
                idle = self._new_worker()
            self._waiting.remove(job)
            idle.give(job)
            yield Started(job.key)

    def _new_worker(self) -> _Worker:
        try:
            worker = _Worker(self._function, self._prepare)
        except OSError as error:
            raise _not_started(error.strerror or str(error)) from error
        self._workers.append(worker)
        return worker

    def _next(self) -> Job | None:
        """The first waiting job that fits beside those that run."""
        running = [worker.job.bytes for worker in self._workers if worker.job is not None]
        if self._bytes is None:
            return self._waiting[0] if self._waiting else None
        return next((job for job in self._waiting if sum(running) + job.bytes <= (self._bytes or 0)), None)

    def _ended(self) -> Iterator[Ended]:
        """Wait for a worker to say something, to die, or to have had its time."""
        busy = [worker for worker in self._workers if worker.job is not None]
        if not busy:
            return
        places = [place for worker in busy for place in (worker.connection, worker.process.sentinel)]
        if self._heard_bell in connection.wait([self._heard_bell, *places], self._patience(busy)):
            raise Interrupted
        for worker in busy:
            yield from self._heard(worker)
        yield from self._too_large([worker for worker in busy if worker.job is not None])
        self._leaving = [worker for worker in self._leaving if worker.process.is_alive()]

    def _patience(self, busy: list[_Worker]) -> float | None:
        """Seconds until something has to be looked at."""
        times = [_LOOK_SECONDS] if self._limit is not None else []
        if self._timeout is not None:
            ends = [worker.began + self._timeout for worker in busy if worker.ready]
            times += [max(0.0, min(ends) - time.monotonic())] if ends else []
        return min(times, default=None)

    def _heard(self, worker: _Worker) -> Iterator[Ended]:
        """What a worker says, or what has become of it."""
        alive = worker.process.is_alive()  # asked first: what it said before it died counts
        try:
            while worker.job is not None and worker.connection.poll():
                said = worker.connection.recv()
                if said == READY:
                    worker.ready, worker.began, self._stillborn = True, time.monotonic(), 0
                else:
                    yield self._concluded(worker, *said)
        except (EOFError, OSError):
            alive = False
        if worker.job is None:
            return
        if not alive:
            yield self._lost(worker, Failure("killed", _death(worker.process)))
        elif self._timeout is not None and worker.ready and time.monotonic() >= worker.began + self._timeout:
            yield self._lost(worker, Failure("timeout", f"did not end within {self._timeout:g} s"))

    def _concluded(self, worker: _Worker, value: Any, failure: Failure | None) -> Ended:
        job, worker.job = worker.job, None
        assert job is not None
        worker.jobs_done += 1
        if worker.jobs_done >= JOBS_PER_WORKER or (failure is not None and failure.kind == "memory"):
            self._let_go(worker)
            self._workers.remove(worker)
        return Ended(job.key, value, failure)

    def _let_go(self, worker: _Worker) -> None:
        """Let a worker end by itself."""
        with suppress(OSError):
            worker.connection.send(None)
        self._leaving.append(worker)

    def _lost(self, worker: _Worker, failure: Failure) -> Ended:
        """End a worker, if it lives, and with it its job."""
        worker.kill()
        self._workers.remove(worker)
        job, worker.job = worker.job, None
        assert job is not None
        if not worker.ready:
            self._stillborn += 1
            if self._stillborn >= _MAX_STILLBORN:
                raise _not_started(failure.message)
        return Ended(job.key, None, failure)

    def _too_large(self, busy: list[_Worker]) -> Iterator[Ended]:
        """End the largest worker where all together have more than they may."""
        if self._limit is None or not busy:
            return
        sizes = {worker: _resident(worker.process.pid) for worker in busy}
        if sum(sizes.values()) <= self._limit:
            return
        largest = max(busy, key=lambda worker: sizes[worker])
        text = f"used {sizes[largest] / 1e9:.2f} GB of memory, {self._limit / 1e9:.2f} GB may be used"
        if len(busy) > 1:
            text += f" by {len(busy)} cases together"
        yield self._lost(largest, Failure("memory", text))


def _not_started(reason: str) -> AccelsurfError:
    return AccelsurfError(f"worker processes cannot be started ({reason})", "is there memory left? try fewer jobs")


def _death(process: SpawnProcess) -> str:
    """How a process has ended, in words."""
    process.join(_LEAVE_SECONDS)
    code = process.exitcode
    if code is None or code >= 0:
        return f"its process has ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    likely = ": the machine ran out of memory, or somebody ended it" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{likely}"


def _resident(pid: int | None) -> int:
    """Bytes of memory that a process has now; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/statm").read_text().split()
    except OSError:
        return 0
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Let signals wait while a process is started, which has SIGINT blocked from its first moment on.

    Between its start and its first line a Ctrl-C in the terminal would end it with a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # which unblocks signals when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
