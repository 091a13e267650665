"""How much more likely a value is inside than around: ratios of smoothed histograms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

#: Bins of a histogram and the Gaussian that smooths it, in bins.
BINS, WIDTH = 128, 2.0


def log_ratio(
    images: Sequence[NDArray[np.float32]], inside: NDArray[np.int64], around: NDArray[np.int64]
) -> NDArray[np.float32]:
    """(p - q)/(p + q) of the densities p inside and q around; the channels count as independent.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    inside, around : ndarray of int64
        Raveled voxels.
    """
    total = np.zeros(images[0].shape, np.float32)
    for image in images:
        flat = image.ravel()
        both = np.concatenate((flat[inside], flat[around]))
        low, high = (float(v) for v in np.percentile(both, (0.5, 99.5)))
        if not high > low:
            continue
        scale = BINS / (high - low)
        density = [_density(flat[part], low, scale) for part in (inside, around)]
        table = np.log(density[0] / density[1]).astype(np.float32)
        total += table[np.clip((image - low) * scale, 0, BINS - 1).astype(np.int32)]
    return np.tanh(0.5 * total)


def _density(values: NDArray[np.float32], low: float, scale: float) -> NDArray[np.float64]:
    counts = np.bincount(np.clip((values - low) * scale, 0, BINS - 1).astype(np.int64), minlength=BINS)
    smooth = ndimage.gaussian_filter1d(counts.astype(np.float64), WIDTH, mode="nearest")
    return np.asarray((smooth + 0.01 * smooth.mean()) / smooth.sum())
