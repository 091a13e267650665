"""Mass of a surface gathered on a coarse lattice, where it is compared before and after a motion."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel
from accelsurf.kernels.stages import Stage


@kernel
def lattice_weights(index, shift, n, stride, count, w):
    """First of the three nodes of an axis around the point that a foot moves to, and their weights into ``w`` (3,).

    The point is ``shift`` voxels from the cell ``index`` of ``n``; beyond the border it is at the border. ``stride``
    voxels lie between the ``count`` nodes. Their middle is that of the volume: mirrored, it has the mirrored lattice.
    The weights are those of the quadratic B-spline: not below 0, with sum 1, and so smooth that a sum hardly depends on
    where the surface lies between the voxels.
    """
    middle = 0.5 * (n - 1)
    place = 0.5 * (count - 1) + min(max(index + shift - middle, -middle), middle) / stride
    nearest = int(place + 0.5)
    t = place - nearest
    w[0], w[1], w[2] = 0.5 * (0.5 - t) ** 2, 0.75 - t * t, 0.5 * (0.5 + t) ** 2
    return nearest - 1


@kernel(stage=Stage.FLOW)
def deposit(grid, band, mass, motion, stride, lattice):
    """Add the ``mass`` (n,) of every cell to the ``lattice`` (mz, my, mx), at the point that its foot moves to. Serial.

    ``motion`` = (velocity (n, 3), dt); ``stride`` (3,) voxels between nodes. A mass is shared by the nodes around its
    point, see `lattice_weights`: what is added is what there was.
    """
    velocity, dt = motion
    mz, my, mx = lattice.shape
    wz, wy, wx = np.empty(3), np.empty(3), np.empty(3)
    for s in range(mass.size):
        if mass[s] <= 0.0:
            continue
        foot = band.to_closest[s]
        iz, iy, ix = unravel(band.cells[s], grid)
        az = lattice_weights(iz, (foot[0] + dt * velocity[s, 0]) / grid.hz, grid.nz, stride[0], mz, wz)
        ay = lattice_weights(iy, (foot[1] + dt * velocity[s, 1]) / grid.hy, grid.ny, stride[1], my, wy)
        ax = lattice_weights(ix, (foot[2] + dt * velocity[s, 2]) / grid.hx, grid.nx, stride[2], mx, wx)
        for i in range(3):
            for j in range(3):
                share = mass[s] * wz[i] * wy[j]
                for k in range(3):
                    lattice[az + i, ay + j, ax + k] += share * wx[k]


@kernel(stage=Stage.FLOW)
def lattice_factors(start, stop, grid, band, lattice, stride, out):
    """Mean of the ``lattice`` (mz, my, mx) around the foot of every cell, with the weights of `deposit`."""
    mz, my, mx = lattice.shape
    wz, wy, wx = np.empty(3), np.empty(3), np.empty(3)
    for s in range(start, stop):
        foot = band.to_closest[s]
        iz, iy, ix = unravel(band.cells[s], grid)
        az = lattice_weights(iz, foot[0] / grid.hz, grid.nz, stride[0], mz, wz)
        ay = lattice_weights(iy, foot[1] / grid.hy, grid.ny, stride[1], my, wy)
        ax = lattice_weights(ix, foot[2] / grid.hx, grid.nx, stride[2], mx, wx)
        total = 0.0
        for i in range(3):
            for j in range(3):
                share = wz[i] * wy[j]
                for k in range(3):
                    total += share * wx[k] * lattice[az + i, ay + j, ax + k]
        out[s] = total


@kernel(stage=Stage.FLOW)
def border_outflow(start, stop, grid, cells, motion, out):
    """Part of what is in every cell that flows out through the border in a step, V dt/h; below 0: that flows in.

    ``motion`` = (velocity (n, 3), dt). 0 for cells off the border, and along axes of one voxel.
    """
    velocity, dt = motion
    for s in range(start, stop):
        iz, iy, ix = unravel(cells[s], grid)
        out[s] = 0.0
        if grid.nz > 1 and (iz == 0 or iz == grid.nz - 1):
            out[s] += velocity[s, 0] * (dt / grid.hz if iz > 0 else -dt / grid.hz)
        if grid.ny > 1 and (iy == 0 or iy == grid.ny - 1):
            out[s] += velocity[s, 1] * (dt / grid.hy if iy > 0 else -dt / grid.hy)
        if grid.nx > 1 and (ix == 0 or ix == grid.nx - 1):
            out[s] += velocity[s, 2] * (dt / grid.hx if ix > 0 else -dt / grid.hx)
