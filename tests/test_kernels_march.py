"""Closest points and the march: first guess, crossings, convergence, order, what enters, borders, thin volumes."""

import numpy as np
import pytest

from accelsurf.kernels import closest, march
from accelsurf.kernels.grid import Band, neighbours, unravel, voxels_along
from tests import reference

pytestmark = pytest.mark.nojit

UNEQUAL = (3.0, 1.0, 0.7)
THIN = [(1, 9, 12), (2, 9, 8), (3, 8, 10), (9, 1, 8), (9, 8, 2)]


def around(grid, cell):
    """(raveled cell, its neighbours) as the kernels pass them."""
    raveled = int(np.ravel_multi_index(cell, (grid.nz, grid.ny, grid.nx)))
    near = np.empty(6, np.int64)
    neighbours(raveled, *cell, grid, near)
    return raveled, near


def front_of(psi):
    """(dense, cells, foot, state) of the band of front cells, as a level set starts."""
    dense, _ = reference.whole_band(psi)
    dense.slot[:] = -1
    cells = np.flatnonzero(reference.front_cells(psi))
    dense.slot[cells] = np.arange(cells.size)
    return dense, cells, np.zeros((cells.size, 3), np.float32), np.full(cells.size, -1, np.int8)


def marched(psi, spacing, half_width):
    """Feet of the front cells and one march: (dense, cells, foot, state, old)."""
    grid = reference.grid_of(psi.shape, spacing)
    dense, cells, foot, state = front_of(psi)
    march.find_feet(0, cells.size, dense, grid, cells, foot, state)
    reviewed = np.empty_like(state)
    march.review_feet(0, cells.size, dense, grid, cells, foot, state, reviewed)
    found, feet, states, n = march.march(dense, grid, cells, foot, reviewed, half_width)
    return dense, found[:n], feet[:n], states[:n], cells.size


def plane(shape, spacing, direction, offset):
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    centre = (np.array(shape) - 1) / 2 * spacing
    z, y, x = reference.coordinates(shape, spacing, centre)
    return direction[0] * z + direction[1] * y + direction[2] * x - offset, direction


def crosses(psi, cell, other):
    """Whether the surface lies between a voxel and a raveled neighbour (-1: beyond the border)."""
    return other >= 0 and (psi.ravel()[other] < 0) != (psi[cell] < 0)


@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 3, 4), (2, 1, 3)])
def test_neighbours_and_unravel_at_every_voxel(shape):
    grid = reference.grid_of(shape, UNEQUAL)
    for cell in np.ndindex(*shape):
        raveled, near = around(grid, cell)
        assert unravel(raveled, grid) == cell
        for side in range(6):
            other = np.array(cell)
            other[side // 2] += 1 if side % 2 else -1
            inside = np.all((other >= 0) & (other < shape))
            assert near[side] == (np.ravel_multi_index(other, shape) if inside else -1)
            step = np.array(march.step_of(side, grid))
            np.testing.assert_allclose(step, (other - cell) * UNEQUAL)


def test_length_in_voxels_uses_each_axis_spacing():
    grid = reference.grid_of((5, 5, 5), UNEQUAL)
    assert voxels_along(3.0, 0.0, 0.0, grid) == pytest.approx(1)
    assert voxels_along(3.0, 2.0, -1.4, grid) == pytest.approx(3)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), UNEQUAL])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 1, 1), (-0.3, 0.8, 0.5)])
def test_first_guess_and_crossings_of_a_plane_are_exact(direction, spacing):
    shape = (7, 9, 8)
    psi, n = plane(shape, spacing, direction, 0.13)
    grid = reference.grid_of(shape, spacing)
    front = reference.front_cells(psi)
    assert front.any()
    for cell in np.ndindex(*shape):
        raveled, near = around(grid, cell)
        guess, crossing = np.empty(3), np.empty(3)
        assert march.first_guess(psi.ravel(), grid, raveled, *cell, near, guess)
        np.testing.assert_allclose(guess, -psi[cell] * n, atol=1e-9)
        bound = closest.crossing_point(psi.ravel(), grid, raveled, *cell, near, crossing)
        assert (bound >= 0) == front[cell]
        if bound >= 0:
            assert bound >= abs(psi[cell]) * (1 - 1e-9)
            # The nearest of the points where the edges to the neighbours cross the plane.
            slopes = [abs(n[a]) for a in range(3) for o in near[2 * a : 2 * a + 2] if crosses(psi, cell, o)]
            assert bound == pytest.approx(abs(psi[cell]) / max(slopes), rel=1e-9)
            # Exact where every axis that the plane is not parallel to has a crossing.
            complete = all(
                any(crosses(psi, cell, o) for o in near[2 * a : 2 * a + 2])
                for a in range(3)
                if abs(n[a]) > 1e-9
            )
            if complete:
                np.testing.assert_allclose(crossing, -psi[cell] * n, atol=1e-9)


def test_first_guess_points_to_the_front_on_a_ridge():
    """Between two fronts the centred difference is 0; one of the two fronts must be taken."""
    psi = np.abs(np.arange(9.0) - 4)[None, None, :] * -1 + 2.5
    psi = np.broadcast_to(psi, (5, 6, 9)).copy()
    grid = reference.grid_of(psi.shape, (1, 1, 1))
    for sign in (1, -1):
        raveled, near = around(grid, (2, 3, 4))
        guess = np.empty(3)
        assert march.first_guess(sign * psi.ravel(), grid, raveled, 2, 3, 4, near, guess)
        np.testing.assert_allclose(np.abs(guess), (0, 0, 2.5))
    flat = np.full(psi.size, 2.0)
    assert not march.first_guess(flat, grid, raveled, 2, 3, 4, near, guess)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.6, 1.0, 0.8)])
def test_closest_point_as_by_brute_force(spacing):
    """On the interpolant of a smooth function that is no distance, to 2e-3 voxel."""
    shape = (9, 11, 14)
    z, y, x = reference.coordinates(shape, spacing, np.array((4.2, 4.9, 6.4)) * spacing)
    psi = np.sqrt(z**2 + 1.4 * y**2 + 0.8 * x**2) - 3.8
    psi = (psi + 0.25 * reference.smooth_noise(shape, 21, 2.5)).astype(np.float32)
    grid = reference.grid_of(shape, spacing)
    front = np.argwhere(reference.front_cells(psi))
    front = front[((front > 1) & (front < np.array(shape) - 2)).all(axis=1)]
    want = np.linalg.norm(reference.closest_points(psi, spacing, front) - front * spacing, axis=1)
    feet = np.empty((len(front), 3))
    for foot, cell in zip(feet, front, strict=True):
        raveled, near = around(grid, tuple(cell))
        assert march.first_guess(psi.ravel(), grid, raveled, *cell, near, foot)
        assert closest.closest_point(psi.ravel(), grid, *cell, foot, np.empty(24))
    value, slope = reference.interpolate(psi, front + feet / spacing)
    np.testing.assert_allclose(value, 0, atol=2e-3 * min(spacing))
    normal = slope / spacing
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    off_normal = feet - (feet * normal).sum(axis=1)[:, None] * normal
    assert np.linalg.norm(off_normal, axis=1).max() < 0.03 * min(spacing)
    gap = np.linalg.norm(feet, axis=1) - want
    print("closest point, worst distance in voxels:", np.abs(gap).max() / min(spacing))
    assert len(front) > 100
    assert np.abs(gap).max() < 2e-3 * min(spacing)


def test_closest_point_fails_where_there_is_no_slope():
    grid = reference.grid_of((5, 5, 5), (1, 1, 1))
    for value in (1.0, np.nan):
        foot = np.array([0.5, 0.0, 0.0])
        assert not closest.closest_point(np.full(125, value), grid, 2, 2, 2, foot, np.empty(24))
        np.testing.assert_array_equal(foot, (0.5, 0, 0))


@pytest.mark.parametrize("shape", [(7, 9, 8), *THIN])
def test_every_front_cell_finds_a_foot_no_further_than_its_nearest_crossing(shape):
    """Rough surfaces too, and at every border."""
    for seed, sigma in ((1, 0.7), (2, 1.5)):
        psi = reference.smooth_noise(shape, seed, sigma)
        grid = reference.grid_of(shape, UNEQUAL)
        dense, cells, foot, state = front_of(psi)
        march.find_feet(0, cells.size, dense, grid, cells, foot, state)
        assert set(state) == {march.FROZEN}
        assert np.isfinite(foot).all()
        for s, cell in enumerate(cells):
            index = np.unravel_index(cell, shape)
            _, near = around(grid, index)
            bound = closest.crossing_point(dense.psi, grid, cell, *index, near, np.empty(3))
            assert np.linalg.norm(foot[s]) <= bound + 0.1 * min(UNEQUAL) + 1e-6
            assert march.length(foot, s) == pytest.approx(np.linalg.norm(foot[s]), rel=1e-6)


def test_review_opens_cells_whose_neighbour_knows_a_closer_surface():
    shape, spacing = (5, 6, 7), (1.0, 1.0, 1.0)
    psi = np.broadcast_to(np.arange(7.0) - 2.5, shape)
    dense, band = reference.whole_band(psi)
    grid = reference.grid_of(shape, spacing)
    foot = np.zeros((psi.size, 3), np.float32)
    foot[:, 2] = -psi.ravel()
    state = np.full(psi.size, march.FROZEN, np.int8)
    wrong = int(np.ravel_multi_index((2, 3, 6), shape))
    foot[wrong, 2] = -4.5
    not_known = int(np.ravel_multi_index((0, 0, 0), shape))
    state[not_known] = march.OPEN
    absent = int(np.ravel_multi_index((4, 5, 3), shape))
    dense.slot[absent] = -1
    reviewed = np.full(psi.size, 99, np.int8)
    march.review_feet(0, psi.size, dense, grid, band.cells, foot, state, reviewed)
    want = np.full(shape, march.FROZEN)
    want[2, 3, 6] = want[0, 0, 0] = march.OPEN
    want[4, 5, 2] = want[4, 5, 4] = want[3, 5, 3] = want[4, 4, 3] = march.EDGE
    reviewed = reviewed.reshape(shape)
    reviewed[4, 5, 3] = march.FROZEN  # not in the band: nothing is asked of it
    np.testing.assert_array_equal(reviewed, want)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), UNEQUAL])
def test_march_of_a_plane_gives_exact_feet_and_all_cells_within_reach(spacing):
    shape = (7, 11, 10)
    psi, n = plane(shape, spacing, (0.5, 0.6, -0.4), 0.2)
    dense, cells, foot, state, old = marched(psi, spacing, 2.5)
    assert len(set(cells)) == len(cells)
    np.testing.assert_array_equal(dense.slot[cells], np.arange(cells.size))
    assert np.count_nonzero(dense.slot >= 0) == cells.size
    frozen = state != march.OPEN
    want = -psi.ravel()[cells, None] * n
    at = np.stack(np.unravel_index(cells, shape), axis=1) + want / spacing
    reached = frozen & ((at >= 0) & (at <= np.array(shape) - 1)).all(axis=1)
    assert reached.sum() > 0.5 * frozen.sum()
    np.testing.assert_allclose(foot[reached], want[reached], atol=2e-5)
    # Where the closest point lies beyond the border, another may be taken.
    assert (np.linalg.norm(foot[frozen], axis=1) > np.abs(psi.ravel()[cells[frozen]]) - 1e-5).all()
    grid = reference.grid_of(shape, spacing)
    reach = np.array([voxels_along(*(-d * n), grid) for d in psi.ravel()])
    assert set(np.flatnonzero(reach < 2.4)) <= set(cells[frozen])
    assert old < cells.size


def test_march_of_a_ball_to_its_centre_is_the_exact_distance():
    shape, spacing = (13, 12, 14), (1.0, 1.0, 1.0)
    z, y, x = reference.coordinates(shape, spacing, (6.2, 5.4, 6.7))
    exact = np.sqrt(z**2 + y**2 + x**2) - 4.0
    dense, cells, foot, state, _ = marched(exact.astype(np.float32), spacing, 3.0)
    known = state != march.OPEN
    gap = np.linalg.norm(foot[known], axis=1) - np.abs(exact.ravel()[cells[known]])
    # The medial point apart, where the interpolant of a cone is what it is.
    near = np.abs(exact.ravel()[cells[known]]) < 2.5
    assert np.abs(gap[near]).max() < 0.02
    assert np.abs(gap).max() < 0.1
    assert np.all(np.abs(exact.ravel())[np.setdiff1d(np.arange(exact.size), cells)] > 2.7)


@pytest.mark.parametrize("shape", [(7, 9, 8), *THIN])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), UNEQUAL])
def test_march_stays_inside_the_volume_and_knows_each_cell_once(shape, spacing):
    """Random surfaces that cross every face of the border."""
    psi = reference.smooth_noise(shape, 5, 1.0)
    for sign in (1, -1):
        dense, cells, foot, state, old = marched(sign * psi, spacing, 3.0)
        assert cells.min() >= 0
        assert cells.max() < psi.size
        assert len(set(cells)) == len(cells)
        assert np.isfinite(foot).all()
        assert set(state[:old]) <= {march.FROZEN, march.EDGE}
        np.testing.assert_array_equal(dense.slot[cells], np.arange(cells.size))
        np.testing.assert_array_equal(dense.psi, (sign * psi).ravel())


def test_front_cells_and_their_count():
    for shape in [(7, 9, 8), *THIN]:
        psi = reference.smooth_noise(shape, 6, 0.8)
        dense, _ = reference.whole_band(psi)
        grid = reference.grid_of(shape, UNEQUAL)
        want = np.flatnonzero(reference.front_cells(psi))
        assert march.front_cells(dense, grid, np.empty(0, np.int64)) == want.size
        out = np.full(want.size + 3, -7)
        assert march.front_cells(dense, grid, out) == want.size
        np.testing.assert_array_equal(out, [*want, -7, -7, -7])


def test_arrays_grow_and_keep_what_they_held():
    small = np.arange(4)
    assert march.grown(small, 3) is small
    larger = march.grown(small, 4)
    assert larger.size > 4
    np.testing.assert_array_equal(larger[:4], small)
    rows = march.grown_rows(np.ones((2, 3), np.float32), 2)
    assert rows.shape[0] > 2
    assert (rows[:2] == 1).all()


def test_a_range_of_slots_writes_nothing_outside_itself():
    psi = reference.smooth_noise((7, 9, 8), 7)
    grid = reference.grid_of(psi.shape, UNEQUAL)
    dense, cells, foot, state = front_of(psi)
    march.find_feet(5, 11, dense, grid, cells, foot, state)
    assert (state[:5] == -1).all() and (state[11:] == -1).all() and (state[5:11] >= 0).all()
    assert not foot[:5].any() and not foot[11:].any()
    march.find_feet(0, cells.size, dense, grid, cells, foot, state)
    reviewed = np.full_like(state, 77)
    march.review_feet(5, 11, dense, grid, cells, foot, state, reviewed)
    assert (reviewed[:5] == 77).all() and (reviewed[11:] == 77).all() and (reviewed[5:11] != 77).all()


def test_a_band_is_three_arrays_in_slot_order():
    band = Band(np.arange(3), np.zeros(3, np.float32), np.zeros((3, 3), np.float32))
    assert band._fields == ("cells", "psi", "foot")
