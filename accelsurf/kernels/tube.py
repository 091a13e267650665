"""The operator 1 - ell^2 Laplace-Beltrami on the tube around the surface, symmetric and positive."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import neighbours, unravel, voxels_along


@kernel(stage=Stage.FLOW)
def tube_weight(start, stop, grid, band, width, eta):
    """Weight (1 + cos(pi s/width))/2 of every cell, s its distance in voxels along the normal; 0 from ``width`` on."""
    for s in range(start, stop):
        x = (
            voxels_along(band.to_closest[s, 0], band.to_closest[s, 1], band.to_closest[s, 2], grid)
            / width
        )
        eta[s] = 0.5 * (1.0 + np.cos(np.pi * x)) if x < 1.0 else 0.0


@kernel(stage=Stage.FLOW)
def tube_product(start, stop, slot, grid, cells, operator, field, out):
    """Product of the weighted operator with ``field`` (n,): eta g - ell^2 div(eta grad g).

    ``operator`` = (eta (n,) from `tube_weight`, ell in mm).

    The weak form of sum eta (g^2 + ell^2 |grad g|^2)/2, a face between two cells having the mean of their weights:
    symmetric. Cells just off the tube count too (without them the faces at its edge would be lost).
    """
    eta, length = operator
    near = np.empty(6, np.int64)
    for s in range(start, stop):
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        total = 0.0
        for side in range(6):
            other = slot[near[side]] if near[side] >= 0 else -1
            if other >= 0:
                h = grid.hz if side < 2 else (grid.hy if side < 4 else grid.hx)
                total += 0.5 * (eta[s] + eta[other]) * (field[s] - field[other]) / (h * h)
        out[s] = eta[s] * field[s] + length * length * total


@kernel(stage=Stage.FLOW)
def tube_diagonal(start, stop, slot, grid, cells, operator, out):
    """Diagonal (n,) of `tube_product`'s operator; 1 where that is 0, away from the tube."""
    eta, length = operator
    near = np.empty(6, np.int64)
    for s in range(start, stop):
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        total = 0.0
        for side in range(6):
            other = slot[near[side]] if near[side] >= 0 else -1
            if other >= 0:
                h = grid.hz if side < 2 else (grid.hy if side < 4 else grid.hx)
                total += 0.5 * (eta[s] + eta[other]) / (h * h)
        total = eta[s] + length * length * total
        out[s] = total if total > 0.0 else 1.0
