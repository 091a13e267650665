"""Changes of a run while it runs: settings, clicks, and balls added to or removed from an object, each before a step.

A run that a person changed by hand is repeated when its edits are given to it: viewer, command line and Python apply
them in one place, `accelsurf.segmentation.run.Run`.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, model_serializer
from pydantic.fields import FieldInfo

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.entry import entry_of
from accelsurf.settings.wording import did_you_mean, shown

_WHOLE = re.compile(r"[0-9]{1,18}")
_CLICKS = ("inside", "outside")
FORM = 'step=30 smoothness=0.5 add=ball:X,Y,Z,R, or in TOML a table [[edit]] with step = 30 and so on'


class Edit(BaseModel):
    """One change before a step.

    Parameters
    ----------
    step : int
        Number of the step, as in the history, before which it happens; 0 is the start.
    add, remove : str, optional
        A ball, ``ball:X,Y,Z,R`` as a start: added to the object, or removed from it.
    inside, outside : tuple of str, optional
        Clicks, as ``--inside`` and ``--outside`` take them; they hold from this step on.
    object : int, optional
        Id of the object that the ball or the clicks are for, where there are several; what one gains is taken from the
        others. 0 is no object.
    **settings
        Fields of RunConfig that are in force from this step on, but for those that are fixed while a run runs. A ball
        comes after them.

    Notes
    -----
    With neither, the run continues: the stop rule begins anew at this step.

    Examples
    --------
    >>> edit = Edit(step=30, smoothness=0.5, add="ball:10,10,10,4")
    >>> edit.settings, edit.balls
    ({'smoothness': 0.5}, (('add', 'ball:10,10,10,4'),))
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    step: int
    add: str | None = None
    remove: str | None = None
    inside: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    object: int | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that change."""
        return dict(self.model_extra or {})

    @property
    def balls(self) -> tuple[tuple[str, str], ...]:
        """("add" or "remove", ball), in the order in which they happen."""
        both = (("add", self.add), ("remove", self.remove))
        return tuple((kind, ball) for kind, ball in both if ball is not None)

    @property
    def has_clicks(self) -> bool:
        """Whether it has clicks."""
        return bool(self.inside or self.outside)

    @model_serializer
    def _table(self) -> dict[str, Any]:
        given = {"step": self.step, **self.settings, "add": self.add, "remove": self.remove}
        given |= {"inside": list(self.inside) or None, "outside": list(self.outside) or None, "object": self.object}
        return {key: value for key, value in given.items() if value is not None}

    def __str__(self) -> str:
        words = ((key, one) for key, value in self._table().items() for one in _each(value))
        return " ".join(f"{key}={shlex.quote(str(value))}" for key, value in words)


def _each(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else (value,)


def edits_of(value: Any) -> Any:
    """Return edits from the value of a configuration file, an option or an argument: tables, texts, or edits.

    Parameters
    ----------
    value : Edit, mapping, str, or a list or tuple of them

    Returns
    -------
    tuple of Edit
        By step; those of one step in the order given.

    Raises
    ------
    UsageError
        When one has no step or a negative one, or a ball is no text.

    Examples
    --------
    >>> [str(edit) for edit in edits_of(["step=9 flow=gradient", {"step": 3, "add": "ball:1,2,3,4"}])]
    ['step=3 add=ball:1,2,3,4', 'step=9 flow=gradient']
    """
    many = value if isinstance(value, (list, tuple)) else [value]
    budgets.EDITS.check(len(many), "edit", kind=UsageError)
    return tuple(sorted((_edit(one) for one in many), key=lambda edit: edit.step))


def _edit(value: Any) -> Edit:
    if isinstance(value, Edit):
        value = value.model_dump()
    table = _words(value) if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        raise UsageError(f"edit: {shown(value)} was given, expected a step and what changes before it", FORM)
    step = table.get("step")
    if isinstance(step, str) and _WHOLE.fullmatch(step):
        step = int(step)
    if not isinstance(step, int) or isinstance(step, bool) or step < 0:
        given = "no step" if step is None else f"step {shown(step)}"
        raise UsageError(f"edit: {given} was given, expected a whole number at least 0", FORM)
    for key in ("add", "remove"):
        ball = table.get(key)
        if ball is not None and not (isinstance(ball, str) and ball.startswith("ball:")):
            raise UsageError(f"edit at step {step}: {key} {shown(ball)} was given, expected ball:X,Y,Z,R", FORM)
    clicks = {side: _texts(table.get(side, ()), side, step) for side in _CLICKS}
    own = table.get("object")
    if isinstance(own, str) and _WHOLE.fullmatch(own):
        own = int(own)
    if own is not None and (not isinstance(own, int) or isinstance(own, bool) or own < 0):
        raise UsageError(f"edit at step {step}: object {shown(own)} was given, expected an object's id", FORM)
    return Edit(**{**table, **clicks, "step": step, "object": own})


def _texts(value: Any, side: str, step: int) -> tuple[str, ...]:
    """The clicks of one side of an edit."""
    texts = (value,) if isinstance(value, str) else value
    if not isinstance(texts, (list, tuple)) or not all(isinstance(text, str) and text for text in texts):
        raise UsageError(
            f"edit at step {step}: {side} {shown(value)} was given, expected clicks such as point:X,Y,Z", FORM
        )
    return tuple(texts)


def _words(text: str) -> dict[str, Any]:
    budgets.EXPRESSION.check(len(text), "edit", kind=UsageError)
    try:
        pairs = [word.partition("=") for word in shlex.split(text)]
    except ValueError:
        pairs = [(text, "", "")]
    if not pairs or not all(sign and key and value for key, sign, value in pairs):
        raise UsageError(f"edit: {shown(text)} was given, expected words like step=30", FORM)
    table: dict[str, Any] = {key: value for key, _, value in pairs}
    return table | {side: [v for k, _, v in pairs if k == side] for side in _CLICKS if side in table}


def refuse_unknown(edit: Edit, known: Mapping[str, FieldInfo]) -> None:
    """Refuse settings that do not exist, or that cannot change while a run runs.

    Raises
    ------
    UsageError
        With the nearest valid name.
    """
    own = ("add", "remove", *_CLICKS)
    possible = [key for key, field in known.items() if not entry_of(field).fixed]
    for key in edit.settings:
        if key in possible:
            continue
        if key in known:
            raise UsageError(
                f"edit at step {edit.step}: {key} cannot change while a run runs", f"these can: {', '.join(possible)}"
            )
        raise UsageError(
            f"edit at step {edit.step}: {shown(key)}: there is no such setting",
            f"{did_you_mean(key, [*own, *possible])}Valid are {', '.join([*own, *possible])}",
        )
