"""Corrections of a finished run, in the order in which they were made: clicks, and how far each may move the surface.

A run that a person has refined is repeated when its refinements are given to it: command line, Python and viewer apply
them in one place, `accelsurf.segmentation.refiner.Refiner`.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, model_serializer

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.wording import did_you_mean, shown

FORM = "inside=point:X,Y,Z near=10, or in TOML a table [[refine]] with inside = [\"point:X,Y,Z\"] and so on"
_WHOLE = re.compile(r"[0-9]{1,18}")


class Refinement(BaseModel):
    """One correction: the clicks of one stroke, and what they may move.

    Parameters
    ----------
    inside, outside : tuple of str
        Voxels that are in the object, and that are not, as the settings of these names.
    near : float or "auto"
        How far from the clicks the surface may move, mm; beyond it every byte stays. auto is what the clicks are about.
    object : int, optional
        Id of the object that is corrected, where there are several.

    Examples
    --------
    >>> refinement = Refinement(inside=("point:1,2,3",), near=4.0)
    >>> str(refinement)
    'inside=point:1,2,3 near=4.0'
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    inside: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    near: float | Literal["auto"] = "auto"
    object: int | None = None

    @model_serializer
    def _table(self) -> dict[str, Any]:
        given: dict[str, Any] = {"inside": self.inside, "outside": self.outside, "object": self.object}
        return {key: value for key, value in given.items() if value} | (
            {} if self.near == "auto" else {"near": self.near}
        )

    def __str__(self) -> str:
        words = []
        for key, value in self._table().items():
            many = value if isinstance(value, tuple) else (value,)
            words += [f"{key}={shlex.quote(str(one))}" for one in many]
        return " ".join(words)


def refinements_of(value: Any) -> Any:
    """Return refinements from the value of a configuration file, an option or an argument: tables, texts, or such.

    Parameters
    ----------
    value : Refinement, mapping, str, or a list or tuple of them

    Returns
    -------
    tuple of Refinement
        In the order given.

    Raises
    ------
    UsageError
        When one has no click, an unknown key, or a value of another kind.

    Examples
    --------
    >>> [str(one) for one in refinements_of(["inside=point:1,2,3 near=5", {"outside": "ball:4,5,6,2"}])]
    ['inside=point:1,2,3 near=5.0', 'outside=ball:4,5,6,2']
    """
    many = value if isinstance(value, (list, tuple)) else [value]
    budgets.EDITS.check(len(many), "refine", kind=UsageError)
    return tuple(_refinement(one) for one in many)


def _refinement(value: Any) -> Refinement:
    if isinstance(value, Refinement):
        return value
    table = _words(value) if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        raise UsageError(f"refine: {shown(value)} was given, expected clicks", FORM)
    for key in table:
        if key not in Refinement.model_fields:
            valid = list(Refinement.model_fields)
            hint = f"{did_you_mean(str(key), valid)}Valid are {', '.join(valid)}"
            raise UsageError(f"refine: {shown(key)}: there is no such setting", hint)
    sides = {side: _texts(side, table.get(side, ())) for side in ("inside", "outside")}
    if not any(sides.values()):
        raise UsageError("refine: no click was given, expected inside or outside", FORM)
    return Refinement(near=_near(table.get("near", "auto")), object=_object(table.get("object")), **sides)


def _texts(side: str, value: Any) -> tuple[str, ...]:
    many = (value,) if isinstance(value, str) else value
    if not isinstance(many, (list, tuple)) or not all(isinstance(one, str) and one for one in many):
        raise UsageError(f"refine: {side} {shown(value)} was given, expected where, as point:X,Y,Z", FORM)
    return tuple(many)


def _near(value: Any) -> float | Literal["auto"]:
    if value == "auto":
        return "auto"
    try:
        near = float(value) if not isinstance(value, bool) else -1.0
    except (TypeError, ValueError):
        near = -1.0
    if not 0 < near <= 1e9:
        raise UsageError(f"refine: near {shown(value)} was given, expected a length above 0 in mm, or auto", FORM)
    return near


def _object(value: Any) -> int | None:
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
        raise UsageError(f"refine: object {shown(value)} was given, expected an object's id", FORM)
    return value


def _words(text: str) -> dict[str, Any]:
    budgets.EXPRESSION.check(len(text), "refine", kind=UsageError)
    try:
        pairs = [word.partition("=") for word in shlex.split(text)]
    except ValueError:
        pairs = [(text, "", "")]
    if not pairs or not all(sign and key and value for key, sign, value in pairs):
        raise UsageError(f"refine: {shown(text)} was given, expected words like inside=point:X,Y,Z", FORM)
    table: dict[str, Any] = {}
    for key, _, value in pairs:
        if key in ("inside", "outside"):
            table[key] = (*table.get(key, ()), value)
        else:
            table[key] = value
    return table
