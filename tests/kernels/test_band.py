"""Bookkeeping of the band: who stays, order, dense arrays, extension."""

import numpy as np
import pytest

from accelsurf.kernels import band as band_kernels
from accelsurf.kernels.grid import Band, DenseArrays
from accelsurf.kernels.march import EDGE, FROZEN, OPEN
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)


def scattered(shape, seed, share=0.6):
    """A band of some of the voxels with random closest points: (lattice, band, present)."""
    rng = np.random.default_rng(seed)
    present = rng.random(shape) < share
    cells = np.flatnonzero(present)
    closest_point = (rng.uniform(-1, 1, (cells.size, 3)) * SPACING).astype(np.float32)
    if shape[0] == 1:
        closest_point[:, 0] = 0
    sign = np.where(rng.random(cells.size) < 0.5, -1, 1)
    psi = (np.linalg.norm(closest_point, axis=1) * sign).astype(np.float32)
    dense = DenseArrays(np.full(present.size, 9, np.float32), np.full(present.size, -1, np.int32))
    dense.psi[cells], dense.slot[cells] = psi, np.arange(cells.size)
    return dense, Band(cells, psi, closest_point), present


def test_keep_mask_drops_the_unknown_and_the_far():
    closest_point = np.array(
        [(2.9, 0, 0), (3.1, 0, 0), (0, 0.99, 0), (0, 0, 0.71), (0, 0, 0)], np.float32
    )
    state = np.array([FROZEN, FROZEN, EDGE, FROZEN, OPEN], np.int8)
    keep, psi = np.ones(5, bool), np.ones(5, np.float32)
    grid = reference.grid_of((5, 1, 1), SPACING)
    band_kernels.keep_mask(0, 5, psi, grid, (np.arange(5), closest_point, state), 1.0, keep)
    np.testing.assert_array_equal(keep, [True, False, True, False, False])


def test_front_mask_is_the_part_within_a_width():
    _, band, _ = scattered((5, 6, 7), 1)
    grid = reference.grid_of((5, 6, 7), (1.0, 1.0, 1.0))
    front = np.zeros(band.cells.size, bool)
    band_kernels.front_mask(0, band.cells.size, grid, band, 1.3, front)
    np.testing.assert_array_equal(front, np.linalg.norm(band.to_closest, axis=1) <= 1.3)
    assert 0 < front.sum() < front.size


@pytest.mark.parametrize("seed", range(5))
def test_merged_order_is_raster_order(seed):
    rng = np.random.default_rng(seed)
    selected = rng.permutation(200)[:90]
    n_old = int(rng.integers(0, 90))
    old, new = np.sort(selected[:n_old]), selected[n_old:]
    cells = np.concatenate([old, new])
    keep = rng.random(cells.size) < 0.6
    entered = n_old + np.flatnonzero(keep[n_old:])
    entered = entered[np.argsort(cells[entered])]
    order = band_kernels.merged_order(cells, n_old, keep, entered)
    np.testing.assert_array_equal(order, np.flatnonzero(keep)[np.argsort(cells[keep])])


def test_gather_keeps_signs_and_never_gives_zero():
    shape = (4, 5, 6)
    dense, old, _ = scattered(shape, 2)
    grid = reference.grid_of(shape, SPACING)
    old.to_closest[7] = 0
    order = np.random.default_rng(3).permutation(old.cells.size)[:30]
    order[4] = 7
    new = Band(
        np.full(30, -1), np.full(30, np.nan, np.float32), np.full((30, 3), np.nan, np.float32)
    )
    band_kernels.gather_band(0, 30, dense.psi, grid, order, old, new)
    np.testing.assert_array_equal(new.cells, old.cells[order])
    np.testing.assert_array_equal(new.to_closest, old.to_closest[order])
    lengths = np.linalg.norm(old.to_closest[order], axis=1)
    np.testing.assert_allclose(np.abs(new.psi), np.maximum(lengths, 0.7e-6), rtol=1e-6)
    np.testing.assert_array_equal(new.psi < 0, dense.psi[new.cells] < 0)
    assert new.psi[4] != 0


def sampled_by_the_reference(shape, present, values, cells, closest_point, old_slot):
    """What `sample_at_closest_points` should give: cubic where all nodes are ``present``, else linear, else the own
    value.
    """
    on_grid = np.zeros(shape, np.float32)
    on_grid[present] = values
    at = np.stack(np.unravel_index(cells, shape), axis=1) + closest_point.astype(float) / SPACING
    want, ways = np.empty(cells.size), []
    for s, cell in enumerate(cells):
        if reference.has_stencil(present, at[s]):
            want[s] = reference.interpolate(on_grid, np.clip(at[s], 0, np.array(shape) - 1.0))[0][0]
            ways.append("cubic")
        else:
            want[s], found = reference.known_linear(on_grid, present, at[s])
            if not found:
                want[s] = values[old_slot[cell]] if old_slot[cell] >= 0 else 0.0
            ways.append("linear" if found else "own")
    return want, ways


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fields", [1, 3])
@pytest.mark.parametrize("share", [0.3, 0.8, 0.99, 1.0])
@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 6), (3, 4, 5)])
def test_fields_are_sampled_at_the_closest_points(shape, share, fields):
    """Cubic in a full band; the known of the eight elsewhere; the own value where none is known.

    As after a march: the new band has cells that the old one had not, the slot map holds slots of cells that have come
    in since, in any order, and some old cells are gone.
    """
    dense, old, present = scattered(shape, 4, share)
    n_old = old.cells.size
    rng = np.random.default_rng(5)
    values = rng.standard_normal((fields, n_old)).astype(np.float32)
    old_slot = dense.slot.copy()
    entered = rng.permutation(np.flatnonzero(~present))
    dense.slot[entered] = n_old + np.arange(entered.size)
    cells = np.sort(np.concatenate([old.cells[rng.random(n_old) < 0.9], entered]))
    closest_point = (rng.uniform(-1, 1, (cells.size, 3)) * SPACING).astype(np.float32)
    closest_point[::7] = 0  # on nodes
    if shape[0] == 1:
        closest_point[:, 0] = 0
    new = Band(cells, np.linalg.norm(closest_point, axis=1).astype(np.float32), closest_point)
    out = np.full((fields, cells.size), np.nan, np.float32)
    front = rng.random(cells.size) < 0.9
    band_kernels.sample_at_closest_points(
        0, cells.size, dense.slot, reference.grid_of(shape, SPACING), new, front, values, out
    )
    for field in range(fields):
        want, ways = sampled_by_the_reference(
            shape, present, values[field], cells, closest_point, old_slot
        )
        np.testing.assert_allclose(out[field, front], want[front], rtol=0, atol=2e-5)
        assert np.isnan(out[field, ~front]).all()
    if min(shape) > 4:
        assert ("cubic" in ways) == (share > 0.9)
        assert share > 0.5 or "own" in ways
    if share == 1:
        assert set(ways) == {"cubic"}


def test_fields_sampled_are_the_same_bytes_alone_and_together_and_in_any_range():
    shape = (7, 9, 8)
    dense, band, _ = scattered(shape, 6, share=0.995)
    n, grid = band.cells.size, reference.grid_of(shape, SPACING)
    values = np.random.default_rng(7).standard_normal((3, n)).astype(np.float32)
    whole, parts = np.full((3, n), np.nan, np.float32), np.full((3, n), np.nan, np.float32)
    front = np.ones(n, np.bool_)
    band_kernels.sample_at_closest_points(0, n, dense.slot, grid, band, front, values, whole)
    assert np.isfinite(whole).all()
    for start, stop in ((0, 1), (1, 200), (200, n - 3), (n - 3, n)):
        band_kernels.sample_at_closest_points(
            start, stop, dense.slot, grid, band, front, values, parts
        )
        assert np.isfinite(parts[:, start:stop]).all() and np.isnan(parts[:, stop:]).all()
    np.testing.assert_array_equal(parts, whole)
    for field in range(3):
        alone = np.empty((1, n), np.float32)
        band_kernels.sample_at_closest_points(
            0, n, dense.slot, grid, band, front, values[field : field + 1], alone
        )
        np.testing.assert_array_equal(alone[0], whole[field])


def extended(dense, grid, band, front, values):
    """``values`` after `extend_outwards` by a fresh `outward_table`, and the table: as a level set does it."""
    off = np.flatnonzero(~front).astype(np.int32)
    slots, shares = np.full((off.size, 8), -1, np.int32), np.full((off.size, 8), np.nan, np.float32)
    band_kernels.outward_table(0, off.size, dense.slot, grid, band, front, off, (slots, shares))
    out = values.copy()
    band_kernels.extend_outwards(0, off.size, off, slots, shares, out)
    return out, off, slots, shares


@pytest.mark.sampled(4)
@pytest.mark.parametrize("on_front", [0.5, 0.1, 0.0, 1.0])
@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 6), (3, 1, 4)])
def test_extension_replaces_values_off_the_front_only(shape, on_front):
    dense, band, present = scattered(shape, 7, share=0.7)
    n = band.cells.size
    rng = np.random.default_rng(8)
    before = rng.standard_normal(n).astype(np.float32)
    front = rng.random(n) < on_front
    values, off, slots, shares = extended(
        dense, reference.grid_of(shape, SPACING), band, front, before
    )
    np.testing.assert_array_equal(values[front], before[front])
    on_grid, is_front = np.zeros(shape, np.float32), np.zeros(shape, bool)
    on_grid[present], is_front[present] = before, front
    at = np.argwhere(present) + band.to_closest.astype(float) / SPACING
    found = np.zeros(off.size, bool)
    for row, s in enumerate(off):
        want, found[row] = reference.known_linear(on_grid, is_front, at[s])
        assert values[s] == pytest.approx(want if found[row] else 0.0, abs=2e-5)
    # The table: front cells with weights of sum 1, and where none counts the cell itself with weight 0.
    assert front[slots[shares > 0]].all()
    assert (slots[shares == 0] == np.repeat(off, 8).reshape(-1, 8)[shares == 0]).all()
    assert (shares >= 0).all()
    np.testing.assert_allclose(shares.sum(axis=1, dtype=float), found, atol=1e-6)
    assert found.any() == (0 < on_front < 1) or n < 20


def quadratic_table(dense, grid, band, front, across=-1):
    off = np.flatnonzero(~front).astype(np.int32)
    slots, shares = (
        np.full((off.size, 10), -1, np.int32),
        np.full((off.size, 10), np.nan, np.float32),
    )
    table = slots, shares, np.full(off.size, -1, np.int8)
    # Rows as if the whole band had one.
    row_of = np.where(front, np.arange(front.size), -1).astype(np.int32)
    band_kernels.quadratic_table(0, off.size, dense.slot, grid, band, row_of, off, across, table)
    return off, slots, shares


@pytest.mark.sampled(1)
@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (9, 1, 9)])
def test_quadratic_extension_is_exact_for_quadratics_away_from_the_border(shape):
    """In a complete band where one cell after the other is off the front, and the ten nodes around its closest point
    are not.
    """
    rng, last = np.random.default_rng(16), np.array(shape) - 1.0
    closest_point = rng.uniform(-2.4, 2.4, (int(np.prod(shape)), 3)) * SPACING * (last > 0)
    dense, band = reference.whole_band(np.ones(shape), closest_point)
    front = np.ones(closest_point.shape[0], bool)
    index = np.argwhere(np.ones(shape, bool))
    at = index + closest_point / SPACING
    a, b = (
        rng.standard_normal((3, 3)) * np.outer(last > 0, last > 0),
        rng.standard_normal(3) * (last > 0),
    )

    def quadratic(p):
        return np.einsum("ni,ij,nj->n", p, a, p) + p @ b + 1.0

    values = quadratic(index.astype(float)).astype(np.float32)
    tested = 0
    for s in range(front.size):
        nearest = np.floor(at[s] + 0.5)
        inner = np.all((nearest >= 1) & (nearest <= last - 1) | (last == 0))
        if not inner or np.abs(index[s] - nearest).max() < 2:
            continue
        front[s] = False
        off, slots, shares = quadratic_table(dense, reference.grid_of(shape, SPACING), band, front)
        front[s] = True
        got = values.copy()
        band_kernels.extend_quadratically(0, 1, off, slots, shares, got)
        assert got[s] == pytest.approx(quadratic(at[s][None])[0], abs=2e-3)
        tested += 1
    assert tested > 3


@pytest.mark.sampled
@pytest.mark.parametrize("share", [1.0, 0.6])
@pytest.mark.parametrize(
    ("axis", "across"), [(0, -1), (1, -1), (2, -1), (0, 0), (1, 1), (2, 2), (1, 2)]
)
def test_quadratic_extension_at_the_border_is_that_of_the_mirrored_whole(axis, across, share):
    """A part of the front is missing (``share``), as in the mirror; a component through it changes sign."""
    rng, shape = np.random.default_rng(18), [5, 6, 7]
    index = np.argwhere(np.ones(shape, bool))
    closest_point = rng.uniform(-1.4, 1.4, (len(index), 3))
    # Up to the face, half a voxel beyond the centres.
    closest_point = np.clip(index + closest_point, -0.5, np.array(shape) - 0.5) - index
    front = rng.random(len(index)) < 0.7 * share
    values = rng.standard_normal(len(index)).astype(np.float32)
    sign = -1.0 if axis == across else 1.0

    def doubled(field, factor):
        field = field.reshape(*shape, -1)
        return np.concatenate([factor * np.flip(field, axis), field], axis).reshape(
            -1, field.shape[-1]
        )

    turn = np.where(np.arange(3) == axis, -1.0, 1.0)
    wide = [n * (2 if a == axis else 1) for a, n in enumerate(shape)]
    whole = (doubled(closest_point, turn) * SPACING, doubled(front, 1) != 0, doubled(values, sign))
    found = []
    for size, closest_points, on, field in (
        (shape, closest_point * SPACING, front, values),
        (wide, *whole),
    ):
        dense, band = reference.whole_band(np.ones(size), closest_points)
        off, slots, shares = quadratic_table(
            dense, reference.grid_of(size, SPACING), band, on.ravel(), across
        )
        got = field.ravel().astype(np.float32)
        band_kernels.extend_quadratically(0, off.size, off, slots, shares, got)
        found.append(got.reshape(size))
    there = [slice(None)] * 3
    there[axis] = slice(shape[axis], None)
    np.testing.assert_allclose(found[0], found[1][tuple(there)], atol=2e-5)


@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 6)])
def test_quadratic_extension_is_linear_where_a_node_is_missing(shape):
    """By the nodes that are on the front, with weights of sum 1 or 0; a constant stays one."""
    dense, band, present = scattered(shape, 7, share=0.7)
    rng, grid = np.random.default_rng(17), reference.grid_of(shape, SPACING)
    front = rng.random(band.cells.size) < 0.4
    off, slots, shares = quadratic_table(dense, grid, band, front)
    assert ((slots >= 0) & (slots < band.cells.size)).all() and front[slots[shares != 0]].all()
    total = shares.sum(axis=1, dtype=float)
    assert (np.isclose(total, 1.0, atol=1e-5) | (total == 0.0)).all()
    on_grid, is_front = np.zeros(shape, np.float32), np.zeros(shape, bool)
    values = rng.standard_normal(front.size).astype(np.float32)
    on_grid[present], is_front[present] = values, front
    at = np.clip(
        np.argwhere(present) + band.to_closest.astype(float) / SPACING, 0, np.array(shape) - 1.0
    )
    got = values.copy()
    band_kernels.extend_quadratically(0, off.size, off, slots, shares, got)
    linear = (shares >= 0).all(axis=1) & (shares[:, 8:] == 0).all(axis=1)
    assert linear.sum() > 0.5 * off.size
    for s in off[linear]:
        want, found = reference.known_linear(on_grid, is_front, at[s])
        assert got[s] == pytest.approx(want if found else 0.0, abs=2e-5)


def test_extension_of_one_field_by_the_table_of_another():
    """The table knows nothing of values: kept for the next field with the same mask."""
    shape = (5, 6, 7)
    dense, band, _ = scattered(shape, 9)
    grid, n = reference.grid_of(shape, SPACING), band.cells.size
    rng = np.random.default_rng(10)
    front = rng.random(n) < 0.4
    one, other = rng.standard_normal((2, n)).astype(np.float32)
    _, off, slots, shares = extended(dense, grid, band, front, one)
    got = other.copy()
    band_kernels.extend_outwards(0, off.size, off, slots, shares, got)
    np.testing.assert_array_equal(got, extended(dense, grid, band, front, other)[0])


def test_nan_off_the_front_does_not_reach_the_extension():
    dense, band, _ = scattered((5, 6, 7), 11)
    n = band.cells.size
    front = np.random.default_rng(12).random(n) < 0.3
    values = np.where(front, 2, np.nan).astype(np.float32)
    got, *_ = extended(dense, reference.grid_of((5, 6, 7), SPACING), band, front, values)
    assert set(np.round(got, 5)) == {0, 2}


def test_extension_only_in_its_range():
    dense, band, _ = scattered((5, 6, 7), 13)
    grid, n = reference.grid_of((5, 6, 7), SPACING), band.cells.size
    front = np.random.default_rng(14).random(n) < 0.5
    off = np.flatnonzero(~front).astype(np.int32)
    slots, shares = np.full((off.size, 8), -9, np.int32), np.full((off.size, 8), -9, np.float32)
    band_kernels.outward_table(10, 25, dense.slot, grid, band, front, off, (slots, shares))
    for array in (slots, shares):
        assert (array[:10] == -9).all() and (array[25:] == -9).all() and (array[10:25] >= 0).all()
    values = np.random.default_rng(15).standard_normal(n).astype(np.float32)
    before = values.copy()
    band_kernels.extend_outwards(12, 20, off, slots, shares, values)
    np.testing.assert_array_equal(np.delete(values, off[12:20]), np.delete(before, off[12:20]))
    assert (values[off[12:20]] != before[off[12:20]]).all()


def test_dropped_cells_leave_the_dense_arrays_and_stored_ones_enter():
    dense, band, _ = scattered((4, 5, 6), 9)
    n = band.cells.size
    keep = np.random.default_rng(10).random(n) < 0.5
    before = dense.psi.copy()
    band_kernels.drop_cells(0, n, dense, band.cells, keep, np.float32(7.5))
    gone = band.cells[~keep]
    np.testing.assert_array_equal(dense.slot[gone], -1)
    np.testing.assert_array_equal(dense.psi[gone], np.where(before[gone] < 0, -7.5, 7.5))
    rest = np.setdiff1d(np.arange(before.size), gone)
    np.testing.assert_array_equal(dense.psi[rest], before[rest])
    new = Band(np.array([0, 5, 17]), np.array([1, -2, 3], np.float32), np.zeros((3, 3), np.float32))
    band_kernels.store_band(1, 3, dense, new)
    assert dense.slot[5] == 1 and dense.slot[17] == 2
    assert dense.psi[5] == -2 and dense.psi[17] == 3
    assert dense.psi[0] == before[0] or dense.psi[0] in (-7.5, 7.5)
