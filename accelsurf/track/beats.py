"""The beat of a volume that rises and falls again and again: its period, and its ejection fraction."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: The volume must change by this part of the largest, else there is no beat.
MIN_CHANGE = 0.05
#: Least autocorrelation of a periodic curve; largest difference of its two ends, as a part of its change.
MIN_CORRELATION, MAX_GAP = 0.7, 0.25
#: Frames of a beat at least.
MIN_FRAMES = 5


class Beat(NamedTuple):
    """A periodic volume.

    ``kind`` is "repeats" where two or more periods are there, and "closes" where the curve ends as it began, as one
    heart beat does; ``period`` is in the unit of the times, None for one that closes; ``ejection_fraction`` is
    (largest - smallest) / largest.
    """

    kind: Literal["repeats", "closes"]
    period: float | None
    ejection_fraction: float


def find_beat(times: ArrayLike, volumes: ArrayLike) -> Beat | None:
    """Find the beat of a volume; None where it does not rise and fall again.

    The period is where the curve, less its line of growth, correlates best with itself: the first maximum of the
    correlation of all pairs of frames that far apart, by a parabola through it and its neighbours.

    Parameters
    ----------
    times, volumes : array-like, shape (n,)
        Rising times; frames without a volume are left out before.

    Examples
    --------
    >>> t = np.arange(40) * 0.05
    >>> beat = find_beat(t, 100 + 20 * np.cos(2 * np.pi * t / 0.8))
    >>> beat.kind, round(beat.period, 2), round(beat.ejection_fraction, 3)
    ('repeats', 0.8, 0.333)
    >>> find_beat(t, 100 + t) is None
    True
    """
    at, values = np.asarray(times, float), np.asarray(volumes, float)
    if len(at) < MIN_FRAMES or not values.max() > 0:
        return None
    change = float(np.ptp(values))
    fraction = change / float(values.max())
    if fraction < MIN_CHANGE:
        return None
    period = _period(at, values)
    if period is not None:
        return Beat("repeats", period, _mean_fraction(at, values, period))
    extreme = int(np.argmax(np.abs(values - values[0])))
    closed = abs(values[-1] - values[0]) <= MAX_GAP * change and 0 < extreme < len(values) - 1
    smooth = float(np.abs(np.diff(values)).sum()) <= 2.5 * change  # down once and up once is 2, noise is more
    return Beat("closes", None, fraction) if closed and smooth else None


def _period(at: NDArray[np.float64], values: NDArray[np.float64]) -> float | None:
    """The first lag at which the curve correlates best with itself, of those that two periods fit into."""
    step = float(np.median(np.diff(at)))
    grid = np.arange(at[0], at[-1] + 0.5 * step, step)
    curve = np.interp(grid, at, values)
    curve = curve - np.polyval(np.polyfit(grid, curve, 1), grid)
    if np.ptp(curve) < MIN_CHANGE * values.max():
        return None  # it grows or shrinks only
    count = len(curve) // 2 + 1
    found = np.array([_correlation(curve, lag) for lag in range(count)])
    falls = np.flatnonzero(found < 0)
    if not len(falls):
        return None
    for lag in range(max(int(falls[0]), 1) + 1, count):
        before, here = found[lag - 1], found[lag]
        after = found[lag + 1] if lag + 1 < count else -1.0
        if here >= MIN_CORRELATION and here >= before and here >= after:
            bend = before - 2 * here + after
            shift = 0.5 * (before - after) / bend if bend < 0 and lag + 1 < count else 0.0
            return float((lag + shift) * step)
    return None


def _mean_fraction(at: NDArray[np.float64], values: NDArray[np.float64], period: float) -> float:
    """Ejection fraction of the mean of the largest and of the smallest volumes of whole beats."""
    beat = ((at - at[0]) / period + 1e-6).astype(int)
    whole = range(max(int((at[-1] - at[0]) / period + 0.05), 1))
    largest = float(np.mean([values[beat == n].max() for n in whole if (beat == n).any()]))
    smallest = float(np.mean([values[beat == n].min() for n in whole if (beat == n).any()]))
    return (largest - smallest) / largest


def _correlation(curve: NDArray[np.float64], lag: int) -> float:
    """Correlation of the curve with itself, so many frames later."""
    a, b = curve[: len(curve) - lag], curve[lag:]
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
