"""Histograms of an image over regions, each voxel shared by the two bins next to it; tables interpolated by value."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BLOCK
from accelsurf.kernels.stages import Stage


@kernel
def bin_of(value, low, per_value, bins):
    """Bin below a value, and the share of the bin above it; values beyond the ends belong to the end bins."""
    place = (np.float64(value) - low) * per_value
    place = min(max(place, 0.0), bins - 1.0)
    below = min(int(place), bins - 2)
    return below, place - below


@kernel(stage=Stage.ENERGY)
def weighted_histogram(first_block, last_block, cells, weight, image, scale, sums):
    """Per block of slots: sums[block] = histogram of the image at ``cells``, each times ``weight``.

    ``scale`` = (value of the first bin, bins per value); the bins are the columns of ``sums``.
    """
    low, per_value = scale
    bins = sums.shape[1]
    for block in range(first_block, last_block):
        for s in range(block * BLOCK, min((block + 1) * BLOCK, cells.shape[0])):
            if weight[s] != 0.0:
                below, share = bin_of(image[cells[s]], low, per_value, bins)
                sums[block, below] += weight[s] * (1.0 - share)
                sums[block, below + 1] += weight[s] * share


@kernel(stage=Stage.ENERGY)
def inside_histogram(first_plane, last_plane, dense, image, grid, scale, sums):
    """Per plane of the volume: histogram of the image over the inside voxels not in the band."""
    low, per_value = scale
    bins = sums.shape[1]
    size = grid.ny * grid.nx
    for plane in range(first_plane, last_plane):
        for cell in range(plane * size, (plane + 1) * size):
            if dense.slot[cell] < 0 and dense.psi[cell] < 0.0:
                below, share = bin_of(image[cell], low, per_value, bins)
                sums[plane, below] += 1.0 - share
                sums[plane, below + 1] += share


@kernel(stage=Stage.ENERGY)
def look_up(start, stop, values, scale, table, out):
    """Write the ``table`` at each of the values of the range, linear between bins, to ``out``."""
    low, per_value = scale
    for s in range(start, stop):
        below, share = bin_of(values[s], low, per_value, table.shape[0])
        out[s] = table[below] + share * (table[below + 1] - table[below])
