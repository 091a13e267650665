"""Sums over a window around every point, by a coarse lattice of nodes: O(1) per cell whatever the window's size.

A voxel is shared by the eight nodes around it (linear weights); the nodes are smoothed by a tent of
``half_width`` nodes along each axis; a point reads them by the same linear weights. Positions are voxels. The mass of
a surface is gathered on a lattice too, where it is compared before and after a motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import unravel


class Nodes(NamedTuple):
    """Lattice of nodes: their number along each axis, their distance in voxels, and the place of voxel 0 among them."""

    nz: int
    ny: int
    nx: int
    bz: float
    by: float
    bx: float
    pz: float
    py: float
    px: float


@kernel
def node_below(position, distance, before, n):
    """Node at or below a position along an axis, and the share of the one above; 0 of it on an axis of one node."""
    if n == 1:
        return 0, 0.0
    place = position / distance + before
    below = min(max(int(np.floor(place)), 0), n - 2)
    return below, min(max(place - below, 0.0), 1.0)


@kernel(stage=Stage.ENERGY)
def scatter(cells, weight, image, grid, nodes, counts, totals):
    """Add each cell times its weight to the eight nodes around it: 1 to ``counts``, the image to ``totals``.

    ``cells`` (m,) int64, ``weight`` (m,) float64; ``counts`` and ``totals`` (nodes,) float64, raveled. On one thread:
    the order of the sums is that of the cells.
    """
    row, plane = nodes.nx, nodes.ny * nodes.nx
    dz = plane if nodes.nz > 1 else 0
    dy = row if nodes.ny > 1 else 0
    dx = 1 if nodes.nx > 1 else 0
    for s in range(cells.shape[0]):
        if weight[s] == 0.0:
            continue
        value = np.float64(image[cells[s]])
        iz, iy, ix = unravel(cells[s], grid)
        jz, tz = node_below(iz, nodes.bz, nodes.pz, nodes.nz)
        jy, ty = node_below(iy, nodes.by, nodes.py, nodes.ny)
        jx, tx = node_below(ix, nodes.bx, nodes.px, nodes.nx)
        at = jz * plane + jy * row + jx
        for a in range(2):
            wz = weight[s] * (tz if a else 1.0 - tz)
            for b in range(2):
                wy = wz * (ty if b else 1.0 - ty)
                for c in range(2):
                    w = wy * (tx if c else 1.0 - tx)
                    to = at + a * dz + b * dy + c * dx
                    counts[to] += w
                    totals[to] += w * value


@kernel(stage=Stage.ENERGY)
def scatter_inside(dense, image, grid, nodes, counts, totals):
    """`scatter` of the inside voxels that are not in the band, of the whole volume."""
    cell, weight = np.empty(1, np.int64), np.ones(1)
    for at in range(image.shape[0]):
        if dense.slot[at] < 0 and dense.psi[at] < 0.0:
            cell[0] = at
            scatter(cell, weight, image, grid, nodes, counts, totals)


@kernel(stage=Stage.ENERGY)
def tent_along(start, stop, values, length, step, half_width, out):
    """Smooth raveled nodes along an axis by the tent (w - |k|)/w^2, |k| < w, w = ``half_width``; 0 beyond the ends.

    ``step`` is the distance of neighbours along the axis in the raveled array, ``length`` that times the axis' size.
    """
    at = start
    while at < stop:
        first = at // length * length
        end = min(stop, first + length)
        for i in range(at, end):
            out[i] = 0.0
        for k in range(1 - half_width, half_width):
            weight, shift = (half_width - abs(k)) / (half_width * half_width), k * step
            for i in range(max(at, first - shift), min(end, first + length - shift)):
                out[i] += weight * values[i + shift]
        at = end


@kernel(stage=Stage.ENERGY)
def two_means(start, stop, count, total, count_in, total_in, least, out):
    """From the means f1 inside and f2 outside in each window: f1 - f2, f1^2 - f2^2, and what two means fit better.

    They are the rows of ``out`` (3, m). The last is (sum of I inside)^2/n1 + (sum outside)^2/n2 - (sum)^2/n, how much
    less the squares are about two means than about one. All are 0 where a part ``least`` of the window or less lies on
    one side.
    """
    first = out[0]
    second = out[1]
    gain = out[2]
    for i in range(start, stop):
        first[i] = 0.0
        second[i] = 0.0
        gain[i] = 0.0
        n1, n2 = count_in[i], count[i] - count_in[i]
        if n1 > least * count[i] and n2 > least * count[i]:
            f1, f2 = total_in[i] / n1, (total[i] - total_in[i]) / n2
            first[i], second[i] = f1 - f2, f1 * f1 - f2 * f2
            gain[i] = n1 * n2 / count[i] * (f1 - f2) ** 2


@kernel(stage=Stage.ENERGY)
def read_nodes(start, stop, grid, band, front, nodes, fields, out):
    """Two raveled ``fields`` of nodes at the closest point of every front cell, into ``out`` (n, 2); 0 elsewhere."""
    row, plane = nodes.nx, nodes.ny * nodes.nx
    dz = plane if nodes.nz > 1 else 0
    dy = row if nodes.ny > 1 else 0
    dx = 1 if nodes.nx > 1 else 0
    first, second = fields
    for s in range(start, stop):
        out[s, 0], out[s, 1] = 0.0, 0.0
        if not front[s]:
            continue
        iz, iy, ix = unravel(band.cells[s], grid)
        jz, tz = node_below(iz + band.to_closest[s, 0] / grid.hz, nodes.bz, nodes.pz, nodes.nz)
        jy, ty = node_below(iy + band.to_closest[s, 1] / grid.hy, nodes.by, nodes.py, nodes.ny)
        jx, tx = node_below(ix + band.to_closest[s, 2] / grid.hx, nodes.bx, nodes.px, nodes.nx)
        at = jz * plane + jy * row + jx
        for a in range(2):
            wz = tz if a else 1.0 - tz
            for b in range(2):
                wy = wz * (ty if b else 1.0 - ty)
                for c in range(2):
                    w = wy * (tx if c else 1.0 - tx)
                    to = at + a * dz + b * dy + c * dx
                    out[s, 0] += w * first[to]
                    out[s, 1] += w * second[to]


@kernel
def lattice_weights(index, shift, n, stride, count, w):
    """First of the three nodes of an axis around the point that a closest point moves to.

    Their weights go into ``w`` (3,). The point is ``shift`` voxels from the cell ``index`` of ``n``; beyond the border
    it is at the border. ``stride`` voxels lie between the ``count`` nodes. Their middle is that of the volume:
    mirrored, it has the mirrored lattice. The weights are those of the quadratic B-spline: not below 0, with sum 1, and
    so smooth that a sum hardly depends on where the surface lies between the voxels.
    """
    middle = 0.5 * (n - 1)
    place = 0.5 * (count - 1) + min(max(index + shift - middle, -middle), middle) / stride
    nearest = int(place + 0.5)
    t = place - nearest
    w[0] = 0.5 * (0.5 - t) ** 2
    w[1] = 0.75 - t * t
    w[2] = 0.5 * (0.5 + t) ** 2
    return nearest - 1


@kernel(stage=Stage.FLOW)
def deposit(grid, band, mass, motion, stride, lattice):
    """Add the ``mass`` (n,) of every cell to the ``lattice`` (mz, my, mx) where its closest point moves to.

    Serial. ``motion`` = (velocity (n, 3), dt); ``stride`` (3,) voxels between nodes. A mass is shared by the nodes
    around its point, see `lattice_weights`: the sum is that of the masses.
    """
    velocity, dt = motion
    mz, my, mx = lattice.shape
    wz = np.empty(3)
    wy = np.empty(3)
    wx = np.empty(3)
    for s in range(mass.size):
        if mass[s] <= 0.0:
            continue
        closest_point = band.to_closest[s]
        iz, iy, ix = unravel(band.cells[s], grid)
        az = lattice_weights(
            iz, (closest_point[0] + dt * velocity[s, 0]) / grid.hz, grid.nz, stride[0], mz, wz
        )
        ay = lattice_weights(
            iy, (closest_point[1] + dt * velocity[s, 1]) / grid.hy, grid.ny, stride[1], my, wy
        )
        ax = lattice_weights(
            ix, (closest_point[2] + dt * velocity[s, 2]) / grid.hx, grid.nx, stride[2], mx, wx
        )
        for i in range(3):
            for j in range(3):
                share = mass[s] * wz[i] * wy[j]
                for k in range(3):
                    lattice[az + i, ay + j, ax + k] += share * wx[k]


@kernel(stage=Stage.FLOW)
def lattice_factors(start, stop, grid, band, lattice, stride, out):
    """Mean of the ``lattice`` (mz, my, mx) around the closest point of every cell, with the weights of `deposit`."""
    mz, my, mx = lattice.shape
    wz = np.empty(3)
    wy = np.empty(3)
    wx = np.empty(3)
    for s in range(start, stop):
        closest_point = band.to_closest[s]
        iz, iy, ix = unravel(band.cells[s], grid)
        az = lattice_weights(iz, closest_point[0] / grid.hz, grid.nz, stride[0], mz, wz)
        ay = lattice_weights(iy, closest_point[1] / grid.hy, grid.ny, stride[1], my, wy)
        ax = lattice_weights(ix, closest_point[2] / grid.hx, grid.nx, stride[2], mx, wx)
        total = 0.0
        for i in range(3):
            for j in range(3):
                share = wz[i] * wy[j]
                for k in range(3):
                    total += share * wx[k] * lattice[az + i, ay + j, ax + k]
        out[s] = total


@kernel(stage=Stage.FLOW)
def border_outflow(start, stop, grid, cells, motion, out):
    """Part of the content of every cell that flows out through the border in a step, V dt/h; below 0: that flows in.

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
