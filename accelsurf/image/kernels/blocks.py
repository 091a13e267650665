"""Sums over blocks of voxels."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def sums_along(values, step):
    """Sums (n, blocks, m) float32 of ``step`` voxels each along the middle axis; the last block may be smaller.

    Parameters
    ----------
    values : ndarray (n, count, m) float32
    step : int
    """
    n, count, m = values.shape
    blocks = (count + step - 1) // step
    out = np.empty((n, blocks, m), np.float32)
    for i in range(n):
        for block in range(blocks):
            first, stop = block * step, min((block + 1) * step, count)
            for k in range(m):
                rest = np.float32(0.0)
                for j in range(first + 1, stop):
                    rest += values[i, j, k]
                out[i, block, k] = values[i, first, k] + rest
    return out
