"""Likelihood of a value inside and around: ratios of smoothed histograms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

#: Bins of a histogram and the Gaussian that smooths it, in bins.
BINS, WIDTH = 128, 2.0


def log_ratio(
    images: Sequence[NDArray[np.float32]], inside: NDArray[np.bool_], around: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """(p - q)/(p + q) of the densities p inside and q around; the channels count as independent.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    inside, around : ndarray (nz, ny, nx) of bool
        Without voxels in one of them the ratio is 0.
    """
    total = np.zeros(images[0].shape, np.float32)
    if not (inside.any() and around.any()):
        return total
    for image in images:
        samples = image[inside], image[around]
        both = np.concatenate(samples)
        low, high = (float(v) for v in np.percentile(both, (0.5, 99.5)))
        if not high > low:
            continue
        scale = BINS / (high - low)
        density = [_density(part, low, scale) for part in samples]
        table = np.log(density[0] / density[1]).astype(np.float32)
        total += table[np.clip((image - low) * scale, 0, BINS - 1).astype(np.int32)]
    return np.asarray(np.tanh(0.5 * total))


def _density(values: NDArray[np.float32], low: float, scale: float) -> NDArray[np.float64]:
    counts = np.bincount(np.clip((values - low) * scale, 0, BINS - 1).astype(np.int64), minlength=BINS)
    smooth = ndimage.gaussian_filter1d(counts.astype(np.float64), WIDTH, mode="nearest")
    return np.asarray((smooth + 0.01 * smooth.mean()) / smooth.sum())
