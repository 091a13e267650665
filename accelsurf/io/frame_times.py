"""Times of frames as files say them: a step and its unit, or where that cannot say it, a line of text of our own."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.sequence import check_times
from accelsurf.settings import budgets

TimeUnit = Literal["s", "frame"]
#: Under which name files hold the line of text of `FrameTimes.text`.
TIMES_KEY = "accelsurf_frame_times"
_NUMBER = r"-?[0-9]{1,20}(?:\.[0-9]{1,20})?(?:e[-+]?[0-9]{1,3})?"
_TEXT = re.compile(rf"(s|frame)((?: {_NUMBER})+)\s*")


@dataclass(frozen=True)
class FrameTimes:
    """When the frames of a sequence are.

    Attributes
    ----------
    values : tuple of float
        Rising, one for each frame.
    unit : {"s", "frame"}

    Examples
    --------
    >>> FrameTimes.regular(3, 0.5), FrameTimes((0.0, 1.0, 3.0), "frame").step
    (FrameTimes(values=(0.0, 0.5, 1.0), unit='s'), None)
    """

    values: tuple[float, ...]
    unit: TimeUnit = "frame"

    @classmethod
    def given(cls, values: Sequence[float], unit: str) -> FrameTimes:
        """Times that were given, checked.

        Raises
        ------
        UsageError
            When there is none, or the unit is no unit; InputError when they do not rise.
        """
        if unit not in ("s", "frame"):
            raise UsageError(f"time unit {unit!r} given, s or frame expected")
        numbers = tuple(float(value) for value in values)
        if not numbers or not all(map(math.isfinite, numbers)):
            raise UsageError(f"{len(numbers)} times given, finite numbers for one frame or more expected")
        check_times(numbers)
        return cls(numbers, cast(TimeUnit, unit))

    @classmethod
    def regular(cls, count: int, seconds: float | None) -> FrameTimes:
        """Frames from time 0 on, so many seconds apart; or where that is not known, counted.

        Raises
        ------
        InputError
            When there are more than an axis of time may have.
        """
        budgets.AXIS.check(count, "the time points of the sequence")
        if seconds is None:
            return cls(tuple(float(n) for n in range(count)))
        return cls(tuple(n * seconds for n in range(count)), "s")

    @classmethod
    def from_text(cls, text: str, count: int) -> FrameTimes:
        """What `text` has written for so many frames; of one number for several frames, the step between them.

        Raises
        ------
        InputError
            When it is damaged, or of another number of frames.
        """
        found = _TEXT.fullmatch(text.strip())
        values = tuple(float(word) for word in found.group(2).split()) if found else ()
        if found is not None and len(values) == 1 < count and values[0] > 0 and found.group(1) == "s":
            return cls.regular(count, values[0])
        if found is None or len(values) != count or not all(map(math.isfinite, values)):
            raise InputError(f"the times of {count} frames expected, found {text[:60]!r}", "correct or take them out")
        check_times(values)
        return cls(values, cast(TimeUnit, found.group(1)))

    @property
    def step(self) -> float | None:
        """From one frame to the next, where the first is at 0 and all are equally far apart; else None."""
        if self.values[0] != 0.0:
            return None
        step = self.values[1] if len(self.values) > 1 else 1.0
        return step if all(value == n * step for n, value in enumerate(self.values)) else None

    @property
    def seconds(self) -> float | None:
        """The step in seconds; None where there is none, or the unit is another."""
        return self.step if self.unit == "s" else None

    @property
    def is_count(self) -> bool:
        """Whether the frames are counted: 0, 1, 2, ..."""
        return self.unit == "frame" and self.step == 1.0

    @property
    def mean_step(self) -> float:
        """From one frame to the next on average, for fields of headers that hold one number."""
        if len(self.values) == 1:
            return 1.0
        return self.step or (self.values[-1] - self.values[0]) / (len(self.values) - 1)

    @property
    def text(self) -> str:
        """Unit and times as a line of text; the numbers are exact."""
        return " ".join([self.unit, *(repr(value) for value in self.values)])


def single_precision(value: float) -> float:
    """The shortest number that has the same single precision: what is meant where a header holds 0.0399999991.

    Examples
    --------
    >>> single_precision(0.03999999910593033)
    0.04
    """
    with np.errstate(over="ignore"):
        return float(str(np.float32(value)))
