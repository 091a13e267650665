"""Edits: settings of a run that change while it runs, each before a step."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict
from pydantic.fields import FieldInfo

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.corrections import CORRECTION_KEYS, moment_of, words_of
from accelsurf.settings.entry import entry_of
from accelsurf.settings.wording import did_you_mean, shown

_FORM = "step=30 smoothness=0.5, or in TOML a table [[edit]] with step = 30 and so on"


class Edit(BaseModel):
    """Settings that change before a step of a run.

    Parameters
    ----------
    step : int
        Number of the step, as in the history; 0 is the start.
    **settings
        Fields of RunConfig that are in force from the step on, but for settings that are fixed while a run runs.

    Notes
    -----
    A step alone lets the run continue: the stop rule begins anew there.

    Examples
    --------
    >>> edit = Edit(step=30, smoothness=0.5)
    >>> edit.settings, str(edit)
    ({'smoothness': 0.5}, 'step=30 smoothness=0.5')
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    step: int

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that change."""
        return dict(self.model_extra or {})

    def __str__(self) -> str:
        return " ".join(f"{key}={shlex.quote(str(value))}" for key, value in self)


def edits_of(value: Any) -> tuple[Edit, ...]:
    """Read edits from the value of a configuration file, an option or an argument: tables, texts or edits.

    Parameters
    ----------
    value : anything
        One edit or several.

    Returns
    -------
    tuple of Edit
        By step.

    Raises
    ------
    UsageError
        When one is none, or has clicks or a ball: a correction ends the run.

    Examples
    --------
    >>> [str(edit) for edit in edits_of(["step=9 smoothness=2", {"step": 2, "cfl": 0.3}])]
    ['step=2 cfl=0.3', 'step=9 smoothness=2']
    """
    many = value if isinstance(value, (list, tuple)) else [value]
    budgets.EDITS.check(len(many), "edit", kind=UsageError)
    return tuple(sorted(map(_edit, many), key=lambda edit: edit.step))


#: The type of the setting.
Edits = Annotated[tuple[Edit, ...], BeforeValidator(edits_of)]


def _edit(value: Any) -> Edit:
    if isinstance(value, Edit):
        return value
    table = words_of(value, "edit", _FORM, "step=30") if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        raise UsageError(
            f"edit: {shown(value)} was given, expected a step and the settings that change before it",
            _FORM,
        )
    step = moment_of(table, "step", "edit", _FORM)
    for key in ("add", *CORRECTION_KEYS):
        if key in table:
            raise UsageError(
                f"edit at step {step}: {key} was given, and a surface that moves takes no correction",
                f"end the run there, then correct it: --max-steps {step} --end present --refine inside=WHERE",
            )
    return Edit(**{**table, "step": step})


def refuse_unknown(edit: Edit, known: Mapping[str, FieldInfo]) -> None:
    """Refuse settings that do not exist, or that cannot change while a run runs.

    Parameters
    ----------
    edit : Edit
    known : mapping
        Fields of `RunConfig` by name.

    Raises
    ------
    UsageError
        With the nearest setting that exists.
    """
    possible = [key for key, field in known.items() if not entry_of(field).fixed]
    for key in edit.settings:
        if key in possible:
            continue
        if key in known:
            raise UsageError(
                f"edit at step {edit.step}: {key} cannot change while a run runs",
                f"these can: {', '.join(possible)}",
            )
        raise UsageError(
            f"edit at step {edit.step}: {shown(key)}: there is no such setting",
            f"{did_you_mean(key, possible)}Valid are {', '.join(possible)}",
        )
