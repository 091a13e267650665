"""Answers to the first click: outlines of the others in the slices, and keys to take one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from accelsurf.viewer.actions.frames import FramesFeature
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, whole
from accelsurf.viewer.core.status import Status

if TYPE_CHECKING:
    from accelsurf.viewer.core.first_answers import FirstAnswer

#: The key of each answer, by its number; 1 and 2 change the tiles.
KEYS = {1: "7", 2: "8", 3: "9"}
_WORDS = {
    1: "show the likeliest answer to the first click",
    2: "show a part of that",
    3: "show all that is alike and connected",
}


class AnswersFeature(Feature):
    """Offers other meanings of the first click."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        #: Those whose outlines are drawn, and those whose outlines the person wants to see no longer.
        self._drawn: tuple[FirstAnswer, ...] = ()
        self._hidden: tuple[FirstAnswer, ...] = ()

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"take_answer": self._begin_with}

    def keys(self) -> Mapping[str, Key]:
        return {key: Key("take_answer", (number,), _WORDS[number]) for number, key in KEYS.items()}

    def state(self, status: Status) -> dict[str, Any]:
        answers = status.answers if self.actions.feature(FramesFeature).shows_run else ()
        drawn = () if answers == self._hidden else answers
        if drawn != self._drawn:
            self._drawn = drawn
            self.actions.scene.marks.show_answers(
                [answer.surface for answer in drawn if answer.surface is not None]
            )
        return {
            "first_answers": [
                {
                    "number": answer.number,
                    "key": KEYS[answer.number],
                    "volume": answer.size or "all alike",
                    "taken": answer.is_taken,
                }
                for answer in answers
            ]
        }

    def hide(self) -> None:
        """Draw the outlines no longer."""
        self._hidden = self._drawn

    def _begin_with(self, number: Any) -> None:
        self.actions.ask(self.actions.session.take_answer(whole(number, 1, max(KEYS))))
