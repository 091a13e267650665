"""Interpolation: weights, value and gradient, on thin volumes and beyond the border, and in an incomplete band."""

import numpy as np
import pytest

from accelsurf.kernels import interpolate
from tests import reference

pytestmark = pytest.mark.nojit

SHAPES = [(7, 9, 8), (5, 4, 6), (1, 9, 12), (2, 5, 7), (6, 3, 2), (3, 1, 4), (1, 1, 5)]
SPACING = (3.0, 1.0, 0.7)


def positions(shape, seed, count=40, beyond=0.0):
    """Random positions, all corners and some voxel centres."""
    rng = np.random.default_rng(seed)
    last = np.array(shape) - 1.0
    some = rng.uniform(-beyond, last + beyond, (count, 3))
    corners = np.array(np.meshgrid(*((0.0, n) for n in last), indexing="ij")).reshape(3, -1).T
    return np.concatenate([some, corners, np.floor(np.clip(some[:10], 0, last))])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 9])
def test_weights_are_those_of_the_monomials_and_reach_only_nodes_of_the_axis(n):
    for p in np.concatenate([np.linspace(-1.7, n + 0.7, 35), np.arange(n), [np.nextafter(n - 1, 0)]]):
        w = np.full(24, np.nan)
        base, count, beyond = interpolate.axis_weights(p, n, w, 8)
        want_base, want, want_slope, want_beyond = reference.axis_weights(np.array([p]), n)
        assert count == min(n, 4)
        assert 0 <= base <= n - count
        assert base == want_base[0]
        assert beyond == want_beyond[0]
        np.testing.assert_allclose(w[8 : 8 + count], want[0], atol=1e-13)
        np.testing.assert_allclose(w[12 : 12 + count], want_slope[0], atol=1e-12)
        assert w[8 : 8 + count].sum() == pytest.approx(1, abs=1e-13)
        assert w[12 : 12 + count].sum() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_value_and_gradient_as_the_twin_also_beyond_the_border(shape):
    array = reference.smooth_noise(shape, 1)
    grid = reference.grid_of(shape, SPACING)
    points = positions(shape, 2, beyond=1.5)
    want, slope = reference.interpolate(array, points)
    got = np.array([interpolate.value_and_gradient(array.ravel(), grid, *p, np.empty(24)) for p in points])
    np.testing.assert_allclose(got[:, 0], want, atol=2e-5)
    np.testing.assert_allclose(got[:, 1:], slope / SPACING, atol=2e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_value_at_and_linear_at_are_held_at_the_border(shape):
    array = reference.smooth_noise(shape, 3)
    grid = reference.grid_of(shape, SPACING)
    points = positions(shape, 4, beyond=1.5)
    held = np.clip(points, 0, np.array(shape) - 1.0)
    cubic = [interpolate.value_at(array.ravel(), grid, *p, np.empty(24)) for p in points]
    np.testing.assert_allclose(cubic, reference.interpolate(array, held)[0], atol=2e-5)
    straight = [interpolate.linear_at(array.ravel(), grid, *p) for p in points]
    np.testing.assert_allclose(straight, reference.linear(array, held), atol=2e-6)


def test_voxel_values_come_back_and_cubic_polynomials_are_exact():
    shape, grid = (5, 6, 7), reference.grid_of((5, 6, 7), SPACING)
    z, y, x = reference.coordinates(shape, SPACING, (5.0, 2.0, 2.0))

    def polynomial(z, y, x):
        return 0.2 * z**3 - y**3 + x**2 * y + z * y * x + 2 * z - 1

    array = polynomial(z, y, x)
    for p in positions(shape, 5):
        value, gz, gy, gx = interpolate.value_and_gradient(array.ravel(), grid, *p, np.empty(24))
        c = p * SPACING - (5.0, 2.0, 2.0)
        assert value == pytest.approx(polynomial(*c), abs=1e-9)
        assert gz == pytest.approx(0.6 * c[0] ** 2 + c[1] * c[2] + 2, abs=1e-9)
        assert gy == pytest.approx(-3 * c[1] ** 2 + c[2] ** 2 + c[0] * c[2], abs=1e-9)
        assert gx == pytest.approx(2 * c[2] * c[1] + c[0] * c[1], abs=1e-9)
    noise = reference.smooth_noise(shape, 6)
    for cell in np.ndindex(*shape):
        p = np.array(cell, float)
        assert interpolate.value_at(noise.ravel(), grid, *p, np.empty(24)) == pytest.approx(noise[cell], abs=1e-6)


def test_one_slice_has_no_gradient_across():
    array = reference.smooth_noise((1, 9, 12), 7)
    grid = reference.grid_of(array.shape, SPACING)
    for z in (-2.0, 0.0, 0.4):
        value, gz, _, _ = interpolate.value_and_gradient(array.ravel(), grid, z, 3.3, 4.6, np.empty(24))
        assert gz == 0
        assert value == pytest.approx(interpolate.value_at(array.ravel(), grid, 0.0, 3.3, 4.6, np.empty(24)))


def band_of(shape, present, seed):
    """Raveled slot map and values of a band of the ``present`` voxels, and the values on the grid."""
    values = np.random.default_rng(seed).standard_normal(int(present.sum())).astype(np.float32)
    slot = np.full(shape, -1, np.int32)
    slot[present] = np.arange(values.size)
    dense = np.zeros(shape, np.float32)
    dense[present] = values
    return slot.ravel(), values, dense


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (3, 5, 2)])
def test_band_value_is_cubic_in_a_complete_band(shape):
    slot, values, dense = band_of(shape, np.ones(shape, bool), 8)
    grid = reference.grid_of(shape, SPACING)
    known = np.ones(values.size, bool)
    for p in positions(shape, 9, beyond=0.8):
        got, found = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24), known)
        assert found
        assert got == pytest.approx(interpolate.value_at(dense.ravel(), grid, *p, np.empty(24)), abs=1e-6)


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 3)])
def test_band_value_falls_back_on_the_known_of_the_eight(shape):
    rng = np.random.default_rng(10)
    present = rng.random(shape) < 0.5
    slot, values, dense = band_of(shape, present, 11)
    known = rng.random(values.size) < 0.7
    on_grid = np.zeros(shape, bool)
    on_grid[present] = known
    grid = reference.grid_of(shape, SPACING)
    missing = 0
    for p in positions(shape, 12, beyond=0.8):
        want, want_found = reference.known_linear(dense, on_grid, p)
        got, found = interpolate.linear_band_value(values, slot, values.size, grid, p, known)
        assert (found, got) == (want_found, pytest.approx(want, abs=1e-5))
        full, full_found = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24), known)
        assert (full_found, full) == (want_found, pytest.approx(want, abs=1e-5))
        missing += not found
    assert missing > 0


def test_slots_that_are_not_of_this_band_do_not_count():
    """Between march and store the slot map also holds slots beyond the old band."""
    shape = (5, 6, 7)
    slot, values, dense = band_of(shape, np.ones(shape, bool), 13)
    n = 109  # two of the eight around p
    grid, p = reference.grid_of(shape, SPACING), np.array([2.4, 3.3, 2.6])
    known = np.ones(n, bool)
    on_grid = np.arange(values.size).reshape(shape) < n
    want, _ = reference.known_linear(dense, on_grid, p)
    got, found = interpolate.band_value_at(values[:n], slot, n, grid, p, np.empty(24), known)
    assert found
    assert got == pytest.approx(want, abs=1e-6)
    assert want != pytest.approx(interpolate.value_at(dense.ravel(), grid, *p, np.empty(24)), abs=1e-3)


def test_one_unknown_node_of_the_stencil_is_enough_for_the_linear_fall_back():
    shape = (6, 7, 8)
    slot, values, dense = band_of(shape, np.ones(shape, bool), 14)
    grid, p = reference.grid_of(shape, SPACING), np.array([2.4, 3.3, 2.6])
    known = np.ones(values.size, bool)
    cubic, _ = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24), known)
    known[int(np.ravel_multi_index((1, 2, 1), shape))] = False  # a corner of the 4 x 4 x 4
    got, found = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24), known)
    assert found
    assert got == pytest.approx(reference.linear(dense, p)[0], abs=1e-6)
    assert got != pytest.approx(cubic, abs=1e-3)
