"""To hear of it when a kernel is compiled, which takes seconds: those that are stored are only loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

_COMPILED = "numba:compile"


class _First(event.Listener):
    """Calls a function once, when the first compilation begins."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, event: Any) -> None:
        tell, self._tell = self._tell, None
        if tell is not None:
            tell()

    def on_end(self, event: Any) -> None:
        """Nothing is to be done."""


@contextmanager
def first_compilation(tell: Callable[[], None]) -> Iterator[None]:
    """Call ``tell`` before the first kernel that is compiled in this block, if any is.

    Parameters
    ----------
    tell : callable
        Called once at most, on the thread that compiles.
    """
    listener = _First(tell)
    event.register(_COMPILED, listener)
    try:
        yield
    finally:
        event.unregister(_COMPILED, listener)
