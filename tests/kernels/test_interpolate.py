"""Interpolation: weights, value and gradient, on thin volumes and beyond the border, and in an incomplete band."""

import itertools

import numpy as np
import pytest

from accelsurf.kernels import interpolate
from tests.support import reference

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
    for p in np.concatenate(
        [np.linspace(-1.7, n + 0.7, 35), np.arange(n), [np.nextafter(n - 1, 0)]]
    ):
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
def test_value_and_gradient_as_the_reference_also_beyond_the_border(shape):
    array = reference.smooth_noise(shape, 1)
    grid = reference.grid_of(shape, SPACING)
    points = positions(shape, 2, beyond=1.5)
    want, slope = reference.interpolate(array, points)
    got = np.array(
        [interpolate.value_and_gradient(array.ravel(), grid, *p, np.empty(24)) for p in points]
    )
    np.testing.assert_allclose(got[:, 0], want, atol=2e-5)
    np.testing.assert_allclose(got[:, 1:], slope / SPACING, atol=2e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_value_at_and_linear_at_are_held_at_the_border(shape):
    array = reference.smooth_noise(shape, 3)
    grid = reference.grid_of(shape, SPACING)
    points = positions(shape, 4, beyond=1.5)
    clamped = np.clip(points, 0, np.array(shape) - 1.0)
    cubic = [interpolate.value_at(array.ravel(), grid, *p, np.empty(24)) for p in points]
    np.testing.assert_allclose(cubic, reference.interpolate(array, clamped)[0], atol=2e-5)
    straight = [interpolate.linear_at(array.ravel(), grid, *p) for p in points]
    np.testing.assert_allclose(straight, reference.linear(array, clamped), atol=2e-6)


def polynomial(z, y, x):
    """A cubic polynomial and its slopes along z, y, x."""
    value = 0.2 * z**3 - y**3 + x**2 * y + z * y * x + 2 * z - 1
    return value, 0.6 * z**2 + y * x + 2, -3 * y**2 + x**2 + z * x, 2 * x * y + z * y


def test_voxel_values_come_back_and_cubic_polynomials_are_exact():
    """To the rounding of float32: 34 halves of it (see test_kernels_cubic), the nodes' own and the position's."""
    shape, grid = (5, 6, 7), reference.grid_of((5, 6, 7), SPACING)
    z, y, x = reference.coordinates(shape, SPACING, (5.0, 2.0, 2.0))
    array = polynomial(z, y, x)[0].astype(np.float32)
    eps = np.finfo(np.float32).eps
    for p in positions(shape, 5):
        got = interpolate.value_and_gradient(array.ravel(), grid, *p, np.empty(24))
        want = polynomial(*(p * SPACING - (5.0, 2.0, 2.0)))
        axes = [reference.axis_weights(p[a : a + 1], shape[a]) for a in range(3)]
        block = np.abs(
            array[tuple(slice(base[0], base[0] + 4) for base, _, _, _ in axes)].astype(float)
        )
        w = [np.abs(axis[1][0]) for axis in axes]
        # Slopes of Lagrange's weights are sums of terms up to 14 in size (11 at most within the four nodes).
        sizes = [np.einsum("ijk,i,j,k", block, *w)]
        for a in range(3):
            sizes.append(
                np.einsum(
                    "ijk,i,j,k", block, *(np.full(4, 14.0) if b == a else w[b] for b in range(3))
                )
            )
        limit = 18 * eps * np.array(sizes) / (1, *SPACING) + 2 * eps * np.abs(want).max()
        assert (np.abs(np.array(got) - want) <= limit).all()
    noise = reference.smooth_noise(shape, 6)
    for cell in np.ndindex(*shape):
        p = np.array(cell, float)
        assert interpolate.value_at(noise.ravel(), grid, *p, np.empty(24)) == pytest.approx(
            noise[cell], abs=1e-6
        )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(5, 6, 7), (4, 5, 4), (4, 4, 5)])
def test_the_way_through_thin_volumes_is_exact_on_cubic_polynomials(shape, dtype):
    """thin_value_and_gradient, which takes volumes of any size, and any type."""
    grid = reference.grid_of(shape, SPACING)
    array = polynomial(*reference.coordinates(shape, SPACING, (5.0, 2.0, 2.0)))[0].astype(dtype)
    limit = 1e-9 if dtype == np.float64 else 60 * np.finfo(np.float32).eps * np.abs(array).max()
    for p in positions(shape, 5):
        got = interpolate.thin_value_and_gradient(array.ravel(), grid, *p, np.empty(24))
        np.testing.assert_allclose(
            got, polynomial(*(p * SPACING - (5.0, 2.0, 2.0))), rtol=0, atol=limit
        )


@pytest.mark.parametrize("shape", SHAPES)
def test_the_two_ways_agree_and_thin_volumes_take_the_slow_one(shape):
    array = reference.smooth_noise(shape, 15)
    grid = reference.grid_of(shape, SPACING)
    fast = shape[2] >= 4 and all(n >= 4 or n == 1 for n in shape[:2])
    assert interpolate.has_cubes(grid) == fast
    for p in positions(shape, 16, beyond=1.5):
        one = interpolate.value_and_gradient(array.ravel(), grid, *p, np.empty(24))
        other = interpolate.thin_value_and_gradient(array.ravel(), grid, *p, np.empty(24))
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-5 if fast else 0)


def test_which_grids_have_cubes():
    for shape in itertools.product((1, 2, 3, 4, 5), repeat=3):
        want = shape[2] >= 4 and shape[1] not in (2, 3) and shape[0] not in (2, 3)
        assert interpolate.has_cubes(reference.grid_of(shape, SPACING)) == want


@pytest.mark.parametrize("n", [1, 4, 5, 9])
def test_nodes_are_those_of_the_weights(n):
    close = [np.nextafter(n - 1, 0), -1e-9, n - 1 + 1e-9]
    for p in np.concatenate([np.linspace(-1.7, n + 0.7, 35), np.arange(n), close]):
        base, u, beyond, stride = interpolate.nodes_of(p, n, 6)
        want_base, _, _, want_beyond = reference.axis_weights(np.array([p]), n)
        if n == 1:
            # The one slice four times, at the second of them: nothing lies beyond and nothing slopes.
            assert (base, u, beyond, stride) == (0, 1, 0, 0)
        else:
            assert (base, beyond, stride) == (want_base[0], want_beyond[0], 6)
            assert u == pytest.approx(np.clip(p, 0, n - 1) - base, rel=1e-7)


@pytest.mark.parametrize("shape", [(7, 9, 8), (2, 2, 2), (3, 5, 2)])
def test_a_linear_cell_is_linear_interpolation(shape):
    array = reference.smooth_noise(shape, 17)
    rng = np.random.default_rng(18)
    for cell in np.ndindex(*(n - 1 for n in shape)):
        for t in (*rng.random((3, 3)).astype(np.float32), (0, 0, 0), (1, 1, 1)):
            at = int(np.ravel_multi_index(cell, shape))
            got = interpolate.linear_cell(
                array.ravel(), at, shape[2], shape[1] * shape[2], *np.asarray(t, np.float32)
            )
            want = reference.linear(array, cell + np.asarray(t, float))[0]
            # Three interpolations in float32, each of three operations.
            assert got == pytest.approx(
                want, abs=float(6 * np.finfo(np.float32).eps * np.abs(array).max())
            )


def test_one_slice_has_no_gradient_across():
    array = reference.smooth_noise((1, 9, 12), 7)
    grid = reference.grid_of(array.shape, SPACING)
    for z in (-2.0, 0.0, 0.4):
        value, gz, _, _ = interpolate.value_and_gradient(
            array.ravel(), grid, z, 3.3, 4.6, np.empty(24)
        )
        assert gz == 0
        assert value == pytest.approx(
            interpolate.value_at(array.ravel(), grid, 0.0, 3.3, 4.6, np.empty(24))
        )


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
    # Through `cubic` the value at the same place is computed in float32, and otherwise in float64 as here.
    limit = (
        20 * np.finfo(np.float32).eps * np.abs(values).max()
        if interpolate.has_cubes(grid)
        else 1e-6
    )
    for p in positions(shape, 9, beyond=0.8):
        got, found = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24))
        assert found
        clamped = np.clip(p, 0, np.array(shape) - 1.0)
        assert got == pytest.approx(reference.interpolate(dense, clamped)[0][0], abs=1e-6)
        assert got == pytest.approx(
            interpolate.value_at(dense.ravel(), grid, *p, np.empty(24)), abs=float(limit)
        )


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 3)])
def test_band_value_falls_back_on_the_known_of_the_eight(shape):
    present = np.random.default_rng(10).random(shape) < 0.35
    slot, values, dense = band_of(shape, present, 11)
    grid = reference.grid_of(shape, SPACING)
    missing = 0
    for p in positions(shape, 12, beyond=0.8):
        want, want_found = reference.known_linear(dense, present, p)
        got, found = interpolate.linear_band_value(values, slot, values.size, grid, p)
        assert (found, got) == (want_found, pytest.approx(want, abs=1e-5))
        full, full_found = interpolate.band_value_at(
            values, slot, values.size, grid, p, np.empty(24)
        )
        assert (full_found, full) == (want_found, pytest.approx(want, abs=1e-5))
        missing += not found
    assert missing > 0


def test_slots_that_are_not_of_this_band_do_not_count():
    """Between march and store the slot map also holds slots beyond the old band."""
    shape = (5, 6, 7)
    slot, values, dense = band_of(shape, np.ones(shape, bool), 13)
    n = 109  # two of the eight around p
    grid, p = reference.grid_of(shape, SPACING), np.array([2.4, 3.3, 2.6])
    on_grid = np.arange(values.size).reshape(shape) < n
    want, _ = reference.known_linear(dense, on_grid, p)
    got, found = interpolate.band_value_at(values[:n], slot, n, grid, p, np.empty(24))
    assert found
    assert got == pytest.approx(want, abs=1e-6)
    assert want != pytest.approx(
        interpolate.value_at(dense.ravel(), grid, *p, np.empty(24)), abs=1e-3
    )


def test_one_unknown_node_of_the_stencil_is_enough_for_the_linear_fall_back():
    shape = (6, 7, 8)
    slot, values, dense = band_of(shape, np.ones(shape, bool), 14)
    grid, p = reference.grid_of(shape, SPACING), np.array([2.4, 3.3, 2.6])
    cubic, _ = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24))
    slot[int(np.ravel_multi_index((1, 2, 1), shape))] = -1  # a corner of the 4 x 4 x 4
    got, found = interpolate.band_value_at(values, slot, values.size, grid, p, np.empty(24))
    assert found
    assert got == pytest.approx(reference.linear(dense, p)[0], abs=1e-6)
    assert got != pytest.approx(cubic, abs=1e-3)


# ------------------------------------------------------------------------------------------------------- band rows


def rows_from(slot, n_slots, shape, base):
    """(whether all 64 are in the band, first slots) by `band_rows`, and the same node by node."""
    rows = np.full(17, -9)
    at = int(np.ravel_multi_index(base, shape))
    found = interpolate.band_rows(slot, n_slots, at, shape[2], shape[1] * shape[2], rows)
    assert rows[16] == -9
    z, y, x = base
    block = slot.reshape(shape)[z : z + 4, y : y + 4, x : x + 4]
    return (
        bool(found),
        rows[:16],
        bool(((block >= 0) & (block < n_slots)).all()),
        block[:, :, 0].ravel(),
    )


def test_rows_of_a_complete_band_begin_at_the_slots_of_their_first_nodes():
    shape = (5, 6, 7)
    slot, values, _ = band_of(shape, np.ones(shape, bool), 19)
    for base in np.ndindex(2, 3, 4):
        found, rows, want_found, want = rows_from(slot, values.size, shape, base)
        assert found and want_found
        np.testing.assert_array_equal(rows, want)


def test_every_single_missing_node_is_noticed():
    """Not in the band, and in the band that is being built only (whose slots are any from n_slots on)."""
    shape = (6, 6, 6)
    for step in np.ndindex(4, 4, 4):
        cell = tuple(np.array(step) + 1)
        present = np.ones(shape, bool)
        present[cell] = False
        slot, values, _ = band_of(shape, present, 20)
        for other in (-1, values.size, values.size + 1, values.size + 99):
            slot.reshape(shape)[cell] = other
            assert rows_from(slot, values.size, shape, (1, 1, 1))[0] is False
            # Slots beyond the band's that happen to be consecutive.
            z, y, x = cell
            slot.reshape(shape)[z, y] = values.size + np.arange(6)
            assert rows_from(slot, values.size, shape, (1, 1, 1))[0] is False
            slot, values, _ = band_of(shape, present, 20)


def test_a_row_that_begins_one_before_the_bands_first_cell_is_not_in_it():
    """-1 and the slots 0, 1, 2: three apart, as in a row that is."""
    shape = (6, 6, 6)
    for i, j in np.ndindex(4, 4):
        slot, values, _ = band_of(shape, np.ones(shape, bool), 22)
        slot.reshape(shape)[1 + i, 1 + j, 1:5] = (-1, 0, 1, 2)
        assert rows_from(slot, values.size, shape, (1, 1, 1))[0] is False


@pytest.mark.parametrize("share", [0.9, 0.97, 0.995])
def test_rows_of_a_band_with_holes_as_node_by_node(share):
    """Holes, and cells that have come in since with slots beyond the band's, in any order."""
    shape = (7, 8, 9)
    verdicts = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slot, values, _ = band_of(shape, rng.random(shape) < share, 21)
        holes = np.flatnonzero(slot < 0)
        entered = rng.permutation(holes)[: holes.size // 2]
        slot[entered] = values.size + np.arange(entered.size)
        for base in np.ndindex(4, 5, 6):
            found, rows, want_found, want = rows_from(slot, values.size, shape, base)
            assert found == want_found
            if found:
                np.testing.assert_array_equal(rows, want)
            verdicts.append(found)
    assert not all(verdicts)
    assert any(verdicts)
