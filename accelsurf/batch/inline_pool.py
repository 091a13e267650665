"""Jobs in this process, one after the other: the same interface as worker processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from accelsurf.batch.pool import Ended, Interrupted, Job, Started
from accelsurf.batch.worker import done


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
            yield Ended(job.key, *done(self._function, job.payload))

    def interrupt(self) -> None:
        """Let `events` raise `Interrupted` soon; the only method that another thread may call."""
        self._interrupted = True

    def close(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
