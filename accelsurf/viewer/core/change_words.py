"""Changes in a few words, for messages and the list of changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from accelsurf.grid.clicks import Side


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


def clicks_in_words(side: Side, where: Sequence[str], object_id: int | None = None) -> str:
    """Return the clicks of one stroke in words.

    Examples
    --------
    >>> clicks_in_words("inside", ["ball:1,2,3,4"])
    'inside: ball:1,2,3,4'
    >>> clicks_in_words("outside", ["path:1,2,3,4;5,6,7,4"], 2)
    'outside: stroke of 2 places, object 2'
    """
    whose = "" if object_id is None else f", object {object_id}"
    if len(where) == 1 and where[0].startswith("path:"):
        return f"{side}: stroke of {where[0].count(';') + 1} places{whose}"
    more = f" and {len(where) - 1} more" if len(where) > 1 else ""
    return f"{side}: {where[0]}{more}{whose}"


def balls_in_words(kind: str, balls: Sequence[str], object_id: int | None = None) -> str:
    """Return balls that were added or removed in words.

    Examples
    --------
    >>> balls_in_words("add", ["ball:1,2,3,4"], 3)
    'added ball:1,2,3,4 to object 3'
    >>> balls_in_words("remove", ["ball:1,2,3,4", "ball:2,2,3,4"])
    'removed a stroke of 2 balls'
    """
    whose = "" if object_id is None else f" {'to' if kind == 'add' else 'from'} object {object_id}"
    what = balls[0] if len(balls) == 1 else f"a stroke of {len(balls)} balls"
    return f"{'added' if kind == 'add' else 'removed'} {what}{whose}"
