"""Noise of an image, and the area weight that keeps a surface from following it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import axis_steps

#: Of a normal distribution: median absolute second difference, in standard deviations.
SECOND_DIFFERENCE = 0.6745 * 6.0**0.5
#: Area weight of `area_for_noise` where the noise is as strong as the contrast, in voxels of the smallest spacing:
#: the clicks' model has the same there (`accelsurf.clicks.model.surface`).
WEIGHT = 0.3
#: Approximate number of voxels whose second differences tell the noise of an image.
SAMPLES = 1 << 18


def area_for_noise(deviation: float, shape: Sequence[int], spacing: Sequence[float]) -> float:
    """Weight of the area (mm, times the square of the image's unit) beside squared differences from means.

    A surface that follows the noise gains in the sum of squares as much as its area costs: both grow with the variance.

    Parameters
    ----------
    deviation : float
        Of the noise, as `noise_of` returns it.
    shape : (nz, ny, nx)
    spacing : (hz, hy, hx)
        Of the image's own grid, mm: the weight is the same on all levels.

    Examples
    --------
    >>> area_for_noise(2.0, (9, 9, 9), (3.0, 1.0, 1.5))
    1.2
    """
    return WEIGHT * deviation**2 * min(axis_steps(shape, spacing))


def noise_of(image: NDArray[np.float32]) -> float:
    """Standard deviation of the noise in an image (nz, ny, nx), of the voxels that differ least along an axis.

    By the median absolute second difference, which edges and ramps do not raise; 0 where half of the voxels lie in
    even parts without noise. Of white noise: of smooth noise, which smoothing leaves, it is less.

    Notes
    -----
    Of a large image some voxels are looked at, the same from either end of each axis.
    """
    return noise_of_samples([image[np.ix_(*at)] for at in sample_places(image.shape)])


def sample_places(shape: Sequence[int]) -> list[tuple[NDArray[np.int64], ...]]:
    """Indices (z, y, x) of the voxels that `noise_of` looks at: along each axis those before, at and after places."""
    apart = 1
    while math.prod(math.ceil(n / apart) for n in shape) > SAMPLES:
        apart += 1
    places = []
    for axis in (i for i, n in enumerate(shape) if n > 2):
        at = [_evenly(n - 2 if i == axis else n, apart) for i, n in enumerate(shape)]
        for shift in (0, 1, 2):
            places.append(
                tuple(index + shift if i == axis else index for i, index in enumerate(at))
            )
    return places


def noise_of_samples(samples: Sequence[NDArray[np.float32]]) -> float:
    """The noise, as `noise_of` has it, from the values at its `sample_places`."""
    found = []
    for before, here, after in zip(samples[0::3], samples[1::3], samples[2::3], strict=True):
        found.append(float(np.median(np.abs((before + after) - (here + here)))) / SECOND_DIFFERENCE)
    return min(found, default=0.0)


def _evenly(count: int, apart: int) -> NDArray[np.int64]:
    """Indices up to ``count``, one in ``apart``, the same counted from the other end."""
    half = np.arange((count - 1) // 2, -1, -apart)[::-1]
    return np.union1d(half, count - 1 - half)
