"""What a click on a large object leaves out changes no byte."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.energies.seeded.appearance import learn
from accelsurf.energies.seeded.contest import arrival, field_of
from accelsurf.energies.seeded.edge import _seen_both
from accelsurf.energies.seeded.model import BEYOND, LATER, later_times, seeded_model
from accelsurf.grid.clicks import Clicks
from tests.support import clicked_balls

SPACING, SHAPE = (1.5, 1.0, 0.8), (16, 24, 28)


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [(1, 20, 31), (2, 5, 3), (33, 17, 8), (24, 1, 40), (7, 9, 30)])
@pytest.mark.parametrize("size", [3, 5, 9])
def test_both_sides_are_seen_as_by_filters(shape: tuple[int, int, int], size: int) -> None:
    for share in (0.02, 0.5, 0.98):
        inside = np.random.default_rng(size).random(shape) < share
        sizes = [size if n > 1 else 1 for n in shape]
        values = inside.view(np.uint8)
        expected = ndimage.maximum_filter(values, sizes) != ndimage.minimum_filter(values, sizes)
        before = inside.copy()
        assert np.array_equal(_seen_both(inside, size), expected)
        assert np.array_equal(inside, before)


def test_later_times_are_those_of_a_sorted_march() -> None:
    noise = np.random.default_rng(1).normal(0, 0.2, SHAPE)
    image = ((clicked_balls.distance((8, 12, 14), SHAPE, SPACING) < 6) + noise).astype(np.float32)
    first = clicked_balls.ball("inside", (8, 12, 14), 2.0, SHAPE, SPACING)
    later = clicked_balls.ball("outside", (8, 12, 23), 1.0, SHAPE, SPACING)
    model = seeded_model([image], SPACING, Clicks((first,), SHAPE))
    assert model.answer is not None
    field, answer = field_of([image], SPACING, None), model.answer
    seeds = np.flatnonzero(later.mask_on(tuple(slice(0, n) for n in SHAPE)))
    times, order = arrival(field, learn([image], SPACING, later), seeds, int(1.05 * BEYOND * answer.count))
    assert np.all(np.diff(times[order]) >= 0)
    own = float(times[order[min(answer.count, len(order)) - 1]])
    times[order] *= np.float32(LATER["outside"] * answer.level / own)
    found = later_times(field, learn([image], SPACING, later), later, answer)
    assert np.array_equal(found, times)
