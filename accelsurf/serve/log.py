"""The server's log: lines on standard error, for which no request waits."""

from __future__ import annotations

import os
import queue
import threading

#: Lines that wait to be written; more are dropped, as when nobody reads them.
MAX_WAITING = 1000
#: Seconds that the end waits for them.
SECONDS = 1.0
_STDERR = 2


class Log:
    """Writes lines in a thread of its own: a pipe that nobody reads would hold up the server."""

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._write_all, name="accelsurf log", daemon=True)
        self._thread.start()

    def write(self, line: str) -> None:
        """Have a line written, unless too many wait."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            return

    def close(self) -> None:
        """Write the waiting lines, if that can be done at once."""
        try:
            self._lines.put(None, timeout=SECONDS)
        except queue.Full:
            return
        self._thread.join(SECONDS)

    def _write_all(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                os.write(_STDERR, f"{line}\n".encode(errors="replace"))
            except OSError:  # it is closed
                return
