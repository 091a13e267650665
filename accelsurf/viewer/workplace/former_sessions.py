"""Sessions of images that were open before another was opened in their place."""

from __future__ import annotations

from accelsurf.viewer.core.session import Session
from accelsurf.viewer.workplace.files import FilesFeature
from accelsurf.viewer.workplace.workplace import Workplace

#: Seconds that a session has at the end of the program to end its step, and to finish a save.
STEP_SECONDS, SAVING_SECONDS = 10.0, 600.0


class FormerSessions:
    """Ends sessions without waiting for them; at the end of the program they finish what was asked of them."""

    def __init__(self) -> None:
        self._sessions: list[tuple[Session, float]] = []

    def add(self, workplace: Workplace) -> None:
        """End the session of a workplace that is left."""
        is_saving = workplace.feature(FilesFeature).is_saving
        workplace.session.close(0.0)
        self._sessions = [one for one in self._sessions if one[0].is_alive]
        self._sessions.append((workplace.session, SAVING_SECONDS if is_saving else STEP_SECONDS))

    def close(self) -> None:
        """Wait until they have ended."""
        for session, seconds in self._sessions:
            session.close(seconds)
