"""Dense layers of a small network, with sums in one order whatever the number of threads."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel

#: Columns that are computed together: their inputs stay in the cache.
TILE = 256


@kernel
def layer(values, weights, biases, is_rectified):
    """Outputs (m, k) float32 of a layer: sum over i of weights[i, j] values[i], plus biases[j]; cut at 0 if rectified.

    Parameters
    ----------
    values : ndarray (n, k) float32
        A column for each case.
    weights : ndarray (n, m) float32
    biases : ndarray (m,) float32
    is_rectified : bool
    """
    n, k = values.shape
    m = len(biases)
    out = np.empty((m, k), np.float32)
    for first in range(0, k, TILE):
        stop = min(first + TILE, k)
        for j in range(m):
            total = out[j, first:stop]
            total[:] = biases[j]
            for i in range(n):
                weight, row = weights[i, j], values[i, first:stop]
                for c in range(stop - first):
                    total[c] += weight * row[c]
            if is_rectified:
                for c in range(stop - first):
                    total[c] = max(total[c], np.float32(0.0))
    return out
