"""Signals and standard streams: SIGINT (Ctrl-C) and SIGTERM give a line, an exit code, and complete files.

Lines about errors and warnings are short, on one line, in characters that a terminal prints. The results and
files of a command do not depend on whether somebody can read its messages.
"""

from __future__ import annotations

import _thread
import errno
import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from accelsurf.errors import AccelsurfWarning
from accelsurf.settings.wording import escaped

#: Exit code after Ctrl-C.
INTERRUPTED = 130
#: Signals that end a program on request; their exit code is 128 more than their number.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_AGAIN_SECONDS = 0.05
#: Errors of a stream that nobody reads any more, or that has no space left.
_NOT_WRITTEN = (errno.EPIPE, errno.ENOSPC, errno.EIO, errno.EBADF)
#: Longest line of an error and of a hint, characters: most paths have room, a megabyte of garbage has not.
MAX_ERROR = 390
MAX_HINT = 1000


class Interrupts:
    """The handler of both signals while a command runs.

    A signal raises KeyboardInterrupt, so that staging files are removed and the earlier result stays. While there is
    something to save (`patience`), a first signal only asks the run to stop; the second raises.

    Attributes
    ----------
    count : int
        Signals that came, whether or not their exception was swallowed on its way.
    number : int
        The first of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.number: int = signal.SIGINT
        self._outcome = "no result is written; what was there before is as it was"
        self._question: str | None = None
        self._listener: Callable[[], None] | None = None
        self._usual: tuple[int, ...] = ()
        self._was_patient = False  # a first signal may have been answered with a question
        self._ending = False
        self._reported = False
        self._replaced: dict[int, Any] = {}
        self._hooks: list[Any] = []  # Python's hooks for exceptions that it cannot raise

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
            again.daemon = True  # Timer takes it in no other way
            again.start()
        else:
            self._hooks[-1](lost)

    def __call__(self, number: int, frame: FrameType | None = None) -> None:
        """Count a signal; raise KeyboardInterrupt unless it only asks."""
        if self._listener is not None and number in self._usual:
            self._listener()
            return
        self.number = self.number if self.count else number
        self.count += 1
        if self._ending:
            return
        if self._listener is not None:
            self._listener()
            return
        if self.count == 1 and self._question is not None:
            again = "press again" if number == signal.SIGINT else "a second signal"
            say(f"interrupted: {self._question} ({again} to quit at once)")
            return
        raise KeyboardInterrupt

    @contextmanager
    def patience(self, question: str) -> Iterator[None]:
        """While this lasts, a first signal is answered with a line and stored; raises for one that was lost.

        Parameters
        ----------
        question : str
            The work that is finished first, for that line.
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

    @contextmanager
    def calling(self, listener: Callable[[], None], usual: Sequence[int] = ()) -> Iterator[None]:
        """While this lasts, a signal calls a function and raises nothing: for a loop of events, which ends itself.

        Parameters
        ----------
        listener : callable
            Called within whatever the main thread does: it may note the signal, and no more.
        usual : sequence of int
            Signals that are the documented way to end: they are not counted, and no line tells of them.
        """
        self._listener, self._usual = listener, tuple(usual)
        try:
            yield
        finally:
            self._listener, self._usual = None, ()

    def check(self) -> None:
        """Raise KeyboardInterrupt again when a second signal came and its exception was swallowed."""
        if self.count > 1:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        """Keep a line about the files on the disk, for the last line that is printed."""
        self._outcome = text

    def report(self, kind: str = "") -> None:
        """Print the line about the files on the disk, once, if there was a signal.

        Parameters
        ----------
        kind : str, optional
            First words of the line, like "error: ".
        """
        if self.count and not self._reported:
            self._reported = True
            say(f"{kind}interrupted: {self._outcome}")

    def end(self) -> None:
        """From now on signals are counted only: the program is about to end."""
        self._ending = True

    def exit_code(self, code: int) -> int:
        """Return the exit code: 128 more than the number of the signal, if there was one."""
        return 128 + self.number if self.count else code


class WorkerInterrupts(Interrupts):
    """The handler of a worker process: further signals do nothing, as the process that started it can end it."""

    def __call__(self, number: int, frame: FrameType | None = None) -> None:
        """Take the first signal as `Interrupts` does."""
        if not self.count:
            super().__call__(number, frame)


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


def resuming_command() -> str:
    """Return the command line that resumes this one."""
    words = [word for word in sys.argv[1:] if word != "--resume"]
    return shlex.join(["accelsurf", *words, "--resume"])


def say(line: str) -> None:
    """Write a line to stderr also where a stream cannot: in a signal handler, or when nobody reads it."""
    try:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    except RuntimeError:  # the main program is writing to it at this moment
        with suppress(OSError):
            os.write(2, f"{line}\n".encode(errors="replace"))
    except (OSError, ValueError):  # nobody reads it
        return


def printable(text: str, length: int) -> str:
    """Return a text as one line that a terminal prints; if it is longer than ``length`` its middle is left out.

    Examples
    --------
    >>> printable("abc" + 100 * "x" + "yz", 20)
    'abcxxxxx...xxxxxxyz'
    """
    text = " ".join(text.split())
    for _ in range(2):  # escapes make it longer again
        if len(text) > length:
            text = text[: length // 2 - 2] + "..." + text[2 - length // 2 :]
        text = escaped(text)
    return text


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print each warning of accelsurf once, as a line; warnings of libraries go the usual way."""
    with warnings.catch_warnings():
        usual, seen = warnings.showwarning, set[str]()

        def show(message, category, *args, **kwargs):  # type: ignore[no-untyped-def]
            if not issubclass(category, AccelsurfWarning):
                usual(message, category, *args, **kwargs)
            elif str(message) not in seen:
                seen.add(str(message))
                say("warning: " + printable(str(message), MAX_HINT))

        warnings.simplefilter("always", AccelsurfWarning)
        warnings.showwarning = show  # the hook that Python documents for this
        yield


def open_missing() -> None:
    """Open streams that were closed before the program began on the null device.

    Else the next file that is opened would get their number, and the output of a library would land in it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
    # Python has made None of them, and print would write to the other one.
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")


def output_failure(error: BaseException) -> OSError | None:
    """Return an error of standard output, which has no file name as a file has; None of other errors."""
    is_output = isinstance(error, OSError) and error.filename is None
    return error if is_output and error.errno in _NOT_WRITTEN else None  # type: ignore[return-value, attr-defined]
