"""Window sums and histograms against slow references: every window by its formula, every value by itself."""

import math

import numpy as np
import pytest

from accelsurf.kernels import statistics, windows
from accelsurf.kernels.grid import BLOCK, Band, Grid
from tests.support import reference

pytestmark = pytest.mark.nojit

SHAPE, SPACING = (7, 9, 11), (2.0, 1.0, 0.8)
#: Nodes along each axis: (number, distance in voxels, before voxel 0), and the half_width of the tent.
NODES, REACH = windows.Nodes(7, 9, 10, 1.5, 2.3, 2.0, 1, 2, 2), (2, 3, 3)


def weights():
    axes = zip(SHAPE, NODES[3:6], NODES[6:], REACH, NODES[:3], strict=True)
    return [
        reference.node_weights(n, b, before, half_width, count)
        for n, b, before, half_width, count in axes
    ]


def smoothed(field):
    step, values = 1, field.ravel()
    for axis in (2, 1, 0):
        out = np.empty_like(values)
        # In two ranges: what a range needs of the other one is read, not written.
        half = values.size // 2
        for start, stop in ((0, half), (half, values.size)):
            windows.tent_along(
                start, stop, values, step * field.shape[axis], step, REACH[axis], out
            )
        step, values = step * field.shape[axis], out
    return values.reshape(field.shape)


def test_windows_add_up_to_1_on_every_voxel():
    for axis in weights():
        np.testing.assert_allclose(axis.sum(axis=0), 1.0)


def test_scatter_and_tents_are_the_window_sums():
    rng = np.random.default_rng(1)
    image, share = rng.normal(size=SHAPE).astype(np.float32), rng.random(SHAPE)
    share[rng.random(SHAPE) < 0.2] = 0.0
    grid = reference.grid_of(SHAPE, SPACING)
    counts, totals = np.zeros(NODES[:3]).ravel(), np.zeros(NODES[:3]).ravel()
    windows.scatter(
        np.arange(share.size), share.ravel(), image.ravel(), grid, NODES, counts, totals
    )
    for got, values in ((counts, share), (totals, share * image)):
        want = reference.window_sums(values, weights())
        np.testing.assert_allclose(smoothed(got.reshape(NODES[:3])), want, atol=1e-12)


def test_scatter_inside_is_that_of_the_inside_voxels_out_of_the_band():
    rng = np.random.default_rng(2)
    psi, image = (
        rng.normal(size=SHAPE).astype(np.float32),
        rng.normal(size=SHAPE).astype(np.float32),
    )
    lattice, _ = reference.whole_band(psi)
    lattice.slot[rng.random(psi.size) < 0.7] = -1
    grid = reference.grid_of(SHAPE, SPACING)
    got = [np.zeros(math.prod(NODES[:3])) for _ in range(4)]
    windows.scatter_inside(lattice, image.ravel(), grid, NODES, got[0], got[1])
    cells = np.flatnonzero((lattice.slot < 0) & (psi.ravel() < 0))
    windows.scatter(cells, np.ones(cells.size), image.ravel(), grid, NODES, got[2], got[3])
    np.testing.assert_array_equal(got[0], got[2])
    np.testing.assert_array_equal(got[1], got[3])
    assert got[0].sum() == pytest.approx(cells.size)


def test_two_means_by_their_formulas():
    rng = np.random.default_rng(3)
    n, n1 = rng.random(50) + 1.0, rng.random(50)
    n1[:3] = 0.0
    total, total1 = rng.normal(size=50), rng.normal(size=50)
    out = np.full((3, 50), np.nan)
    windows.two_means(0, 50, n, total, n1, total1, 1e-6, out)
    f1, f2 = np.divide(total1, n1, where=n1 > 0, out=np.zeros(50)), (total - total1) / (n - n1)
    better = total1 * f1 + (total - total1) * f2 - total**2 / n
    for got, want in zip(out, (f1 - f2, f1**2 - f2**2, better), strict=True):
        np.testing.assert_allclose(got[3:], want[3:], rtol=1e-9, atol=1e-12)
        assert (got[:3] == 0).all()


def test_read_nodes_is_linear_between_them():
    rng = np.random.default_rng(4)
    grid, n = reference.grid_of(SHAPE, SPACING), math.prod(SHAPE)
    closest_point = rng.uniform(-0.6, 0.6, (n, 3)).astype(np.float32)
    band, front = Band(np.arange(n), np.zeros(n, np.float32), closest_point), rng.random(n) < 0.8
    first, second = rng.normal(size=NODES[:3]), rng.normal(size=NODES[:3])
    out = np.full((n, 2), np.nan)
    windows.read_nodes(0, n, grid, band, front, NODES, (first.ravel(), second.ravel()), out)
    index = np.stack(np.unravel_index(np.arange(n), SHAPE), axis=1) + closest_point / np.array(
        SPACING
    )
    place = np.clip(index / np.array(NODES[3:6]) + np.array(NODES[6:]), 0, np.array(NODES[:3]) - 1)
    for got, field in zip(out.T, (first, second), strict=True):
        np.testing.assert_allclose(got[front], reference.linear(field, place)[front], atol=1e-6)
        assert (got[~front] == 0).all()


def test_histograms_share_values_between_bins():
    rng = np.random.default_rng(5)
    shape, scale, bins = (3, 40, 40), (-1.0, 3.5), 9
    image, weight = rng.normal(size=shape).astype(np.float32), rng.random(shape)
    weight[0] = 0.0
    rows = np.zeros((-(-image.size // BLOCK), bins))
    cells = np.arange(image.size)
    statistics.weighted_histogram(0, len(rows), cells, weight.ravel(), image.ravel(), scale, rows)
    np.testing.assert_allclose(
        rows.sum(axis=0), reference.histogram(image, weight, *scale, bins), atol=1e-9
    )
    lattice, _ = reference.whole_band(rng.normal(size=shape))
    lattice.slot[rng.random(image.size) < 0.6] = -1
    rows, grid = np.zeros((shape[0], bins)), Grid(*shape, 1.0, 1.0, 1.0)
    statistics.inside_histogram(0, len(rows), lattice, image.ravel(), grid, scale, rows)
    counted = ((lattice.slot < 0) & (lattice.psi < 0)).astype(float)
    np.testing.assert_allclose(
        rows.sum(axis=0), reference.histogram(image, counted, *scale, bins), atol=1e-9
    )


def test_look_up_is_linear_between_bins():
    image, table = np.linspace(-3, 3, 31).astype(np.float32), np.array([0.0, 1.0, 4.0, 9.0])
    out = np.zeros(31, np.float32)
    statistics.look_up(0, 31, image, (-1.0, 2.0), table, out)
    np.testing.assert_allclose(out, np.interp(image, [-1.0, -0.5, 0.0, 0.5], table), atol=1e-6)
