"""Euclidean distances to marked voxels, as far as they are asked for: one axis after the other, over short windows.

d^2(z, y, x) = min over z' of (z - z')^2 hz^2 + min over y' of (y - y')^2 hy^2 + min over x' of (x - x')^2 hx^2. Within
six voxels this takes a fifth of the time of a transform that finds the nearest voxel at any distance.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def distances_within(marked, spacing, reach):
    """Distance from each voxel's centre to that of the nearest marked one.

    Parameters
    ----------
    marked : ndarray (nz, ny, nx) bool
    spacing : (hz, hy, hx) float64
        mm.
    reach : float
        mm; the time goes with it.

    Returns
    -------
    ndarray (nz, ny, nx) float32
        mm; inf where none is within ``reach``.
    """
    nz, ny, nx = marked.shape
    hz, hy, hx = spacing
    # What rounds to just beyond is not.
    farthest = np.float32((reach * (1.0 + 1e-6)) ** 2)
    along_x, known = squares_along_rows(marked, hx, farthest)
    square = np.full((nz, ny, nx), np.float32(np.inf))
    found = np.zeros((nz, ny), np.bool_)
    for iz in range(nz):
        nearest_of_rows(along_x[iz], known[iz], hy, farthest, square[iz], found[iz])
    out = np.full((nz, ny, nx), np.float32(np.inf))
    for iy in range(ny):
        nearest_of_rows(square[:, iy], found[:, iy], hz, farthest, out[:, iy], known[:, iy])
    for iz in range(nz):
        for iy in range(ny):
            row = out[iz, iy]
            for ix in range(nx):
                row[ix] = np.sqrt(row[ix]) if row[ix] <= farthest else np.float32(np.inf)
    return out


@kernel
def squares_along_rows(marked, hx, farthest):
    """Squared distance (nz, ny, nx) float32 to the nearest marked voxel of the same row; which rows have one."""
    nz, ny, nx = marked.shape
    out = np.full((nz, ny, nx), np.float32(np.inf))
    known = np.zeros((nz, ny), np.bool_)
    for iz in range(nz):
        for iy in range(ny):
            here = marked[iz, iy]
            row = out[iz, iy]
            last = -1
            for ix in range(nx):
                if here[ix]:
                    last = ix
                if last >= 0:
                    row[ix] = np.float32(((ix - last) * hx) ** 2)
            known[iz, iy] = last >= 0
            last = -1
            for ix in range(nx - 1, -1, -1):
                if here[ix]:
                    last = ix
                if last >= 0:
                    row[ix] = min(row[ix], np.float32(((last - ix) * hx) ** 2))
    return out, known


@kernel
def nearest_of_rows(rows, known, h, farthest, out, found):
    """Smallest sum of a row's squares and the squared distance to it: ``rows`` (n, m) one ``h`` apart, into ``out``.

    ``known`` (n,) bool: the rows that have a number. ``found`` (n,) bool receives those of ``out``.
    """
    n, m = rows.shape
    window = int(np.sqrt(farthest) / h)
    for i in range(n):
        found[i] = False
        for j in range(max(i - window, 0), min(i + window + 1, n)):
            apart = np.float32(((i - j) * h) ** 2)
            if known[j] and apart <= farthest:
                found[i] = True
                here, there = out[i], rows[j]
                for k in range(m):
                    here[k] = min(here[k], there[k] + apart)
