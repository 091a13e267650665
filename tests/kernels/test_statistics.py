"""Order statistics by bits, and sums of products by blocks, against numpy."""

import numpy as np
import pytest

from accelsurf.kernels import statistics
from accelsurf.kernels.grid import BLOCK, Band
from tests.support import reference

pytestmark = pytest.mark.nojit

TINY = np.finfo(np.float32).smallest_subnormal


def check_ranks(values, where, ranks):
    want = np.sort(np.abs(values[where]))
    for rank in ranks:
        got = statistics.magnitude_at_rank(values, where, rank)
        assert got == want[rank]
        assert np.float32(got).tobytes() == want[rank].tobytes()


@pytest.mark.parametrize("n", [1, 2, 3, 17])
def test_every_rank_of_few_values(n):
    values = np.random.default_rng(n).standard_normal(n).astype(np.float32)
    check_ranks(values, np.ones(n, bool), range(n))


def test_ranks_of_many_values_of_all_sizes_where_a_mask_is_set():
    """Exponents from denormals to the largest, of either sign; what is not in the mask does not count."""
    rng = np.random.default_rng(1)
    values = rng.integers(0, 0x7F800000, 700).astype(np.uint32).view(np.float32)
    values *= rng.choice(np.array([-1, 1], np.float32), values.size)
    where = rng.random(values.size) < 0.6
    values[~where] = np.nan
    count = int(where.sum())
    check_ranks(values, where, [0, 1, count // 3, count // 2, count - 2, count - 1])


def test_zeros_denormals_ties_and_infinity():
    above_1 = np.nextafter(np.float32(1), np.float32(2))
    few = [0.0, -0.0, TINY, -TINY, 3 * TINY, 1.0, -1.0, 1.0, above_1, -np.inf, np.inf]
    values = np.random.default_rng(2).permutation(np.array(few, np.float32))
    check_ranks(values, np.ones(values.size, bool), range(values.size))


@pytest.mark.parametrize("width", [9, 20])
def test_values_that_differ_only_in_their_last_bits(width):
    """Across the parts of 11, 11 and 9 bits that are looked at in turn."""
    base = np.array([1.0], np.float32).view(np.uint32)[0]
    bits = base + np.random.default_rng(3).integers(0, 2 << width, 200).astype(np.uint32)
    check_ranks(bits.view(np.float32), np.ones(200, bool), [0, 1, 50, 99, 100, 150, 198, 199])


def test_values_stay_as_they_were():
    values = np.array([3.0, -1.0, 2.0], np.float32)
    before = values.copy()
    where = np.array([True, True, False])
    assert statistics.magnitude_at_rank(values, where, 1) == 3
    np.testing.assert_array_equal(values, before)


def test_products_by_blocks():
    rng = np.random.default_rng(4)
    n = 2 * BLOCK + 37
    weight = np.where(rng.random(n) < 0.3, 0.0, rng.random(n))
    one, other = (rng.standard_normal(n).astype(np.float32) for _ in range(2))
    one[np.flatnonzero(weight == 0)[:5]] = np.nan  # what has no weight is not looked at
    sums = np.full((5, 1), -1.0)
    statistics.products(1, 3, weight, one, other, sums)
    assert (sums[[0, 3, 4]] == -1).all()
    statistics.products(0, 1, weight, one, other, sums)
    terms = np.where(weight != 0, weight * one.astype(float) * other.astype(float), 0.0)
    for block in range(3):
        part = terms[block * BLOCK : (block + 1) * BLOCK]
        assert sums[block, 0] == pytest.approx(part.sum(), abs=1e-12 * np.abs(part).sum())
    assert (sums[3:] == -1).all()


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 5, 13), (6, 1, 1)])
def test_sums_by_cube(shape):
    """Of cells in raster order, some rows without any; the order of the sums is that of the cells."""
    rng = np.random.default_rng(5)
    cells = np.flatnonzero(rng.random(shape) < 0.3)
    values, scale = rng.standard_normal(cells.size).astype(np.float32), np.float32(-1.7)
    cube_of = [np.arange(n) // 3 for n in shape]
    count = [int(c[-1]) + 1 for c in cube_of]
    planes, rows = cube_of[0] * (count[1] * count[2]), cube_of[1] * count[2]
    reached, sums = np.zeros(int(np.prod(count)), bool), np.zeros(int(np.prod(count)))
    statistics.sums_by_cube(
        cells, values, scale, np.add.outer(planes, rows).ravel(), cube_of[2], reached, sums
    )
    z, y, x = np.unravel_index(cells, shape)
    cubes = planes[z] + rows[y] + cube_of[2][x]
    np.testing.assert_array_equal(reached, np.bincount(cubes, minlength=sums.size) > 0)
    np.testing.assert_array_equal(sums, np.bincount(cubes, values * scale, minlength=sums.size))


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (2.5, 0.8, 1.1)])
def test_displacement_sums(spacing):
    """Against the same by whole arrays, of more than two blocks; the earlier band lacks cells and has others."""
    rng, n, far, beyond = np.random.default_rng(6), 2 * BLOCK + 37, 0.5, 3.0
    cells = np.flatnonzero(rng.random(3 * n) < 0.4)[:n]
    old_cells = np.sort(np.concatenate([cells[rng.random(n) < 0.8], np.arange(3 * n, 3 * n + 9)]))
    psi, old = (rng.normal(0, 1, size).astype(np.float32) for size in (n, old_cells.size))
    band = Band(cells, psi, rng.normal(0, 1, (n, 3)).astype(np.float32))
    band.to_closest[5] = 0.0
    area = np.where(rng.random(n) < 0.5, rng.random(n), 0.0)
    area[5] = 1.0
    sums, arguments = np.full((4, 3), -7.0), (band, area, (old_cells, old), (far, beyond))
    grid = reference.grid_of((30, 30, 30), spacing)
    statistics.displacement_sums(1, 3, grid, *arguments, sums)
    assert (sums[[0, 3]] == -7.0).all()
    statistics.displacement_sums(0, 1, grid, *arguments, sums)
    places = np.minimum(np.searchsorted(old_cells, cells), old_cells.size - 1)
    known = old_cells[places] == cells
    to_closest = band.to_closest.astype(float)
    per_mm = np.linalg.norm(to_closest / spacing, axis=1) / np.maximum(
        np.linalg.norm(to_closest, axis=1), 1e-150
    )
    way = np.where(known, np.abs(psi.astype(float) - old[places]) * per_mm, beyond)
    for block in range(3):
        own = slice(block * BLOCK, (block + 1) * BLOCK)
        want = [area[own].sum(), (area * way)[own].sum(), area[own][way[own] > far].sum()]
        np.testing.assert_allclose(sums[block], want, rtol=1e-6)
