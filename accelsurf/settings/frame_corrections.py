"""Corrections of single frames of a tracking: as those of a finished run, with the frame."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, model_serializer

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.refinements import Refinement, refinements_of
from accelsurf.settings.wording import shown

FORM = (
    "frame=12 inside=point:X,Y,Z object=2; frame=12 new=3 inside=ball:X,Y,Z,R; frame=12 remove=2; and all else that "
    "accelsurf refine takes, after the frame"
)


class FrameCorrection(BaseModel):
    """A correction of one frame: ``frame``, from 0, and the ``refinement``.

    Examples
    --------
    >>> str(corrections_of("frame=12 inside=point:1,2,3 object=2")[0])
    'frame=12 inside=point:1,2,3 object=2'
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame: int
    refinement: Refinement

    @model_serializer
    def _table(self) -> dict[str, Any]:
        table: dict[str, Any] = self.refinement.model_dump()
        return {"frame": self.frame, **table}

    def __str__(self) -> str:
        return f"frame={self.frame} {self.refinement}"


def corrections_of(value: Any) -> tuple[FrameCorrection, ...]:
    """Return corrections of frames from the value of a configuration file, an option or an argument.

    Parameters
    ----------
    value : FrameCorrection, mapping, str, or a list or tuple of them

    Returns
    -------
    tuple of FrameCorrection
        In the order given.

    Raises
    ------
    UsageError
        When one has no frame, or says nothing.
    """
    many = value if isinstance(value, (list, tuple)) else [value]
    budgets.EDITS.check(len(many), "correct", kind=UsageError)
    return tuple(_correction(one) for one in many)


def _correction(value: Any) -> FrameCorrection:
    if isinstance(value, FrameCorrection):
        return value
    number, rest = _split(value)
    if isinstance(number, str) and number.isascii() and number.isdigit() and len(number) < 10:
        number = int(number)
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise UsageError(f"correct: {shown(value)} was given, expected the frame, from 0, and clicks", FORM)
    try:
        (refinement,) = refinements_of(rest)
    except UsageError as error:
        raise UsageError(error.message.replace("refine:", "correct:", 1), FORM) from None
    return FrameCorrection(frame=number, refinement=refinement)


def _split(value: Any) -> tuple[Any, Any]:
    """The frame, and the rest."""
    if isinstance(value, Mapping):
        return value.get("frame"), {key: one for key, one in value.items() if key != "frame"}
    if not isinstance(value, str):
        return None, None
    budgets.EXPRESSION.check(len(value), "correct", kind=UsageError)
    try:
        words = shlex.split(value)
    except ValueError:
        return None, None
    numbers = [word.removeprefix("frame=") for word in words if word.startswith("frame=")]
    rest = shlex.join(word for word in words if not word.startswith("frame="))
    return (numbers[0], rest) if len(numbers) == 1 else (None, None)
