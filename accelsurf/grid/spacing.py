"""Spacings of the axes that count: an axis of one slice has a thickness, but nothing happens along it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


def counted_spacings(shape: Sequence[int], spacing: Sequence[float]) -> tuple[float, ...]:
    """Return the spacings (mm) of the axes with more than one slice, in array order.

    Examples
    --------
    >>> counted_spacings((1, 20, 30), (5.0, 0.5, 0.7))
    (0.5, 0.7)
    """
    return tuple(float(h) for n, h in zip(shape, spacing, strict=True) if n > 1)


def smallest_spacing(shape: Sequence[int], spacing: Sequence[float]) -> float:
    """Return the smallest spacing (mm) among the axes with more than one slice; 1 where there is none."""
    return min(counted_spacings(shape, spacing), default=1.0)


def largest_spacing(shape: Sequence[int], spacing: Sequence[float]) -> float:
    """Return the largest spacing (mm) among the axes with more than one slice; 1 where there is none."""
    return max(counted_spacings(shape, spacing), default=1.0)


def gaussian_smoothed(
    image: NDArray[np.generic], spacing: Sequence[float], sigma: float, mode: str = "nearest"
) -> NDArray[np.float32]:
    """Return an image, float32, smoothed by a Gaussian along each axis of more than one slice.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
    spacing : (hz, hy, hx)
        mm.
    sigma : float
        Standard deviation of the Gaussian, mm.
    mode : str, optional
        What is beyond the border, as in `scipy.ndimage.gaussian_filter`.
    """
    widths = [sigma / h if n > 1 else 0.0 for n, h in zip(image.shape, spacing, strict=True)]
    return np.asarray(ndimage.gaussian_filter(np.asarray(image, np.float32), widths, mode=mode))
