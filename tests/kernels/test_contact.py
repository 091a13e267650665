"""Places where a surface touches another one, and cells of both grids, against SciPy and numpy."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.kernels.components import shared_cells, touching
from accelsurf.kernels.grid import DenseArrays, Grid

pytestmark = pytest.mark.nojit


@pytest.mark.parametrize("shape", [(5, 6, 7), (1, 6, 5), (3, 1, 4), (2, 2, 2)])
def test_places_that_touch_are_those_of_a_plain_look(shape):
    rng = np.random.default_rng(sum(shape))
    psi = rng.normal(0.5, 1.0, shape).astype(np.float32)
    slot = np.where(rng.random(shape) < 0.7, np.arange(psi.size).reshape(shape), -1).astype(
        np.int32
    )
    corner, reach, width = np.array([4.0, -2.0, 1.0]), 2.0, 1.5
    points = rng.uniform(-4.0, np.array(shape) + 4.0, (400, 3)) + corner
    points[:8] = rng.integers(0, shape, (8, 3)) + corner  # on voxels, and on the border
    grid = Grid(*shape, 1.0, 1.0, 1.0)
    near, slots, share = touching(
        points, DenseArrays(psi.ravel(), slot.ravel()), grid, corner, reach, width
    )
    place = points - corner
    within = np.clip(place, 0, np.array(shape) - 1)
    expected = np.flatnonzero((np.abs(place - within) <= reach).all(axis=1))
    theirs = slot[tuple(np.rint(within[expected]).astype(int).T)]
    gap = ndimage.map_coordinates(
        psi.astype(np.float64), within[expected].T, order=1, mode="nearest"
    )
    wanted = np.clip(1.0 - gap / width, 0.0, 1.0)
    there = (theirs >= 0) & (wanted > 1e-6)
    assert there.any() and not there.all()
    assert np.array_equal(near, expected[there]) and np.array_equal(slots, theirs[there])
    np.testing.assert_allclose(share, wanted[there], atol=1e-5)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shift", [(0, 0, 0), (1, -2, 3), (-1, 0, -4), (9, 0, 0)])
def test_cells_of_both_grids(shift):
    rng = np.random.default_rng(1)
    shape, other = (4, 5, 6), (3, 4, 5)
    psi = rng.normal(size=other).astype(np.float32)
    cells = np.sort(rng.choice(120, 60, replace=False)).astype(np.int64)
    on, values = shared_cells(
        cells, Grid(*shape, 1, 1, 1), psi.ravel(), Grid(*other, 1, 1, 1), np.array(shift)
    )
    place = np.stack(np.unravel_index(cells, shape), axis=1) + shift
    inside = ((place >= 0) & (place < other)).all(axis=1)
    assert np.array_equal(on, np.flatnonzero(inside))
    assert np.array_equal(values, psi[tuple(place[inside].T)])
