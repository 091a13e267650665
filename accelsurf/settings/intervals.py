"""How often something is done, as it is typed: every so many steps, or as often as a time."""

from __future__ import annotations

import re
from typing import NamedTuple

from accelsurf.errors import UsageError
from accelsurf.settings.wording import shown

#: Seconds of each unit.
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
#: An interval as it is written.
INTERVAL = rf"^([0-9]{{1,9}}|[0-9]{{1,9}}(\.[0-9]{{1,9}})?({'|'.join(UNITS)}))$"
INTERVAL_FORM = re.compile(INTERVAL)


class Interval(NamedTuple):
    """Every so many ``steps``, or as often as ``seconds`` have passed; one of them is None."""

    steps: int | None
    seconds: float | None

    def is_over(self, steps: int, seconds: float) -> bool:
        """Whether so many steps and seconds are an interval or more.

        Examples
        --------
        >>> Interval(5, None).is_over(5, 0.0), Interval(None, 30.0).is_over(1000, 29.0)
        (True, False)
        """
        return steps >= self.steps if self.steps is not None else seconds >= (self.seconds or 0.0)


def interval_of(text: str) -> Interval:
    """Return the interval that a text says.

    Parameters
    ----------
    text : str
        A whole number of steps, or a number followed by one of `UNITS`.

    Raises
    ------
    UsageError
        When it is not of this form, or is 0.

    Examples
    --------
    >>> interval_of("50"), interval_of("1.5min")
    (Interval(steps=50, seconds=None), Interval(steps=None, seconds=90.0))
    """
    found = INTERVAL_FORM.fullmatch(text)
    unit = None if found is None else found[3]
    number = 0.0 if found is None else float(text.removesuffix(unit or ""))
    if number == 0:
        raise UsageError(
            f"checkpoint: {shown(text)} was given, expected a number of steps or a time, above 0",
            f"as in 50, 30s or 5min; the units of time are {', '.join(UNITS)}",
        )
    return Interval(int(number), None) if unit is None else Interval(None, number * UNITS[unit])
