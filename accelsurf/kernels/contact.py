"""Contact of a surface with another one on a grid of its own: the points that touch, and the cells in both."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel
from accelsurf.kernels.interpolate import linear_at


@kernel
def touching(points, dense, grid, corner, reach, width):
    """Points at most so far from the inside of another surface, and in its band.

    Parameters
    ----------
    points : ndarray (n, 3) float64
        In voxels of the common grid.
    dense : DenseArrays
        Of the other surface.
    grid : Grid
        Its grid.
    corner : ndarray (3,) float64
        Where that begins in the common one.
    reach : float
        Points beyond its border count as on it up to so many voxels, along each axis.
    width : float
        How far, mm.

    Returns
    -------
    near : ndarray (m,) int64
        Rising.
    slots : ndarray (m,) int32
        Of the other's band, the nearest voxel's.
    share : ndarray (m,) float32
        1 - gap/width, at most 1; the gap is the other's psi, between voxels linear.
    """
    n = len(points)
    near, slots, share = np.empty(n, np.int64), np.empty(n, np.int32), np.empty(n, np.float32)
    last_z, last_y, last_x = grid.nz - 1.0, grid.ny - 1.0, grid.nx - 1.0
    count = 0
    for i in range(n):
        z, y, x = points[i, 0] - corner[0], points[i, 1] - corner[1], points[i, 2] - corner[2]
        if not (-reach <= z <= last_z + reach and -reach <= y <= last_y + reach and -reach <= x <= last_x + reach):
            continue
        z, y, x = min(max(z, 0.0), last_z), min(max(y, 0.0), last_y), min(max(x, 0.0), last_x)
        slot = dense.slot[(np.int64(np.rint(z)) * grid.ny + np.int64(np.rint(y))) * grid.nx + np.int64(np.rint(x))]
        if slot < 0:
            continue
        gap = np.float32(linear_at(dense.psi, grid, z, y, x))
        part = np.float32(min(max(1.0 - gap / width, 0.0), 1.0))
        if part > 0:
            near[count], slots[count], share[count] = i, slot, part
            count += 1
    return near[:count].copy(), slots[:count].copy(), share[:count].copy()


@kernel
def shared_cells(cells, grid, psi, other, shift):
    """Find the cells that lie on another grid too: positions (m,) int64 in ``cells``, and the psi (m,) float32 there.

    Parameters
    ----------
    cells : ndarray (n,) int64
        Of ``grid``.
    grid : Grid
    psi : ndarray float32
        Dense, on the other grid.
    other : Grid
    shift : ndarray (3,) int64
        From an index to that in the other grid.
    """
    on, values = np.empty(len(cells), np.int64), np.empty(len(cells), np.float32)
    count = 0
    for i in range(len(cells)):
        iz, iy, ix = unravel(cells[i], grid)
        jz, jy, jx = iz + shift[0], iy + shift[1], ix + shift[2]
        if 0 <= jz < other.nz and 0 <= jy < other.ny and 0 <= jx < other.nx:
            on[count], values[count] = i, psi[(jz * other.ny + jy) * other.nx + jx]
            count += 1
    return on[:count].copy(), values[:count].copy()
