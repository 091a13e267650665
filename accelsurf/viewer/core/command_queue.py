"""Commands from any thread, carried out one by one in another."""

from __future__ import annotations

import contextvars
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, NamedTuple, TypeVar


class Command(NamedTuple):
    """A function to be called by the thread, and the Future that gets its result."""

    work: Callable[..., Any]
    future: Future[Any]


class CommandQueue:
    """A queue of commands, and a condition to wait for its end.

    The thread that carries them out calls `next` and, after each command, `done`; any thread may call the others.
    """

    def __init__(self) -> None:
        #: None only wakes the thread up.
        self._queue: queue.SimpleQueue[Command | None] = queue.SimpleQueue()
        self._condition = threading.Condition()
        self._pending, self._closing = 0, False

    @property
    def pending(self) -> int:
        """Commands that have not been carried out yet."""
        return self._pending

    @property
    def is_empty(self) -> bool:
        """True if nothing waits to be taken out."""
        return self._queue.empty()

    @property
    def is_closed(self) -> bool:
        """True if `close` was called and all commands before that were taken out."""
        return self._closing and self._queue.empty()

    def put(self, work: Callable[..., Any]) -> Future[Any]:
        """Add a command; the Future gets its result or its error."""
        future: Future[Any] = Future()
        with self._condition:
            self._pending += 1
        self._queue.put(Command(work, future))
        return future

    def wake(self) -> None:
        """Let `next` return."""
        self._queue.put(None)

    def close(self) -> None:
        """Let the queue be closed after the commands that are in it."""
        self._closing = True
        self._queue.put(None)

    def next(self, block: bool, timeout: float | None = None) -> Command | None:
        """Take out the next command; None when there is none, or to wake the thread up.

        Parameters
        ----------
        block : bool
            Wait for a command, or for `wake` or `close`.
        timeout : float, optional
            Longest wait, seconds.
        """
        try:
            return self._queue.get(block=block, timeout=timeout)
        except queue.Empty:
            return None

    def done(self) -> None:
        """A command that was taken out has been carried out."""
        with self._condition:
            self._pending -= 1

    def abandon(self) -> None:
        """Cancel the commands that are left; no more will be carried out."""
        while not self._queue.empty():
            command = self._queue.get()
            if command is not None:
                command.future.cancel()
        with self._condition:
            self._pending = 0
            self._condition.notify_all()

    def notify(self) -> None:
        """Let waiting threads check their condition again."""
        with self._condition:
            self._condition.notify_all()

    def wait_for(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        """Wait until a condition is true, looked at after each `notify`; False when the time was not enough."""
        with self._condition:
            return self._condition.wait_for(condition, timeout)


T = TypeVar("T")


def in_background(work: Callable[[], T], name: str) -> Future[T]:
    """Begin work in a thread that ends with the process.

    Parameters
    ----------
    work : callable
        Sees the variables of the present context.
    name : str
        Of the thread.

    Returns
    -------
    Future
        Has the result, or the error.

    Examples
    --------
    >>> in_background(lambda: 6 * 7, "example").result()
    42
    """
    future: Future[T] = Future()
    context = contextvars.copy_context()

    def carry_out() -> None:
        try:
            future.set_result(context.run(work))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=carry_out, name=name, daemon=True).start()
    return future
