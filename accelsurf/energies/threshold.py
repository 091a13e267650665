"""Thresholds with soft edges as a force: grow where the image lies between two values, shrink where it does not."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.energies.image_energy import RegionField
from accelsurf.errors import UsageError
from accelsurf.grid.boxes import runs

#: Width of the soft edge unless given: this part of the image's range, but at most this part of the window, so that
#: g = -1 in its middle.
_SOFT_RANGE = 0.1
_SOFT_WINDOW = 0.25


class Threshold(RegionField):
    """U = int_in g(I) dx + alpha A, g from -1 (inside the window LO..HI) to 1 (outside), f = g + alpha H.

    g = 1 - s((I - LO)/soft) s((HI - I)/soft) / 2 with s(x) = 1 + tanh(x): the speed of region competition that
    ITK-SNAP's users know, with the sign of a force. On a threshold far from the other one g = 0.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit.
    low, high : float, optional
        The window, in the image's unit; None leaves that side open.
    soft : float, optional
        Width of the edges, in the image's unit. By default a tenth of the image's range, but at most a quarter of
        the window.
    alpha : float
        Weight of the area, mm.

    Raises
    ------
    UsageError
        When both sides are open or the low threshold is not below the high one.
    """

    def __init__(
        self,
        image: np.ndarray,
        low: float | None = None,
        high: float | None = None,
        soft: float | None = None,
        alpha: float = 0.0,
    ) -> None:
        a, b = -math.inf if low is None else float(low), math.inf if high is None else float(high)
        if not a < b or (math.isinf(a) and math.isinf(b)):
            raise UsageError(
                f"threshold: {a:g} to {b:g} was given, expected a low value below a high one",
                "one of the two may be left out",
            )
        soft = soft_edge(np.ptp(image), low, high) if soft is None else float(soft)
        super().__init__(threshold_field(image, a, b, soft), alpha)


def soft_edge(values: float, low: float | None, high: float | None) -> float:
    """Width of the edges of a window, in the image's unit, where none is given; ``values``: range of the image's."""
    fraction = _SOFT_RANGE * float(values)
    return fraction if low is None or high is None else min(fraction, _SOFT_WINDOW * (high - low))


def threshold_field(image: np.ndarray, low: float, high: float, soft: float) -> np.ndarray:
    """The field g of `Threshold`, float32 on the image's grid.

    Examples
    --------
    >>> import numpy as np
    >>> threshold_field(np.array([[[0.0, 2.0, 5.0, 9.0]]]), 2, np.inf, 1).round(2)
    array([[[ 0.96, 0. , -1. , -1. ]]], dtype=float32)
    """
    values = np.ascontiguousarray(image, np.float32).reshape(-1)
    out = np.empty(values.size, np.float32)
    for fraction in runs(values.size):
        share = np.ones(values[fraction].size, np.float32)
        if low > -math.inf:
            share *= 0.5 + 0.5 * np.tanh((values[fraction] - np.float32(low)) / np.float32(soft))
        if high < math.inf:
            share *= 0.5 + 0.5 * np.tanh((np.float32(high) - values[fraction]) / np.float32(soft))
        out[fraction] = 1.0 - 2.0 * share
    return out.reshape(np.shape(image))
