"""The voxels beside the surface, found in the whole volume: rows that lie on one side are skipped."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import neighbours
from accelsurf.kernels.stages import Stage


@kernel(stage=Stage.BAND)
def count_inside(start, stop, psi, grid, inside):
    """Voxels inside, of each of the range's rows along x of the volume: ``inside`` (nz ny,) int32."""
    for row in range(start, stop):
        first = row * grid.nx
        count = 0
        for cell in range(first, first + grid.nx):
            count += psi[cell] < 0.0
        inside[row] = count


@kernel(stage=Stage.BAND)
def count_front(start, stop, psi, grid, inside, counts):
    """Front cells of each of the range's rows: ``counts`` (nz ny,) int64. ``inside`` is that of `count_inside`."""
    near = np.empty(6, np.int64)
    for row in range(start, stop):
        counts[row] = 0
        if is_even(inside, row, grid):
            continue
        for ix in range(grid.nx):
            counts[row] += is_front(psi, grid, row, ix, near)


@kernel(stage=Stage.BAND)
def front_cells(start, stop, psi, grid, inside, ends, cells):
    """Raveled front cells of the range's rows into ``cells``, those of row r before ``ends[r]``, in raster order.

    A front cell has a 6-neighbour on the other side of the surface. ``ends`` (nz ny,) is the running sum of
    `count_front`.
    """
    near = np.empty(6, np.int64)
    for row in range(start, stop):
        if is_even(inside, row, grid):
            continue
        at = ends[row - 1] if row > 0 else 0
        for ix in range(grid.nx):
            if is_front(psi, grid, row, ix, near):
                cells[at] = row * grid.nx + ix
                at += 1


@kernel
def is_front(psi, grid, row, ix, near):
    """Whether a voxel of a row has a 6-neighbour on the other side; ``near`` (6,) int64 is memory for them."""
    cell = row * grid.nx + ix
    neighbours(cell, row // grid.ny, row % grid.ny, ix, grid, near)
    inside = psi[cell] < 0.0
    for side in range(6):
        if near[side] >= 0 and (psi[near[side]] < 0.0) != inside:
            return True
    return False


@kernel
def is_even(inside, row, grid):
    """Whether a row and those beside it are all on one side."""
    own = inside[row]
    even = own == 0 or own == grid.nx
    iz, iy = row // grid.ny, row % grid.ny
    if iz > 0:
        even = even and inside[row - grid.ny] == own
    if iz < grid.nz - 1:
        even = even and inside[row + grid.ny] == own
    if iy > 0:
        even = even and inside[row - 1] == own
    if iy < grid.ny - 1:
        even = even and inside[row + 1] == own
    return even
