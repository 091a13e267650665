"""Gaussian smoothing with a width in mm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.kernels.smoothing import smooth_across_rows, smooth_rows

#: A Gaussian ends so many standard deviations from its middle; one narrower than this (voxels) does nothing.
REACH, MIN_WIDTH = 4.0, 1e-15


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
    image = np.ascontiguousarray(image, np.float32)
    out = np.empty_like(image)
    if widths[0] > MIN_WIDTH:
        smooth_across_rows(image, gaussian_weights(widths[0]), 0, out)
    else:
        np.copyto(out, image)
    if widths[1] > MIN_WIDTH:
        for plane in range(len(out)):
            part = out[plane : plane + 1]
            smooth_across_rows(part.copy(), gaussian_weights(widths[1]), 1, part)
    if widths[2] > MIN_WIDTH:
        smooth_rows(out, gaussian_weights(widths[2]), out)
    return out


def gaussian_weights(width: float) -> NDArray[np.float64]:
    """Weights of a voxel and of those up to four widths, in voxels, to either side of it; of all they sum up to 1.

    Examples
    --------
    >>> gaussian_weights(0.5).round(3)
    array([0.787, 0.106, 0.   ])
    """
    reach = int(REACH * width + 0.5)
    weights = np.exp(-0.5 / (width * width) * np.arange(-reach, reach + 1) ** 2)
    return np.asarray((weights / weights.sum())[reach:])
