"""Differences: gradient, curvatures and Godunov's norm against their references, on every voxel up to the border."""

import itertools

import numpy as np
import pytest

from accelsurf.kernels import differences
from accelsurf.kernels.grid import BATCH, Band
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
SHAPES = [(7, 9, 8), (1, 9, 12), (2, 5, 6), (3, 4, 5), (5, 1, 6), (6, 5, 2), (1, 1, 5)]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_and_curvatures_as_the_reference(shape):
    psi = (2 * reference.smooth_noise(shape, 1)).astype(np.float64)
    grid = reference.grid_of(shape, SPACING)
    want, _ = reference.derivatives(psi, SPACING)
    k = reference.principal_curvatures(psi, SPACING)
    steep = np.linalg.norm(want, axis=-1) > 0.02
    assert steep.mean() > 0.5
    for cell in np.ndindex(*shape):
        raveled = int(np.ravel_multi_index(cell, shape))
        got = differences.gradient(psi.ravel(), raveled, *cell, grid)
        np.testing.assert_allclose(got, want[cell], atol=1e-12)
        if steep[cell]:
            mean, gauss = differences.curvatures(psi.ravel(), raveled, *cell, grid)
            size = np.abs(k[cell]).max() + 1
            assert mean == pytest.approx(k[cell].sum(), abs=1e-9 * size)
            assert gauss == pytest.approx(k[cell].prod(), abs=1e-9 * size**2)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("shape", SHAPES)
def test_mirrored_curvatures_as_the_reference(shape):
    """And those of the voxel in the volume that is mirrored at all its borders."""
    psi = (2 * reference.smooth_noise(shape, 1)).astype(np.float64)
    grid = reference.grid_of(shape, SPACING)
    slope, _ = reference.derivatives(psi, SPACING, mirrored=True)
    k = reference.principal_curvatures(psi, SPACING, mirrored=True)
    width = [(1, 1) if n > 1 else (0, 0) for n in shape]
    whole, more = np.pad(psi, width, mode="symmetric"), [w for w, _ in width]
    around = reference.grid_of(whole.shape, SPACING)
    for cell in np.ndindex(*shape):
        mean, gauss = differences.mirrored_curvatures(
            psi.ravel(), int(np.ravel_multi_index(cell, shape)), *cell, grid
        )
        there = tuple(np.add(cell, more))
        same = differences.curvatures(
            whole.ravel(), int(np.ravel_multi_index(there, whole.shape)), *there, around
        )
        np.testing.assert_allclose((mean, gauss), same, atol=1e-9 * (np.abs(same).max() + 1))
        if np.linalg.norm(slope[cell]) > 0.02:
            size = np.abs(k[cell]).max() + 1
            assert mean == pytest.approx(k[cell].sum(), abs=1e-9 * size)
            assert gauss == pytest.approx(k[cell].prod(), abs=1e-9 * size**2)


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (3, 4, 5)])
def test_gradient_and_pure_second_derivatives_are_exact_on_quadratics_up_to_the_border(shape):
    z, y, x = reference.coordinates(shape, SPACING, (1.0, 2.0, 1.5))
    psi = (0.5 * z**2 - y**2 + 2 * x**2 + z - 2 * y).ravel()
    wanted = np.stack([z + 1, -2 * y - 2, 4 * x], axis=-1) * (np.array(shape) > 1)
    grid, strides = reference.grid_of(shape, SPACING), (shape[1] * shape[2], shape[2], 1)
    for cell in np.ndindex(*shape):
        raveled = int(np.ravel_multi_index(cell, shape))
        np.testing.assert_allclose(
            differences.gradient(psi, raveled, *cell, grid), wanted[cell], atol=1e-9
        )
        for a, second in enumerate((1.0, -2.0, 4.0)):
            _, got = differences.axis_derivatives(
                psi, raveled, cell[a], shape[a], strides[a], SPACING[a]
            )
            assert got == pytest.approx(second if shape[a] > 1 else 0, abs=1e-9)


@pytest.mark.parametrize("shape", [(1, 4, 6), (3, 4, 5), (2, 5, 1)])
def test_which_cells_lie_at_the_border(shape):
    grid = reference.grid_of(shape, SPACING)
    for cell in np.ndindex(*shape):
        want = any(n > 1 and i in (0, n - 1) for i, n in zip(cell, shape, strict=True))
        assert differences.is_at_border(*cell, grid) == want


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (3, 4, 5)])
def test_second_derivatives_are_exact_on_quadratics_inside_and_gone_at_the_border(shape):
    """axis_differences and mixed_difference one by one."""
    z, y, x = reference.coordinates(shape, SPACING, (1.0, 2.0, 1.5))
    psi = 0.5 * z**2 - y**2 + 2 * x**2 + 0.3 * z * y - 0.7 * y * x + 0.2 * z * x + z - 2 * y
    wanted_bends, wanted_mixed = (1.0, -2.0, 4.0), {(0, 1): 0.3, (0, 2): 0.2, (1, 2): -0.7}
    strides = (shape[1] * shape[2], shape[2], 1)
    for cell in np.ndindex(*shape):
        raveled = int(np.ravel_multi_index(cell, shape))
        for a in range(3):
            down, up, bend = differences.axis_differences(
                psi.ravel(), raveled, cell[a], shape[a], strides[a], SPACING[a]
            )
            inside = 0 < cell[a] < shape[a] - 1
            assert bend == pytest.approx(wanted_bends[a] if inside else 0, abs=1e-9)
            assert inside or down == up
            if shape[a] == 1:
                assert down == 0
        for (a, b), want in wanted_mixed.items():
            at = (cell[a], shape[a], cell[b], shape[b])
            got = differences.mixed_difference(
                psi.ravel(), raveled, at, (strides[a], strides[b]), (SPACING[a], SPACING[b])
            )
            assert got == pytest.approx(want if shape[a] > 1 and shape[b] > 1 else 0, abs=1e-9)


def test_curvature_is_zero_where_there_is_no_gradient():
    grid = reference.grid_of((3, 3, 3), SPACING)
    assert differences.curvatures(np.ones(27), 13, 1, 1, 1, grid) == (0.0, 0.0)


def test_signs_and_sizes_on_balls_and_cylinders():
    """Positive on a ball with psi negative inside; 2/r and 1/r^2; a cylinder has 1/r and 0."""
    shape, spacing = (21, 21, 21), (1.0, 1.0, 1.0)
    grid = reference.grid_of(shape, spacing)
    z, y, x = reference.coordinates(shape, spacing, (10, 10, 10))
    cell, raveled = (10, 10, 17), int(np.ravel_multi_index((10, 10, 17), shape))
    mean, gauss = differences.curvatures(
        (np.sqrt(z**2 + y**2 + x**2) - 6).ravel(), raveled, *cell, grid
    )
    assert mean == pytest.approx(2 / 7, rel=0.01)
    assert gauss == pytest.approx(1 / 49, rel=0.02)
    mean, gauss = differences.curvatures(
        (6 - np.sqrt(z**2 + y**2 + x**2)).ravel(), raveled, *cell, grid
    )
    assert mean == pytest.approx(-2 / 7, rel=0.01)
    assert gauss == pytest.approx(1 / 49, rel=0.02)
    mean, gauss = differences.curvatures((np.hypot(y, x) - 6).ravel(), raveled, *cell, grid)
    assert mean == pytest.approx(1 / 7, rel=0.01)
    assert gauss == pytest.approx(0, abs=1e-9)


def test_curvature_at_closest_point_undoes_the_distance():
    """Of a level d off a surface of principal curvatures k: k/(1 + d k) each. Reference: from d to d = 0 and back."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        k, d = rng.normal(0, 0.5, 2), rng.uniform(-2, 2)
        if (1 + d * k).min() < 0.3:
            continue  # beyond a centre of curvature
        level = k / (1 + d * k)
        # (1 - d l1)(1 - d l2), which is 1/((1 + d k1)(1 + d k2)), is what must not be too small.
        want = k.sum() if (1 - d * level).prod() > 0.2 else level.sum()
        got = differences.curvature_at_closest_point(level.sum(), level.prod(), d, 2.0)
        assert got == pytest.approx(np.clip(want, -2, 2), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("mean", "gauss", "d", "want"),
    [
        (0.5, 0.0625, 0.0, 0.5),  # at the surface nothing is undone
        (0.5, 0.0625, 2.0, 1.0),  # a ball of radius 2, two off
        (0.4, 0.04, -2.0, 2 / 7),  # and from inside
        (0.9, 0.0, 1.0, 0.9),  # 1 - d k = 0.1 is too little to divide by
        (0.7, 0.0, 1.0, 1.5),  # clipped
        (-0.7, 0.0, -1.0, -1.5),
        (9.0, 0.0, 0.0, 1.5),
    ],
)
def test_curvature_at_closest_point_of_known_surfaces(mean, gauss, d, want):
    assert differences.curvature_at_closest_point(mean, gauss, d, 1.5) == pytest.approx(want)


def test_minmod():
    assert differences.minmod(1.0, 2.0) == 1
    assert differences.minmod(-3.0, -2.0) == -2
    assert differences.minmod(-1.0, 2.0) == 0
    assert differences.minmod(0.0, 2.0) == 0


@pytest.mark.parametrize("n", [1, 2, 3, 4, 9])
def test_upwind_differences_as_the_reference(n):
    line = np.random.default_rng(n).standard_normal(n)
    down, up = reference.one_sided(line, 0.7)
    got = np.array([differences.upwind_differences(line, i, i, n, 1, 0.7) for i in range(n)])
    np.testing.assert_allclose(got, np.stack([down, up], axis=1), atol=1e-12)


def test_upwind_differences_are_exact_on_quadratics():
    x = np.arange(9) * 0.7
    line = 1.5 * x**2 - x
    for i in range(2, 7):
        down, up = differences.upwind_differences(line, i, i, 9, 1, 0.7)
        assert down == pytest.approx(3 * x[i] - 1)
        assert up == pytest.approx(3 * x[i] - 1)


@pytest.mark.parametrize("shape", SHAPES)
def test_upwind_norms_as_godunovs_theorem(shape):
    psi = reference.smooth_noise(shape, 4, 0.8)
    dense, band = reference.whole_band(psi)
    rng = np.random.default_rng(5)
    beta = rng.standard_normal(psi.size).astype(np.float32)
    front = rng.random(psi.size) < 0.8
    out = np.full(psi.size, np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    differences.upwind_norms(0, psi.size, dense.psi, grid, band, beta, front, out)
    want = reference.godunov_norm(psi, SPACING, (beta > 0).reshape(shape)).ravel()
    np.testing.assert_allclose(out[front], want[front], rtol=1e-4, atol=1e-5)
    assert (out[~front] == 1).all()


def test_upwind_norms_of_more_than_one_chunk():
    """Whole chunks and a rest, with the slow way at the border in each, holes, and cells far from raster neighbours."""
    shape = (9, 10, 13)
    psi = reference.smooth_noise(shape, 7, 0.8)
    rng = np.random.default_rng(8)
    cells = np.flatnonzero(rng.random(psi.size) < 0.6)
    n = cells.size
    assert n > 4 * BATCH and n % BATCH
    band = Band(cells, psi.ravel()[cells], np.zeros((n, 3), np.float32))
    beta, front = rng.standard_normal(n).astype(np.float32), rng.random(n) < 0.8
    beta[:5] = 0
    out = np.full(n, np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    differences.upwind_norms(0, n, psi.ravel(), grid, band, beta, front, out)
    shrinking = np.zeros(psi.size, bool)
    shrinking[cells] = beta > 0
    want = reference.godunov_norm(psi, SPACING, shrinking.reshape(shape)).ravel()[cells]
    np.testing.assert_allclose(out[front], want[front], rtol=1e-4, atol=1e-5)
    assert (out[~front] == 1).all()
    at = np.stack(np.unravel_index(cells, shape), axis=1)
    inside = ((at > 1) & (at < np.array(shape) - 2)).all(axis=1) & front
    chunks = [inside[first : first + BATCH] for first in range(0, n, BATCH)]
    assert sum(bool(chunk.any() and not chunk.all()) for chunk in chunks) > 3


def test_upwind_norms_are_the_same_bytes_however_the_range_is_cut():
    psi = reference.smooth_noise((9, 10, 13), 9, 0.8)
    dense, band = reference.whole_band(psi)
    n, grid = psi.size, reference.grid_of(psi.shape, SPACING)
    rng = np.random.default_rng(10)
    beta, front = rng.standard_normal(n).astype(np.float32), rng.random(n) < 0.8
    whole, parts = np.full(n, np.nan, np.float32), np.full(n, np.nan, np.float32)
    differences.upwind_norms(0, n, dense.psi, grid, band, beta, front, whole)
    cuts = [0, 1, 8, 130, 300, 301, 557, n]
    for start, stop in itertools.pairwise(cuts):
        differences.upwind_norms(start, stop, dense.psi, grid, band, beta, front, parts)
    np.testing.assert_array_equal(whole, parts)


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_a_wedge_moves_as_the_viscosity_solution(speed):
    """psi = -|x| opens into a fan or keeps its edge, by the sign of beta: |grad psi| at the kink is 0 or 1."""
    x = np.arange(11.0) - 5
    psi = np.broadcast_to(-np.abs(x), (3, 3, 11)).astype(np.float32)
    dense, band = reference.whole_band(psi)
    front = np.ones(psi.size, bool)
    out = np.empty(psi.size, np.float32)
    beta = np.full(psi.size, speed, np.float32)
    differences.upwind_norms(
        0, psi.size, dense.psi, reference.grid_of(psi.shape, (1, 1, 1)), band, beta, front, out
    )
    # psi_t = beta |grad psi|: a maximum may not grow (beta > 0), and falls at slope 1 for beta < 0.
    assert out.reshape(psi.shape)[1, 1, 5] == (0 if speed > 0 else 1)


@pytest.mark.parametrize(("start", "stop"), [(40, 50), (3, 3 + 128), (100, 301), (0, 0)])
def test_a_range_of_slots_writes_nothing_outside_itself(start, stop):
    psi = reference.smooth_noise((7, 9, 8), 6)
    dense, band = reference.whole_band(psi)
    grid, n = reference.grid_of(psi.shape, SPACING), psi.size
    out = np.full(n, np.nan, np.float32)
    differences.upwind_norms(start, stop, dense.psi, grid, band, dense.psi, np.ones(n, bool), out)
    assert (
        np.isfinite(out[start:stop]).all()
        and np.isnan(out[:start]).all()
        and np.isnan(out[stop:]).all()
    )
