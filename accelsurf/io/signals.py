"""Work during which signals wait."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: Signals that end a program on request.
SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let both signals wait until the end of a short piece of work, such as some renames; then they act as before."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled in the main thread alone
        return
    waiting: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    python_ones = [signal.Signals(number) for number, handler in before.items() if callable(handler)]
    for number in python_ones:
        signal.signal(number, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        for number in python_ones:
            signal.signal(number, before[number])
        for came in waiting:
            signal.raise_signal(came)
