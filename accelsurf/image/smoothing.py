"""Gaussian smoothing with a width in mm, and gradients of smoothed images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, with_halo
from accelsurf.image.kernels.smoothing import smooth_across_rows, smooth_rows

#: A Gaussian ends this number of standard deviations from its middle; one narrower than this (voxels) does nothing.
REACH = 4.0
MIN_WIDTH = 1e-15


def gaussian_mm(
    image: NDArray[np.float32],
    spacing: Sequence[float],
    sigma: float,
) -> NDArray[np.float32]:
    """Smooth an image by a Gaussian, along each axis of more than one voxel.

    Beyond its border the image is mirrored: values that leave it there come back, so its mean stays.

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


def gradient_magnitude(
    image: NDArray[Any], spacing: Sequence[float], scale: float
) -> NDArray[np.float32]:
    """|grad I| (nz, ny, nx), float32, per mm, of the image smoothed by a Gaussian of ``scale`` mm.

    Centred differences of the smoothed image, and not a filter of the Gaussian's derivative: that is wrong where the
    Gaussian is narrower than a voxel, as it is across thick slices. An axis with one slice has no slope.
    """
    smooth = gaussian_mm(np.asarray(image, np.float32), spacing, scale)
    total = np.zeros(image.shape, np.float32)
    for axis, n in enumerate(image.shape):
        if n > 1:
            total += np.gradient(smooth, np.float32(spacing[axis]), axis=axis) ** 2
    return np.sqrt(total)


def gaussian_on_box(
    read: Callable[[Box], NDArray[Any]],
    shape: Sequence[int],
    spacing: Sequence[float],
    sigma: float,
    box: Box,
) -> NDArray[np.float32]:
    """A box of the image that `gaussian_mm` makes of a whole one, of which only the box and its halo are read.

    Parameters
    ----------
    read : callable
        Returns the values of a box of the whole image.
    shape, spacing : sequence of 3
        Of the whole image; mm.
    sigma : float
        Standard deviation, mm.
    box : tuple of slice

    Returns
    -------
    ndarray of the box's shape, float32
    """
    halo = [
        reach_of(sigma / h) if n > 1 and sigma > 0 else 0
        for n, h in zip(shape, spacing, strict=True)
    ]

    def smoothed(around: Box) -> NDArray[np.float32]:
        values = read(around).astype(np.float32, copy=False)
        # Errors at faces of the halo reach no further than the halo is wide.
        return gaussian_mm(values, spacing, sigma) if sigma > 0 else values

    return np.ascontiguousarray(with_halo(smoothed, box, shape, halo))


def reach_of(width: float, widths: float = REACH) -> int:
    """Reach (voxels) of the weights of a Gaussian of a ``width`` in voxels, that ends at ``widths`` times its width."""
    return int(widths * width + 0.5) if width > MIN_WIDTH else 0


def gaussian_weights(width: float, widths: float = REACH) -> NDArray[np.float64]:
    """Weights of a voxel and those up to ``widths`` widths, in voxels, to either side; of all they sum up to 1.

    Examples
    --------
    >>> gaussian_weights(0.5).round(3)
    array([0.787, 0.106, 0.   ])
    """
    reach = reach_of(width, widths)
    weights = np.exp(-0.5 / (width * width) * np.arange(-reach, reach + 1) ** 2)
    return np.asarray((weights / weights.sum())[reach:])
