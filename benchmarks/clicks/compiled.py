"""Compiled parts of the peers that no installed library has: shortest paths from seeds, and trees over features."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def nearest_seed(values, seeds, offsets, lengths, weight, squared):
    """The seed that each voxel is nearest to, by the shortest path (Dijkstra).

    Parameters
    ----------
    values : ndarray of float32, shape (nz, ny, nx)
    seeds : ndarray of uint8, of the same shape
        0 where open.
    offsets : ndarray of int64, shape (n, 3)
        Steps to the neighbours.
    lengths : ndarray of float32, shape (n,)
        What a step costs in even tissue.
    weight : float
        Of a difference in value.
    squared : bool
        A step costs sqrt(length^2 + (weight difference)^2); otherwise length + weight |difference|.

    Returns
    -------
    ndarray of uint8, shape (nz, ny, nx)
    """
    nz, ny, nx = values.shape
    size = nz * ny * nx
    far = np.full(size, np.float32(np.inf))
    label = seeds.copy().ravel()
    done = np.zeros(size, np.bool_)
    keys = np.empty(4 * size + 16, np.float32)
    cells = np.empty(4 * size + 16, np.int64)
    count = 0
    for i in range(size):
        if label[i] > 0:
            far[i] = 0.0
            keys[count] = 0.0
            cells[count] = i
            count += 1
    flat = values.ravel()
    while count > 0:
        here = cells[0]
        count -= 1
        last, moved = keys[count], cells[count]
        at = 0
        while True:
            child = 2 * at + 1
            if child >= count:
                break
            if child + 1 < count and keys[child + 1] < keys[child]:
                child += 1
            if keys[child] >= last:
                break
            keys[at] = keys[child]
            cells[at] = cells[child]
            at = child
        keys[at] = last
        cells[at] = moved
        if done[here]:
            continue
        done[here] = True
        z = here // (ny * nx)
        y = here // nx % ny
        x = here % nx
        for n in range(offsets.shape[0]):
            c = z + offsets[n, 0]
            b = y + offsets[n, 1]
            a = x + offsets[n, 2]
            if c < 0 or b < 0 or a < 0 or c >= nz or b >= ny or a >= nx:
                continue
            there = (c * ny + b) * nx + a
            if done[there]:
                continue
            change = weight * abs(flat[there] - flat[here])
            if squared:
                step = np.sqrt(lengths[n] * lengths[n] + change * change)
            else:
                step = lengths[n] + change
            reached = np.float32(far[here] + step)
            if reached < far[there]:
                far[there] = reached
                label[there] = label[here]
                if count == keys.size:
                    keys = np.append(keys, np.empty_like(keys))
                    cells = np.append(cells, np.empty_like(cells))
                at = count
                count += 1
                while at > 0 and keys[(at - 1) // 2] > reached:
                    keys[at] = keys[(at - 1) // 2]
                    cells[at] = cells[(at - 1) // 2]
                    at = (at - 1) // 2
                keys[at] = reached
                cells[at] = there
    return label.reshape(values.shape)


@njit(cache=True)
def vote(features, feature, threshold, share):
    """Mean over trees of the share of "inside" in the leaf that each row falls into.

    Parameters
    ----------
    features : ndarray of float32, shape (rows, columns)
    feature, threshold, share : ndarray, shape (trees, 2^(depth + 1) - 1)
        Complete trees by level: the children of node i are 2 i + 1 and 2 i + 2; ``feature`` < 0 marks a leaf.
    """
    rows, trees = features.shape[0], feature.shape[0]
    out = np.zeros(rows, np.float32)
    for row in range(rows):
        total = np.float32(0.0)
        for tree in range(trees):
            node = 0
            while feature[tree, node] >= 0:
                node = 2 * node + (
                    1 if features[row, feature[tree, node]] <= threshold[tree, node] else 2
                )
            total += share[tree, node]
        out[row] = total / trees
    return out
