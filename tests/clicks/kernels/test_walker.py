"""Random walks: the solution of the linear equations, against SciPy's direct solver and by symmetry."""

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from accelsurf.clicks.kernels.walker import MIN_WEIGHT, walk

SHAPE = (4, 5, 7)


def by_scipy(start, fixed, values, spacing, sharpness):
    index = np.arange(start.size).reshape(start.shape)
    rows, columns, weights = [], [], []
    flat = values.reshape(len(values), -1)
    for axis in range(3):
        count = start.shape[axis]
        here, there = (
            np.take(index, part, axis).ravel() for part in (range(count - 1), range(1, count))
        )
        slopes = (flat[:, there] - flat[:, here]).astype(np.float64) / spacing[axis]
        weight = np.exp(-sharpness * (slopes**2).sum(axis=0)) + MIN_WEIGHT
        rows += [here, there]
        columns += [there, here]
        weights += [weight, weight]
    parts = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    links = coo_array(parts, shape=(start.size, start.size)).tocsr()
    laplacian = (diags_array(links.sum(axis=1)) - links).tocsr()
    held, out = fixed.ravel(), start.ravel().copy()
    right = -laplacian[~held][:, held] @ out[held]
    out[~held] = spsolve(laplacian[~held][:, ~held].tocsc(), right)
    return out.reshape(start.shape)


def problem():
    random = np.random.default_rng(5)
    values = random.normal(size=(2, *SHAPE)).astype(np.float32)
    fixed = random.random(SHAPE) < 0.1
    start = np.where(fixed, np.where(random.random(SHAPE) < 0.5, -1.0, 1.0), 0.0)
    return start, fixed, values, np.array([2.0, 1.0, 1.5])


def test_it_solves_the_equations():
    start, fixed, values, spacing = problem()
    found = start.copy()
    assert walk(found, fixed, values, spacing, 0.7, 1e-10, 1000) < 1000
    np.testing.assert_allclose(found, by_scipy(start, fixed, values, spacing, 0.7), atol=1e-8)
    assert (found[fixed] == start[fixed]).all()


def test_it_stops_at_the_tolerance():
    start, fixed, values, spacing = problem()
    rough, fine = start.copy(), start.copy()
    assert walk(rough, fixed, values, spacing, 0.7, 1e-2, 1000) < walk(
        fine, fixed, values, spacing, 0.7, 1e-8, 1000
    )
    assert np.abs(rough - fine).max() < 0.05


def test_between_two_ends_it_is_linear():
    start = np.zeros((1, 1, 5))
    start[0, 0, 0], start[0, 0, 4] = -1.0, 1.0
    walk(start, start != 0, np.zeros((1, 1, 1, 5), np.float32), np.ones(3), 1.0, 1e-12, 100)
    np.testing.assert_allclose(start.ravel(), [-1.0, -0.5, 0.0, 0.5, 1.0], atol=1e-9)


def test_with_one_side_alone_all_is_that_side():
    start = np.zeros(SHAPE)
    start[0, 0, 0] = -1.0
    walk(start, start != 0, np.zeros((1, *SHAPE), np.float32), np.ones(3), 1.0, 1e-10, 1000)
    np.testing.assert_allclose(start, -1.0, atol=1e-6)
