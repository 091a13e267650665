"""Random fields as sums of plane waves: against numpy, and their mean, variance and correlation over many draws."""

import numpy as np
import pytest

from accelsurf.kernels import waves
from accelsurf.kernels.grid import Band
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.3, 0.7)
SHAPES = [(3, 4, 5), (1, 5, 6), (2, 1, 7)]


def band_of(shape, seed):
    n = int(np.prod(shape))
    closest_point = (np.random.default_rng(seed).uniform(-1, 1, (n, 3)) * SPACING).astype(
        np.float32
    )
    return Band(np.arange(n), np.ones(n, np.float32), closest_point)


def closest_points(shape, band):
    """Closest points in mm, (n, 3)."""
    return np.argwhere(np.ones(shape, bool))[band.cells] * np.array(
        SPACING
    ) + band.to_closest.astype(float)


def draw(rng, count, length):
    """As the noise of the flows draws them."""
    return rng.normal(size=(count, 3)) / length, rng.uniform(0, 2 * np.pi, count)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [1, 7])
def test_sum_of_waves_as_numpy(shape, count):
    band, rng = band_of(shape, 1), np.random.default_rng(2)
    n = band.cells.size
    vectors, phases = draw(rng, count, 1.5)
    front, out = rng.random(n) < 0.6, np.full(n, np.nan, np.float32)
    waves.sum_of_waves(0, n, reference.grid_of(shape, SPACING), band, front, vectors, phases, out)
    # As the real part of complex waves.
    want = (
        np.sqrt(2 / count)
        * np.exp(1j * (closest_points(shape, band) @ vectors.T + phases)).sum(axis=1).real
    )
    np.testing.assert_allclose(out[front], want[front], atol=1e-6)
    assert (out[~front] == 0).all() and not front.all()
    assert np.abs(out).max() <= np.sqrt(2 * count) + 1e-6


def test_only_the_point_in_space_counts():
    """Not the cell that it is the closest point of."""
    shape, point = (4, 5, 6), np.array([4.2, 2.3, 1.9])
    at = np.argwhere(np.ones(shape, bool)) * np.array(SPACING)
    band = Band(np.arange(120), np.ones(120, np.float32), (point - at).astype(np.float32))
    vectors, phases = draw(np.random.default_rng(3), 9, 1.5)
    out = np.empty(120, np.float32)
    waves.sum_of_waves(
        0, 120, reference.grid_of(shape, SPACING), band, np.ones(120, bool), vectors, phases, out
    )
    np.testing.assert_allclose(out, out[0], atol=1e-5)


def test_only_its_range_is_written():
    band, out = band_of((3, 4, 5), 4), np.full(60, np.nan, np.float32)
    vectors, phases = draw(np.random.default_rng(5), 3, 1.5)
    grid = reference.grid_of((3, 4, 5), SPACING)
    waves.sum_of_waves(7, 20, grid, band, np.ones(60, bool), vectors, phases, out)
    assert np.isfinite(out[7:20]).all() and np.isnan(out[:7]).all() and np.isnan(out[20:]).all()


def test_mean_variance_and_correlation_over_many_draws():
    """0, 1 and exp(-|d|^2/(2 length^2)), d in mm, in every direction."""
    shape, length, draws = (3, 4, 5), 2.5, 1500
    at = np.array(
        [
            (3.0, 1.0, 0.7),
            (3.0, 3.0, 0.7),
            (6.0, 1.0, 0.7),
            (3.0, 1.0, 3.2),
            (4.2, 2.2, 2.0),
            (3, 1, 1.4),
        ]
    )
    cells = np.array([0, 21, 33, 34, 55, 59])
    corner = np.argwhere(np.ones(shape, bool))[cells] * np.array(SPACING)
    band = Band(cells, np.ones(6, np.float32), (at - corner).astype(np.float32))
    rng, grid, front = np.random.default_rng(6), reference.grid_of(shape, SPACING), np.ones(6, bool)
    xi = np.empty((draws, 6), np.float32)
    for row in xi:
        waves.sum_of_waves(0, 6, grid, band, front, *draw(rng, 8, length), row)
    squared = ((at[:, None] - at) ** 2).sum(axis=2)
    want = np.exp(-squared / (2 * length**2))
    got = xi.T.astype(float) @ xi / draws
    assert np.abs(xi.mean(axis=0)).max() < 0.1  # 4 standard errors
    assert np.abs(np.diag(got) - 1).max() < 0.13
    assert np.abs(got - want).max() < 0.13
    # Correlations of another shape or length differ.
    for other in (
        np.exp(-squared / length**2),
        np.exp(-squared / (4 * length**2)),
        np.exp(-np.sqrt(squared) / length),
    ):
        assert np.abs(got - other).max() > 0.15


def test_no_variation_along_an_axis_without_waves():
    """How the flows treat a single slice: vectors without a component across it."""
    shape = (1, 5, 6)
    band = band_of(shape, 7)
    vectors, phases = draw(np.random.default_rng(8), 6, 1.5)
    vectors[:, 0] = 0
    grid, one, other = (
        reference.grid_of(shape, SPACING),
        np.empty(30, np.float32),
        np.empty(30, np.float32),
    )
    waves.sum_of_waves(0, 30, grid, band, np.ones(30, bool), vectors, phases, one)
    band.to_closest[:, 0] = 0
    waves.sum_of_waves(0, 30, grid, band, np.ones(30, bool), vectors, phases, other)
    np.testing.assert_array_equal(one, other)
