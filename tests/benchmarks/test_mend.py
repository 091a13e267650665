"""The benchmark of mending: masks that are made worse, and how clicks are counted."""

import numpy as np
import pytest

from benchmarks.mend import WORSE, dice, needed, surface_distance

SPACING = (2.0, 1.0, 1.0)


def ball():
    z, y, x = np.indices((18, 36, 36)) * np.array(SPACING)[:, None, None, None]
    return (z - 18) ** 2 + (y - 18) ** 2 + (x - 18) ** 2 < 9**2


@pytest.mark.parametrize("way", [way for way in WORSE if way != "right"])
def test_a_worse_mask_is_worse_and_the_same_each_time(way):
    truth = ball()
    first, again = (WORSE[way](truth, SPACING, np.random.default_rng(3)) for _ in range(2))
    assert first.shape == truth.shape and np.array_equal(first, again)
    assert 0.3 < dice(first, truth) < 0.99 and surface_distance(first, truth, SPACING) > 0


def test_the_right_mask_has_no_distance():
    assert dice(ball(), ball()) == 1.0 and surface_distance(ball(), ball(), SPACING) == 0.0


def test_clicks_are_counted_from_what_was_there_before():
    assert needed([0.8, 0.91, 0.96], 0.9) == 1 and needed([0.8, 0.91], 0.95) is None
    assert needed([0.92], 0.9, first=1) == 1
