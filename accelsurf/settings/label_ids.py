"""Labels as people write them: ``2,41,251-255``, alone or behind the name of a file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from accelsurf.errors import UsageError
from accelsurf.settings.wording import shown

#: First and last id of each range.
IdRanges = tuple[tuple[int, int], ...]

_LABEL = re.compile(r"[0-9]{1,18}")


def parse_ids(text: str, what: str, example: str) -> IdRanges:
    """Read ids and ranges of ids, separated by commas.

    Parameters
    ----------
    text : str
    what, example : str
        Where it was given, and what is right, for the message.

    Raises
    ------
    UsageError
        When a part is neither a whole number nor a range of them.

    Examples
    --------
    >>> parse_ids("2,5-9", "--labels", "--labels 1,3-5")
    ((2, 2), (5, 9))
    """
    ids = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not (_LABEL.fullmatch(first) and _LABEL.fullmatch(last or first) and int(first) <= int(last or first)):
            raise UsageError(
                f"{what}: {shown(part)!r} is no label, expected whole numbers and ranges", f"as in {example}"
            )
        ids.append((int(first), int(last or first)))
    return tuple(ids)


def holds(ranges: Sequence[tuple[int, int]], label: int) -> bool:
    """Whether an id is in one of the ranges.

    Examples
    --------
    >>> holds(((2, 2), (5, 9)), 7), holds(((2, 2), (5, 9)), 3)
    (True, False)
    """
    return any(first <= label <= last for first, last in ranges)
