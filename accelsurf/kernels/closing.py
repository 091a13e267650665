"""The largest value within a footprint around each voxel, of which a grey closing is made."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def dilate(values, lines, out):
    """Largest of the values of a footprint, for each voxel; what lies beyond the border does not count.

    The footprint is a set of lines along the last axis. Those of equal length are compared first, from the longest on,
    and what was found is then widened by a voxel to either side for each voxel that the next ones are shorter: a pass
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
