"""Closest points and the march: first guess, crossings, convergence, order, what enters, borders, thin volumes."""

import numpy as np
import pytest

from accelsurf.kernels import closest, interpolate, march
from accelsurf.kernels.grid import Band, neighbours, unravel, voxels_along
from tests import reference

pytestmark = pytest.mark.nojit

UNEQUAL = (3.0, 1.0, 0.7)
EPS = float(np.finfo(np.float32).eps)
THIN = [(1, 9, 12), (2, 9, 8), (3, 8, 10), (9, 1, 8), (9, 8, 2)]


def around(grid, cell):
    """(raveled cell, its neighbours) as the kernels pass them."""
    raveled = int(np.ravel_multi_index(cell, (grid.nz, grid.ny, grid.nx)))
    near = np.empty(6, np.int64)
    neighbours(raveled, *cell, grid, near)
    return raveled, near


def front_of(psi):
    """(dense, band, foot, state) of the band of front cells, as a level set starts."""
    dense, _ = reference.whole_band(psi)
    dense.slot[:] = -1
    cells = np.flatnonzero(reference.front_cells(psi))
    dense.slot[cells] = np.arange(cells.size)
    band = Band(cells, dense.psi[cells].copy(), np.zeros((cells.size, 3), np.float32))
    return dense, band, np.zeros((cells.size, 3), np.float32), np.full(cells.size, -1, np.int8)


def find_feet(dense, grid, band, foot, state, part=None, inner=np.inf):
    """The feet of the slots in the range ``part``, all by default, with no use of the band's old feet by default."""
    start, stop = part or (0, band.cells.size)
    march.find_feet(start, stop, dense, grid, band, inner, foot, state)


def march_from(dense, grid, cells, foot, state, half_width, room=0):
    """(cells, foot, state) after a march that starts with ``room`` for more: the one place that calls it."""
    n_old = cells.size
    with_room = [np.concatenate([a, np.full((room, *a.shape[1:]), -99, a.dtype)]) for a in (cells, foot, state)]
    *found, n = march.march(dense, grid, with_room[0], n_old, with_room[1], with_room[2], half_width)
    return [a[:n] for a in found]


def marched(psi, spacing, half_width, room=0):
    """Feet of the front cells and one march: (dense, cells, foot, state, old)."""
    grid = reference.grid_of(psi.shape, spacing)
    dense, band, foot, state = front_of(psi)
    find_feet(dense, grid, band, foot, state)
    reviewed = np.empty_like(state)
    march.review_feet(0, band.cells.size, dense, grid, band.cells, foot, state, reviewed)
    return dense, *march_from(dense, grid, band.cells, foot, reviewed, half_width, room), band.cells.size


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
        psi = np.full(125, value, np.float32)
        assert not closest.closest_point(psi, grid, 2, 2, 2, foot, np.empty(24))
        np.testing.assert_array_equal(foot, (0.5, 0, 0))


# ------------------------------------------------------------------------------------------------------ corrections


def random_levels(count, seed):
    """(feet (count, 3), levels (count, 4)): value and gradient, of slope 1/5 and more."""
    rng = np.random.default_rng(seed)
    feet, gradient = rng.normal(0, 1, (2, count, 3))
    gradient *= (rng.uniform(0.25, 2, count) / np.linalg.norm(gradient, axis=1))[:, None]
    return feet, np.concatenate([rng.normal(0, 0.5, (count, 1)), gradient], axis=1)


@pytest.mark.parametrize("relax", [1.0, 0.4, 2.5])
def test_a_correction_goes_down_the_gradient_and_along_the_level(relax):
    for foot, level in zip(*random_levels(50, 1), strict=True):
        step = np.array(closest.correction(*foot, tuple(level), relax))
        value, g = level[0], level[1:]
        down, along = step[:3] - relax * step[3:], step[3:]
        np.testing.assert_allclose(down, -value * g / (g @ g), atol=1e-12)
        assert along @ g == pytest.approx(0, abs=1e-12)
        # Down, the linear level is 0; along, the foot comes under the cell: on the gradient through it.
        np.testing.assert_allclose(np.cross(foot + along, g), 0, atol=1e-12)


def test_the_first_correction_of_many_is_that_of_one():
    """With relax 1, to the rounding of float32 in the sums f.g - v and g.g; done where it is small."""
    grid = reference.grid_of((5, 5, 5), UNEQUAL)
    feet, levels = (a.astype(np.float32) for a in random_levels(150, 2))
    # A third of them nearly right: the foot under the cell, the level off by about as much as is allowed.
    rng = np.random.default_rng(3)
    for i in range(50):
        g = levels[i, 1:]
        n = g / np.linalg.norm(g)
        feet[i] = rng.uniform(-3, 3) * n
        limit = closest.FIRST_TOLERANCE * max(1, np.linalg.norm(feet[i] / UNEQUAL))
        levels[i, 0] = rng.uniform(0.95, 1.05) * limit * np.linalg.norm(g) / np.linalg.norm(n / UNEQUAL)
    # Too little slope, though nothing is left to correct; none; no numbers.
    feet[50:54] = levels[50:54, 0] = 0
    levels[50:53, 1:] *= 0.1 / np.linalg.norm(levels[50:53, 1:], axis=1)[:, None]
    levels[53] = 0
    levels[54] = np.nan
    count, room = 137, 150
    corrected, done = np.full((3, room), np.float32(-77)), np.full(room, True)
    rows = np.ascontiguousarray(feet.T), np.ascontiguousarray(levels.T)
    with np.errstate(all="ignore"):  # 0/0 where there is no slope
        closest.correct_once(count, grid, *rows, corrected, done)
    assert (corrected[:, count:] == -77).all() and done[count:].all()
    assert not done[50:55].any()
    near_limit = 0
    for i in [*range(50), *range(55, count)]:
        f, (v, *g) = feet[i].astype(float), levels[i].astype(float)
        step = np.array(closest.correction(*f, (v, *g), 1.0)[:3])
        slope2 = np.dot(g, g)
        # Nine operations on sums of that size make the factor of g.
        size = (np.abs(f) @ np.abs(g) + abs(v)) / slope2 * np.abs(g)
        off = 5 * EPS * size
        assert (np.abs(corrected[:, i] - f - step) <= off).all()
        voxels, far = np.linalg.norm(step / UNEQUAL), np.linalg.norm(f / UNEQUAL)
        limit = closest.FIRST_TOLERANCE * max(1, far)
        if abs(voxels - limit) > np.linalg.norm((off + EPS * np.abs(f)) / UNEQUAL) + 4 * EPS * limit:
            assert done[i] == (voxels < limit)
        else:
            near_limit += 1
    assert near_limit < 5
    assert 10 < done[:50].sum() < 50


def test_the_first_correction_is_the_same_bytes_wherever_it_stands():
    grid = reference.grid_of((5, 5, 5), UNEQUAL)
    feet, levels = (np.ascontiguousarray(a.T, np.float32) for a in random_levels(128, 4))
    whole, done = np.empty((3, 128), np.float32), np.empty(128, bool)
    closest.correct_once(128, grid, feet, levels, whole, done)
    for first, count in ((0, 1), (3, 7), (5, 31), (64, 64)):
        part = slice(first, first + count)
        some, flags = np.empty((3, count), np.float32), np.empty(count, bool)
        one, other = (np.ascontiguousarray(a[:, part]) for a in (feet, levels))
        closest.correct_once(count, grid, one, other, some, flags)
        np.testing.assert_array_equal(some, whole[:, part])
        np.testing.assert_array_equal(flags, done[part])


def test_refine_goes_on_from_the_level_that_it_is_given():
    shape, spacing = (9, 10, 11), (1.6, 1.0, 0.8)
    psi = reference.smooth_noise(shape, 8, 2.0)
    grid, w = reference.grid_of(shape, spacing), np.empty(24)
    converged = 0
    for cell in np.argwhere(reference.front_cells(psi)):
        raveled, near = around(grid, tuple(cell))
        one = np.empty(3)
        if not march.first_guess(psi.ravel(), grid, raveled, *cell, near, one):
            continue
        other, at = one.copy(), cell + one / spacing
        level = interpolate.value_and_gradient(psi.ravel(), grid, *at, w)
        found = closest.refine(psi.ravel(), grid, *cell, other, w, level)
        assert closest.closest_point(psi.ravel(), grid, *cell, one, w) == found
        # A division here is a product there; where that rounds a place to another float32 the level changes by as much.
        np.testing.assert_allclose(one, other, rtol=0, atol=4 * EPS)
        converged += found
        # Where the level is flat or no number, nothing is moved.
        for value in (0.0, np.nan):
            before = other.copy()
            assert not closest.refine(psi.ravel(), grid, *cell, other, w, (value, value, value, value))
            np.testing.assert_array_equal(other, before)
    assert converged > 100


# ------------------------------------------------------------------------------------------------------------- feet


def guessed(dense, grid, band, inner, first, count):
    guesses, beside = np.full((3, count + 1), np.float32(-77)), np.full(count + 1, True)
    near, guess = np.empty(6, np.int64), np.empty(3)
    march.guess_feet(first, count, dense, grid, band, inner, near, guess, guesses, beside)
    assert (guesses[:, count] == -77).all() and beside[count]
    return guesses[:, :count].T, beside[:count]


@pytest.mark.parametrize("shape", [(7, 9, 8), *THIN])
def test_guesses_are_the_first_guess_or_the_old_foot_drawn_out(shape):
    """Of a whole band, moved since it was a distance; 0 where there is no guess."""
    rng = np.random.default_rng(9)
    psi = reference.smooth_noise(shape, 10, 1.0)
    psi.ravel()[: psi.size // 10] = 2  # flat: no guess within
    foot = rng.normal(0, 1, (psi.size, 3))
    dense, band = reference.whole_band(psi, foot)
    band.psi[:] *= rng.uniform(0.5, 2, psi.size)
    band.psi[-1] = np.float32(3)
    grid, inner = reference.grid_of(shape, UNEQUAL), 0.8
    first, count = 2, psi.size - 2
    got, beside = guessed(dense, grid, band, inner, first, count)
    drawn = none = 0
    for i in range(count):
        s = first + i
        cell = np.unravel_index(s, shape)
        _, near = around(grid, cell)
        assert beside[i] == any(crosses(psi, cell, other) for other in near)
        want = np.zeros(3)
        if abs(band.psi[s]) > inner:
            want = float(dense.psi[s]) / float(band.psi[s]) * band.foot[s].astype(float)
            drawn += 1
        elif not march.first_guess(dense.psi, grid, s, *cell, near, want):
            want[:] = 0
            none += 1
        np.testing.assert_allclose(got[i], want, rtol=3 * EPS, atol=1e-30)
    assert drawn > 0
    if shape == (7, 9, 8):
        assert none > 0


def test_where_the_surface_has_moved_the_old_foot_is_drawn_out_by_what_psi_has_changed():
    """At the band's edge, where a centred difference would reach the jump to +-gamma: exact for a plane moved along."""
    shape = (5, 6, 12)
    psi, n = plane(shape, (1.0, 1.0, 1.0), (0, 0, 1), 0.1)
    moved = psi - 0.3
    near_band = np.abs(psi) < 3
    dense, band = reference.whole_band(np.where(near_band, moved, np.sign(moved) * 3.0), -psi.reshape(-1, 1) * n)
    band.psi[:] = psi.ravel()
    grid = reference.grid_of(shape, (1, 1, 1))
    edge = np.flatnonzero(near_band & (np.abs(psi) > 1.5))
    for inner, exact in ((1.5, True), (np.inf, False)):
        got, _ = guessed(dense, grid, band, inner, 0, psi.size)
        error = np.linalg.norm(got[edge] + moved.ravel()[edge, None] * n, axis=1)
        assert (error.max() < 1e-5) == exact


@pytest.mark.parametrize("shape", [(7, 9, 8), *THIN, (4, 4, 4)])
def test_levels_are_those_of_the_interpolant_at_every_foot(shape):
    """Within, across and beyond the border; on nodes too."""
    psi = reference.smooth_noise(shape, 11)
    grid, rng = reference.grid_of(shape, UNEQUAL), np.random.default_rng(12)
    cells = rng.permutation(psi.size)
    feet = (rng.uniform(-1.5, 1.5, (psi.size, 3)) * UNEQUAL).astype(np.float32)
    feet[::5] = 0
    feet[1::5] = np.round(feet[1::5] / UNEQUAL) * UNEQUAL
    levels = np.full((4, psi.size), np.float32(-77))
    rows = np.ascontiguousarray(feet[3:-2].T)
    march.levels_at(3, psi.size - 5, psi.ravel(), grid, cells, np.empty(24), rows, levels)
    assert (levels[:, psi.size - 5 :] == -77).all()
    at = np.stack(np.unravel_index(cells, shape), axis=1) + feet.astype(float) / UNEQUAL
    value, slope = reference.interpolate(psi, at[3:-2])
    np.testing.assert_allclose(levels[0, : psi.size - 5], value, atol=2e-5)
    np.testing.assert_allclose(levels[1:, : psi.size - 5].T, slope / UNEQUAL, atol=2e-5)


@pytest.mark.parametrize(("value", "distance", "found", "bound", "want"), [
    (1.0, 1.2, True, -1.0, "guess"),
    (-1.0, 1.2, True, -1.0, "guess"),
    (1.0, 0.6, True, -1.0, "guess"),  # half as far as psi said, and more
    (1.0, 0.4, True, -1.0, None),  # too close to be true
    (1.0, 2.3, True, -1.0, "guess"),
    (1.0, 2.5, True, -1.0, None),  # more than two of the smallest spacing further
    (1.0, 1.0, False, -1.0, None),
    (1.0, 0.4, True, 0.5, "guess"),  # beside the surface the length is no matter
    (1.0, 0.56, True, 0.5, "guess"),  # up to a tenth of a voxel beyond the crossing
    (1.0, 0.58, True, 0.5, "plane"),
    (1.0, 0.4, False, 0.5, "plane"),
    (1.0, 0.4, False, 0.0, "plane"),
    (1.0, np.nan, False, 0.5, "plane"),
])  # fmt: skip
def test_what_holds_for_a_foot(value, distance, found, bound, want):
    grid = reference.grid_of((5, 5, 5), UNEQUAL)
    guess, plane_foot = distance * np.array((0.6, 0.0, 0.8)), np.array((0.1, 0.2, 0.3))
    before = guess.copy()
    state = march.settle(value, grid, plane_foot, bound, guess, found)
    assert state == (march.OPEN if want is None else march.FROZEN)
    np.testing.assert_array_equal(guess, plane_foot if want == "plane" else before)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.6, 1.0, 0.8)])
def test_feet_of_a_front_as_by_brute_force(spacing):
    """Whether one correction was enough or more were made; as `test_closest_point_as_by_brute_force`."""
    shape = (9, 11, 14)
    z, y, x = reference.coordinates(shape, spacing, np.array((4.2, 4.9, 6.4)) * spacing)
    psi = np.sqrt(z**2 + 1.4 * y**2 + 0.8 * x**2) - 3.8
    psi = (psi + 0.25 * reference.smooth_noise(shape, 21, 2.5)).astype(np.float32)
    grid = reference.grid_of(shape, spacing)
    dense, band, foot, state = front_of(psi)
    find_feet(dense, grid, band, foot, state)
    assert (state == march.FROZEN).all()
    front = np.stack(np.unravel_index(band.cells, shape), axis=1)
    well_inside = ((front > 1) & (front < np.array(shape) - 2)).all(axis=1)
    front, feet = front[well_inside], foot[well_inside].astype(float)
    want = np.linalg.norm(reference.closest_points(psi, spacing, front) - front * spacing, axis=1)
    gap = np.abs(np.linalg.norm(feet, axis=1) - want) / min(spacing)
    print("feet, worst distance in voxels:", gap.max())
    assert len(front) > 100
    assert gap.max() < 2e-3


@pytest.mark.parametrize("shape", [(7, 9, 8), *THIN])
def test_every_front_cell_finds_a_foot_no_further_than_its_nearest_crossing(shape):
    """Rough surfaces too, and at every border."""
    for seed, sigma in ((1, 0.7), (2, 1.5)):
        psi = reference.smooth_noise(shape, seed, sigma)
        grid = reference.grid_of(shape, UNEQUAL)
        dense, band, foot, state = front_of(psi)
        find_feet(dense, grid, band, foot, state)
        assert set(state) == {march.FROZEN}
        assert np.isfinite(foot).all()
        for s, cell in enumerate(band.cells):
            index = np.unravel_index(cell, shape)
            _, near = around(grid, index)
            bound = closest.crossing_point(dense.psi, grid, cell, *index, near, np.empty(3))
            assert np.linalg.norm(foot[s]) <= bound + 0.1 * min(UNEQUAL) + 1e-6
            assert march.length(foot, s) == pytest.approx(np.linalg.norm(foot[s]), rel=1e-6)


def test_feet_are_the_same_bytes_however_the_range_is_cut():
    psi = reference.smooth_noise((9, 10, 13), 13, 1.0)
    grid = reference.grid_of(psi.shape, UNEQUAL)
    dense, band, foot, state = front_of(psi)
    n = band.cells.size
    assert n > 2 * march.TOGETHER
    parts, states = np.zeros_like(foot), np.full_like(state, -1)
    find_feet(dense, grid, band, foot, state)
    for cut in ((0, 1), (1, 8), (8, 140), (140, 141), (141, n)):
        find_feet(dense, grid, band, parts, states, cut)
    np.testing.assert_array_equal(parts, foot)
    np.testing.assert_array_equal(states, state)


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


# ------------------------------------------------------------------------------------------------------------ march


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), UNEQUAL])
def test_a_foot_through_a_neighbour_is_where_its_tangent_plane_is_closest(spacing):
    """Exact on a plane; the neighbour's own foot where that neighbour is too close to the surface."""
    grid, rng = reference.grid_of((5, 5, 5), spacing), np.random.default_rng(14)
    h = min(spacing)
    for _ in range(40):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        d = rng.uniform(-3, 3)
        side = int(rng.integers(6))
        step = np.array(march.step_of(side, grid))
        foot, out = np.zeros((3, 3), np.float32), np.full(3, np.nan)
        foot[1] = d * n
        through = foot[1].astype(float) + step
        got = march.flattened(foot, 1, grid, *through, out)
        want = through if d**2 < 0.1 * h**2 else (d + step @ n) * n
        np.testing.assert_allclose(out, want, rtol=0, atol=2e-6)
        assert got == pytest.approx(np.linalg.norm(want / spacing), abs=1e-5)
    tiny = np.zeros((1, 3), np.float32)
    assert march.flattened(tiny, 0, grid, 0.0, 0.0, spacing[2], out) == pytest.approx(1)
    np.testing.assert_allclose(out, (0, 0, spacing[2]))


def test_freezing_polishes_the_foot_but_never_makes_it_longer():
    shape, r = (13, 13, 13), 4.0
    z, y, x = reference.coordinates(shape, (1, 1, 1), (6.2, 5.9, 6.1))
    psi = (np.sqrt(z**2 + y**2 + x**2) - r).astype(np.float32)
    grid = reference.grid_of(shape, (1, 1, 1))

    def exact(cell):
        out = np.array(cell) - (6.2, 5.9, 6.1)
        return (r / np.linalg.norm(out) - 1) * out

    cell, neighbour = (6, 6, 11), (6, 6, 10)
    for best, polished in ((1e30, True), (0.5, False)):
        foot = np.zeros((2, 3), np.float32)
        foot[0] = exact(neighbour)
        own = foot[1] = foot[0] + np.float32((0, 0, -1))
        raveled = int(np.ravel_multi_index(cell, shape))
        march.freeze(psi.ravel(), grid, raveled, foot, 0, best, 1, np.empty(3), np.empty(24))
        np.testing.assert_array_equal(foot[0], exact(neighbour).astype(np.float32))
        np.testing.assert_allclose(foot[1], exact(cell) if polished else own, atol=0.02 if polished else 0)
    flat = np.full(psi.size, 2, np.float32)
    foot[1] = own
    march.freeze(flat, grid, raveled, foot, 0, 1e30, 1, np.empty(3), np.empty(24))
    np.testing.assert_array_equal(foot[1], own)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), UNEQUAL])
def test_a_march_is_the_same_bytes_with_any_room(spacing):
    """What does not fit is moved to larger arrays; what does is changed in place."""
    psi = reference.smooth_noise((7, 9, 8), 15, 1.5)
    *first, old = marched(psi, spacing, 3.0)
    assert first[1].size > old
    for room in (1, 7, first[1].size - old - 1, first[1].size - old, 5000):
        *other, _ = marched(psi, spacing, 3.0, room)
        np.testing.assert_array_equal(first[0].slot, other[0].slot)
        for one, another in zip(first[1:], other[1:], strict=True):
            np.testing.assert_array_equal(one, another)


def test_a_march_leaves_the_feet_that_hold():
    psi = reference.smooth_noise((7, 9, 8), 16, 1.5)
    grid = reference.grid_of(psi.shape, UNEQUAL)
    dense, band, foot, state = front_of(psi)
    find_feet(dense, grid, band, foot, state)
    reviewed = np.empty_like(state)
    march.review_feet(0, band.cells.size, dense, grid, band.cells, foot, state, reviewed)
    cells, feet, _ = march_from(dense, grid, band.cells, foot, reviewed, 3.0)
    held = np.flatnonzero(reviewed != march.OPEN)
    np.testing.assert_array_equal(cells[: band.cells.size], band.cells)
    np.testing.assert_array_equal(feet[held], foot[held])


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
    dense, band, foot, state = front_of(psi)
    find_feet(dense, grid, band, foot, state, (5, 11))
    assert (state[:5] == -1).all() and (state[11:] == -1).all() and (state[5:11] >= 0).all()
    assert not foot[:5].any() and not foot[11:].any()
    find_feet(dense, grid, band, foot, state)
    reviewed = np.full_like(state, 77)
    march.review_feet(5, 11, dense, grid, band.cells, foot, state, reviewed)
    assert (reviewed[:5] == 77).all() and (reviewed[11:] == 77).all() and (reviewed[5:11] != 77).all()


def test_a_band_is_three_arrays_in_slot_order():
    band = Band(np.arange(3), np.zeros(3, np.float32), np.zeros((3, 3), np.float32))
    assert band._fields == ("cells", "psi", "foot")
