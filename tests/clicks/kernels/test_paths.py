"""Shortest paths: against SciPy's Dijkstra, and the odd ends."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from accelsurf.clicks.kernels.arrival import shortest_paths

SHAPE = (4, 6, 7)


def by_scipy(seeds, values, lengths, weight):
    size = seeds.size
    index = np.arange(size).reshape(seeds.shape)
    rows, columns, costs = [], [], []
    for axis in range(3):
        count = seeds.shape[axis]
        here, there = (
            np.take(index, part, axis).ravel() for part in (range(count - 1), range(1, count))
        )
        change = weight * (
            values.reshape(len(values), -1)[:, there] - values.reshape(len(values), -1)[:, here]
        )
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
    found = shortest_paths(
        np.zeros(SHAPE, bool), np.zeros((1, *SHAPE), np.float32), np.ones(3), 1.0
    )
    assert np.isinf(found).all()


def test_where_all_are_seeds_no_path_is_longer_than_nothing():
    shape = (20, 20, 30)
    found = shortest_paths(np.ones(shape, bool), np.zeros((1, *shape), np.float32), np.ones(3), 1.0)
    assert (found == 0.0).all()


def test_a_path_that_winds_through_walls_is_followed_to_its_end():
    values = np.full((1, 1, 21, 15), 9.0, np.float32)
    values[0, 0, ::2] = 0.0
    for wall in range(1, 21, 2):  # one gap in each, to the left and to the right in turns
        values[0, 0, wall, 0 if wall % 4 == 1 else -1] = 0.0
    seeds = np.zeros(values.shape[1:], bool)
    seeds[0, 0, -1] = True
    for turned in (lambda a: a, np.flipud, np.fliplr, np.transpose):
        flat_values, flat_seeds = (
            np.ascontiguousarray(turned(a)) for a in (values[0, 0], seeds[0])
        )
        found = shortest_paths(flat_seeds[None], flat_values[None, None], np.ones(3), 100.0)
        way = flat_values == 0.0
        assert found[0][way].max() == np.count_nonzero(way) - 1
        expected = by_scipy(flat_seeds[None], flat_values[None, None], np.ones(3), 100.0)
        np.testing.assert_allclose(found, expected, rtol=1e-5)
