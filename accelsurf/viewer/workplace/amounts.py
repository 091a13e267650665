"""Numbers as a person reads and sets them: on a slider, in the unit of the file, with the digits that it can resolve.

The session, its files and what is copied from it are in mm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from accelsurf.settings.wording import in_unit

#: Positions of a slider.
TICKS = 1000
#: A unit of a setting that is a length, an area or a volume, whatever it is per.
_LENGTH = re.compile(r"mm([23])?(?= |$)")


def amount(
    low: float, high: float, value: float | str, power: float, limit: float, words: Sequence[str] = (),
    per: float = 1.0,
) -> dict[str, Any]:
    """Return how a number is shown.

    Parameters
    ----------
    low, high : float
        Ends of the slider.
    value : float or str
        In force; a word may stand for it.
    power : float
        Above 1 the slider is finer at its lower end.
    limit : float
        Largest number that can be typed.
    words : sequence of str
        Words that may stand for a number.
    per : float
        How many of the unit that is shown are one of that of the numbers given here.

    Returns
    -------
    dict
        ``low``, ``high``, ``value``, ``limit`` in the unit that is shown, ``power``, ``words``; ``digits`` after the
        point; ``tick``, the position from 0 to `TICKS`.

    Examples
    --------
    >>> row = amount(0.0, 0.0025, 0.0001, power=2.0, limit=1.0, per=1000.0)
    >>> row["high"], row["value"], row["digits"], row["tick"]
    (2.5, 0.1, 3, 200)
    """
    share = 0.0 if isinstance(value, str) else min(max((value - low) / (high - low), 0.0), 1.0)
    return {
        "low": low * per, "high": high * per, "power": power, "digits": digits_of(low * per, high * per),
        "value": value if isinstance(value, str) else rounded(value * per), "limit": limit * per,
        "words": list(words), "tick": round(TICKS * share ** (1.0 / power)),
    }  # fmt: skip


def digits_of(low: float, high: float) -> int:
    """How many digits after the point a slider needs: thousandths of its upper end, and two digits of its lower one.

    Examples
    --------
    >>> digits_of(0.0, 5.0), digits_of(0.0, 0.0025), digits_of(0.25, 24.0), digits_of(250.0, 24000.0)
    (3, 6, 2, 0)
    """
    needed = [3 - math.floor(math.log10(high))] + ([1 - math.floor(math.log10(low))] if low > 0 else [])
    return max(0, *needed)


def rounded(value: float) -> float:
    """A number without what changing its unit adds to its last digits.

    Examples
    --------
    >>> rounded(0.0003 * 1000.0), rounded(float("inf"))
    (0.3, inf)
    """
    return float(f"{value:.12g}")


def read_in(unit: str, of_file: str) -> tuple[str, float]:
    """Return the unit in which a number is read, and how many of it are one of its own: those of the file for lengths.

    Examples
    --------
    >>> read_in("mm2 per unit of flow time", "um"), read_in("voxels", "um"), read_in("1/mm", "nm")
    (('um2 per unit of flow time', 1000000.0), ('voxels', 1.0), ('1/mm', 1.0))
    """
    found = _LENGTH.match(unit)
    if found is None:
        return unit, 1.0
    return f"{of_file}{unit[2:]}", in_unit(1.0, of_file, int(found.group(1) or 1))


def from_read(value: Any, per: float) -> Any:
    """Return what was typed or set in the unit that is read, in its own; what is no number stays as it is.

    Examples
    --------
    >>> from_read("0.6", 1000.0), from_read("2vox", 1000.0), from_read(0.1, 1.0)
    (0.0006, '2vox', 0.1)
    """
    if per == 1.0 or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return value
    try:
        return rounded(float(value) / per)
    except (ValueError, OverflowError):
        return value
