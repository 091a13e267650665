"""Arrival times, plainly: fast marching with a heap, voxel by voxel."""

import heapq
from itertools import product

import numpy as np


def plain_cost(image, spacing, median, spread, edge, weights):
    """Cost per mm (nz, ny, nx) of one channel, as `accelsurf.clicks.kernels.arrival.cost_at` has it."""
    parts = [np.gradient(image, h, axis=i) for i, h in enumerate(spacing) if image.shape[i] > 1]
    length = np.sqrt(sum(part.astype(np.float64) ** 2 for part in parts))
    base, w_edge, max_edge, w_far, free, max_far = weights
    far = np.abs(image.astype(np.float64) - median) / spread
    return (
        base
        + w_edge * np.minimum(length / edge, max_edge)
        + w_far * np.clip(far - free, 0.0, max_far)
    )


def plain_times(cost, spacing, seeds, passes=None):
    """Arrival times (nz, ny, nx) by first-order upwind differences, each the largest root over sets of axes."""
    times, final = np.full(cost.shape, np.inf), np.zeros(cost.shape, bool)
    heap = [(0.0, seed) for seed in seeds]
    for _, seed in heap:
        times[seed] = 0.0
    while heap:
        _, cell = heapq.heappop(heap)
        if final[cell]:
            continue
        final[cell] = True
        for other in around(cell, cost.shape):
            if not final[other] and (passes is None or passes[other]):
                found = solved(times, final, other, cost[other], spacing)
                if found < times[other]:
                    times[other] = found
                    heapq.heappush(heap, (found, other))
    return times


def around(cell, shape):
    """The 6-neighbours inside the grid."""
    for axis, step in product(range(3), (-1, 1)):
        index = cell[axis] + step
        if 0 <= index < shape[axis]:
            yield (*cell[:axis], index, *cell[axis + 1 :])


def solved(times, final, cell, cost, spacing):
    """The smallest root over all sets of axes that is no earlier than the neighbours that it uses."""
    earliest = []
    for axis in range(3):
        known = [times[o] for o in around(cell, times.shape) if o[axis] != cell[axis] and final[o]]
        if known:
            earliest.append((min(known), spacing[axis]))
    earliest.sort()
    best = np.inf
    for n in range(1, len(earliest) + 1):
        weights = np.array([1.0 / h**2 for _, h in earliest[:n]])
        values = np.array([t for t, _ in earliest[:n]])
        a, b, c = weights.sum(), (weights * values).sum(), (weights * values**2).sum() - cost**2
        if b * b - a * c >= 0.0:
            root = (b + np.sqrt(b * b - a * c)) / a
            if root >= values[-1]:
                best = min(best, root)
    return best
