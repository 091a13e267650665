"""Jobs on a Dask cluster: the same interface as worker processes of this machine, and no scheduler of our own.

The cluster decides where and when each job runs, how much memory a worker may have, and how often the job of a lost
worker is run again elsewhere (its setting ``distributed.scheduler.allowed-failures``).
"""

from __future__ import annotations

import contextlib
import os
import threading
import uuid
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.batch.pool import Ended, Failure, Interrupted, Job, Started, run_job
from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.version import __version__

if TYPE_CHECKING:
    from distributed import Client, Future

#: Seconds that a scheduler has to answer.
CONNECT_SECONDS = 30
_INSTALL = "install it with: pip install 'accelsurf[dask]'"
_WHERE = "give its address, such as tcp://host:8786, or its scheduler file"
_ONE_THREAD = (
    "start the workers with --nthreads 1: as many of them as there are cores, in place of threads"
)


class DaskPool:
    """The workers of a Dask cluster.

    Parameters
    ----------
    function : callable
        Of a payload, of a module's top level: workers import it by its name, so that accelsurf must be installed there.
    address : str
        Of the scheduler, as ``tcp://host:8786``; or the path of its scheduler file.

    Raises
    ------
    UsageError
        When the package ``distributed`` is missing, no scheduler answers, or workers have several threads.
    """

    def __init__(self, function: Callable[[Any], Any], address: str) -> None:
        self._function = function
        self._client = _connected(address)
        self._name = f"accelsurf-{uuid.uuid4().hex[:12]}"
        self._futures: dict[str, Future[Any]] = {}
        self._new: list[Job] = []
        self._interrupted = threading.Event()
        try:
            for place, worker in self._client.scheduler_info(n_workers=-1)["workers"].items():
                _refuse_threads(place, worker["nthreads"])
        except BaseException:
            self.close()
            raise

    def submit(self, job: Job) -> None:
        """Add a job."""
        self._new.append(job)

    def events(self) -> Iterator[Started | Ended]:
        """Yield events as they come, until all jobs have ended; a job counts as started when the cluster has it.

        Raises
        ------
        AccelsurfError
            When the cluster is gone.
        Interrupted
            After `interrupt`.
        """
        from distributed import CancelledError, as_completed

        for job in self._new:
            key = f"{self._name}-{job.key}"
            what = (self._function, job.payload, os.getcwd(), __version__)
            self._futures[key] = self._client.submit(_call, *what, key=key, pure=False)
            yield Started(job.key)
        self._new.clear()
        for future in as_completed(
            list(self._futures.values()), loop=self._client.loop, raise_errors=False
        ):
            if self._interrupted.is_set():
                raise Interrupted
            if future.status == "cancelled" or isinstance(future.exception(), CancelledError):
                raise AccelsurfError(
                    "the scheduler is gone", "see its log; the same command with --resume goes on"
                )
            yield _ended(future, future.key.removeprefix(f"{self._name}-"))
            del self._futures[future.key]

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        self._interrupted.set()
        self._client.cancel(list(self._futures.values()), force=True)

    def stop(self) -> Iterator[Ended]:
        """Yield nothing: a worker finishes the case that it has begun."""
        return iter(())

    def close(self) -> None:
        """Take back the jobs that still wait, and leave the cluster as it is."""
        if self._futures:
            self._client.cancel(list(self._futures.values()), force=True)
            self._futures.clear()
        self._client.close()


def _connected(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(
            f"scheduler: the package distributed is missing ({error})", _INSTALL
        ) from None
    is_file = Path(address).is_file()
    if not is_file and ":" not in address:  # the client would wait for the file
        raise UsageError(f"scheduler: {address} is no file and no address", _WHERE)
    where = {"scheduler_file": address} if is_file else {"address": address}
    try:
        return Client(**where, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # a timeout is an OSError
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"scheduler: {address} does not answer ({reason})", _WHERE) from None


def _refuse_threads(place: str, count: int) -> None:
    """Refuse a worker that would run two cases in one process.

    Raises
    ------
    UsageError
    """
    if count != 1:
        raise UsageError(
            f"scheduler: the worker {place} has {count} threads, expected one", _ONE_THREAD
        )


def _call(
    function: Callable[[Any], Any], payload: Any, folder: str, version: str
) -> tuple[Any, Failure | None]:
    """Call the function in a folder, on a worker; fail where the accelsurf of the worker is another version."""
    from distributed import get_worker

    worker = get_worker()
    try:
        if version != __version__:
            raise UsageError(
                f"the worker {worker.address} has accelsurf {__version__}, expected {version}",
                _INSTALL,
            )
        _refuse_threads(worker.address, worker.state.nthreads)  # one that came later
    except UsageError as error:
        return None, Failure("error", f"{error.message}; {error.hint}")
    return run_job(partial(_in_folder, folder, function), payload)


def _in_folder(folder: str, function: Callable[[Any], Any], payload: Any) -> Any:
    with contextlib.chdir(folder):
        return function(payload)


def _ended(future: Future[Any], key: str) -> Ended:
    """The end of a job, also of one whose workers were lost again and again."""
    from distributed import KilledWorker

    error = future.exception()
    if error is None:
        return Ended(key, *future.result())
    if isinstance(error, KilledWorker):
        text = f"its worker was lost, {error.allowed_failures + 1} times in all"
        return Ended(key, None, Failure("killed", text))
    return Ended(key, None, Failure("error", f"{type(error).__name__}: {error}"))
