"""Changes by the user, one by one, to be undone and made again; and the corrections that they make."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from accelsurf.errors import UsageError
from accelsurf.settings.corrections import Correction
from accelsurf.settings.edits import Edit
from accelsurf.settings.run_config import RunConfig


class Moment(NamedTuple):
    """Settings and corrections before a change, and the ``step`` at which the change is made."""

    config: RunConfig
    step: int
    refinements: tuple[Correction, ...]


class ChangeLine(NamedTuple):
    """A change as lists show it: its ``number`` from 1, the ``step`` at which it was made, its text in one ``line``,
    and whether it is in force (``done``), not undone.
    """

    number: int
    step: int
    line: str
    done: bool


class _Change(NamedTuple):
    """A change: its ``line``, and the ``moment`` before it; of one that was undone the moment after it."""

    line: str
    moment: Moment


class ChangeLog:
    """Past changes, and those that were undone since the last one."""

    def __init__(self) -> None:
        self._done: list[_Change] = []
        self._undone: list[_Change] = []
        self._lines: tuple[ChangeLine, ...] = ()

    @property
    def undoable(self) -> int:
        """Number of changes that can be undone."""
        return len(self._done)

    @property
    def redoable(self) -> int:
        """Number of undone changes that can be made again."""
        return len(self._undone)

    @property
    def lines(self) -> tuple[ChangeLine, ...]:
        """All changes in their order, those that are undone last; the same object until something changes."""
        return self._lines

    def add(self, before: Moment, line: str) -> None:
        """Note the moment before a change that has been made; undone changes are forgotten."""
        # A list has little room: four digits of each number are enough there.
        line = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.4g}", line)
        self._done.append(_Change(line, before))
        self._undone.clear()
        self._renew()

    def undo(self, now: Moment) -> Moment:
        """Return the moment before the last change, which is undone now.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._done:
            raise UsageError("there is no change to undo")
        return self.move_to(self.undoable - 1, now)

    def redo(self, now: Moment) -> Moment:
        """Return the moment after the change that was undone last, which is made again now.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._undone:
            raise UsageError("there is no undone change to make again")
        return self.move_to(self.undoable + 1, now)

    def move_to(self, count: int, now: Moment) -> Moment:
        """Return the moment with the first ``count`` changes in force, and later ones undone.

        Raises
        ------
        UsageError
            When there are fewer changes.
        """
        if not 0 <= count <= self.undoable + self.redoable:
            most = self.undoable + self.redoable
            raise UsageError(f"change {count} was given, expected a number from 0 to {most}")
        while self.undoable > count:
            change = self._done.pop()
            self._undone.append(_Change(change.line, now._replace(step=change.moment.step)))
            now = change.moment
        while self.undoable < count:
            change = self._undone.pop()
            self._done.append(_Change(change.line, now._replace(step=change.moment.step)))
            now = change.moment
        self._renew()
        return now

    def _renew(self) -> None:
        both = [
            *((change, True) for change in self._done),
            *((change, False) for change in reversed(self._undone)),
        ]
        self._lines = tuple(
            ChangeLine(number, change.moment.step, change.line, done)
            for number, (change, done) in enumerate(both, 1)
        )


def edits_with(
    config: RunConfig, edits: tuple[Edit, ...], step: int, settings: dict[str, Any]
) -> tuple[Edit, ...]:
    """Return edits with a change of settings at a step; several changes at one step are one edit.

    Parameters
    ----------
    config : RunConfig
        Of the run.
    edits : tuple of Edit
        Up to this step.
    step : int
    settings : dict

    Raises
    ------
    UsageError
        When a setting is not valid.
    """
    # As when a slider is dragged back and forth.
    last = edits[-1] if edits and edits[-1].step == step else None
    earlier = edits if last is None else edits[:-1]
    config.replace(edit=(*earlier, Edit(step=step, **settings)))
    before = config.replace(edit=earlier).at(step)
    after = before.replace(**{**(last.settings if last else {}), **settings})
    changed = differing(before, after)
    # An edit without settings makes a converged run continue.
    continues = last is not None and not last.settings
    return (*earlier, Edit(step=step, **changed)) if changed or continues else earlier


def differing(before: RunConfig, after: RunConfig) -> dict[str, Any]:
    """Return the settings that differ, with their later values.

    Examples
    --------
    >>> differing(RunConfig(), RunConfig(smoothness=0.5))
    {'smoothness': 0.5}
    """
    values = {key: getattr(after, key) for key in RunConfig.model_fields}
    return {key: value for key, value in values.items() if value != getattr(before, key)}


def in_words(settings: Mapping[str, Any]) -> str:
    """Return changed settings in words.

    Examples
    --------
    >>> in_words({"smoothness": 0.5, "flow": "gradient"})
    'smoothness 0.5, flow gradient'
    >>> in_words({"mesh": ("stl", "vtp"), "also": ()})
    'mesh stl,vtp, also none'
    """
    return ", ".join(f"{key} {_word(value)}" for key, value in settings.items())


def _word(value: Any) -> Any:
    return (",".join(map(str, value)) or "none") if isinstance(value, tuple | list) else value
