"""Gaussian smoothing with a width in mm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


def gaussian_mm(
    image: NDArray[np.float32],
    spacing: Sequence[float],
    sigma: float,
) -> NDArray[np.float32]:
    """Smooth an image by a Gaussian, along each axis of more than one voxel.

    Beyond its border the image is mirrored: what leaves it there comes back, so its mean stays.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    sigma : float
        Standard deviation, mm.

    Returns
    -------
    ndarray (nz, ny, nx), float32
        A new array.

    Examples
    --------
    >>> image = np.zeros((1, 1, 5), np.float32)
    >>> image[0, 0, 2] = 1
    >>> gaussian_mm(image, (9.0, 9.0, 2.0), 1.0).round(3)
    array([[[0.   , 0.106, 0.787, 0.106, 0.   ]]], dtype=float32)
    """
    widths = [sigma / h if n > 1 else 0.0 for n, h in zip(image.shape, spacing, strict=True)]
    return np.asarray(ndimage.gaussian_filter(image, widths, output=np.float32, mode="reflect"))
