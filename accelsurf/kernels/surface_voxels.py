"""The voxels beside the surface, found in the whole volume: rows that lie on one side are skipped."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.stages import Stage


@kernel(stage=Stage.BAND)
def count_inside(start, stop, psi, grid, inside):
    """Voxels inside, of each of the range's rows along x of the volume: ``inside`` (nz ny,) int32."""
    for row in range(start, stop):
        first = np.uint64(row * grid.nx)
        count = 0
        for ix in range(np.uint64(grid.nx)):
            count += psi[first + ix] < 0.0
        inside[row] = count


@kernel(stage=Stage.BAND)
def count_front(start, stop, psi, grid, inside, counts):
    """Front cells of each of the range's rows: ``counts`` (nz ny,) int64. ``inside`` is that of `count_inside`."""
    marks = np.empty(grid.nx, np.uint8)
    for row in range(start, stop):
        counts[row] = 0
        if not is_even(inside, row, grid):
            mark_front(psi, grid, row, marks)
            for ix in range(grid.nx):
                counts[row] += marks[ix]


@kernel(stage=Stage.BAND)
def front_cells(start, stop, psi, grid, inside, ends, cells):
    """Raveled front cells of the range's rows into ``cells``, those of row r before ``ends[r]``, in raster order.

    A front cell has a 6-neighbour on the other side of the surface. ``ends`` (nz ny,) is the running sum of
    `count_front`.
    """
    marks = np.empty(grid.nx, np.uint8)
    for row in range(start, stop):
        if is_even(inside, row, grid):
            continue
        mark_front(psi, grid, row, marks)
        at = ends[row - 1] if row > 0 else 0
        for ix in range(grid.nx):
            if marks[ix]:
                cells[at] = row * grid.nx + ix
                at += 1


@kernel
def mark_front(psi, grid, row, marks):
    """Set ``marks`` (nx,) uint8 to 1 at the front cells of a row, to 0 at the others; in vectors."""
    iz, iy = row // grid.ny, row % grid.ny
    # Unsigned: an index that may be negative keeps the loops from running in vectors.
    nx, own, one = np.uint64(grid.nx), np.uint64(row * grid.nx), np.uint64(1)
    plane = np.uint64(grid.ny) * nx
    # Beyond the border a row is its own neighbour.
    above = own - nx if iy > 0 else own
    below = own + nx if iy < grid.ny - 1 else own
    before = own - plane if iz > 0 else own
    behind = own + plane if iz < grid.nz - 1 else own
    for ix in range(nx):
        inside = psi[own + ix] < 0.0
        along_y = ((psi[above + ix] < 0.0) != inside) | ((psi[below + ix] < 0.0) != inside)
        along_z = ((psi[before + ix] < 0.0) != inside) | ((psi[behind + ix] < 0.0) != inside)
        marks[ix] = along_y | along_z
    for ix in range(one, nx):
        marks[ix] |= (psi[own + ix - one] < 0.0) != (psi[own + ix] < 0.0)
    for ix in range(nx - one):
        marks[ix] |= (psi[own + ix + one] < 0.0) != (psi[own + ix] < 0.0)


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
