"""Where the surface grew in the last part of its run."""

import numpy as np
import pytest

from accelsurf.segmentation.api import segment, segment_objects


def dumbbell():
    """A ball with a long arm: the far end of the arm is reached last."""
    z, y, x = np.indices((28, 28, 64))
    ball = (x - 14) ** 2 + (y - 14) ** 2 + (z - 14) ** 2 < 9**2
    arm = ((y - 14) ** 2 + (z - 14) ** 2 < 4**2) & (x > 14) & (x < 56)
    return (100.0 * (ball | arm)).astype(np.float32)


@pytest.mark.parametrize(("mask", "levels"), [(False, 1), (True, 1), (True, 2)])
def test_it_is_the_far_end_of_what_was_filled_last(mask, levels):
    image = dumbbell()
    region = np.zeros(image.shape, bool)
    region[3:, 4:, 2:] = True
    options = {"mask": region} if mask else {}
    result = segment(image, start="ball:14,14,14,5", levels=levels, smoothness=0.05, **options)
    assert result.labels[14, 14, 54]  # it has got there
    z, y, x = result.late_growth
    assert x > 40 and abs(y - 14) < 7 and abs(z - 14) < 7


def test_of_several_objects_it_is_where_any_grew_most():
    image = dumbbell()
    starts = np.zeros(image.shape, int)
    starts[11:18, 11:18, 11:18] = 4
    result = segment_objects(image, starts, levels=1, smoothness=0.05)
    assert result.late_growth[2] > 40


def test_there_is_none_where_nothing_grew():
    image = dumbbell()
    assert segment(image, start="ball:14,14,14,5", max_steps=0).late_growth is None
