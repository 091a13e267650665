"""Distances over short windows: against SciPy's exact transform."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.clicks.kernels.distance import distances_within


@pytest.mark.parametrize(
    "shape, spacing, reach",
    [
        ((12, 17, 23), (1.0, 1.0, 1.0), 6.0),
        ((9, 20, 21), (2.5, 0.7, 0.9765625), 5.0),
        ((1, 30, 31), (4.0, 0.8, 1.1), 4.0),
    ],
)
def test_distances_are_scipy_s_as_far_as_asked(shape, spacing, reach):
    marked = np.random.default_rng(5).random(shape) < 0.004
    marked[0, 3, 4] = True
    exact = ndimage.distance_transform_edt(~marked, spacing)
    found = distances_within(marked, spacing, reach)
    near = exact <= reach
    assert near.any() and not near.all()
    np.testing.assert_array_equal(np.isfinite(found), near)
    np.testing.assert_allclose(found[near], exact[near], rtol=1e-6)


def test_a_voxel_at_the_reach_itself_is_found_and_the_next_is_not():
    marked = np.zeros((1, 1, 40), bool)
    marked[0, 0, 5] = True
    found = distances_within(marked, (1.0, 1.0, 0.1), 12 * 0.1)
    assert np.isfinite(found[0, 0, :18]).all() and np.isinf(found[0, 0, 18:]).all()


def test_without_marked_voxels_nothing_is_near():
    assert np.isinf(distances_within(np.zeros((3, 4, 5), bool), (1.0, 1.0, 1.0), 9.0)).all()
