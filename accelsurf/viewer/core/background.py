"""Work in a thread of its own, with what the caller's context allows."""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def in_background(work: Callable[[], T], name: str) -> Future[T]:
    """Begin work in a thread that ends with the process.

    Parameters
    ----------
    work : callable
        Sees the variables of the present context: `accelsurf.io.headers.outside_data_allowed` holds in it.
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
