"""Symmetric weighted means along the axes of an image, which is mirrored at its border."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def smooth_across_rows(values, weights, axis, out):
    """Smooth along an axis that is not the last one.

    Parameters
    ----------
    values : ndarray (nz, ny, nx) float32
    weights : ndarray (r + 1,) float64
        Of the voxel itself and of those so far to either side.
    axis : int
        0 or 1.
    out : ndarray (nz, ny, nx) float32
        Written; not ``values``.
    """
    nz, ny, nx = values.shape
    total = np.empty(nx)
    for iz in range(nz):
        for iy in range(ny):
            for ix in range(nx):
                total[ix] = weights[0] * values[iz, iy, ix]
            for far in range(len(weights) - 1, 0, -1):
                az = mirrored(iz - far, nz) if axis == 0 else iz
                bz = mirrored(iz + far, nz) if axis == 0 else iz
                ay = mirrored(iy - far, ny) if axis == 1 else iy
                by = mirrored(iy + far, ny) if axis == 1 else iy
                for ix in range(nx):
                    both = np.float64(values[az, ay, ix]) + np.float64(values[bz, by, ix])
                    total[ix] += weights[far] * both
            for ix in range(nx):
                out[iz, iy, ix] = total[ix]


@kernel
def smooth_rows(values, weights, out):
    """Smooth along the last axis; as `smooth_across_rows`, but ``out`` may be ``values``."""
    nz, ny, nx = values.shape
    room = len(weights) - 1
    row, total = np.empty(nx + 2 * room), np.empty(nx)
    for iz in range(nz):
        for iy in range(ny):
            for ix in range(nx):
                row[room + ix] = values[iz, iy, ix]
            for far in range(1, room + 1):
                row[room - far] = values[iz, iy, mirrored(-far, nx)]
                row[room + nx - 1 + far] = values[iz, iy, mirrored(nx - 1 + far, nx)]
            for ix in range(nx):
                total[ix] = weights[0] * row[room + ix]
            for far in range(room, 0, -1):
                for ix in range(nx):
                    total[ix] += weights[far] * (row[room + ix - far] + row[room + ix + far])
            for ix in range(nx):
                out[iz, iy, ix] = total[ix]


@kernel
def mirrored(index, count):
    """The index within 0 .. count - 1 of one beyond it: the border lies half a voxel beyond the last ones."""
    place = index % (2 * count)
    return place if place < count else 2 * count - 1 - place
