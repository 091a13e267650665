"""Which values of an image are drawn black and white: a window, as radiologists say, with its level (the middle)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.errors import UsageError

#: Windows of CT by name, (level, width), Hounsfield units; the common ones of radiology.
CT_WINDOWS = {
    "soft-tissue": (40.0, 400.0),
    "bone": (500.0, 2000.0),
    "lung": (-600.0, 1500.0),
    "brain": (40.0, 80.0),
}
#: Windows that follow from the image: from all of it, and from the object and what lies around it.
IMAGE, OBJECT = "image", "auto"
#: Percentiles of the values that are drawn black and white in these.
PERCENTILES = (1.0, 99.0)
#: Voxels along each axis at most from which percentiles are taken.
SAMPLES = 128


class GreyWindow(NamedTuple):
    """The ``level``, the value drawn in the middle grey, and the ``width`` from black to white."""

    level: float
    width: float

    @property
    def low(self) -> float:
        """The value from which on voxels are drawn black."""
        return self.level - 0.5 * self.width

    @property
    def high(self) -> float:
        """The value from which on voxels are drawn white."""
        return self.level + 0.5 * self.width

    def grey(self, values: ArrayLike) -> NDArray[np.uint8]:
        """Values as grey from 0 to 255; what is no number is black.

        Examples
        --------
        >>> GreyWindow(40.0, 400.0).grey([-1000.0, 40.0, 240.0, float("nan")]).tolist()
        [0, 127, 255, 0]
        """
        shown = np.nan_to_num(np.asarray(values, np.float32), nan=self.low, posinf=self.high, neginf=self.low)
        shown -= np.float32(self.low)
        shown *= np.float32(255.0 / self.width if self.width > 0 else 0.0)
        return np.clip(shown, 0.0, 255.0, out=shown).astype(np.uint8)


def window_of(values: NDArray[np.generic]) -> GreyWindow:
    """Return the window from the 1st to the 99th percentile of values (of a sample where there are many).

    Examples
    --------
    >>> window_of(np.arange(101.0))
    GreyWindow(level=50.0, width=98.0)
    """
    sample = values[tuple(slice(None, None, max(1, n // SAMPLES)) for n in values.shape)]
    sample = sample[np.isfinite(sample)] if sample.dtype.kind == "f" else sample
    low, high = np.percentile(sample, PERCENTILES) if sample.size else (0.0, 1.0)
    if not high > low:
        low, high = (float(sample.min()), float(sample.max())) if sample.size else (0.0, 1.0)
    return GreyWindow(float(0.5 * (low + high)), float(high - low) or 1.0)


def parse_window(text: str) -> GreyWindow | str:
    """Return the window of a text, ``LEVEL,WIDTH`` or a name of `CT_WINDOWS`; ``image`` and ``auto`` as they are.

    Raises
    ------
    UsageError
        For another text.

    Examples
    --------
    >>> parse_window("40,400"), parse_window("brain"), parse_window("auto")
    (GreyWindow(level=40.0, width=400.0), GreyWindow(level=40.0, width=80.0), 'auto')
    """
    if text in (IMAGE, OBJECT):
        return text
    if text in CT_WINDOWS:
        return GreyWindow(*CT_WINDOWS[text])
    try:
        level, width = (float(part) for part in text.split(","))
    except ValueError:
        level = width = math.nan
    if not (math.isfinite(level) and math.isfinite(width) and width > 0):
        names = ", ".join((IMAGE, OBJECT, *CT_WINDOWS))
        raise UsageError(f"window: {text!r} was given, expected LEVEL,WIDTH with a width above 0, or {names}")
    return GreyWindow(level, width)
