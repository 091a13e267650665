"""Corrections: clicks on objects, and objects that change as a whole, after the end of a run or at a frame."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, model_serializer

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.toml import VOLUME, checked_volume
from accelsurf.settings.wording import did_you_mean, shown

_WHOLE = re.compile(r"[0-9]{1,18}")
#: Largest id of an object.
MAX_ID = 2**32 - 1
_CLICKS = ("inside", "outside")
#: Keys that are read only in corrections of a finished run: the key of the action, and the keys that may
#: come with it.
_KINDS: dict[str, tuple[str, ...]] = {
    "merge": (),
    "remove": (),
    "split": ("new", "object"),
    "new": ("inside", "outside", "size"),
    "to_edges": ("islands", "holes", "object"),
    "islands": ("holes", "object"),
    "holes": ("object",),
    "": ("inside", "outside", "near", "object"),
}
_OF_WHOLE = ("to_edges", "islands", "holes")
#: Keys of a correction.
CORRECTION_KEYS = (
    "inside",
    "outside",
    "near",
    "object",
    "new",
    "size",
    "merge",
    "split",
    "remove",
    *_OF_WHOLE,
)
SettingName = Literal["refine", "correct"]


class _Setting(NamedTuple):
    """A setting with corrections: the ``form`` of one, and an example of a word."""

    form: str
    example: str


#: The settings of the run and of tracking that have corrections.
_SETTINGS = {
    "refine": _Setting(
        "inside=point:X,Y,Z near=10; new=ID inside=ball:X,Y,Z,R size=4ml; merge=ID,ID; split=point:X,Y,Z; "
        "remove=ID; or to_edges=2 islands=50mm3 holes=50mm3; in TOML a table [[refine]] with "
        'inside = ["point:X,Y,Z"] and so on',
        "inside=point:X,Y,Z",
    ),
    "correct": _Setting(
        "frame=12 inside=point:X,Y,Z object=2; frame=12 new=3 inside=ball:X,Y,Z,R; frame=12 remove=2; and all "
        "else that accelsurf refine takes, after the frame",
        "frame=12",
    ),
}


class Correction(BaseModel):
    """One correction: after the end of a run, or at a frame of a sequence.

    Parameters
    ----------
    frame : int
        Number of the frame, from 0, that is corrected; -1 without a sequence.
    inside, outside : tuple of str
        Clicks: voxels in the object, and not in it, as the settings of these names; they hold from then on.
    object : int, optional
        Id of the object that the clicks are for, where there are several; voxels that one gains are taken from the
        others.
    near : float or "auto"
        How far from the clicks the surface may move, mm; beyond it every byte stays. auto follows from their radius
        and depth, and moves at most a share of the object.
    new : int, optional
        Id of an object that begins at the clicks, beside the others; one that has this id already begins anew. With
        ``split``: id of the part that is split off.
    size : str, optional
        About how large the new object is, as the setting of this name.
    merge : tuple of int
        Ids of objects that become the first of them.
    split : str, optional
        A point, ``point:X,Y,Z``: the part connected to it becomes an object, without the rest of its former one
        (``object``; by default that in which the point lies).
    remove : int, optional
        The id of an object that is not wanted.
    to_edges : float, optional
        The whole border is brought to the image's edges, by at most this length in mm; no click is needed.
    islands, holes : str, optional
        Parts of the object that are smaller than this volume, as ``50mm3``, are removed, but for the largest; parts
        smaller than this that it encloses are filled.

    Examples
    --------
    >>> str(Correction(inside=("point:1,2,3",), near=4.0)), str(Correction(merge=(1, 3)))
    ('inside=point:1,2,3 near=4.0', 'merge=1,3')
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame: int = -1
    inside: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    object: int | None = None
    near: float | Literal["auto"] = "auto"
    new: int | None = None
    size: str | None = None
    merge: tuple[int, ...] = ()
    split: str | None = None
    remove: int | None = None
    to_edges: float | None = None
    islands: str | None = None
    holes: str | None = None

    @property
    def target(self) -> int | None:
        """The object that the clicks are about: one that begins, or one that is there; None if none is named."""
        return self.object if self.new is None else self.new

    @property
    def kind(self) -> Literal["clicks", "new", "merge", "split", "remove", "mend"]:
        """The change of a finished run."""
        if self.merge:
            return "merge"
        if self.split is not None:
            return "split"
        if self.remove is not None:
            return "remove"
        if self.to_edges is not None or self.islands is not None or self.holes is not None:
            return "mend"
        return "clicks" if self.new is None else "new"

    @property
    def is_of_one(self) -> bool:
        """True if it changes an object that is there: by clicks, or as a whole."""
        return self.kind in ("clicks", "mend")

    @model_serializer
    def _table(self) -> dict[str, Any]:
        given: dict[str, Any] = {
            "frame": self.frame if self.frame >= 0 else None,
            "inside": list(self.inside) or None,
            "outside": list(self.outside) or None,
            "object": self.object,
            "new": self.new,
            "size": self.size,
            "merge": self.merge or None,
            "split": self.split,
            "remove": self.remove,
            "near": None if self.near == "auto" else self.near,
            "to_edges": self.to_edges,
            "islands": self.islands,
            "holes": self.holes,
        }
        return {key: value for key, value in given.items() if value is not None}

    def __str__(self) -> str:
        words = ((key, word) for key, value in self._table().items() for word in _texts_of(value))
        return " ".join(f"{key}={shlex.quote(word)}" for key, word in words)


def _texts_of(value: Any) -> Sequence[str]:
    if isinstance(value, list):
        return [str(item) for item in value]
    return [",".join(map(str, value)) if isinstance(value, tuple) else str(value)]


def corrections_of(value: Any, name: SettingName = "refine") -> tuple[Correction, ...]:
    """Read corrections from the value of a configuration file, an option or an argument: tables, texts or corrections.

    Parameters
    ----------
    value : anything
        One correction or several.
    name : {"refine", "correct"}
        The setting: after the end, or at frames.

    Returns
    -------
    tuple of Correction
        In the order given.

    Raises
    ------
    UsageError
        When one is none.

    Examples
    --------
    >>> [correction.near for correction in corrections_of(["inside=point:1,2,3 near=5", {"outside": "point:4,5,6"}])]
    [5.0, 'auto']
    >>> corrections_of("frame=2 new=5 inside=ball:1,2,3,2", "correct")[0].frame
    2
    """
    many = value if isinstance(value, (list, tuple)) else [value]
    budgets.EDITS.check(len(many), name, kind=UsageError)
    return tuple(_correction(item, name) for item in many)


def corrections_in_order(table: Mapping[str, Any]) -> tuple[Correction, ...]:
    """Return the corrections that are given at once: first actions on an object as a whole, then the clicks.

    Raises
    ------
    UsageError
        When there is none, or one says two things at once.
    """
    given = {key: value for key, value in table.items() if value not in (None, (), "", [])}
    whole = {key: value for key, value in given.items() if key in _OF_WHOLE}
    rest = {key: value for key, value in given.items() if key not in _OF_WHOLE}
    if not whole or not {"inside", "outside"} & rest.keys():
        return corrections_of({**given})
    named = {"object": given["object"]} if "object" in given else {}
    return corrections_of([{**whole, **named}, rest])


def click_by_click(
    corrections: Sequence[Correction], clicks: Sequence[tuple[str, str]]
) -> tuple[Correction, ...]:
    """Return corrections in which each click is one of its own, in the order in which they were given.

    Parameters
    ----------
    corrections : sequence of Correction
        From `corrections_in_order`; an object that begins keeps its clicks together.
    clicks : sequence of (str, str)
        Side and place of each click, as given.

    Examples
    --------
    >>> both = corrections_in_order({"inside": ("point:1,2,3",), "outside": ("point:4,5,6",), "near": 5})
    >>> [str(one) for one in click_by_click(both, [("outside", "point:4,5,6"), ("inside", "point:1,2,3")])]
    ['outside=point:4,5,6 near=5.0', 'inside=point:1,2,3 near=5.0']
    """
    found: list[Correction] = []
    for correction in corrections:
        if correction.kind == "clicks":
            none = correction.model_copy(update=dict.fromkeys(_CLICKS, ()))
            found += (none.model_copy(update={side: (place,)}) for side, place in clicks)
        else:
            found.append(correction)
    return tuple(found)


#: The types of the settings in which they are given.
Refinements = Annotated[
    tuple[Correction, ...], BeforeValidator(lambda value: corrections_of(value, "refine"))
]
FrameCorrections = Annotated[
    tuple[Correction, ...], BeforeValidator(lambda value: corrections_of(value, "correct"))
]


def _correction(value: Any, name: SettingName) -> Correction:
    if isinstance(value, Correction):
        value = value.model_dump()
    form, example = _SETTINGS[name]
    table = words_of(value, name, form, example) if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        raise UsageError(f"{name}: {shown(value)} was given, expected clicks", form)
    valid = [*(["frame"] if name == "correct" else []), *CORRECTION_KEYS]
    for key in table:
        if key not in valid:
            hint = f"{did_you_mean(str(key), valid)}Valid are {', '.join(valid)}"
            raise UsageError(f"{name}: {shown(key)}: there is no such setting", hint)
    given = {
        key
        for key, value in table.items()
        if key in CORRECTION_KEYS and value not in (None, (), [], "", "auto")
    }
    fields: dict[str, Any] = dict(table)
    if name == "correct":
        fields["frame"] = moment_of(table, "frame", name, form)
    fields |= {side: _clicks(side, table.get(side, ()), name, form) for side in _CLICKS}
    _refuse_mixed(given, name, form)
    size, split = checked_volume(table.get("size")), table.get("split")
    if size is not None and (not isinstance(size, str) or not re.fullmatch(VOLUME, size)):
        raise UsageError(
            f"{name}: size {shown(size)} was given, expected a volume with its unit", form
        )
    if split is not None and not (isinstance(split, str) and split.startswith("point:")):
        raise UsageError(f"{name}: split {shown(split)} was given, expected point:X,Y,Z", form)
    edges = table.get("to_edges")
    fields |= {"size": size, "split": split}
    fields["near"] = _near(table.get("near", "auto"), name, form)
    fields["merge"] = _ids(table.get("merge", ()), name, form)
    fields["to_edges"] = None if edges is None else _length("to_edges", edges, name, form)
    fields |= {key: _part_size(key, table.get(key), name, form) for key in ("islands", "holes")}
    fields |= {key: _id(key, table.get(key), name, form) for key in ("object", "new", "remove")}
    return Correction(**fields)


def moment_of(table: Mapping[str, Any], key: str, name: str, form: str) -> int:
    """Return the step or the frame of a table: a whole number at least 0.

    Raises
    ------
    UsageError
        When there is none.
    """
    number = _whole(table.get(key), 0, 10**18)
    if number is None:
        given = f"no {key}" if table.get(key) is None else f"{key} {shown(table[key])}"
        raise UsageError(f"{name}: {given} was given, expected a whole number at least 0", form)
    return number


def _refuse_mixed(given: set[str], name: str, form: str) -> None:
    """Refuse a correction that says nothing, or two things at once."""
    kind = next(key for key in _KINDS if key in given or not key)
    if kind in ("", "new") and not given & ({"inside"} if kind else set(_CLICKS)):
        raise UsageError(
            f"{name}: no click was given, expected inside{'' if kind else ' or outside'}", form
        )
    others = sorted(given - {kind, *_KINDS[kind]})
    if others:
        raise UsageError(
            f"{name}: {others[0]} was given with {kind or 'clicks'}, expected one thing at a time",
            form,
        )


def _clicks(side: str, value: Any, where: str, form: str) -> tuple[str, ...]:
    texts = (value,) if isinstance(value, str) else value
    if not isinstance(texts, (list, tuple)) or not all(
        isinstance(text, str) and text for text in texts
    ):
        raise UsageError(
            f"{where}: {side} {shown(value)} was given, expected clicks such as point:X,Y,Z", form
        )
    return tuple(texts)


def _ids(value: Any, name: str, form: str) -> tuple[int, ...]:
    """Return the ids of objects that are merged."""
    many = value.split(",") if isinstance(value, str) else value
    if not isinstance(many, (list, tuple)):
        raise UsageError(f"{name}: merge {shown(value)} was given, expected ids of objects", form)
    ids = tuple(_id("merge", item, name, form) or 0 for item in many)
    if many and (len(set(ids)) < len(ids) or len(ids) < 2):
        raise UsageError(
            f"{name}: merge {shown(value)} was given, expected at least two different ids", form
        )
    return ids


def _near(value: Any, name: str, form: str) -> float | Literal["auto"]:
    return "auto" if value == "auto" else _length("near", value, name, form, ", or auto")


def _length(key: str, value: Any, name: str, form: str, otherwise: str = "") -> float:
    """Return a length above 0; messages also name the alternatives ``otherwise``."""
    try:
        length = float(value) if not isinstance(value, bool) else -1.0
    except (TypeError, ValueError):
        length = -1.0
    if not 0 < length <= 1e9:
        raise UsageError(
            f"{name}: {key} {shown(value)} was given, expected a length above 0 in mm{otherwise}",
            form,
        )
    return length


def _part_size(key: str, value: Any, name: str, form: str) -> str | None:
    """Return the volume, with its unit, below which islands or holes go."""
    if value is not None and not (isinstance(value, str) and re.fullmatch(VOLUME, value)):
        raise UsageError(
            f"{name}: {key} {shown(value)} was given, expected a volume with its unit, as 50mm3",
            form,
        )
    return value


def _whole(value: Any, least: int, most: int) -> int | None:
    """Return a whole number, also one that is written as text; None for anything else."""
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    return (
        value
        if isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
        else None
    )


def _id(key: str, value: Any, where: str, form: str) -> int | None:
    number = _whole(value, 1, MAX_ID)
    if value is not None and number is None:
        raise UsageError(f"{where}: {key} {shown(value)} was given, expected an object's id", form)
    return number


def words_of(text: str, name: str, form: str, example: str) -> dict[str, Any]:
    """Return the words KEY=VALUE of a correction or an edit by key; clicks may be repeated.

    Parameters
    ----------
    text : str
    name : str
        Of the setting.
    form : str
        The hint of an error.
    example : str
        A word, as an error names it.

    Raises
    ------
    UsageError
        When a word is none, or a key is given twice.
    """
    budgets.EXPRESSION.check(len(text), name, kind=UsageError)
    try:
        pairs = [word.partition("=") for word in shlex.split(text)]
    except ValueError:
        pairs = [(text, "", "")]
    if not pairs or not all(sign and key and value for key, sign, value in pairs):
        raise UsageError(f"{name}: {shown(text)} was given, expected words like {example}", form)
    table: dict[str, Any] = {}
    for key, _, value in pairs:
        if key in table and key not in _CLICKS:
            raise UsageError(f"{name}: {shown(key)} was given twice", form)
        table[key] = (*table.get(key, ()), value) if key in _CLICKS else value
    return table
