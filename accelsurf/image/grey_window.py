"""Values that are shown black and white: selected from an object and its surroundings, or from the whole image."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.boxes import bounding_box

#: Voxels that a window is selected from at most.
MAX_SAMPLES = 300_000
#: Percentiles of the object, of its surroundings and of a whole image that are taken as their ends.
OBJECT_ENDS = (2.0, 98.0)
AROUND_ENDS = (3.0, 97.0)
IMAGE_ENDS = (1.0, 99.0)
#: Largest width of the window, in widths of the object's own range, so that differences near its edge show.
MAX_OBJECT_WIDTHS = 4.0
#: Width, in voxels, of the rim of neighbours around an object; part of the rim beyond which neighbours count.
RIM = 3
TOUCHING = 0.005
#: Most voxels in which a rim is looked for, in some of the slices.
MAX_RIM = 1 << 22
#: Windows of CT by name, level (the value of the middle grey) and width, Hounsfield units.
CT_WINDOWS = {
    "soft-tissue": (40.0, 400.0),
    "bone": (500.0, 2000.0),
    "lung": (-600.0, 1500.0),
    "brain": (40.0, 80.0),
}
#: Of a CT without an object: the window that radiologists begin with.
SOFT_TISSUE = CT_WINDOWS["soft-tissue"]
#: Name of a window that follows from object and image.
AUTO = "auto"


class GreyWindow(NamedTuple):
    """Values that are drawn black and white."""

    low: float
    high: float

    @classmethod
    def of(cls, level: float, width: float) -> GreyWindow:
        """The window with this middle and width."""
        return cls(level - 0.5 * width, level + 0.5 * width)

    @property
    def level(self) -> float:
        """The value of the middle grey."""
        return 0.5 * (self.low + self.high)

    @property
    def width(self) -> float:
        """From black to white."""
        return self.high - self.low

    @property
    def text(self) -> str:
        """Level (radiologists also say centre) and width."""
        return f"L {self.level:.4g} W {self.width:.4g}"

    def grey(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Grey values of an array; values that are not finite are black."""
        share = (np.asarray(values, np.float32) - np.float32(self.low)) / np.float32(
            self.high - self.low
        )
        return (
            255.0 * np.clip(np.nan_to_num(share, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
        ).astype(np.uint8)


def parse_window(text: str) -> GreyWindow | None:
    """Return the window that was typed as ``LEVEL,WIDTH`` or by name; None for ``auto``.

    Raises
    ------
    UsageError
        For anything else.

    Examples
    --------
    >>> parse_window("40,400"), parse_window("brain"), parse_window("auto")
    (GreyWindow(low=-160.0, high=240.0), GreyWindow(low=0.0, high=80.0), None)
    """
    if text == AUTO:
        return None
    if text in CT_WINDOWS:
        return GreyWindow.of(*CT_WINDOWS[text])
    try:
        level, width = (float(part) for part in text.split(","))
    except ValueError:
        level = width = math.nan
    if not (math.isfinite(level) and math.isfinite(width) and width > 0):
        names = ", ".join((AUTO, *CT_WINDOWS))
        raise UsageError(
            f"window: {text[:40]!r} was given, expected {names}, or level and width above 0 with a comma between them",
            "as in 40,400 for soft tissue in CT",
        )
    return GreyWindow.of(level, width)


def checked_window(value: Any) -> Any:
    """Check a window as a setting gives it; a value that is no text is left to the type of the setting."""
    if isinstance(value, str):
        parse_window(value)
    return value


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
        With an object: from the values around it and of its neighbours, brighter or darker, so that the two differ;
        but not wider than `MAX_OBJECT_WIDTHS` times its own range around its median. Else `SOFT_TISSUE` for values that
        are Hounsfield units, or percentiles of all but the most frequent value (the zeros around a stripped brain).
    """
    stride = max(1, math.ceil((image.size / MAX_SAMPLES) ** (1 / 3)))
    part = tuple(slice(None, None, stride if n > 2 * stride else 1) for n in image.shape)
    values = np.asarray(image[part], np.float64).ravel()
    finite = np.isfinite(values)
    sample = (
        np.zeros(0)
        if inside is None
        else np.asarray(image[inside][:: max(1, inside.sum() // MAX_SAMPLES)], float)
    )
    object_values = sample[np.isfinite(sample)]
    values = values[finite]
    if not values.size:
        return GreyWindow(0.0, 1.0)
    if object_values.size:
        low, middle, high = np.percentile(object_values, (OBJECT_ENDS[0], 50.0, OBJECT_ENDS[1]))
        around = np.percentile(values, AROUND_ENDS)
        darkest, brightest = _touching(image, inside, low, high)
        room = 0.5 * MAX_OBJECT_WIDTHS * (high - low) or math.inf
        low = max(min(low, around[0], darkest), middle - room)
        high = min(max(high, around[1], brightest), middle + room)
    elif is_hounsfield(values):
        low, high = SOFT_TISSUE[0] - SOFT_TISSUE[1] / 2, SOFT_TISSUE[0] + SOFT_TISSUE[1] / 2
    else:
        kinds, counts = np.unique(values, return_counts=True)
        most = kinds[np.argmax(counts)]
        filled = (
            values[values != most]
            if counts.max() > 0.2 * values.size and len(kinds) > 2
            else values
        )
        low, high = np.percentile(filled, IMAGE_ENDS)
        if filled is not values:
            low = min(low, most)
    return (
        GreyWindow(float(low), float(high))
        if high > low
        else GreyWindow(float(low), float(low) + 1.0)
    )


def _touching(
    image: NDArray[Any], inside: NDArray[np.bool_] | None, low: float, high: float
) -> tuple[float, float]:
    """Return the typical values of an object's neighbours darker than ``low``, and brighter than ``high``.

    The bounds themselves where there are none. At the ribs a spleen that is all white would leak unseen.
    """
    box = None if inside is None else bounding_box(inside, RIM)
    if inside is None or box is None:
        return low, high
    from scipy import ndimage  # a picture without an object does without SciPy

    every = slice(None, None, 1 + inside[box].size // MAX_RIM)
    part = inside[box][every]
    rim = ndimage.binary_dilation(part, np.ones((1, 3, 3)), iterations=RIM) & ~part  # within slices
    values = np.asarray(image[box][every][rim], np.float64)
    values = values[np.isfinite(values)]
    darker, brighter = values[values < low], values[values > high]
    return (
        float(np.median(darker)) if darker.size > TOUCHING * values.size else low,
        float(np.median(brighter)) if brighter.size > TOUCHING * values.size else high,
    )


def is_hounsfield(values: NDArray[Any]) -> bool:
    """Test if values look like CT: air near -1000, much of it and of soft tissue, nothing far below air.

    Examples
    --------
    >>> is_hounsfield(np.array([-1000.0, -998, -1003, 40, 60, -90, 300])), is_hounsfield(np.arange(100.0))
    (True, False)
    """
    low = np.percentile(values, 0.5)
    if not -3100 <= low <= -800:  # some scanners pad with -2048 or -3024
        return False
    air, tissue = (
        np.mean((values > -1100) & (values < -700)),
        np.mean((values > -200) & (values < 250)),
    )
    return bool(air > 0.01 and tissue > 0.01)
