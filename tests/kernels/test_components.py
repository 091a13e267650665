"""Small components: which are found, removed and counted, and which stay."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.kernels import band as band_kernels
from accelsurf.kernels import components
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)


def islands(shape, sizes, seed):
    """psi of +1 with 6-connected random islands of -1 of given sizes, no two touching, none around a lake."""
    rng = np.random.default_rng(seed)
    label = np.zeros(shape, int)
    for number, size in enumerate(sizes, start=1):
        while True:
            grown = np.zeros(shape, bool)
            free = ~ndimage.binary_dilation(label > 0)
            grown[tuple(rng.choice(np.argwhere(free)))] = True
            while grown.sum() < size:
                edge = ndimage.binary_dilation(grown) & ~grown & free
                if not edge.any():
                    break
                grown[tuple(rng.choice(np.argwhere(edge)))] = True
            if grown.sum() == size and ndimage.label(~grown & (label == 0))[1] == 1:
                break
        label[grown] = number
    return np.where(label > 0, -1.0, 1.0), label


def remove_components(dense, grid, band, most, depth, held=()):
    peak = np.zeros(band.cells.size, np.bool_)
    # In two ranges, as two threads would.
    for start, stop in ((0, 100), (100, band.cells.size)):
        components.find_peaks(start, stop, dense, grid, band, depth, peak)
    turned, before = np.zeros(band.cells.size, np.bool_), dense.psi[band.cells] < 0
    cells = np.array(held, np.int64)
    found = components.small_components(
        dense, grid, band, np.flatnonzero(peak), most, cells, turned
    )
    np.testing.assert_array_equal(turned, before != (dense.psi[band.cells] < 0))
    return found


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shape", [(9, 10, 11), (1, 19, 31)])
def test_components_are_removed_up_to_the_size_and_counted(shape, sign):
    """Islands of 1 to 20 cells, some at the border; limit 14."""
    psi, label = islands(shape, [1, 2, 5, 13, 14, 15, 20], 11)
    # A distance within each island, as after redistancing: unequal values, the deepest no neighbour exceeds.
    inside = ndimage.distance_transform_edt(label > 0)
    psi = (
        sign
        * np.where(label > 0, -(inside - 0.5), psi)
        * (1 + 0.1 * np.random.default_rng(12).random(shape))
    )
    dense, band = reference.whole_band(psi)
    want, removed_inside, removed_outside = reference.small_components(dense.psi.reshape(shape), 14)
    grid = reference.grid_of(shape, (1.0, 1.0, 1.0))
    got = remove_components(dense, grid, band, 14, 2.0)
    assert (removed_inside, removed_outside) == ((5, 0) if sign == 1 else (0, 5))
    assert got == (removed_inside, removed_outside, 35)
    np.testing.assert_array_equal(dense.psi.reshape(shape), want)


def test_deep_cells_are_not_searched_and_nothing_happens_to_large_components():
    psi = reference.smooth_noise((9, 10, 11), 13, 2.0)
    dense, band = reference.whole_band(psi)
    before = dense.psi.copy()
    want, inside, outside = reference.small_components(before.reshape(psi.shape), 14)
    grid = reference.grid_of(psi.shape, SPACING)
    assert remove_components(dense, grid, band, 14, 1e9)[:2] == (inside, outside)
    np.testing.assert_array_equal(dense.psi.reshape(psi.shape), want)
    lone = np.ones((5, 5, 5), np.float32)
    lone[2, 2, 2] = -3
    dense, band = reference.whole_band(lone)
    grid = reference.grid_of(lone.shape, SPACING)
    assert remove_components(dense, grid, band, 14, 2.0) == (0, 0, 0)
    assert remove_components(dense, grid, band, 14, 4.0) == (1, 0, 1)


def test_flood_gives_up_beyond_its_room():
    psi = -np.ones((3, 4, 5), np.float32)
    grid = reference.grid_of(psi.shape, SPACING)
    near = np.empty(6, np.int64)
    flood = np.empty(8, np.int64)
    assert components.flood_component(psi.ravel(), grid, 22, True, flood, near) == 9
    flood = np.empty(60, np.int64)
    assert components.flood_component(psi.ravel(), grid, 22, True, flood, near) == 60
    assert sorted(flood) == list(range(60))


def test_beyond_the_band_psi_is_flat():
    psi = reference.smooth_noise((5, 6, 7), 31)
    psi.ravel()[:2] = 0.0, -0.0
    dense, _ = reference.whole_band(psi)
    dense.slot[np.random.default_rng(32).permutation(psi.size)[:150]] = -1
    dense.slot[:2] = -1
    gamma, start, stop = np.float32(2.5), 1, psi.size - 9
    band_kernels.flatten_beyond(start, stop, dense, gamma)
    want = psi.ravel().copy()
    beyond = np.flatnonzero(dense.slot < 0)
    beyond = beyond[(beyond >= start) & (beyond < stop)]
    want[beyond] = np.where(want[beyond] < 0, -gamma, gamma)
    np.testing.assert_array_equal(dense.psi, want)
