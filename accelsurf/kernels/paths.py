"""Shortest paths over a grid from a set of voxels: every step costs its length and the change of the values."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.arrival import Queue, enter, first_waiting, fresh

#: First number of entries of the queue; it doubles when full.
FIRST_ENTRIES = 4096


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
    size = nz * ny * nx
    flat, marked = values.reshape(channels, size), seeds.ravel()
    far, done = np.full(size, np.float32(np.inf)), np.zeros(size, np.bool_)
    queue = path_queue(flat, lengths, weight)
    counts, strides = np.array((nz, ny, nx)), np.array((ny * nx, nx, 1))
    waiting, bucket = 0, np.int64(0)
    for i in range(size):
        if marked[i]:
            far[i] = 0.0
            queue = enter(queue, np.int64(0), np.int64(i))
            waiting += 1
    while waiting > 0:
        here, bucket = first_waiting(queue, bucket)
        waiting -= 1
        if done[here]:
            continue
        done[here] = True
        for axis in range(3):
            index = here // strides[axis] % counts[axis]
            for step in (-1, 1):
                if not 0 <= index + step < counts[axis]:
                    continue
                there = here + step * strides[axis]
                if done[there]:
                    continue
                length = np.float32(far[here] + step_length(flat, here, there, lengths[axis], weight))
                if length < far[there]:
                    far[there] = length
                    queue = enter(queue, np.int64(length), there)
                    waiting += 1
    return far.reshape(nz, ny, nx)


@kernel
def step_length(flat, here, there, length, weight):
    """Cost of a step: its length and the difference of the values."""
    total = length * length
    for channel in range(len(flat)):
        difference = weight * np.float64(flat[channel, there] - flat[channel, here])
        total += difference * difference
    return np.sqrt(total)


@kernel
def path_queue(flat, lengths, weight):
    """An empty queue of buckets as wide as the shortest step, in a ring longer than the longest."""
    total = lengths.max() ** 2
    for channel in range(len(flat)):
        total += (weight * np.float64(flat[channel].max() - flat[channel].min())) ** 2
    ring = 2
    while ring < np.sqrt(total) + 3.0:
        ring *= 2
    return Queue(
        np.full(ring, -1, np.int64), np.empty(FIRST_ENTRIES, np.int64), fresh(0, FIRST_ENTRIES), np.zeros(1, np.int64)
    )
