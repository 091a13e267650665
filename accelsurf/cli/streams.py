"""Standard output and error that cannot be written: a full disk, a reader that has gone, a stream that was closed.

What a command has computed and written to files does not depend on whether somebody can read what it prints.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any


class GuardedStream:
    """A text stream whose first error is remembered, and after which nothing more is written.

    Parameters
    ----------
    stream : file object

    Attributes
    ----------
    error : Exception or None
        The first error.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self.error: Exception | None = None

    def write(self, text: str) -> int:
        """Write text, unless there was an error before."""
        if self.error is None:
            try:
                self._stream.write(text)
            except (OSError, ValueError) as error:  # ValueError: it was closed
                self._fail(error)
        return len(text)

    def flush(self) -> None:
        """Write what is still in memory."""
        if self.error is None:
            try:
                self._stream.flush()
            except (OSError, ValueError) as error:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.error = error
        # What is left in its buffer would fail again when Python ends.
        with suppress(OSError, ValueError, io.UnsupportedOperation):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def open_missing() -> None:
    """Open streams that were closed before the program began on the null device.

    Else the next file that is opened would get their number, and what a library prints would land in it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number


@contextmanager
def guarded() -> Iterator[GuardedStream]:
    """Guard both streams; yields standard output."""
    before = sys.stdout, sys.stderr
    # A stream that was closed is None, and print would write to the other one.
    output, error = (
        GuardedStream(open(os.devnull, "w", encoding="utf-8") if stream is None else stream) for stream in before
    )
    sys.stdout, sys.stderr = output, error
    try:
        yield output
    finally:
        output.flush()
        error.flush()
        sys.stdout, sys.stderr = before
