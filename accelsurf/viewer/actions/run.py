"""Run, pause, go back and forward, undo; the list of changes, and uncertain locations to click at next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.viewer.actions.slices import SlicesFeature
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, whole
from accelsurf.viewer.core.status import Status, UncertainLocation
from accelsurf.viewer.scene.legend import caption


class RunFeature(Feature):
    """Steers the run of the session."""

    def requests(self) -> Mapping[str, Callable[..., None]]:
        session, ask = self.actions.session, self.actions.ask
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
            "ready": status.ready,
            "playing": status.playing,
            "state_word": status.word,
            "has_begun": status.has_begun,
            "can_run": status.has_begun and status.settings.labels is None,
            "is_due": status.stop
            is None,  # one that has ended may go on, but nobody need wait for that
            "step": status.step,
            "last": max((status.step, *status.checkpoints)),
            "undoable": status.undoable,
            "redoable": status.redoable,
            "edits": len(status.edits),
            "checkpoints": list(status.checkpoints),
        }

    def _toggle(self) -> None:
        session = self.actions.session
        self.actions.ask(session.pause() if session.status.playing else session.play())

    def _back(self) -> None:
        session = self.actions.session
        if session.status.step > 0:
            self.actions.ask(session.go_to(session.status.step - 1))


class HistoryFeature(Feature):
    """Goes back and forward over changes, and to uncertain locations."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._uncertain: tuple[UncertainLocation, ...] = ()
        #: Which of them N went to last.
        self._at = -1

    def requests(self) -> Mapping[str, Callable[..., None]]:
        session, ask = self.actions.session, self.actions.ask
        return {
            "change": lambda count: ask(session.go_to_change(whole(count, 0, 10**6))),
            "next_uncertain": self._next_uncertain,
            "uncertain": lambda number: self._go_to(
                whole(number, 1, max(len(self._uncertain), 1)) - 1
            ),
        }

    def keys(self) -> Mapping[str, Key]:
        return {"N": Key("next_uncertain", (), "where to click next, once more: the next place")}

    def state(self, status: Status) -> dict[str, Any]:
        if status.uncertain != self._uncertain:
            self._uncertain, self._at = status.uncertain, -1
            self.actions.scene.marks.show_places([location.world for location in self._uncertain])
        return {
            "result": self._result(status),
            "changes": [change._asdict() for change in status.changes],
            "rests": list(status.plateaus),
            "uncertain": [
                {
                    "place": ", ".join(f"{v:.4g}" for v in location.world),
                    "percent": round(100.0 * location.share),
                }
                for location in status.uncertain
            ],
            "uncertain_at": self._at + 1,
        }

    def _result(self, status: Status) -> list[str]:
        """Return lines about the objects: volume, how likely each is good, where it is doubtful most."""
        scene = self.actions.scene
        if scene.frame is None or not status.has_begun:
            return []
        lines = caption(scene.frame, scene.geometry, scene.unit)[1:]
        for object_id, likely in status.likelihoods.items():
            whose = f"object {object_id}: " if len(status.likelihoods) > 1 else ""
            lines.append(f"{whose}{likely}")
        if status.uncertain:
            place, share = status.uncertain[0].world, status.uncertain[0].share
            where = self.actions.feature(SlicesFeature).shown(place)
            lines.append(f"most doubtful at {where} ({100.0 * share:.0f}\N{NO-BREAK SPACE}% doubt)")
        return lines

    def _next_uncertain(self) -> None:
        """Go to the most uncertain location, and from there to the next.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._uncertain:
            ended = self.actions.session.status.stop is not None
            raise UsageError(
                "no place is in doubt"
                if ended
                else "where to click next is known when the run has ended"
            )
        self._go_to((self._at + 1) % len(self._uncertain))

    def _go_to(self, number: int) -> None:
        if not number < len(self._uncertain):
            raise UsageError("no place is in doubt")
        self._at, location = number, self._uncertain[number]
        self.actions.scene.cursor = location.world
        place = f"place {number + 1} of {len(self._uncertain)}"
        self.actions.note(f"{place}, {100.0 * location.share:.0f} % doubt: click inside or outside")
