"""What a worker process does: one job after another, until it is told to end or whoever started it is gone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

#: What a worker sends when it can take a job.
READY = "ready"


class Failure(NamedTuple):
    """Why a job has no result.

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


def serve(connection: Connection, function: Callable[[Any], Any], prepare: Callable[[], None] | None) -> None:
    """Run jobs as they come, and send back a pair of result and `Failure` of each, one of them None.

    Ctrl-C in a terminal reaches all processes of a program; what it means is for the one that started this.

    Parameters
    ----------
    connection : Connection
        Gives payloads, and None at the end.
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
        while (job := connection.recv()) is not None:
            _send(connection, done(function, job[0]))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # nobody is there any more


def done(function: Callable[[Any], Any], payload: Any) -> tuple[Any, Failure | None]:
    """Return what a function makes of a payload, and why it makes nothing: one of them is None."""
    try:
        return function(payload), None
    except MemoryError as error:
        return None, Failure("memory", f"not enough memory {error}".strip())
    except Exception as error:
        return None, Failure("error", f"{type(error).__name__}: {error}", traceback.format_exc())


def _send(connection: Connection, reply: tuple[Any, Failure | None]) -> None:
    try:
        connection.send(reply)
    except (TypeError, AttributeError, ValueError) as error:  # the result cannot be sent
        connection.send((None, Failure("error", f"{type(error).__name__}: {error}", traceback.format_exc())))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
