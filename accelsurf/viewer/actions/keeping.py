"""Keeps settings and clicks of the open image while they are not saved: nothing that ends the program loses them."""

from __future__ import annotations

import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.core.command_queue import in_background
from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.unsaved import Unsaved, UnsavedSessions, fingerprint

#: Seconds between two notes of a run that moves on; a click is noted at once.
SECONDS = 5.0
#: Seconds that the program's end waits for the fingerprint of an image.
_FINGERPRINT_SECONDS = 60.0


class Keeper:
    """Keeps one image's session, and finds the earlier one of it.

    Parameters
    ----------
    sessions : UnsavedSessions
    actions : Actions
        Of the image that is open.
    opened : OpenedImage
    """

    def __init__(self, sessions: UnsavedSessions, actions: Actions, opened: OpenedImage) -> None:
        self._sessions = sessions
        self._actions = actions
        self.opened = opened
        earlier = opened.unsaved
        self._file: Path | None = None if earlier is None else earlier.file
        #: Content of the file: configuration, corrections, step.
        self._stored: tuple[Any, ...] = ()
        self._next_time = 0.0
        self._image: Future[str] | None = None
        #: The steps of the earlier session are being made again: until then its file has more than this session.
        self._repeats = earlier is not None
        self._has_looked = earlier is not None
        #: Why nothing can be kept; empty while it can.
        self.trouble = ""
        if earlier is not None:
            self._image = Future()
            self._image.set_result(earlier.image)
            self._write(earlier.config, earlier.step)

    @property
    def is_stored(self) -> bool:
        """Test if there is something of this session to go on with."""
        return self._file is not None and not self.trouble

    def store(self, at_once: bool = False) -> None:
        """Note unsaved changes; forget saved ones.

        Parameters
        ----------
        at_once : bool
            The program ends: also a step is noted that is newer than the last note.
        """
        session = self._actions.session
        status = session.status
        if not self._sessions.keeps or not status.ready or status.config is None:
            return
        if self._repeats and not (session.wait(0.0) or status.undoable):
            return
        self._repeats = False
        if not self._actions.feature(FilesFeature).is_unsaved:
            self.forget()
            return
        content = (
            status.config,
            status.refinements,
            status.step if status.stop is None else -1,
        )
        is_step = content[:2] == self._stored[:2]
        if content == self._stored or (
            is_step and time.monotonic() < self._next_time and not at_once
        ):
            return
        if not self._fingerprint().done() and not at_once:
            return
        # A run that had gone on beyond its last step does so again; one that has ended ends there.
        steps = max(status.config.max_steps, status.step + (status.stop is None))
        config = status.config.replace(refine=status.refinements, max_steps=steps)
        self._stored, self._next_time = content, time.monotonic() + SECONDS
        self._write(config, content[2])

    def _write(self, config: Any, step: int) -> None:
        try:
            file = self._file or self._sessions.new_file()
            image = self._fingerprint().result(_FINGERPRINT_SECONDS)
            opened = self.opened
            self._sessions.store(file, image, opened.name, opened.source, config, step)
            self._file = file
        except (OSError, TimeoutError, UnicodeError) as error:
            if not self.trouble:
                self.trouble = f"unsaved clicks cannot be kept for the next start ({error})"
                self._actions.note(self.trouble, 30.0)

    def _fingerprint(self) -> Future[str]:
        if self._image is None:
            volume, channels = self.opened.volume, self.opened.channels
            self._image = in_background(
                lambda: fingerprint(volume, channels), "accelsurf fingerprint"
            )
        return self._image

    def found(self) -> Unsaved | None:
        """Return the newest session of this image that was not saved, once; None where there is none, or not yet."""
        if self._has_looked or not self._sessions.keeps:
            return None
        if self._image is None and self._sessions.is_empty():
            self._has_looked = True
            return None
        if not self._fingerprint().done():
            return None
        self._has_looked = True
        return self._sessions.of_image(self._fingerprint().result())

    def look_again(self) -> None:
        """Let `found` return one more."""
        self._has_looked = False

    def forget(self) -> None:
        """Keep nothing of this session."""
        if self._file is not None:
            self._sessions.forget(self._file)
        self._file, self._stored = None, ()
