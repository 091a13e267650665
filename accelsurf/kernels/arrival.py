"""Geodesic arrival times: an ordered march from a set of voxels through a medium with a cost per mm.

|grad T| = c, with T given at the seeds: first-order Godunov differences, voxels accepted in the order of their times
(the fast marching method of Tsitsiklis and of Sethian).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import neighbours, unravel

#: First capacity of the queue and of the list of accepted voxels; both double when full.
FIRST_CAPACITY = 4096


class Medium(NamedTuple):
    """What the march goes through.

    ``values`` (channels, n) float32; ``open`` (n,) bool, False where nothing passes, or (0,) where all is open.
    """

    values: np.ndarray
    open: np.ndarray


class Tissue(NamedTuple):
    """What passes easily: per channel (channels,) float64 the median and the spread of the values, and the gradient
    (per mm) that counts as 1; and the weights of the cost, see `cost_at`.
    """

    median: np.ndarray
    spread: np.ndarray
    gradient: np.ndarray
    weights: np.ndarray


class Queue(NamedTuple):
    """Voxels by their times: ``heads`` (ring of buckets) the last entry of each, -1 for none; of each entry ``cells``
    the voxel and ``links`` the one before it, or the next free one; ``free`` (1,) the first free entry.
    """

    heads: np.ndarray
    cells: np.ndarray
    links: np.ndarray
    free: np.ndarray


@kernel
def march(times, medium, tissue, grid, seeds, cap, max_time, max_count):
    """Accept voxels in the order of their arrival times, from the seeds outwards.

    Parameters
    ----------
    times : ndarray (n,) float32
        At the seeds their times, at least 0, which are final; inf at all others. On return the times of the accepted
        voxels, inf at those that the march did not accept. While it runs, a time that is not final is stored as its
        negative.
    medium : Medium
    tissue : Tissue
    grid : Grid
    seeds : ndarray (k,) int64
        Each once. A seed starts also where nothing passes.
    cap : ndarray (n,) or (0,) float32
        A voxel is accepted only if its time is below its cap; without elements there is none.
    max_time : float
        No voxel with a later time is accepted.
    max_count : int
        No more voxels than these are accepted.

    Returns
    -------
    ndarray (m,) int64
        The accepted voxels, seeds included, in the order of their times up to `bucket_width`; within it in an order
        that depends on the input alone.
    """
    width = bucket_width(tissue.weights, grid)
    queue = new_queue(tissue.weights, grid, width)
    order, around = np.empty(max(FIRST_CAPACITY, len(seeds)), np.int64), np.empty(6, np.int64)
    order[: len(seeds)] = seeds
    done, count, waiting, bucket = 0, len(seeds), 0, np.int64(0)
    while True:
        for cell in order[done:count]:
            iz, iy, ix = unravel(cell, grid)
            neighbours(cell, iz, iy, ix, grid, around)
            for other in around:
                if other < 0 or 0.0 <= times[other] < np.inf or (len(medium.open) > 0 and not medium.open[other]):
                    continue
                time = np.float32(upwind_time(times, other, medium, tissue, grid))
                if time <= max_time and time < abs(times[other]) and (len(cap) == 0 or time < cap[other]):
                    times[other] = -time
                    queue = enter(queue, np.int64(time / width), other)
                    waiting += 1
        done = count
        if waiting == 0 or count >= max_count:
            break
        cell, bucket = first_waiting(queue, bucket)
        waiting -= 1
        if times[cell] < 0.0 and np.int64(-times[cell] / width) <= bucket:
            times[cell] = -times[cell]
            order = with_space(order, count)
            order[count] = cell
            count += 1
    for _ in range(waiting):  # on their way, not arrived
        cell, bucket = first_waiting(queue, bucket)
        if times[cell] < 0.0:
            times[cell] = np.inf
    return order[:count].copy()


@kernel
def bucket_width(w, grid):
    """Times of one bucket: half the shortest step between two voxels, within which the order is free."""
    return w[0] * min(grid.hz, grid.hy, grid.hx) / 2.0


@kernel
def new_queue(w, grid, width):
    """An empty queue: buckets in a ring, longer than the longest step."""
    step = (w[0] + w[1] * w[2] + w[3] * w[5]) * max(grid.hz, grid.hy, grid.hx)
    length = 2
    while length * width < step + 2.0 * width:
        length *= 2
    return Queue(
        np.full(length, -1, np.int64),
        np.empty(FIRST_CAPACITY, np.int64),
        fresh(0, FIRST_CAPACITY),
        np.zeros(1, np.int64),
    )


@kernel
def fresh(first, last):
    """Links of the free entries first..last - 1, each to the next."""
    return np.arange(first + 1, last + 1)


@kernel
def enter(queue, bucket, cell):
    """Enter a voxel into a bucket; returns the queue, larger where it was full."""
    entry = queue.free[0]
    if entry == len(queue.cells):
        cells, links = np.empty(2 * entry, np.int64), np.empty(2 * entry, np.int64)
        cells[:entry], links[:entry] = queue.cells, queue.links
        links[entry:] = fresh(entry, 2 * entry)
        queue = Queue(queue.heads, cells, links, queue.free)
    place = bucket & (len(queue.heads) - 1)
    queue.free[0] = queue.links[entry]
    queue.cells[entry], queue.links[entry] = cell, queue.heads[place]
    queue.heads[place] = entry
    return queue


@kernel
def first_waiting(queue, bucket):
    """Take the next voxel from a queue that is not empty: (voxel, its bucket)."""
    cell = leave(queue, bucket)
    while cell < 0:
        bucket += 1
        cell = leave(queue, bucket)
    return cell, bucket


@kernel
def leave(queue, bucket):
    """Take the voxel that entered a bucket last; -1 where it is empty."""
    place = bucket & (len(queue.heads) - 1)
    entry = queue.heads[place]
    if entry < 0:
        return np.int64(-1)
    queue.heads[place] = queue.links[entry]
    queue.links[entry] = queue.free[0]
    queue.free[0] = entry
    return queue.cells[entry]


@kernel
def upwind_time(times, cell, medium, tissue, grid):
    """Solution T of sum over the axes of (max(T - T_i, 0)/h_i)^2 = c^2, T_i the earlier final time of two neighbours.

    Axis by axis in the order of T_i, as long as the solution is later than the next one.
    """
    iz, iy, ix = unravel(cell, grid)
    cost = cost_at(cell, iz, iy, ix, medium, tissue, grid)
    a = earlier(times, cell, iz, grid.nz, grid.ny * grid.nx)
    b = earlier(times, cell, iy, grid.ny, grid.nx)
    c = earlier(times, cell, ix, grid.nx, 1)
    wa, wb, wc = 1.0 / (grid.hz * grid.hz), 1.0 / (grid.hy * grid.hy), 1.0 / (grid.hx * grid.hx)
    if b < a:
        a, b, wa, wb = b, a, wb, wa
    if c < b:
        b, c, wb, wc = c, b, wc, wb
    if b < a:
        a, b, wa, wb = b, a, wb, wa
    time = a + cost / np.sqrt(wa)
    if time <= b:
        return time
    time = later_root(cost, wa, wb, 0.0, b - a, 0.0) + a
    if time <= c:
        return time
    return later_root(cost, wa, wb, wc, b - a, c - a) + a


@kernel
def cost_at(cell, iz, iy, ix, medium, tissue, grid):
    """Cost per mm: w0 + w1 min(|grad I|/g, w2) + w3 min(max(|I - median|/spread - w4, 0), w5), of the worst channel."""
    w = tissue.weights
    edge, far = 0.0, 0.0
    for channel in range(len(medium.values)):
        values = medium.values[channel]
        dz = difference(values, cell, iz, grid.nz, grid.ny * grid.nx) / grid.hz
        dy = difference(values, cell, iy, grid.ny, grid.nx) / grid.hy
        dx = difference(values, cell, ix, grid.nx, 1) / grid.hx
        edge = max(edge, np.sqrt(dz * dz + dy * dy + dx * dx) / tissue.gradient[channel])
        far = max(far, abs(values[cell] - tissue.median[channel]) / tissue.spread[channel])
    return w[0] + w[1] * min(edge, w[2]) + w[3] * min(max(far - w[4], 0.0), w[5])


@kernel
def difference(values, cell, index, length, stride):
    """Central difference per voxel along an axis; one-sided at the border."""
    before, after = (stride if index > 0 else 0), (stride if index < length - 1 else 0)
    if before + after == 0:
        return 0.0
    return np.float64(values[cell + after] - values[cell - before]) * stride / (before + after)


@kernel
def later_root(cost, wa, wb, wc, b, c):
    """The larger T of wa T^2 + wb (T - b)^2 + wc (T - c)^2 = cost^2."""
    total, first = wa + wb + wc, wb * b + wc * c
    rest = wb * b * b + wc * c * c - cost * cost
    return (first + np.sqrt(max(first * first - total * rest, 0.0))) / total


@kernel
def earlier(times, cell, index, length, stride):
    """The earlier of the final times of the two neighbours along an axis; inf where neither is final."""
    before = np.float64(times[cell - stride]) if index > 0 else np.inf
    after = np.float64(times[cell + stride]) if index < length - 1 else np.inf
    before = before if before >= 0.0 else np.inf
    after = after if after >= 0.0 else np.inf
    return min(before, after)


@kernel
def with_space(order, count):
    """The list of accepted voxels with space for one more."""
    if count < len(order):
        return order
    more = np.empty(2 * count, np.int64)
    more[:count] = order
    return more
