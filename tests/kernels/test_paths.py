"""Shortest paths: against SciPy's Dijkstra, and the odd ends."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from accelsurf.kernels.paths import shortest_paths

SHAPE = (4, 6, 7)


def by_scipy(seeds, values, lengths, weight):
    size = seeds.size
    index = np.arange(size).reshape(seeds.shape)
    rows, columns, costs = [], [], []
    for axis in range(3):
        count = seeds.shape[axis]
        here, there = (np.take(index, part, axis).ravel() for part in (range(count - 1), range(1, count)))
        change = weight * (values.reshape(len(values), -1)[:, there] - values.reshape(len(values), -1)[:, here])
        rows.append(here)
        columns.append(there)
        costs.append(np.sqrt(lengths[axis] ** 2 + (change.astype(np.float64) ** 2).sum(axis=0)))
    rows, columns, costs = (np.concatenate(parts) for parts in (rows, columns, costs))
    graph = coo_array((costs, (rows, columns)), shape=(size, size)).tocsr()
    far = dijkstra(graph, directed=False, indices=np.flatnonzero(seeds), min_only=True)
    return far.reshape(seeds.shape)


def test_lengths_are_scipy_s():
    random = np.random.default_rng(3)
    values = random.normal(size=(2, *SHAPE)).astype(np.float32)
    seeds = random.random(SHAPE) < 0.02
    seeds[0, 0, 0] = True
    lengths = np.array([2.5, 1.0, 1.2])
    found = shortest_paths(seeds, values, lengths, 20.0)
    np.testing.assert_allclose(found, by_scipy(seeds, values, lengths, 20.0), rtol=1e-5)


def test_without_seeds_nothing_is_reached():
    found = shortest_paths(np.zeros(SHAPE, bool), np.zeros((1, *SHAPE), np.float32), np.ones(3), 1.0)
    assert np.isinf(found).all()


def test_more_waiting_voxels_than_the_queue_begins_with():
    shape = (20, 20, 30)
    found = shortest_paths(np.ones(shape, bool), np.zeros((1, *shape), np.float32), np.ones(3), 1.0)
    assert (found == 0.0).all()
