"""Smoothing of images by lengths in mm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


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
