"""The operator on the tube against its dense matrix: symmetric, positive, no flux out of the band."""

import numpy as np
import pytest

from accelsurf.kernels import tube
from accelsurf.kernels.grid import Band
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.3, 0.7)
SHAPES = [(4, 5, 6), (1, 7, 5), (5, 1, 4), (2, 3, 3), (1, 1, 6)]
LENGTH = 2.3


def tube_of(shape, seed, share=0.8, within=0.7):
    """(grid, slot map, cells, weights, weights on the grid): a band with holes, part of it in the tube."""
    rng = np.random.default_rng(seed)
    present = rng.random(int(np.prod(shape))) < share
    cells = np.flatnonzero(present)
    slot = np.full(present.size, -1, np.int32)
    slot[cells] = np.arange(cells.size)
    eta = np.where(rng.random(cells.size) < within, rng.uniform(0.01, 1, cells.size), 0.0)
    dense = np.zeros(shape)
    dense.flat[cells] = eta
    return reference.grid_of(shape, SPACING), slot, cells, eta, dense


def product(made, field, length=LENGTH):
    grid, slot, cells, eta, _ = made
    out = np.full(cells.size, np.nan)
    tube.tube_product(0, cells.size, slot, grid, cells, (eta, length), field, out)
    return out


def diagonal(made, length=LENGTH):
    grid, slot, cells, eta, _ = made
    out = np.full(cells.size, np.nan)
    tube.tube_diagonal(0, cells.size, slot, grid, cells, (eta, length), out)
    return out


def test_weights_fade_along_the_normal():
    """Cos^2 of the distance in voxels along the normal, whatever its direction, 0 from the width on."""
    shape, width = (3, 4, 5), 2.5
    rng = np.random.default_rng(1)
    closest_point = (rng.uniform(-1.6, 1.6, (60, 3)) * SPACING).astype(np.float32)
    closest_point[:5] = (
        np.array([(0, 0, 0), (2.5, 0, 0), (0, -1.25, 0), (0, 0, 2.4999), (0, 4, 0)]) * SPACING
    )
    band = Band(np.arange(60), np.ones(60, np.float32), closest_point)
    eta = np.full(60, np.nan)
    tube.tube_weight(0, 60, reference.grid_of(shape, SPACING), band, width, eta)
    s = np.sqrt(((closest_point.astype(float) / SPACING) ** 2).sum(axis=1))
    want = np.where(s < width, np.cos(np.pi * s / (2 * width)) ** 2, 0)
    np.testing.assert_allclose(eta, want, atol=1e-6)
    np.testing.assert_allclose(eta[:5], [1, 0, 0.5, 0, 0], atol=1e-6)
    assert (eta >= 0).all() and (eta[s >= width] == 0).all() and (s >= width).any()


@pytest.mark.sampled
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.7])
def test_product_and_diagonal_are_those_of_the_matrix(shape, share):
    made = tube_of(shape, 2, share)
    *_, cells, eta, dense = made
    present = np.zeros(shape, bool)
    present.flat[cells] = True
    matrix = reference.tube_matrix(dense, present, SPACING, LENGTH)[np.ix_(cells, cells)]
    field = np.random.default_rng(3).standard_normal(cells.size)
    np.testing.assert_allclose(product(made, field), matrix @ field, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        diagonal(made), np.where(matrix.diagonal() > 0, matrix.diagonal(), 1), rtol=1e-12
    )
    # Column by column: the diagonal is the product's own. Cells beside the tube take part, as its edge has faces there.
    unit = np.eye(cells.size)
    columns = np.stack([product(made, row) for row in unit], axis=1)
    np.testing.assert_allclose(columns, matrix, rtol=1e-12, atol=1e-12)
    if shape == (4, 5, 6):
        assert columns[eta == 0].any() and columns[:, eta == 0].any()


@pytest.mark.parametrize("shape", SHAPES)
def test_product_is_symmetric_and_positive(shape):
    made = tube_of(shape, 4)
    *_, cells, eta, _ = made
    rng = np.random.default_rng(5)
    for _ in range(5):
        a, b = rng.standard_normal((2, cells.size))
        assert a @ product(made, b) == pytest.approx(b @ product(made, a), rel=1e-11, abs=1e-11)
        # No less than the weighted square: the rest is that of a gradient.
        assert a @ product(made, a) >= (eta * a * a).sum() * (1 - 1e-12)
        assert (eta * a * a).sum() > 0
        np.testing.assert_allclose(product(made, a, 0.0), eta * a, rtol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_constant_passes_no_flux(shape):
    """Not through the border, not to cells off the band: K 1 = eta; with weights 1, sum K g = sum g."""
    made = tube_of(shape, 6)
    grid, slot, cells, eta, dense = made
    np.testing.assert_allclose(product(made, np.ones(cells.size)), eta, rtol=1e-14)
    field = np.random.default_rng(7).standard_normal(cells.size)
    assert product(made, field).sum() == pytest.approx((eta * field).sum(), abs=1e-10)
    even = grid, slot, cells, np.ones(cells.size), dense
    assert product(even, field).sum() == pytest.approx(field.sum(), abs=1e-10)


def test_cells_without_neighbours():
    """One with none in the volume, one with none in the band; and one off the tube, coupled to its neighbour."""
    one = (
        reference.grid_of((1, 1, 1), SPACING),
        np.zeros(1, np.int32),
        np.zeros(1, np.int64),
        np.array([0.3]),
        None,
    )
    np.testing.assert_array_equal(product(one, np.array([2.0])), [0.6])
    np.testing.assert_array_equal(diagonal(one), [0.3])
    slot = np.full(27, -1, np.int32)
    cells = np.array([0, 13, 14, 26])
    slot[cells] = np.arange(4)
    eta = np.array([0.5, 0.25, 0.0, 1.0])
    made = reference.grid_of((3, 3, 3), SPACING), slot, cells, eta, None
    face = LENGTH**2 * 0.125 / SPACING[2] ** 2
    want = [2, 1 - 5 * face, 5 * face, -3]
    np.testing.assert_allclose(product(made, np.array([4.0, 4.0, 9.0, -3.0])), want, rtol=1e-12)
    np.testing.assert_allclose(diagonal(made), [0.5, 0.25 + face, face, 1], rtol=1e-12)


def test_weights_one_make_the_screened_laplacian():
    """1 - ell^2 Laplacian, each axis with its spacing."""
    shape = (4, 5, 6)
    cells, field = np.arange(120), reference.smooth_noise(shape, 8).astype(float)
    made = (
        reference.grid_of(shape, SPACING),
        cells.astype(np.int32),
        cells,
        np.ones(120),
        np.ones(shape),
    )
    want = field - LENGTH**2 * reference.laplacian(field, np.ones(shape, bool), SPACING)
    np.testing.assert_allclose(product(made, field.ravel()), want.ravel(), rtol=1e-10, atol=1e-10)


def test_kernels_write_only_their_range():
    grid, slot, cells, eta, _ = tube_of((4, 5, 6), 9)
    band = Band(cells, np.ones(cells.size, np.float32), np.zeros((cells.size, 3), np.float32))
    field = np.ones(cells.size)
    for call in (
        lambda out: tube.tube_weight(7, 20, grid, band, 2.0, out),
        lambda out: tube.tube_product(7, 20, slot, grid, cells, (eta, LENGTH), field, out),
        lambda out: tube.tube_diagonal(7, 20, slot, grid, cells, (eta, LENGTH), out),
    ):
        out = np.full(cells.size, np.nan)
        call(out)
        assert np.isfinite(out[7:20]).all() and np.isnan(out[:7]).all() and np.isnan(out[20:]).all()
