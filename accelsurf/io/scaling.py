"""Values of stored numbers that a header scales: slope times stored plus intercept."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError

#: Slopes and intercepts with which no stored number of 64 bits leaves the range of single precision.
_MIN_SLOPE = 1e-30
_MAX_SLOPE = 1e18
_MAX_INTERCEPT = 1e37


def scaled_type(slope: float, intercept: float) -> np.dtype[Any]:
    """Return the type of scaled values: single precision, or double where that would lose them.

    Examples
    --------
    >>> scaled_type(0.5, -1024.0), scaled_type(1e300, 0.0), scaled_type(1e-40, 0.0)
    (dtype('float32'), dtype('float64'), dtype('float64'))
    """
    is_usual = _MIN_SLOPE <= abs(slope) <= _MAX_SLOPE and abs(intercept) <= _MAX_INTERCEPT
    return np.dtype(np.float32 if is_usual else np.float64)


def scaled(
    stored: NDArray[Any], slope: float, intercept: float, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Return scaled values, computed in double precision.

    Parameters
    ----------
    stored : ndarray
    slope, intercept : float
        Finite.
    dtype : numpy.dtype
        Of the values, see `scaled_type`.

    Raises
    ------
    InputError
        When a finite stored number has a value that is none.
    """
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        values = (stored.astype(np.float64) * slope + intercept).astype(dtype)
    if np.isinf(values).any() and (np.isinf(values) & np.isfinite(stored)).any():
        largest = float(np.abs(stored[np.isfinite(stored)]).max())
        raise InputError(
            f"stored numbers up to {largest:g} are scaled by slope {slope:g} and "
            f"intercept {intercept:g}: the values are beyond {np.finfo(dtype).max:.3g}, the largest number",
            "correct the slope in the header, or export the image again",
        )
    return values
