"""Grid of a small scan with slices that are thicker than its pixels, and what a scanner makes of values on it."""

import numpy as np
from scipy import ndimage

SHAPE, SPACING = (30, 44, 48), (2.0, 1.0, 0.8)


def grid():
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(SHAPE, SPACING, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


def noisy(values, noise, seed=1):
    """Values blurred by a scanner of 0.7 mm resolution, with noise."""
    blurred = ndimage.gaussian_filter(values.astype(np.float32), [0.7 / h for h in SPACING])
    return blurred + np.random.default_rng(seed).normal(0, noise, SHAPE).astype(np.float32)
