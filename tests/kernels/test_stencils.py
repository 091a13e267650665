"""Differences of many cells at once, against the cell by cell ones and plain numpy in float64."""

import numpy as np
import pytest

from accelsurf.kernels import differences
from accelsurf.kernels.grid import BATCH, unravel
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
SHAPES = [(7, 9, 8), (5, 5, 5), (8, 5, 6)]
#: Too thin for any cell to have two neighbours to each side along every axis.
THIN = [(1, 9, 12), (4, 9, 8), (2, 5, 6), (3, 4, 5), (9, 8, 4)]
EPS = float(np.finfo(np.float32).eps)
#: Rows of `gather_block`: steps (z, y, x) from the cell.
BLOCK_STEPS = [
    (0, 0, 0),
    (-1, 0, 0),
    (1, 0, 0),
    (0, -1, 0),
    (0, 1, 0),
    (0, 0, -1),
    (0, 0, 1),
    (-1, -1, 0),
    (-1, 1, 0),
    (1, -1, 0),
    (1, 1, 0),
    (-1, 0, -1),
    (-1, 0, 1),
    (1, 0, -1),
    (1, 0, 1),
    (0, -1, -1),
    (0, -1, 1),
    (0, 1, -1),
    (0, 1, 1),
]


def gathered(psi, wanted, first, count):
    """Columns of `gather_cross` for cells ``first .. first + count - 1`` of a whole band: (rows, well inside)."""
    rows = np.full((15, count + 2), np.float32(-77))
    well_inside = np.full(count + 2, True)
    cells = np.arange(psi.size)
    grid = reference.grid_of(psi.shape, SPACING)
    differences.gather_cross(first, count, psi.ravel(), grid, cells, wanted, rows, well_inside)
    return rows, well_inside


def blocks(psi, spacing=SPACING):
    """(cells, rows, gradient z y x, H, K, mean as rows) of every cell that `gather_block` takes."""
    grid = reference.grid_of(psi.shape, spacing)
    memory, count, cells, batches = differences.block_memory(), 0, [], []
    for cell in range(psi.size):
        if differences.gather_block(cell, *unravel(cell, grid), psi.ravel(), grid, memory, count):
            cells.append(cell)
            count += 1
        if count == BATCH or (cell == psi.size - 1 and count):
            differences.block_curvatures(grid, memory)
            batches.append(memory.reshape(-1, BATCH)[:, :count])
            memory, count = differences.block_memory(), 0
    both = np.concatenate([*batches, np.zeros((25, 0), np.float32)], axis=1)
    return np.array(cells, int), both[:19], both[19:]


@pytest.mark.parametrize("shape", [*SHAPES, *THIN])
def test_crosses_are_gathered_of_wanted_cells_well_inside_only(shape):
    psi = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    wanted = np.random.default_rng(2).random(psi.size) < 0.8
    first, count = 3, psi.size - 7
    rows, well_inside = gathered(psi, wanted, first, count)
    for i in range(count):
        cell = np.array(np.unravel_index(first + i, shape))
        inside = bool(((cell >= 2) & (cell < np.array(shape) - 2)).all())
        assert well_inside[i] == (inside and wanted[first + i])
        if well_inside[i]:
            for a in range(3):
                line = [psi[tuple(cell + k * np.eye(3, dtype=int)[a])] for k in range(-2, 3)]
                np.testing.assert_array_equal(rows[5 * a : 5 * a + 5, i], line)
        else:
            assert (rows[:, i] == -77).all()
    assert (rows[:, count:] == -77).all() and well_inside[count:].all()
    assert well_inside[:count].any() == (shape in SHAPES)


def test_smaller_is_minmod():
    values = np.array([-3, -2, -0.5, 0, 0.5, 2, 3], np.float32)
    for a in values:
        for b in values:
            assert differences.smaller(a, b) == differences.minmod(a, b)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("shape", SHAPES)
def test_norms_as_cell_by_cell_and_as_godunovs_theorem(shape):
    psi = reference.smooth_noise(shape, 3, 0.8)
    rng = np.random.default_rng(4)
    way = rng.choice(np.array([-1, 1], np.float32), psi.size + 2)
    rows, well_inside = gathered(psi, np.ones(psi.size, bool), 0, psi.size)
    columns = np.flatnonzero(well_inside[: psi.size])
    rows[:, ~well_inside] = 0
    out = np.full(psi.size + 2, np.float32(-7))
    differences.godunov_norms(psi.size, reference.grid_of(shape, SPACING), rows, way, out)
    assert (out[psi.size :] == -7).all()
    want = reference.godunov_norm(psi, SPACING, way[: psi.size].reshape(shape) > 0).ravel()
    # Of differences up to ``steps`` twelve rounded operations are made per axis.
    steps = np.abs(np.diff(rows.astype(float).reshape(3, 5, -1), axis=1)).max(axis=1)
    bound = 6 * EPS * (steps / np.array(SPACING)[:, None]).sum(axis=0)
    assert (np.abs(out - np.append(want, [0, 0])) <= bound)[columns].all()
    grid = reference.grid_of(shape, SPACING)
    for cell in columns:
        single = differences.godunov_norm(
            psi.ravel().astype(float), cell, *unravel(cell, grid), grid, way[cell] > 0
        )
        assert abs(out[cell] - single) <= bound[cell]


def test_norms_of_a_plane_are_exact_whichever_the_way():
    shape, spacing = (5, 6, 7), (2.0, 1.0, 0.5)
    z, y, x = reference.coordinates(shape, spacing, (0, 0, 0))
    psi = (0.25 * z - 0.5 * y + 2 * x).astype(np.float32)
    rows, well_inside = gathered(psi, np.ones(psi.size, bool), 0, psi.size)
    rows = np.ascontiguousarray(rows[:, : psi.size][:, well_inside[: psi.size]])
    for way in (-1, 1):
        out = np.empty(rows.shape[1], np.float32)
        ways = np.full(rows.shape[1], way, np.float32)
        differences.godunov_norms(rows.shape[1], reference.grid_of(shape, spacing), rows, ways, out)
        np.testing.assert_allclose(out, np.sqrt(0.25**2 + 0.5**2 + 2**2), rtol=EPS)


@pytest.mark.parametrize(
    "shape", [(7, 9, 8), (3, 4, 5), (3, 3, 3), (1, 9, 12), (2, 5, 6), (5, 6, 2), (5, 1, 6)]
)
def test_blocks_are_gathered_where_all_18_neighbours_are(shape):
    psi = np.random.default_rng(5).standard_normal(shape).astype(np.float32)
    cells, rows, _ = blocks(psi)
    at = np.argwhere(np.ones(shape, bool))
    inside = ((at > 0) & (at < np.array(shape) - 1)).all(axis=1)
    np.testing.assert_array_equal(cells, np.flatnonzero(inside))
    for column, cell in zip(rows.T, at[inside], strict=True):
        np.testing.assert_array_equal(column, [psi[tuple(cell + step)] for step in BLOCK_STEPS])


def test_at_the_border_nothing_is_gathered():
    psi = np.ones((3, 4, 5), np.float32)
    grid, memory = reference.grid_of(psi.shape, SPACING), np.full(25 * BATCH, np.float32(-7))
    assert not differences.gather_block(0, 0, 0, 0, psi.ravel(), grid, memory, 1)
    assert (memory == -7).all()
    assert differences.gather_block(26, 1, 1, 1, psi.ravel(), grid, memory, 1)
    rows = memory.reshape(25, BATCH)
    assert (
        (rows[:19, 1] == 1).all()
        and (np.delete(rows, 1, axis=1) == -7).all()
        and (rows[19:] == -7).all()
    )


@pytest.mark.parametrize("spacing", [SPACING, (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("shape", [(7, 9, 8), (3, 4, 5)])
def test_curvatures_as_cell_by_cell_and_as_the_reference(shape, spacing):
    """Within what float32 may lose: the sums of the formulas' terms without their signs, times their operations."""
    psi = 2 * reference.smooth_noise(shape, 1)
    cells, rows, out = blocks(psi, spacing)
    out = out.astype(float)
    gradient, _ = (
        d.reshape(psi.size, *d.shape[3:])[cells] for d in reference.derivatives(psi, spacing)
    )
    k = reference.principal_curvatures(psi, spacing).reshape(-1, 2)[cells]
    h = np.array(spacing)
    r = rows.astype(float)
    # What the second derivatives are made of: differences between neighbours, both counted.
    own = [(abs(r[2 * a + 2] - r[0]) + abs(r[0] - r[2 * a + 1])) / h[a] ** 2 for a in range(3)]
    mixed = [
        (abs(r[o + 3] - r[o + 1]) + abs(r[o + 2] - r[o])) / (4 * h[a] * h[b])
        for o, (a, b) in zip((7, 11, 15), ((0, 1), (0, 2), (1, 2)), strict=True)
    ]
    (zz, yy, xx), (zy, zx, yx), (z, y, x) = own, mixed, np.abs(gradient.T)
    norm = np.linalg.norm(gradient, axis=1)
    mean = xx * (y * y + z * z) + yy * (x * x + z * z) + zz * (x * x + y * y)
    mean = (mean + 2 * (x * y * yx + x * z * zx + y * z * zy)) / norm**3
    gauss = x * x * (yy * zz + zy * zy) + y * y * (xx * zz + zx * zx) + z * z * (xx * yy + yx * yx)
    terms = x * y * (zx * zy + yx * zz) + y * z * (yx * zx + zy * xx) + x * z * (yx * zy + zx * yy)
    gauss = (gauss + 2 * terms) / norm**4
    steep = norm > 0.02
    assert steep.mean() > 0.5
    assert (np.abs(out[:3] - gradient.T) <= 2 * EPS * np.abs(gradient.T)).all()
    assert (np.abs(out[3] - k.sum(axis=1)) <= 18 * EPS * mean)[steep].all()
    assert (np.abs(out[4] - k.prod(axis=1)) <= 23 * EPS * gauss)[steep].all()
    second = sum(r[2 * a + 1] - 2 * r[0] + r[2 * a + 2] for a in range(3)) / 24
    bound = 8 * EPS * sum(own[a] * h[a] ** 2 for a in range(3)) / 24
    assert (np.abs(out[5] - second) <= bound).all()
    grid = reference.grid_of(shape, spacing)
    for i, cell in enumerate(cells):
        at = unravel(cell, grid)
        single = differences.gradient(psi.ravel().astype(float), cell, *at, grid)
        assert (np.abs(out[:3, i] - single) <= 2 * EPS * np.abs(single)).all()
        above = differences.mean_above_centre(psi.ravel().astype(float), cell, *at, grid)
        assert abs(above - out[5, i]) <= bound[i]
        if steep[i]:
            one, product = differences.curvatures(psi.ravel().astype(float), cell, *at, grid)
            assert abs(out[3, i] - one) <= 18 * EPS * mean[i]
            assert abs(out[4, i] - product) <= 23 * EPS * gauss[i]


def test_curvature_is_zero_where_there_is_no_gradient():
    """Flat, and a slope just below and just above what counts."""
    x = np.indices((3, 3, 3))[2]
    for slope, curved in ((0.0, False), (0.9e-4, False), (1.1e-4, True)):
        psi = (slope * x + 1e-3 * (x - 1) ** 2 + 1e-3 * (np.indices((3, 3, 3))[1] - 1) ** 2).astype(
            np.float32
        )
        _, _, out = blocks(psi, (1.0, 1.0, 1.0))
        assert np.isfinite(out[:, 0]).all()
        assert (out[3, 0] != 0) == curved
        single = differences.curvatures(
            psi.ravel(), 13, 1, 1, 1, reference.grid_of((3, 3, 3), (1, 1, 1))
        )
        assert (single[0] != 0) == curved
    _, _, out = blocks(np.full((3, 3, 3), 2, np.float32))
    assert not out[:, 0].any()


def test_a_column_is_the_same_bytes_wherever_it_stands():
    """Vector instructions and what is left over of them: a cell must not depend on the range it is in."""
    rng = np.random.default_rng(6)
    grid = reference.grid_of((9, 9, 9), SPACING)
    cross, block = (rng.standard_normal((n, 128)).astype(np.float32) for n in (15, 19))
    way = rng.choice(np.array([-1, 1], np.float32), 128)
    norms, memory = np.empty(128, np.float32), differences.block_memory()
    differences.godunov_norms(128, grid, cross, way, norms)
    memory[: block.size] = block.ravel()
    differences.block_curvatures(grid, memory)
    shape = memory[block.size :].reshape(6, 128)
    for first, count in ((0, 1), (1, 7), (5, 13), (100, 28), (64, 63)):
        part = slice(first, first + count)
        rows, more = np.zeros((15, 128), np.float32), np.zeros((25, 128), np.float32)
        ways = np.ones(128, np.float32)
        rows[:, :count], more[:19, :count], ways[:count] = cross[:, part], block[:, part], way[part]
        some = np.full(128, np.nan, np.float32)
        differences.godunov_norms(count, grid, rows, ways, some)
        differences.block_curvatures(grid, more.ravel())
        np.testing.assert_array_equal(some[:count], norms[part])
        np.testing.assert_array_equal(more[19:, :count], shape[:, part])
        assert np.isnan(some[count:]).all()
