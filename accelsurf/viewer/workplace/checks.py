"""Checks of values that a page has sent: it is not trusted, it may send anything."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.errors import UsageError

#: The largest number of letters of a value.
MAX_LETTERS = 40


def number(value: Any, low: float, high: float) -> float:
    """Return a finite number from ``low`` to ``high``; a text may stand for it.

    Raises
    ------
    UsageError
        For anything else.
    """
    if isinstance(value, str) and len(value) <= MAX_LETTERS:
        try:
            value = float(value)
        except ValueError:
            value = math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise UsageError(f"{short(value)} was given, expected a number from {low:g} to {high:g}")
    return float(value)


def whole(value: Any, low: int, high: int) -> int:
    """Return a whole number from ``low`` to ``high``; a fraction is cut off.

    Raises
    ------
    UsageError
        For anything else.
    """
    return int(number(value, low, high))


def word(value: Any, words: tuple[str, ...]) -> str:
    """Return one of the words.

    Raises
    ------
    UsageError
        For anything else.
    """
    if not isinstance(value, str) or value not in words:
        raise UsageError(f"{short(value)} was given, expected {', '.join(words)}")
    return value


def text(value: Any, letters: int) -> str:
    """Return a printable text of at most so many letters, without blanks at its ends.

    Raises
    ------
    UsageError
        For anything else.
    """
    if not isinstance(value, str) or len(value) > letters or not value.isprintable():
        raise UsageError(f"{short(value)} was given, expected a text of at most {letters} letters")
    return value.strip()


def carry_out(requests: Mapping[str, Callable[..., None]], name: Any, values: Sequence[Any]) -> None:
    """Carry out a request that a page has sent.

    Raises
    ------
    UsageError
        When there is none of this name, or it takes another number of values; and what it raises itself.
    """
    work = requests.get(name) if isinstance(name, str) else None
    if work is None:
        raise UsageError(f"request: {short(name)} is not known")
    try:
        work(*values)
    except TypeError as error:
        if "argument" not in str(error):
            raise
        raise UsageError(f"{name}: {len(values)} values were given, another number expected") from None


def short(value: Any) -> str:
    """Return a value in a few letters, for messages."""
    kind = type(value).__name__ if isinstance(value, (list, dict)) else repr(value)
    shown = value if isinstance(value, str) else kind
    return "".join(c if c.isprintable() else "?" for c in shown[:MAX_LETTERS])
