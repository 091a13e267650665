"""Sampling at the surface, kick, Laplacian, rates, drift: against plain numpy."""

import numpy as np
import pytest

from accelsurf.kernels import motion
from accelsurf.kernels.grid import Band
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
SHAPES = [(7, 9, 8), (1, 9, 12), (2, 5, 6), (3, 4, 5)]


def scene(shape, seed, reach=1.2):
    """A whole band with random closest points (mm), some of them beyond the border, a front mask and an image."""
    rng = np.random.default_rng(seed)
    closest_point = rng.uniform(-reach, reach, (int(np.prod(shape)), 3)) * SPACING
    if shape[0] == 1:
        closest_point[:, 0] = 0
    psi = np.linalg.norm(closest_point, axis=1) * np.where(
        rng.random(len(closest_point)) < 0.5, -1, 1
    )
    dense, band = reference.whole_band(psi.reshape(shape), closest_point)
    front = rng.random(len(closest_point)) < 0.7
    return dense, band, front, reference.smooth_noise(shape, seed + 1)


def closest_in_voxels(shape, band):
    return np.argwhere(np.ones(shape, bool)) + band.to_closest.astype(float) / SPACING


@pytest.mark.parametrize("shape", SHAPES)
def test_image_is_sampled_at_the_closest_points_and_held_at_the_border(shape):
    _, band, front, image = scene(shape, 1)
    out = np.full(image.size, np.nan, np.float32)
    motion.sample_image(
        0, image.size, image.ravel(), reference.grid_of(shape, SPACING), band, front, out
    )
    at = np.clip(closest_in_voxels(shape, band), 0, np.array(shape) - 1.0)
    want, _ = reference.interpolate(image, at)
    np.testing.assert_allclose(out[front], want[front], atol=2e-5)
    assert not out[~front].any()


@pytest.mark.parametrize("shape", SHAPES)
def test_mean_across_is_taken_along_the_normal(shape):
    dense, band, front, image = scene(shape, 2)
    grid, epsilon, (a, b, c) = reference.grid_of(shape, SPACING), 1.5, (0.7, -0.4, 0.2)
    # Some cells lie on the surface: their direction is the gradient's.
    on = np.arange(image.size) % 5 == 0
    band.to_closest[on] = 0
    out = np.full(image.size, np.nan, np.float32)
    # Curved everywhere, so strongly in places that the bound of 1/2 holds.
    curvature = np.random.default_rng(4).normal(0, 0.5, image.size).astype(np.float32)
    settings = (grid, epsilon, (a, b, c), curvature)
    motion.mean_across(0, image.size, dense.psi, image.ravel(), band, front, settings, out)
    gradient, _ = reference.derivatives(dense.psi.reshape(shape), SPACING)
    way = np.where(on[:, None], gradient.reshape(-1, 3), band.to_closest) / SPACING
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
    s = np.arange(-2, 3) * epsilon / 3
    delta = 1 + np.cos(np.pi * s / epsilon)
    samples = [reference.linear(image, closest_in_voxels(shape, band) + u * way) for u in s]
    # Towards the closest point is outwards for a cell inside; s in mm times H is how much the level's area grows.
    outwards = np.where(on | (band.psi <= 0), 1, -1)
    mm = np.linalg.norm(way * SPACING, axis=1)
    area = 1 + np.clip(s[:, None] * (outwards * mm * curvature), -0.5, 0.5)
    want = ((delta / delta.sum())[:, None] * area * np.polyval((a, b, c), samples)).sum(axis=0)
    np.testing.assert_allclose(out[front], want[front], atol=2e-5)
    assert not out[~front].any()


def test_mean_across_a_linear_image_is_its_value_at_the_closest_point():
    shape = (11, 12, 13)
    z, y, x = np.indices(shape)
    image = (2 * z - y + 0.5 * x).astype(np.float32)
    psi = (x - 6.2).astype(np.float32)
    closest_point = np.zeros((*shape, 3))
    closest_point[..., 2] = -psi
    dense, band = reference.whole_band(psi, closest_point)
    inner = np.zeros(shape, bool)
    inner[3:-3, 3:-3, 4:-4] = True
    out = np.empty(image.size, np.float32)
    flat = np.zeros(image.size, np.float32)
    settings = (reference.grid_of(shape, (1, 1, 1)), 2.0, (0.0, 1.0, 0.0), flat)
    motion.mean_across(0, image.size, dense.psi, image.ravel(), band, inner.ravel(), settings, out)
    np.testing.assert_allclose(out[inner.ravel()], (2 * z - y + 3.1)[inner], atol=1e-5)


def test_kick_solves_the_centred_scheme():
    """The gain is dm times weight, force and 1/density of every cell, and no factor is applied to it again."""
    rng = np.random.default_rng(3)
    n = 200
    beta, force, curvature = (rng.standard_normal(n).astype(np.float32) for _ in range(3))
    density = rng.uniform(0.5, 2, n)
    front = rng.random(n) < 0.7
    gamma, weight, dm = 0.75, 1.7, 0.4
    gain = (dm * weight * force / density).astype(np.float32)
    before, given = beta.copy(), gain.copy()
    motion.kick(0, n, beta, gain, curvature, front, (gamma * dm, dm))
    want = reference.kick(before.astype(float), given.astype(float), curvature, gamma * dm, dm)
    np.testing.assert_allclose(beta[front], want[front], rtol=2e-5, atol=1e-6)
    np.testing.assert_array_equal(beta[~front], before[~front])
    np.testing.assert_array_equal(gain, given)
    # As the equation: (b+ - b)/dm = w f/rho - gamma (b + b+)/2 + b b+ H/2, where the denominator was not clipped.
    b, new, f, h, rho = (a.astype(float)[front] for a in (before, beta, force, curvature, density))
    free = 1 + 0.5 * gamma * dm - 0.5 * dm * b * h > 0.2
    residue = (new - b) / dm - weight * f / rho + gamma * (b + new) / 2 - b * new * h / 2
    assert free.any()
    assert np.abs(residue[free]).max() < 5e-5


def test_kick_from_rest_adds_the_gain_and_bends_nothing():
    """The first kick: no friction and no transport yet, however curved."""
    beta = np.array([0.0, 1.5, -2.0, 0.5], np.float32)
    gain = np.array([0.25, -1.0, 4.0, 8.0], np.float32)
    front = np.array([True, True, True, False])
    motion.kick(0, 4, beta, gain, np.full(4, 30.0, np.float32), front, (0.0, 0.0))
    np.testing.assert_array_equal(beta, np.array([0.25, 0.5, 2.0, 0.5], np.float32))


def test_kick_only_in_its_range():
    beta, ones = np.zeros(6, np.float32), np.ones(6, np.float32)
    motion.kick(2, 5, beta, ones, np.zeros(6, np.float32), np.ones(6, bool), (0.0, 0.0))
    np.testing.assert_array_equal(beta, np.array([0, 0, 1, 1, 1, 0], np.float32))


def test_kick_holds_its_denominator():
    beta, front = np.array([5.0], np.float32), np.ones(1, bool)
    motion.kick(
        0, 1, beta, np.zeros(1, np.float32), np.array([10.0], np.float32), front, (0.0, 1.0)
    )
    assert beta[0] == pytest.approx(25)


def holed(shape, seed, share=0.8):
    """(present, slot map, cells) of a band of some of the voxels."""
    present = np.random.default_rng(seed).random(shape) < share
    slot, cells = np.full(present.size, -1, np.int32), np.flatnonzero(present)
    slot[cells] = np.arange(cells.size)
    return present, slot, cells


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shape", [*SHAPES, (3, 1, 5)])
def test_neighbours_off_the_band_and_beyond_the_border_are_the_cell_itself(shape):
    present, slot, cells = holed(shape, 4)
    grid = reference.grid_of(shape, SPACING)
    on = np.random.default_rng(5).permutation(cells.size)[: cells.size // 2].astype(np.int32)
    table, walls = np.full((on.size, 6), -9, np.int32), np.full(on.size, -9, np.int8)
    near = np.zeros(cells.size, np.bool_)
    motion.neighbour_slots(1, on.size - 1, slot, grid, cells, on, (table, walls, near))
    assert (table[[0, -1]] == -9).all() and (walls[[0, -1]] == -9).all()
    np.testing.assert_array_equal(np.flatnonzero(near), np.unique(table[1:-1]))
    for row in range(1, on.size - 1):
        cell = np.array(np.unravel_index(cells[on[row]], shape))
        for side in range(6):
            other = cell + (1 if side % 2 else -1) * np.eye(3, dtype=int)[side // 2]
            inside = bool(((other >= 0) & (other < shape)).all()) and present[tuple(other)]
            want = slot[np.ravel_multi_index(other, shape)] if inside else on[row]
            assert table[row, side] == want


@pytest.mark.sampled
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("shape", SHAPES)
def test_cells_at_the_walls_across_an_axis(shape, axis):
    """Those of the first and last slice along it; a single slice has no walls."""
    _, slot, cells = holed(shape, 4)
    on = np.random.default_rng(5).permutation(cells.size).astype(np.int32)
    out = (
        np.empty((on.size, 6), np.int32),
        np.full(on.size, -1, np.int8),
        np.empty(cells.size, np.bool_),
    )
    motion.neighbour_slots(0, on.size, slot, reference.grid_of(shape, SPACING), cells, on, out)
    place = np.unravel_index(cells[on], shape)[axis]
    want = np.isin(place, (0, shape[axis] - 1)) & (shape[axis] > 1)
    np.testing.assert_array_equal(out[1] & (1 << axis) != 0, want)
    assert (out[1] & ~7 == 0).all()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_laplacian_as_the_reference_with_holes_and_at_the_border(shape):
    """A stage with the weights 0, 1, 0 is the Laplacian, on the cells ``on`` only."""
    present, slot, cells = holed(shape, 4)
    values = np.random.default_rng(6).standard_normal(shape).astype(np.float32)
    grid = reference.grid_of(shape, SPACING)
    front = np.random.default_rng(7).random(cells.size) < 0.7
    on = np.flatnonzero(front).astype(np.int32)
    beta = values.ravel()[cells]
    table, near = np.empty((on.size, 6), np.int32), np.empty(cells.size, np.bool_)
    motion.neighbour_slots(
        0, on.size, slot, grid, cells, on, (table, np.empty(on.size, np.int8), near)
    )
    out = np.full(cells.size, np.nan, np.float32)
    weights = tuple(np.float32(v) for v in (0, 1, 0))
    motion.diffusion_stage(0, on.size, on, table, grid, (beta, np.zeros_like(beta)), weights, out)
    want = reference.laplacian(values, present, SPACING).ravel()[cells]
    np.testing.assert_allclose(out[front], want[front], rtol=1e-4, atol=1e-4)
    assert np.isnan(out[~front]).all()


def test_a_stage_of_diffusion_weighs_the_last_two():
    shape = (5, 6, 7)
    present, slot, cells = holed(shape, 8)
    n, grid = cells.size, reference.grid_of(shape, SPACING)
    on = np.random.default_rng(10).permutation(n)[: n - 9].astype(np.int32)
    table, near = np.empty((on.size, 6), np.int32), np.empty(cells.size, np.bool_)
    motion.neighbour_slots(
        0, on.size, slot, grid, cells, on, (table, np.empty(on.size, np.int8), near)
    )
    old, older = np.random.default_rng(9).standard_normal((2, n)).astype(np.float32)
    mu, rate, nu = 1.5, 0.07, -0.5
    weights = tuple(np.float32(v) for v in (mu, rate, nu))
    out = np.full(n, np.nan, np.float32)
    motion.diffusion_stage(20, 90, on, table, grid, (old, older), weights, out)
    on_grid = np.zeros(shape, np.float32)
    on_grid[present] = old
    lap = reference.laplacian(on_grid, present, SPACING).ravel()[cells]
    done = on[20:90]
    np.testing.assert_allclose(
        out[done], (mu * old + rate * lap + nu * older)[done], rtol=0, atol=5e-6
    )
    assert np.isnan(np.delete(out, done)).all()
    # Of a constant nothing flows, whatever is missing, and the weights add up to 1.
    ones, out = np.ones(n, np.float32), np.full(n, np.nan, np.float32)
    motion.diffusion_stage(0, on.size, on, table, grid, (ones, ones), weights, out)
    assert (out[on] == 1).all()


def test_rates_are_voxels_along_the_normal():
    normals = np.array(
        [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0) / np.sqrt(2), (0.48, 0.6, 0.64)]
    )
    distance = np.array([2.0, -1.0, 0.3, 1e-6, -1.5])
    closest_point = (-distance[:, None] * normals).astype(np.float32)
    band = Band(np.arange(5), distance.astype(np.float32), closest_point)
    beta = np.array([1.0, -2.0, 3.0, 4.0, -5.0], np.float32)
    front, out = np.array([True, True, True, True, True]), np.empty(5, np.float32)
    motion.voxel_rates(0, 5, reference.grid_of((5, 1, 1), SPACING), band, front, beta, out)
    np.testing.assert_allclose(
        out, np.abs(beta) * np.linalg.norm(normals / SPACING, axis=1), rtol=1e-4
    )
    front[2] = False
    motion.voxel_rates(0, 5, reference.grid_of((5, 1, 1), SPACING), band, front, beta, out)
    assert out[2] == 0


def test_drift_moves_psi_by_the_speed_and_only_in_the_band():
    rng = np.random.default_rng(5)
    psi = np.full(50, 9.0, np.float32)
    cells = np.array([3, 7, 8, 20, 49])
    values, beta, norm = (rng.standard_normal(5).astype(np.float32) for _ in range(3))
    band = Band(cells, values, np.zeros((5, 3), np.float32))
    motion.advance_psi(1, 4, psi, band, beta, norm, np.float32(0.25))
    want = np.full(50, 9.0)
    want[cells[1:4]] = (values + 0.25 * beta * norm)[1:4]
    np.testing.assert_allclose(psi, want, rtol=1e-6)
