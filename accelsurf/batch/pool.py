"""Jobs on worker processes of this machine: each job comes back as an event, whatever happens to its worker.

The standard pool breaks when one worker dies, and neither it nor those built on it can end one that hangs (record
0032), so each worker is watched here: one that is gone, takes too long or too much memory is replaced, and its job
has failed. `Pool` is all that a batch asks for, so that another engine can take the place of `LocalPool`.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple, Protocol

import psutil

from accelsurf.errors import AccelsurfError

#: Message of a worker that can take a job.
READY = "ready"
#: Jobs after which a worker is replaced, so that memory which a library does not give back cannot pile up.
JOBS_PER_WORKER = 200
#: Seconds between two looks at the memory of the workers, and that a worker has to end by itself.
_LOOK_SECONDS = 0.25
_LEAVE_SECONDS = 5.0
#: Number of workers in a row that die before they are ready: more would do the same.
_MAX_STILLBORN = 3


class Failure(NamedTuple):
    """Reason why a job has no result.

    Attributes
    ----------
    kind : {"error", "memory", "timeout", "killed"}
        An exception, too little memory, no end in time, a process that is gone.
    message : str
        One line.
    details : str
        The traceback of an exception.
    """

    kind: str
    message: str
    details: str = ""


#: A result, or the failure in its place; the other is None.
Reply = tuple[Any, Failure | None]


class Job(NamedTuple):
    """A job: its ``key``, the ``payload`` for the function, and the estimate of its ``bytes``."""

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
    """Interface of an engine that runs the cases of a batch."""

    def submit(self, job: Job) -> None:
        """Add a job."""
        ...

    def events(self) -> Iterator[Started | Ended]:
        """Yield events as they come, until all jobs have ended."""
        ...

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        ...

    def stop(self) -> Iterator[Ended]:
        """Let the jobs that run keep their state and end; yield those that end with a result."""
        ...

    def close(self) -> None:
        """End the jobs that still run, and free everything."""
        ...


class _Worker:
    """A process, and the job that it has been given."""

    def __init__(self, function: Callable[[Any], Any], prepare: Callable[[], None] | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(
            target=serve, args=(theirs, function, prepare), daemon=True
        )
        with _signals_wait():
            self.process.start()
        theirs.close()
        self.is_ready = False
        self.jobs_done = 0
        self.began = 0.0
        self.job: Job | None = None

    def give(self, job: Job) -> None:
        """Hand a job over; its time begins now, or when the worker has got ready."""
        self.job, self.began = job, time.monotonic()
        with suppress(OSError):  # it has died: the next look at it finds that
            self.connection.send(job.payload)

    def get_ready(self) -> None:
        """Begin the time of its first job."""
        self.is_ready, self.began = True, time.monotonic()

    def end_job(self, value: Any, failure: Failure | None) -> Ended:
        """Return the end of its job."""
        job, self.job = self.job, None
        assert job is not None
        self.jobs_done += 1
        return Ended(job.key, value, failure)

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
        Of a payload; called by a worker. Of a module's top level, as workers import it by its name.
    jobs : int
        Jobs at once.
    bytes : int, optional
        Estimates of the jobs that run together add up to this at most; a job that is larger fails.
    timeout : float, optional
        Seconds that a job may take.
    limit : int, optional
        Bytes that all workers together may have; beyond it the largest is ended.
    prepare : callable, optional
        Called by a worker before its first job; its time does not count.
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
        self._jobs = jobs
        self._timeout = timeout
        self._limit = limit
        self._bytes: float = math.inf if bytes is None else bytes
        self._waiting: deque[Job] = deque()
        self.workers: list[_Worker] = []
        self._stillborn = 0
        self._bell_receiver, self._bell = multiprocessing.get_context("spawn").Pipe(duplex=False)

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
        while self._waiting or any(worker.job for worker in self.workers):
            for job in [job for job in self._waiting if job.bytes > self._bytes]:
                self._waiting.remove(job)
                text = f"needs about {job.bytes / 1e9:.2f} GB of memory, {self._bytes / 1e9:.2f} GB may be used"
                yield Ended(job.key, None, Failure("memory", text))
            yield from self._started()
            yield from self._ended()

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        with suppress(OSError):  # it has been closed
            self._bell.send_bytes(b"now")

    def stop(self) -> Iterator[Ended]:
        """Send SIGTERM to all workers and wait for them, however long; yield the jobs that end with a result."""
        for worker in self.workers:
            worker.process.terminate()
        for worker in self.workers:
            with suppress(EOFError, OSError):  # it has ended
                while worker.job is not None:
                    message = worker.connection.recv()
                    if message != READY:
                        yield worker.end_job(*message)

    def close(self) -> None:
        """End all workers at once, those at work too."""
        self._bell.close()
        self._bell_receiver.close()
        for worker in self.workers:
            worker.process.kill()
        for worker in self.workers:
            worker.kill()
        self.workers = []
        self._waiting.clear()

    def _started(self) -> Iterator[Started]:
        """Give jobs to workers while there are both, and room for the job."""
        while (job := self._next()) is not None:
            for worker in [
                worker for worker in self.workers if not (worker.job or worker.process.is_alive())
            ]:
                self.workers.remove(worker)  # it was ended while it had nothing to do
            idle = next((worker for worker in self.workers if worker.job is None), None)
            if idle is None:
                if len(self.workers) >= self._jobs:
                    return
                try:
                    idle = _Worker(self._function, self._prepare)
                except OSError as error:
                    raise _not_started(error.strerror or str(error)) from error
                self.workers.append(idle)
            self._waiting.remove(job)
            idle.give(job)
            yield Started(job.key)

    def _next(self) -> Job | None:
        """The first waiting job that fits beside those that run."""
        room = self._bytes - sum(
            worker.job.bytes for worker in self.workers if worker.job is not None
        )
        return next((job for job in self._waiting if job.bytes <= room), None)

    def _ended(self) -> Iterator[Ended]:
        """Wait for a worker to say something, to die, or to have had its time."""
        busy = [worker for worker in self.workers if worker.job is not None]
        if not busy:
            return
        places = [
            place for worker in busy for place in (worker.connection, worker.process.sentinel)
        ]
        if self._bell_receiver in connection.wait(
            [self._bell_receiver, *places], self._patience(busy)
        ):
            raise Interrupted
        for worker in busy:
            yield from self._receive(worker)
        yield from self._too_large([worker for worker in busy if worker.job is not None])

    def _patience(self, busy: list[_Worker]) -> float | None:
        """Seconds until something has to be looked at."""
        times = [_LOOK_SECONDS] if self._limit is not None else []
        if self._timeout is not None:
            times += [
                max(0.0, w.began + self._timeout - time.monotonic()) for w in busy if w.is_ready
            ]
        return min(times, default=None)

    def _receive(self, worker: _Worker) -> Iterator[Ended]:
        """Read the messages of a worker, or find out that it is dead or late."""
        alive = worker.process.is_alive()  # asked first: messages from before its death count
        try:
            while worker.job is not None and worker.connection.poll():
                message = worker.connection.recv()
                if message == READY:
                    worker.get_ready()
                    self._stillborn = 0
                else:
                    yield self._concluded(worker, *message)
        except (EOFError, OSError):
            alive = False
        if worker.job is None:
            return
        if not alive:
            yield self._lost(worker, Failure("killed", _death(worker.process)))
        elif (
            self._timeout is not None
            and worker.is_ready
            and time.monotonic() >= worker.began + self._timeout
        ):
            yield self._lost(worker, Failure("timeout", f"did not end within {self._timeout:g} s"))

    def _concluded(self, worker: _Worker, value: Any, failure: Failure | None) -> Ended:
        ended = worker.end_job(value, failure)
        if worker.jobs_done >= JOBS_PER_WORKER or (
            failure is not None and failure.kind == "memory"
        ):
            worker.kill()
            self.workers.remove(worker)
        return ended

    def _lost(self, worker: _Worker, failure: Failure) -> Ended:
        """End a worker, if it lives, and with it its job."""
        worker.kill()
        self.workers.remove(worker)
        if not worker.is_ready:
            self._stillborn += 1
            if self._stillborn >= _MAX_STILLBORN:
                raise _not_started(failure.message)
        return worker.end_job(None, failure)

    def _too_large(self, busy: list[_Worker]) -> Iterator[Ended]:
        """End the largest worker where all together have more than they may."""
        if self._limit is None or not busy:
            return
        sizes = {worker: _resident(worker.process.pid) for worker in busy}
        if sum(sizes.values()) <= self._limit:
            return
        largest = max(busy, key=lambda worker: sizes[worker])
        text = (
            f"used {sizes[largest] / 1e9:.2f} GB of memory, {self._limit / 1e9:.2f} GB may be used"
        )
        if len(busy) > 1:
            text += f" by {len(busy)} cases together"
        yield self._lost(largest, Failure("memory", text))


class InlinePool:
    """Jobs that are done when somebody waits for them.

    Parameters
    ----------
    function : callable
        Of a payload.

    Examples
    --------
    >>> pool = InlinePool(lambda number: 1 / number)
    >>> for number in (4, 0):
    ...     pool.submit(Job(str(number), number))
    >>> [(event.value, event.failure and event.failure.message) for event in pool.events() if isinstance(event, Ended)]
    [(0.25, None), (None, 'ZeroDivisionError: division by zero')]
    """

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function
        self._waiting: deque[Job] = deque()
        self._interrupted = False

    def submit(self, job: Job) -> None:
        """Add a job."""
        self._waiting.append(job)

    def events(self) -> Iterator[Started | Ended]:
        """Yield events as they come, until all jobs have ended.

        Raises
        ------
        Interrupted
            After `interrupt`, when the present job has ended.
        """
        while self._waiting:
            if self._interrupted:
                raise Interrupted
            job = self._waiting.popleft()
            yield Started(job.key)
            yield Ended(job.key, *run_job(self._function, job.payload))

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        self._interrupted = True

    def stop(self) -> Iterator[Ended]:
        """Yield nothing: no job runs while nobody waits for it."""
        return iter(())

    def close(self) -> None:
        """Forget the jobs that wait."""
        self._waiting.clear()


def serve(
    connection: Connection, function: Callable[[Any], Any], prepare: Callable[[], None] | None
) -> None:
    """Run jobs as they come, and send back a pair of result and `Failure` of each, one of them None.

    Ctrl-C in a terminal reaches all processes of a program; the one that started this acts on it. SIGTERM
    ends the process, if ``prepare`` has given it a handler after the state of the job is kept.

    Parameters
    ----------
    connection : Connection
        Gives payloads.
    function : callable
        Of a payload; makes the result.
    prepare : callable, optional
        Called once before the first job.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        if prepare is not None:
            prepare()
        connection.send(READY)
        while True:
            _send(connection, run_job(function, connection.recv()))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # nobody is there any more
    except KeyboardInterrupt:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.raise_signal(signal.SIGTERM)


def run_job(function: Callable[[Any], Any], payload: Any) -> Reply:
    """Return the value of a function of a payload, and why it has none: one of them is None."""
    try:
        return function(payload), None
    except MemoryError as error:
        return None, Failure("memory", f"not enough memory {error}".strip())
    except Exception as error:
        return None, Failure("error", f"{type(error).__name__}: {error}", traceback.format_exc())


def _send(connection: Connection, reply: Reply) -> None:
    try:
        connection.send(reply)
    except (TypeError, AttributeError, ValueError) as error:  # the result cannot be sent
        connection.send(
            (None, Failure("error", f"{type(error).__name__}: {error}", traceback.format_exc()))
        )


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _not_started(reason: str) -> AccelsurfError:
    return AccelsurfError(
        f"worker processes cannot be started ({reason})", "is there memory left? try fewer jobs"
    )


def _death(process: SpawnProcess) -> str:
    """Say how a process has ended."""
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
    """Bytes of memory that a process has now; 0 where it is gone."""
    with suppress(psutil.Error):
        return int(psutil.Process(pid).memory_info().rss)
    return 0


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
