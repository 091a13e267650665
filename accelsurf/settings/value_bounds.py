"""Bounds of values as they are written: LOW,HIGH, one of which may be left out."""

from __future__ import annotations

import math
import re
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings.wording import shown

_NUMBER = r"[-+]?(?:[0-9]{1,20}(?:\.[0-9]{0,20})?|\.[0-9]{1,20})(?:[eE][-+]?[0-9]{1,2})?"
_BOUNDS = re.compile(rf"({_NUMBER})?,({_NUMBER})?")


def bounds_of(text: str | None) -> tuple[float, float]:
    """The bounds that a text says, infinite where there is none.

    Raises
    ------
    UsageError
        When it is written in another way, or the first is not below the second.

    Examples
    --------
    >>> bounds_of(",250"), bounds_of("-100,250")
    ((-inf, 250.0), (-100.0, 250.0))
    """
    if text is None:
        return -math.inf, math.inf
    found = _BOUNDS.fullmatch(text.replace(" ", ""))
    if found is None or found[0] == ",":
        raise UsageError(
            f"clip: {shown(text)} was given, expected LOW,HIGH, one of which may be left out", "as --clip ,250"
        )
    low = -math.inf if found[1] is None else float(found[1])
    high = math.inf if found[2] is None else float(found[2])
    if not low < high:
        raise UsageError(f"clip: {shown(text)} was given, expected LOW below HIGH", "as --clip -100,250")
    return low, high


def checked_bounds(value: Any) -> Any:
    """Check bounds; a pair of numbers, one of which may be None, becomes its text."""
    if isinstance(value, (list, tuple)) and len(value) == 2:
        value = ",".join("" if number is None else repr(float(number)) for number in value)
    if isinstance(value, str):
        bounds_of(value)
    return value
