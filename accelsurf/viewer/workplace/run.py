"""Run, pause, go back and forward, undo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.viewer.core.status import Status
from accelsurf.viewer.workplace.checks import whole
from accelsurf.viewer.workplace.feature import Feature, Key


class RunFeature(Feature):
    """Steers the run of the session."""

    def requests(self) -> Mapping[str, Callable[..., None]]:
        session, ask = self.workplace.session, self.workplace.ask
        return {
            "play": lambda: ask(session.play()),
            "pause": lambda: ask(session.pause()),
            "toggle": self._toggle,
            "step": lambda: ask(session.single_step()),
            "back": self._back,
            "go_to": lambda step: ask(session.go_to(whole(step, 0, 10**9))),
            "restart": lambda: ask(session.restart()),
            "undo": lambda: ask(session.undo()),
            "redo": lambda: ask(session.redo()),
        }

    def keys(self) -> Mapping[str, Key]:
        return {
            "Space": Key("toggle", (), "run, pause"),
            "Right": Key("step", (), "one step"),
            "Left": Key("back", (), "back one step"),
            "Home": Key("restart", (), "restart with the settings in force"),
            "Ctrl+Z": Key("undo", (), "undo the last change"),
            "Ctrl+Shift+Z": Key("redo", (), "make the undone change again"),
        }

    def state(self, status: Status) -> dict[str, Any]:
        return {
            "ready": status.ready, "playing": status.playing, "state_word": status.word,
            "step": status.step, "last": max((status.step, *status.checkpoints)),
            "undoable": status.undoable, "redoable": status.redoable, "edits": len(status.edits),
            "checkpoints": list(status.checkpoints),
        }

    def _toggle(self) -> None:
        session = self.workplace.session
        self.workplace.ask(session.pause() if session.status.playing else session.play())

    def _back(self) -> None:
        session = self.workplace.session
        if session.status.step > 0:
            self.workplace.ask(session.go_to(session.status.step - 1))
