"""Corrections of a finished run, in the order in which they were made: clicks, and how far each may move the surface;
objects that are new, removed, merged, split.

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
from accelsurf.settings.written_values import VOLUME, checked_volume

FORM = (
    "inside=point:X,Y,Z near=10; new=ID inside=ball:X,Y,Z,R size=4ml; merge=ID,ID; split=point:X,Y,Z; or remove=ID; in "
    "TOML a table [[refine]] with inside = [\"point:X,Y,Z\"] and so on"
)
_WHOLE = re.compile(r"[0-9]{1,18}")
#: Largest id of an object.
MAX_ID = 2**32 - 1
#: What goes together: the key that says what is done, and what it may be given with.
_KINDS: dict[str, tuple[str, ...]] = {
    "merge": (), "remove": (), "split": ("new", "object"), "new": ("inside", "outside", "size"),
    "": ("inside", "outside", "near", "object"),
}


class Refinement(BaseModel):
    """One correction: the clicks of one stroke, and what they may move; or a change of the objects.

    Parameters
    ----------
    inside, outside : tuple of str
        Voxels that are in the object, and that are not, as the settings of these names.
    near : float or "auto"
        How far from the clicks the surface may move, mm; beyond it every byte stays. auto is what the clicks are about.
    object : int, optional
        Id of the object that is corrected, where there are several.
    new : int, optional
        Id of an object that begins at the clicks, beside the others; one that has this id already begins anew. With
        ``split``: of what is split off.
    size : str, optional
        About how large the new object is, as the setting of this name.
    merge : tuple of int
        Ids of objects that become the first of them.
    split : str, optional
        A point, ``point:X,Y,Z``: what is connected to it becomes an object, without the rest of its former one
        (``object``; by default that in which the point lies).
    remove : int, optional
        Id of an object that is not wanted.

    Examples
    --------
    >>> refinement = Refinement(inside=("point:1,2,3",), near=4.0)
    >>> str(refinement)
    'inside=point:1,2,3 near=4.0'
    >>> str(Refinement(merge=(1, 3)))
    'merge=1,3'
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    inside: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    near: float | Literal["auto"] = "auto"
    object: int | None = None
    new: int | None = None
    size: str | None = None
    merge: tuple[int, ...] = ()
    split: str | None = None
    remove: int | None = None

    @property
    def kind(self) -> Literal["clicks", "new", "merge", "split", "remove"]:
        """What it does."""
        if self.merge:
            return "merge"
        if self.split is not None:
            return "split"
        if self.remove is not None:
            return "remove"
        return "clicks" if self.new is None else "new"

    @model_serializer
    def _table(self) -> dict[str, Any]:
        keys = ("inside", "outside", "object", "new", "size", "merge", "split", "remove")
        return {key: value for key in keys if (value := getattr(self, key))} | (
            {} if self.near == "auto" else {"near": self.near}
        )

    def __str__(self) -> str:
        words = []
        for key, value in self._table().items():
            many = value if key in ("inside", "outside") else (value,)
            texts = [",".join(map(str, one)) if isinstance(one, tuple) else str(one) for one in many]
            words += [f"{key}={shlex.quote(text)}" for text in texts]
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
        When one says nothing, or two things at once, or has an unknown key or a value of another kind.

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
    _refuse_mixed({key for key, given in table.items() if given not in (None, (), [], "", "auto")})
    fields: dict[str, Any] = {side: _texts(side, table.get(side, ())) for side in ("inside", "outside")}
    fields |= {key: _id(key, table.get(key)) for key in ("object", "new", "remove")}
    size, split = checked_volume(table.get("size")), table.get("split")
    if size is not None and (not isinstance(size, str) or not re.fullmatch(VOLUME, size)):
        raise UsageError(f"refine: size {shown(size)} was given, expected a volume with its unit", FORM)
    if split is not None and not (isinstance(split, str) and split.startswith("point:")):
        raise UsageError(f"refine: split {shown(split)} was given, expected point:X,Y,Z", FORM)
    near, merge = _near(table.get("near", "auto")), _ids(table.get("merge", ()))
    return Refinement(near=near, size=size, split=split, merge=merge, **fields)


def _refuse_mixed(given: set[str]) -> None:
    """Refuse what says nothing, or two things at once."""
    kind = next(key for key in _KINDS if key in given or not key)
    if kind in ("", "new") and not given & ({"inside"} if kind else {"inside", "outside"}):
        raise UsageError(f"refine: no click was given, expected inside{'' if kind else ' or outside'}", FORM)
    others = sorted(given - {kind, *_KINDS[kind]})
    if others:
        raise UsageError(f"refine: {others[0]} was given with {kind or 'clicks'}, expected one thing at a time", FORM)


def _ids(value: Any) -> tuple[int, ...]:
    """Ids of objects that are merged."""
    many = value.split(",") if isinstance(value, str) else value
    if not isinstance(many, (list, tuple)):
        raise UsageError(f"refine: merge {shown(value)} was given, expected ids of objects", FORM)
    ids = tuple(_id("merge", one) or 0 for one in many)
    if many and (len(set(ids)) < len(ids) or len(ids) < 2):
        raise UsageError(f"refine: merge {shown(value)} was given, expected at least two different ids", FORM)
    return ids


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


def _id(key: str, value: Any) -> int | None:
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= MAX_ID):
        raise UsageError(f"refine: {key} {shown(value)} was given, expected an object's id", FORM)
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
