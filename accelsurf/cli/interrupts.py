"""What SIGINT (Ctrl-C) and SIGTERM do: at each moment a line, an exit code, and files that belong together."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

#: Signals that end a program on request; their exit code is 128 more than their number.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_AGAIN_SECONDS = 0.05


class Interrupts:
    """The handler of both signals while a command runs.

    A signal raises KeyboardInterrupt, so that drafts are removed and the earlier result stays. While there is a result
    to save (`patience`), a first Ctrl-C only asks the run to stop; the second raises.

    Attributes
    ----------
    count : int
        Signals that came, whether or not their exception was swallowed on its way.
    number : int
        The first of them.
    outcome : str
        What of the run is on the disk, for the last line that is printed.
    """

    def __init__(self) -> None:
        self.count = 0
        self.number: int = signal.SIGINT
        self.outcome = "no result is written; what was there before is as it was"
        self._question: str | None = None
        self._was_patient = False  # a first signal may have been answered with a question
        self._ending = False
        self._reported = False
        self._replaced: dict[int, Any] = {}
        self._hooks: list[Any] = []  # what Python did with exceptions that it cannot raise

    @classmethod
    def current(cls) -> Interrupts:
        """The one at work, or where there is none one that no signal reaches."""
        handler = signal.getsignal(signal.SIGINT)
        return handler if isinstance(handler, cls) else cls()

    def install(self) -> None:
        """Handle both signals from now on; the main thread only.

        Also where a shell has started the program in the background and lets it ignore SIGINT: whoever sends one
        means it.
        """
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                self._replaced[number] = signal.signal(number, self)
            if not self._hooks:
                self._hooks.append(sys.unraisablehook)
                sys.unraisablehook = self._raise_again

    def uninstall(self) -> None:
        """Give the signals back to whoever had them."""
        while self._replaced:
            number, handler = self._replaced.popitem()
            signal.signal(number, handler)
            if handler is not self and self._hooks:
                sys.unraisablehook = self._hooks.pop()

    def _raise_again(self, lost: Any) -> None:
        """Raise KeyboardInterrupt a little later where Python cannot: in a callback of compiled code, say."""
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = threading.Timer(_AGAIN_SECONDS, _thread.interrupt_main)
            again.daemon = True
            again.start()
        else:
            self._hooks[-1](lost)

    def __call__(self, number: int, frame: FrameType | None = None) -> None:
        """Take note of a signal; raise KeyboardInterrupt unless it only asks."""
        self.number = self.number if self.count else number
        self.count += 1
        if self._ending:
            return
        if number == signal.SIGINT and self.count == 1 and self._question is not None:
            say(f"interrupted: {self._question} (press again to quit without it)")
            return
        raise KeyboardInterrupt

    @contextmanager
    def patience(self, question: str) -> Iterator[None]:
        """While this lasts, a first Ctrl-C is answered with a line and remembered; raises for one that was lost.

        Parameters
        ----------
        question : str
            What is finished first, for that line.
        """
        before, self._question = self._question, question
        try:
            if self.count and not self._was_patient:
                raise KeyboardInterrupt  # a library has swallowed the one before
            self._was_patient = True
            yield
            self.check()
        finally:
            self._question = before

    def check(self) -> None:
        """Raise KeyboardInterrupt again when a second signal came and its exception was swallowed."""
        if self.count > 1:
            raise KeyboardInterrupt

    def report(self, kind: str = "") -> None:
        """Print what is on the disk, once, if there was a signal.

        Parameters
        ----------
        kind : str, optional
            First words of the line, such as "error: ".
        """
        if self.count and not self._reported:
            self._reported = True
            say(f"{kind}interrupted: {self.outcome}")

    def end(self) -> None:
        """From now on signals are counted only: the program is about to end."""
        self._ending = True

    def exit_code(self, code: int) -> int:
        """What the program returns: 128 more than the number of the signal, if there was one."""
        return 128 + self.number if self.count else code


@contextmanager
def default_handling() -> Iterator[None]:
    """Give Ctrl-C back to Python: for an event loop that has a way of its own to end."""
    before = signal.getsignal(signal.SIGINT)
    if not isinstance(before, Interrupts):
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def say(line: str) -> None:
    """Write a line to stderr also where print cannot: in a signal handler, or when stderr is closed."""
    if sys.stderr is None:
        return
    try:
        print(line, file=sys.stderr, flush=True)
    except RuntimeError:  # the main program is writing to it at this moment
        with suppress(OSError):
            os.write(2, f"{line}\n".encode(errors="replace"))
    except (OSError, ValueError):  # nobody reads it
        return
