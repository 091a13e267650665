"""Measures of quality do not depend on where the grid of an object begins."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.measure import evidence

SPACING = (1.2, 0.7, 0.9)


@pytest.mark.parametrize("before", [(1, 2, 3), (5, 3, 7), (11, 13, 17)])
def test_a_grid_that_begins_earlier_changes_no_bit_of_the_evidence(before):
    rng = np.random.default_rng(4)
    inside = ndimage.gaussian_filter(rng.normal(size=(40, 44, 48)), 5) > 0.02
    inside &= np.linalg.norm((np.indices(inside.shape).T - [20, 22, 24]).T, axis=0) < 12
    image = inside + rng.normal(0, 0.3, inside.shape).astype(np.float32)
    clicked = np.zeros(inside.shape, bool)
    clicked[20, 22, 24:27] = True
    found = []
    for pad in ((0, 0, 0), before):
        widths = [(n, 0) for n in pad]
        one = evidence.gather_evidence(
            *(np.pad(a, widths) for a in (inside, image)), SPACING, np.pad(clicked, widths)
        )
        place, share = evidence.uncertain_places(one, SPACING, 900.0)[0]
        found.append(
            (tuple(np.subtract(place, pad)), share, one.click.tobytes(), one.total.tobytes())
        )
    assert found[0] == found[1]
