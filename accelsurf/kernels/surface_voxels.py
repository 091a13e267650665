"""The voxels beside the surface, found in the whole volume: rows that lie on one side are skipped."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import neighbours
from accelsurf.kernels.stages import Stage


@kernel(stage=Stage.BAND)
def front_cells(dense, grid, out):
    """Raveled cells of the whole volume with a 6-neighbour on the other side of the surface, in raster order.

    With ``out`` too short, only the count is right: call again with room. Returns the count.
    """
    psi = dense.psi
    count = 0
    near = np.empty(6, np.int64)
    sides = sides_of_rows(psi, grid)
    for iz in range(grid.nz):
        for iy in range(grid.ny):
            if is_even(sides, iz, iy):
                continue
            for ix in range(grid.nx):
                cell = (iz * grid.ny + iy) * grid.nx + ix
                neighbours(cell, iz, iy, ix, grid, near)
                inside = psi[cell] < 0.0
                for side in range(6):
                    if near[side] >= 0 and (psi[near[side]] < 0.0) != inside:
                        if count < out.shape[0]:
                            out[count] = cell
                        count += 1
                        break
    return count


@kernel
def sides_of_rows(psi, grid):
    """Of each row along x (nz, ny) int8: 0 where all of it is outside, 1 where all is inside, 2 where it is mixed."""
    sides = np.empty((grid.nz, grid.ny), np.int8)
    for iz in range(grid.nz):
        for iy in range(grid.ny):
            first = (iz * grid.ny + iy) * grid.nx
            inside = 0
            for cell in range(first, first + grid.nx):
                inside += psi[cell] < 0.0
            sides[iz, iy] = 0 if inside == 0 else 1 if inside == grid.nx else 2
    return sides


@kernel
def is_even(sides, iz, iy):
    """Whether a row and those beside it are all on one side."""
    own = sides[iz, iy]
    even = own < 2
    if iz > 0:
        even = even and sides[iz - 1, iy] == own
    if iz < sides.shape[0] - 1:
        even = even and sides[iz + 1, iy] == own
    if iy > 0:
        even = even and sides[iz, iy - 1] == own
    if iy < sides.shape[1] - 1:
        even = even and sides[iz, iy + 1] == own
    return even
