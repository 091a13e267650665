"""Values at given points: of dense arrays, of fields of the band, and of an array that lies shifted on another grid."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel
from accelsurf.kernels.interpolate import value_and_gradient, value_at
from accelsurf.kernels.stages import Stage
from accelsurf.kernels.transport import band_vector_at


@kernel(stage=Stage.EXTENSION)
def fields_at_points(start, stop, slot, grid, values, points, out, known):
    """Band fields ``values`` (n, k) at ``points`` (m, 3), index coordinates, into ``out`` (m, k), see `band_vector_at`.

    ``known`` (m,): False, and 0, where no cell of the band is around the point.
    """
    w = np.empty(24)
    found = np.empty(values.shape[1])
    for p in range(start, stop):
        known[p] = band_vector_at(values, slot, grid, points[p], w, found)
        for c in range(values.shape[1]):
            out[p, c] = found[c] if known[p] else 0.0


@kernel(stage=Stage.ENERGY)
def value_and_gradient_at_points(start, stop, array, grid, points, out):
    """A raveled dense array at ``points`` (m, 3), index coordinates: value and slopes z, y, x per mm, (m, 4)."""
    w = np.empty(24)
    for p in range(start, stop):
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = value_and_gradient(
            array, grid, points[p, 0], points[p, 1], points[p, 2], w
        )


@kernel(stage=Stage.ADVANCE)
def resample_shifted(start, stop, array, grid, first, target, out):
    """A raveled dense array at the places of the voxels of the ``target`` grid, raveled, into ``out``.

    ``first`` (3,), index coordinates of ``grid``: where the first voxel of the target lies; spacings are the same.
    """
    w = np.empty(24)
    for cell in range(start, stop):
        iz, iy, ix = unravel(cell, target)
        out[cell] = value_at(array, grid, first[0] + iz, first[1] + iy, first[2] + ix, w)
