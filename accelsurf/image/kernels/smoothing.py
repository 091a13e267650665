"""Means and maxima around each voxel of an image: weighted along the axes, which mirror it, and of a footprint."""

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
        Weight of the voxel itself, and of the voxels at each distance to either side.
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
            for offset in range(len(weights) - 1, 0, -1):
                az = mirrored(iz - offset, nz) if axis == 0 else iz
                bz = mirrored(iz + offset, nz) if axis == 0 else iz
                ay = mirrored(iy - offset, ny) if axis == 1 else iy
                by = mirrored(iy + offset, ny) if axis == 1 else iy
                for ix in range(nx):
                    both = np.float64(values[az, ay, ix]) + np.float64(values[bz, by, ix])
                    total[ix] += weights[offset] * both
            for ix in range(nx):
                out[iz, iy, ix] = total[ix]


@kernel
def smooth_rows(values, weights, out):
    """Smooth along the last axis; as `smooth_across_rows`, but ``out`` may be ``values``."""
    nz, ny, nx = values.shape
    margin = len(weights) - 1
    row, total = np.empty(nx + 2 * margin), np.empty(nx)
    for iz in range(nz):
        for iy in range(ny):
            for ix in range(nx):
                row[margin + ix] = values[iz, iy, ix]
            for offset in range(1, margin + 1):
                row[margin - offset] = values[iz, iy, mirrored(-offset, nx)]
                row[margin + nx - 1 + offset] = values[iz, iy, mirrored(nx - 1 + offset, nx)]
            for ix in range(nx):
                total[ix] = weights[0] * row[margin + ix]
            for offset in range(margin, 0, -1):
                for ix in range(nx):
                    total[ix] += weights[offset] * (
                        row[margin + ix - offset] + row[margin + ix + offset]
                    )
            for ix in range(nx):
                out[iz, iy, ix] = total[ix]


@kernel
def mirrored(index, count):
    """The index within 0 .. count - 1 of one beyond it: the border lies half a voxel beyond the last ones."""
    place = index % (2 * count)
    return place if place < count else 2 * count - 1 - place


@kernel
def dilate(values, lines, out):
    """Largest of the values of a footprint, for each voxel; voxels beyond the border do not count.

    The footprint is a set of lines along the last axis. Those of equal length are compared first, from the longest on,
    and the result is then widened by a voxel to either side for each voxel that the next ones are shorter: a pass
    over a row for each line, not for each voxel of it.

    Parameters
    ----------
    values : ndarray (nz, ny, nx) float32
    lines : ndarray (n, 3) int64
        Steps (z, y) from a voxel to the middles of the lines, and their half lengths, the longest first.
    out : ndarray (nz, ny, nx) float32
        Written; not ``values``.
    """
    nz, ny, nx = values.shape
    row, narrow = np.empty(nx, np.float32), np.empty(nx, np.float32)
    for iz in range(nz):
        for iy in range(ny):
            row[:] = np.float32(-np.inf)
            half = lines[0, 2]
            for number in range(len(lines)):
                while half > lines[number, 2]:
                    widen(row, narrow)
                    half -= 1
                jz, jy = iz + lines[number, 0], iy + lines[number, 1]
                if 0 <= jz < nz and 0 <= jy < ny:
                    other = values[jz, jy]
                    for ix in range(nx):
                        row[ix] = other[ix] if other[ix] > row[ix] else row[ix]
            while half > 0:
                widen(row, narrow)
                half -= 1
            out[iz, iy] = row


@kernel
def widen(row, narrow):
    """Replace each value of a row by the largest of itself and its neighbours; ``narrow`` is memory of its length."""
    narrow[:] = row
    for ix in range(len(row) - 1):
        row[ix] = narrow[ix + 1] if narrow[ix + 1] > row[ix] else row[ix]
    for ix in range(1, len(row)):
        row[ix] = narrow[ix - 1] if narrow[ix - 1] > row[ix] else row[ix]
