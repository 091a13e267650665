"""What the user has changed, change by change, to be undone and made again; and the edits that changes make."""

from __future__ import annotations

from typing import Any, NamedTuple

from accelsurf.errors import UsageError
from accelsurf.settings.edits import Edit
from accelsurf.settings.refinements import Refinement
from accelsurf.settings.run_config import RunConfig


class Moment(NamedTuple):
    """What is in force before a change: settings and corrections, and the ``step`` at which the change is made."""

    config: RunConfig
    step: int
    refinements: tuple[Refinement, ...]


class ChangeLog:
    """Past changes, and those that were undone since the last one."""

    def __init__(self) -> None:
        self._before: list[Moment] = []
        self._undone: list[Moment] = []

    @property
    def undoable(self) -> int:
        """How many changes can be undone."""
        return len(self._before)

    @property
    def redoable(self) -> int:
        """How many undone changes can be made again."""
        return len(self._undone)

    def add(self, before: Moment, joined: bool = False) -> None:
        """Note what was in force before a change that has been made; what was undone is forgotten.

        One that is ``joined``, a further ball of a stroke, is undone together with the change before it.
        """
        if not (joined and self._before and not self._undone):
            self._before.append(before)
        self._undone.clear()

    def undo(self, now: Moment) -> Moment:
        """Return what was in force before the last change, which is undone now.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._before:
            raise UsageError("there is no change to undo")
        before = self._before.pop()
        self._undone.append(now._replace(step=before.step))
        return before

    def redo(self, now: Moment) -> Moment:
        """Return what was in force after the change that was undone last, which is made again now.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._undone:
            raise UsageError("there is no undone change to make again")
        after = self._undone.pop()
        self._before.append(now._replace(step=after.step))
        return after


def edits_with(config: RunConfig, edits: tuple[Edit, ...], step: int, settings: dict[str, Any]) -> tuple[Edit, ...]:
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
    is_open = edits and edits[-1].step == step and not (edits[-1].balls or edits[-1].has_clicks)
    last = edits[-1] if is_open else None
    earlier = edits if last is None else edits[:-1]
    config.replace(edit=(*earlier, Edit(step=step, **settings)))
    before = config.replace(edit=earlier).at(step)
    after = before.replace(**{**(last.settings if last else {}), **settings})
    changed = {
        key: getattr(after, key) for key in RunConfig.model_fields if getattr(after, key) != getattr(before, key)
    }
    # An edit without settings makes a converged run continue.
    continues = last is not None and not last.settings
    return (*earlier, Edit(step=step, **changed)) if changed or continues else earlier
