"""Shortest paths over a grid from a set of voxels: every step costs its length and the change of the values.

L(x) = min over the neighbours y of L(y) + c(x, y), 0 at the seeds: relaxed row by row, back and forth in each plane,
and plane by plane, until nothing becomes shorter. The least solution does not depend on the order, as rounding keeps
the order of numbers; so these are the lengths of an ordered search (Dijkstra), without a queue.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def shortest_paths(seeds, values, lengths, weight):
    """Length of the shortest path from the seeds to each voxel, over 6 neighbours.

    Parameters
    ----------
    seeds : ndarray (nz, ny, nx) bool
    values : ndarray (channels, nz, ny, nx) float32
    lengths : ndarray (3,) float64
        Of a step along z, y, x; above 0.
    weight : float
        A step costs sqrt(length^2 + (weight difference)^2), the difference over all channels.

    Returns
    -------
    ndarray (nz, ny, nx) float32
        Inf everywhere without seeds.
    """
    nz, ny, nx = seeds.shape
    far = np.where(seeds, np.float32(0.0), np.float32(np.inf))
    costs = step_costs(values, lengths, weight)
    # A row is looked at again only after a row beside it has changed: when that was, and when it was looked at.
    changed, looked = np.zeros((nz, ny), np.int64), np.full((nz, ny), np.int64(-1))
    now, sweep, improves = np.int64(0), 0, True
    while improves:
        improves = False
        for i in range(nz):
            iz = i if sweep % 2 == 0 else nz - 1 - i
            for j in range(2 * ny):
                iy = j if j < ny else 2 * ny - 1 - j
                before = looked[iz, iy]
                now += 1
                looked[iz, iy] = now
                shorter = relax_from_beside(far, costs, iz, iy, changed, before)
                if shorter or before < 0:
                    relax_along(far[iz, iy], costs[2, iz, iy])
                    changed[iz, iy] = now
                    improves = True
        sweep += 1
    return far


@kernel
def step_costs(values, lengths, weight):
    """Cost (3, nz, ny, nx) float32 of the step to each voxel from the one before it along z, y, x; inf from beyond."""
    channels, nz, ny, nx = values.shape
    out = np.full((3, nz, ny, nx), np.float32(np.inf))
    for axis in range(3):
        dz, dy, dx = int(axis == 0), int(axis == 1), int(axis == 2)
        square, scale = np.float32(lengths[axis] ** 2), np.float32(weight)
        for iz in range(dz, nz):
            for iy in range(dy, ny):
                row = out[axis, iz, iy, dx:]
                row[:] = square
                for channel in range(channels):
                    here, before = values[channel, iz, iy, dx:], values[channel, iz - dz, iy - dy, : nx - dx]
                    for k in range(nx - dx):
                        difference = scale * (here[k] - before[k])
                        row[k] += difference * difference
                for k in range(nx - dx):
                    row[k] = np.sqrt(row[k])
    return out


@kernel(inlined=True)
def relax_from_beside(far, costs, iz, iy, changed, before):
    """Shorten a row's paths by the four rows beside it that changed later than ``before``; whether one became so."""
    nz, ny, _ = far.shape
    row, shorter = far[iz, iy], False
    if iz > 0 and changed[iz - 1, iy] > before:
        shorter |= relax(row, far[iz - 1, iy], costs[0, iz, iy])
    if iz < nz - 1 and changed[iz + 1, iy] > before:
        shorter |= relax(row, far[iz + 1, iy], costs[0, iz + 1, iy])
    if iy > 0 and changed[iz, iy - 1] > before:
        shorter |= relax(row, far[iz, iy - 1], costs[1, iz, iy])
    if iy < ny - 1 and changed[iz, iy + 1] > before:
        shorter |= relax(row, far[iz, iy + 1], costs[1, iz, iy + 1])
    return shorter


@kernel(inlined=True)
def relax(row, other, costs):
    """Shorten the paths of a row by steps from another; whether one became shorter. No branch: it runs in vectors."""
    shorter = 0
    for k in range(len(row)):
        through = other[k] + costs[k]
        shorter |= through < row[k]
        row[k] = min(row[k], through)
    return shorter > 0


@kernel(inlined=True)
def relax_along(row, costs):
    """Shorten the paths of a row by steps within it, there and back."""
    # Branches: where nothing becomes shorter, as in most rows that are looked at again, no voxel waits for another.
    for k in range(1, len(row)):
        through = row[k - 1] + costs[k]
        if through < row[k]:
            row[k] = through
    for k in range(len(row) - 2, -1, -1):
        through = row[k + 1] + costs[k + 1]
        if through < row[k]:
            row[k] = through
