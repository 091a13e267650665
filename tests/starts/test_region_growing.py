"""Region growing from a seed."""

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.starts.region_growing import grow_region


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_seed_between_two_voxels_is_the_same_from_either_side(axis):
    values = np.random.default_rng(3).normal(size=(12, 13, 14))
    centre = [5.5, 6.5, 6.0]
    one = grow_region(values, Geometry(values.shape, (1.0, 1.2, 0.9)), tuple(centre), 4.0)
    centre[axis] = values.shape[axis] - 1 - centre[axis]
    flipped = np.flip(values, axis)
    other = grow_region(flipped, Geometry(values.shape, (1.0, 1.2, 0.9)), tuple(centre), 4.0)
    assert one.any()
    np.testing.assert_array_equal(one, np.flip(other, axis))
