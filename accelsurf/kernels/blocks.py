"""Sums over blocks of voxels along one axis, and how many voxels differ from the next."""

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


@kernel
def count_changes(values, limit):
    """Number of pairs of neighbours (nz, ny, nx) that differ by more than ``limit`` float32, and of all pairs."""
    nz, ny, nx = values.shape
    above = 0
    for iz in range(nz):
        for iy in range(ny):
            row = values[iz, iy]
            for ix in range(nx - 1):
                above += abs(row[ix + 1] - row[ix]) > limit
            if iy < ny - 1:
                beside = values[iz, iy + 1]
                for ix in range(nx):
                    above += abs(beside[ix] - row[ix]) > limit
            if iz < nz - 1:
                beside = values[iz + 1, iy]
                for ix in range(nx):
                    above += abs(beside[ix] - row[ix]) > limit
    return above, nz * ny * (nx - 1) + nz * (ny - 1) * nx + (nz - 1) * ny * nx
