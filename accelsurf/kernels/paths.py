"""Shortest paths over a grid from a set of voxels: every step costs its length and the change of the values."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.arrival import SIDES, empty_queue, enter, first_filled, larger, leave
from accelsurf.kernels.grid import Grid, unravel


@kernel
def shortest_paths(seeds, values, lengths, weight):
    """Length of the shortest path from the seeds to each voxel, over 6 neighbours (Dijkstra).

    Parameters
    ----------
    seeds : ndarray (nz, ny, nx) bool
    values : ndarray (channels, nz, ny, nx) float32
    lengths : ndarray (3,) float64
        Of a step along z, y, x; the shortest is 1.
    weight : float
        A step costs sqrt(length^2 + (weight difference)^2), the difference over all channels.

    Returns
    -------
    ndarray (nz, ny, nx) float32
        Inf everywhere without seeds.
    """
    channels, nz, ny, nx = values.shape
    flat, marked = values.reshape(channels, nz * ny * nx), seeds.ravel()
    grid = Grid(nz, ny, nx, lengths[0], lengths[1], lengths[2])
    far = np.full(nz * ny * nx, np.float32(np.inf))
    queue = empty_queue(ring_length(flat, lengths, weight))
    waiting, bucket = 0, np.int64(0)
    for cell in range(len(far)):
        if marked[cell]:
            far[cell] = 0.0
            if waiting == len(queue.entries):
                queue = larger(queue)
            enter(queue, np.int64(0), np.int64(cell))
            waiting += 1
    while waiting > 0:
        bucket = first_filled(queue, bucket)
        here = leave(queue, bucket)
        waiting -= 1
        if np.int64(far[here]) < bucket:  # a shorter path has been found since, and gone on from
            continue
        if waiting + SIDES > len(queue.entries):
            queue = larger(queue)
        waiting += go_on(far, here, flat, weight, grid, queue)
    return far.reshape(nz, ny, nx)


@kernel
def go_on(far, here, flat, weight, grid, queue):
    """Enter the neighbours that have a shorter path through a voxel; returns how many. The queue has space for all."""
    iz, iy, ix = unravel(here, grid)
    entered = 0
    for side in range(SIDES):
        axis, step = side // 2, 2 * (side % 2) - 1
        index = iz if axis == 0 else iy if axis == 1 else ix
        count = grid.nz if axis == 0 else grid.ny if axis == 1 else grid.nx
        length = grid.hz if axis == 0 else grid.hy if axis == 1 else grid.hx
        stride = grid.ny * grid.nx if axis == 0 else grid.nx if axis == 1 else 1
        there = here + step * stride
        if not 0 <= index + step < count or far[there] <= far[here] + length:
            continue  # a step costs at least its length
        found = np.float32(far[here] + step_length(flat, here, there, length, weight))
        if found < far[there]:
            far[there] = found
            enter(queue, np.int64(found), there)
            entered += 1
    return entered


@kernel
def step_length(flat, here, there, length, weight):
    """Cost of a step: its length and the difference of the values."""
    total = length * length
    for channel in range(len(flat)):
        difference = weight * np.float64(flat[channel, there] - flat[channel, here])
        total += difference * difference
    return np.sqrt(total)


@kernel
def ring_length(flat, lengths, weight):
    """Number of buckets, each as wide as the shortest step, in a ring longer than the longest; a power of two."""
    total = lengths.max() ** 2
    for channel in range(len(flat)):
        total += (weight * np.float64(flat[channel].max() - flat[channel].min())) ** 2
    ring = 2
    while ring < np.sqrt(total) + 3.0:
        ring *= 2
    return ring
