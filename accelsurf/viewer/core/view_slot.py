"""The newest view, passed from the solver's thread to the one that draws, and how often one is made."""

from __future__ import annotations

import threading
import time

from accelsurf.viewer.core.status import View

#: Frames per second at most, and the share of the time that making and drawing them may take while the run plays.
FRAME_RATE, DRAWING_SHARE = 15.0, 0.06


class ViewSlot:
    """Contains at most one view. One is made only when it was asked for, and not too often while the run plays."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._view: View | None = None
        self._wanted = False
        self._version = -1
        self._next_time, self._drawing_seconds = 0.0, 0.0

    @property
    def version(self) -> int:
        """Version of the state that the last view shows; -1 before the first."""
        return self._version

    def fetch(self, drawing_seconds: float) -> View | None:
        """Take the view out, or None, and ask for the next; ``drawing_seconds`` is what the last took to draw."""
        if drawing_seconds:
            self._drawing_seconds = drawing_seconds
        with self._lock:
            view, self._view = self._view, None
            self._wanted = True
        return view

    def is_due(self, version: int, playing: bool) -> bool:
        """Whether a view of this version of the state is to be made now."""
        return self._wanted and self._version != version and (not playing or time.perf_counter() >= self._next_time)

    def put(self, view: View, version: int, seconds: float) -> None:
        """Put a view of a version of the state there; ``seconds`` is what it took to make."""
        with self._lock:
            self._view, self._wanted, self._version = view, False, version
        pause = max(1.0 / FRAME_RATE, (seconds + self._drawing_seconds) / DRAWING_SHARE)
        self._next_time = time.perf_counter() - seconds + pause

    def refuse(self) -> None:
        """No view can be made of this state: make none until `fetch` asks again."""
        self._wanted = False
