"""Places in a window, as the whole grid gives them."""

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window


def test_a_place_on_a_coarser_level_stays_at_half_a_voxel_and_has_the_bits_of_the_whole():
    whole = Geometry((40, 50, 60), (1.2, 0.7, 0.9), (0.1, -30.3, 7.7))
    window = Window(whole, (slice(8, 30), slice(4, 40), slice(12, 50)))
    x, y, z = whole.index_to_world(np.array([8.0, 4.0, 12.0])).tolist()
    part = Geometry(window.shape, whole.spacing, (x, y, z))
    for index in np.random.default_rng(0).integers(0, 40, (200, 3)) / 2.0:
        own = window.place_on_whole(part.index_to_world(index))
        assert own == tuple(whole.index_to_world(index + window.corner).tolist())
