"""Which values are black and white: chosen from an object and its surroundings, or from the whole image."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError

#: Voxels that a window is chosen from at most.
MAX_SAMPLES = 300_000
#: Percentiles of the object, of its surroundings and of a whole image that are taken as their ends.
OBJECT_ENDS, AROUND_ENDS, IMAGE_ENDS = (2.0, 98.0), (3.0, 97.0), (1.0, 99.0)
#: The window is at most so many times as wide as the object's own range, so that differences near its edge show.
MAX_OBJECT_WIDTHS = 4.0
#: Of a CT without an object: the window of soft tissue that radiologists begin with, HU.
SOFT_TISSUE = (40.0, 400.0)


class GreyWindow(NamedTuple):
    """Values that are drawn black and white."""

    low: float
    high: float

    @property
    def text(self) -> str:
        """Centre and width, as radiologists give it."""
        return f"C {0.5 * (self.low + self.high):.4g} W {self.high - self.low:.4g}"

    def grey(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Grey values of an array; what is not finite is black."""
        share = (np.asarray(values, np.float32) - np.float32(self.low)) / np.float32(self.high - self.low)
        return (255.0 * np.clip(np.nan_to_num(share, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)).astype(np.uint8)


def parse_window(text: str) -> GreyWindow | None:
    """Return the window that was typed as ``CENTRE,WIDTH``; None for ``auto``.

    Raises
    ------
    UsageError
        For anything else.

    Examples
    --------
    >>> parse_window("40,400"), parse_window("auto")
    (GreyWindow(low=-160.0, high=240.0), None)
    """
    if text == "auto":
        return None
    try:
        centre, width = (float(part) for part in text.split(","))
    except ValueError:
        centre = width = math.nan
    if not (math.isfinite(centre) and math.isfinite(width) and width > 0):
        raise UsageError(
            f"--window: {text[:40]!r} was given, expected auto, or centre and width above 0 with a comma between them",
            "as in --window 40,400 for soft tissue in CT",
        )
    return GreyWindow(centre - width / 2, centre + width / 2)


def window_of(image: NDArray[Any], inside: NDArray[np.bool_] | None = None) -> GreyWindow:
    """Choose a window.

    Parameters
    ----------
    image : ndarray
        The object and its surroundings; or the whole image.
    inside : ndarray of bool, optional
        Which of them are in the object.

    Returns
    -------
    GreyWindow
        With an object: from the values around it, but not wider than `MAX_OBJECT_WIDTHS` times its own range around
        its median. Else `SOFT_TISSUE` for values that are Hounsfield units, or percentiles of what is not the most
        frequent value (the zeros around a stripped brain).
    """
    stride = max(1, math.ceil((image.size / MAX_SAMPLES) ** (1 / 3)))
    part = tuple(slice(None, None, stride if n > 2 * stride else 1) for n in image.shape)
    values = np.asarray(image[part], np.float64).ravel()
    finite = np.isfinite(values)
    own = np.zeros(0) if inside is None else np.asarray(image[inside][:: max(1, inside.sum() // MAX_SAMPLES)], float)
    own = own[np.isfinite(own)]
    values = values[finite]
    if not values.size:
        return GreyWindow(0.0, 1.0)
    if own.size:
        low, middle, high = np.percentile(own, (OBJECT_ENDS[0], 50.0, OBJECT_ENDS[1]))
        around = np.percentile(values, AROUND_ENDS)
        room = 0.5 * MAX_OBJECT_WIDTHS * (high - low) or math.inf
        low, high = max(min(low, around[0]), middle - room), min(max(high, around[1]), middle + room)
    elif is_hounsfield(values):
        low, high = SOFT_TISSUE[0] - SOFT_TISSUE[1] / 2, SOFT_TISSUE[0] + SOFT_TISSUE[1] / 2
    else:
        kinds, counts = np.unique(values, return_counts=True)
        most = kinds[np.argmax(counts)]
        filled = values[values != most] if counts.max() > 0.2 * values.size and len(kinds) > 2 else values
        low, high = np.percentile(filled, IMAGE_ENDS)
        if filled is not values:
            low = min(low, most)
    return GreyWindow(float(low), float(high)) if high > low else GreyWindow(float(low), float(low) + 1.0)


def is_hounsfield(values: NDArray[Any]) -> bool:
    """Whether values look like those of a CT: air near -1000, much of it and of soft tissue, nothing far below air.

    Examples
    --------
    >>> is_hounsfield(np.array([-1000.0, -998, -1003, 40, 60, -90, 300])), is_hounsfield(np.arange(100.0))
    (True, False)
    """
    low = np.percentile(values, 0.5)
    if not -3100 <= low <= -800:  # some scanners pad with -2048 or -3024
        return False
    air, tissue = np.mean((values > -1100) & (values < -700)), np.mean((values > -200) & (values < 250))
    return bool(air > 0.01 and tissue > 0.01)
