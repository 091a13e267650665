"""The grid and the band as arrays for kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels._jit import kernel

# Hot loops count slots and cells as np.uint64: a signed index is tested for being negative at every read. -1 is no slot
# and no cell, so an index is made unsigned after that test.

#: Band slots per block of a reduction. Partial sums are kept per block and added in order of the blocks.
BLOCK = 4096
#: Cells whose arithmetic is done together, in rows: as they do not depend on each other, it runs in vectors.
BATCH = 128
#: Slices are thick from this ratio of the spacings on.
THICK = 4.0


class Grid(NamedTuple):
    """Shape (voxels) and spacing (mm) in array order (z, y, x)."""

    nz: int
    ny: int
    nx: int
    hz: float
    hy: float
    hx: float


class Band(NamedTuple):
    """Narrow band: cells in raster order, with what is known about each.

    ``cells`` (n,) int64 raveled index; ``psi`` (n,) float32 signed distance, mm; ``to_closest`` (n, 3) float32
    vector (z, y, x) in mm from the cell to its closest point on the surface.
    """

    cells: np.ndarray
    psi: np.ndarray
    to_closest: np.ndarray


class DenseArrays(NamedTuple):
    """Dense arrays over the whole volume, raveled: ``psi`` float32 (mm), ``slot`` int32 (band slot or -1)."""

    psi: np.ndarray
    slot: np.ndarray


@kernel
def is_thick(grid):
    """Test if the spacings differ so much that a length in voxels says little of one in mm."""
    return max(grid.hz, max(grid.hy, grid.hx)) >= THICK * min(grid.hz, min(grid.hy, grid.hx))


@kernel
def unravel(cell, grid):
    """Index (z, y, x) of a raveled cell."""
    # Unsigned: rounding towards minus infinity would cost a second division.
    row = np.int64(np.uint64(cell) // np.uint64(grid.nx))
    iz = np.int64(np.uint64(row) // np.uint64(grid.ny))
    return iz, row - iz * grid.ny, cell - row * grid.nx


@kernel
def unravel_in_vectors(cell, grid):
    """`unravel` by products, which run in vectors where divisions do not; in a loop over cells alone.

    Half a cell more than the index is never so near to a whole row that rounding counts, up to 2^50 cells.
    """
    row = np.int64((np.float64(cell) + 0.5) * (1.0 / np.float64(grid.nx)))
    iz = np.int64((np.float64(row) + 0.5) * (1.0 / np.float64(grid.ny)))
    return iz, row - iz * grid.ny, cell - row * grid.nx


@kernel
def neighbours(cell, iz, iy, ix, grid, out):
    """Write the raveled 6-neighbours (-z, +z, -y, +y, -x, +x) to ``out``; -1 beyond the volume's border."""
    plane = grid.ny * grid.nx
    out[0] = cell - plane if iz > 0 else -1
    out[1] = cell + plane if iz < grid.nz - 1 else -1
    out[2] = cell - grid.nx if iy > 0 else -1
    out[3] = cell + grid.nx if iy < grid.ny - 1 else -1
    out[4] = cell - 1 if ix > 0 else -1
    out[5] = cell + 1 if ix < grid.nx - 1 else -1


@kernel
def step_of(side, grid):
    """Vector (mm) from a cell to its neighbour number ``side``."""
    sign = 1.0 if side % 2 == 1 else -1.0
    axis = side // 2
    return (
        sign * grid.hz if axis == 0 else 0.0,
        sign * grid.hy if axis == 1 else 0.0,
        sign * grid.hx if axis == 2 else 0.0,
    )


@kernel
def voxels_along(vz, vy, vx, grid):
    """Length of a vector (mm) in voxels: the norm of its index displacement."""
    return np.sqrt((vz / grid.hz) ** 2 + (vy / grid.hy) ** 2 + (vx / grid.hx) ** 2)
