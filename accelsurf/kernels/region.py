"""Region sums and surface integrals: each voxel cut by the plane that psi and its gradient make in it."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.differences import gradient
from accelsurf.kernels.grid import BLOCK, unravel, voxels_along


@kernel
def cube(x):
    """max(x, 0)^3."""
    return x * x * x if x > 0.0 else 0.0


@kernel
def square(x):
    """max(x, 0)^2."""
    return x * x if x > 0.0 else 0.0


@kernel
def cut_voxel(psi, gz, gy, gx, grid):
    """Part of a voxel inside and area of the cut (mm2) for the plane psi + n.x = 0, n = grad/|grad|.

    Volume of the unit cube below the plane m.u = s (m_a = |n_a| h_a) by inclusion and exclusion of the
    corners; the area is its derivative by s. Exact for a plane of any direction and spacing.
    """
    norm = np.sqrt(gz * gz + gy * gy + gx * gx)
    if norm < 1e-6:
        return (1.0 if psi < 0.0 else 0.0), 0.0
    a = abs(gz) / norm * grid.hz
    b = abs(gy) / norm * grid.hy
    c = abs(gx) / norm * grid.hx
    # A direction along a face has m = 0, where the formula is 0/0: this much tilt changes nothing visible, and
    # shares a face that lies exactly between two voxels among them.
    least = 1e-4 * (a + b + c)
    a, b, c = max(a, least), max(b, least), max(c, least)
    total = a + b + c
    s = 0.5 * total - psi
    if s <= 0.0:
        return 0.0, 0.0
    if s >= total:
        return 1.0, 0.0
    volume = cube(s) - cube(s - a) - cube(s - b) - cube(s - c)
    volume += cube(s - a - b) + cube(s - a - c) + cube(s - b - c)
    area = square(s) - square(s - a) - square(s - b) - square(s - c)
    area += square(s - a - b) + square(s - a - c) + square(s - b - c)
    scale = 1.0 / (6.0 * a * b * c)
    part = min(max(volume * scale, 0.0), 1.0)
    return part, max(3.0 * area * scale, 0.0) * grid.hz * grid.hy * grid.hx


@kernel
def cut_band(start, stop, psi, grid, band, part, area):
    """Fill ``part`` (share of the voxel inside) and ``area`` (mm2 of surface in it) for the range of slots."""
    reach = 0.51 * np.sqrt(grid.hz**2 + grid.hy**2 + grid.hx**2)
    for s in range(start, stop):
        d = band.psi[s]
        if abs(d) > reach:
            part[s] = 1.0 if d < 0.0 else 0.0
            area[s] = 0.0
            continue
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        gz, gy, gx = gradient(psi, cell, iz, iy, ix, grid)
        part[s], area[s] = cut_voxel(d, gz, gy, gx, grid)


@kernel
def smear_band(start, stop, grid, band, epsilon, part):
    """Share of each voxel inside by the smeared Heaviside function of the distance in voxels, s.

    (1 - s/epsilon - sin(pi s/epsilon)/pi)/2 within epsilon of the surface; its derivative is the delta
    function that `motion.mean_across` averages the image with.
    """
    for s in range(start, stop):
        x = voxels_along(band.foot[s, 0], band.foot[s, 1], band.foot[s, 2], grid) / epsilon
        if band.psi[s] < 0.0:
            x = -x
        if x <= -1.0:
            part[s] = 1.0
        elif x >= 1.0:
            part[s] = 0.0
        else:
            part[s] = 0.5 * (1.0 - x - np.sin(np.pi * x) / np.pi)


@kernel
def weighted_sums(first_block, last_block, cells, weight, image, sums):
    """Per block of slots: sums[block] = sum over its slots of weight x (1, I, I^2)."""
    for block in range(first_block, last_block):
        count = 0.0
        total = 0.0
        squares = 0.0
        for s in range(block * BLOCK, min((block + 1) * BLOCK, cells.shape[0])):
            if weight[s] == 0.0:
                continue
            value = np.float64(image[cells[s]])
            count += weight[s]
            total += weight[s] * value
            squares += weight[s] * value * value
        sums[block, 0] = count
        sums[block, 1] = total
        sums[block, 2] = squares


@kernel
def inside_sums(first_block, last_block, dense, image, sums):
    """Per block of voxels of the whole volume: sums over the inside voxels not in the band of (1, I, I^2)."""
    for block in range(first_block, last_block):
        count = 0.0
        total = 0.0
        squares = 0.0
        for cell in range(block * BLOCK, min((block + 1) * BLOCK, image.shape[0])):
            if dense.slot[cell] < 0 and dense.psi[cell] < 0.0:
                value = np.float64(image[cell])  # float() would stay float32
                count += 1.0
                total += value
                squares += value * value
        sums[block, 0] = count
        sums[block, 1] = total
        sums[block, 2] = squares
