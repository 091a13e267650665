"""The dilation that a closing is made of, against scipy.ndimage and its plain definition."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.image.filters import closed_mm, lines_of_ball
from accelsurf.image.kernels.smoothing import dilate


def footprint(spacing, radius):
    reach = [int(radius / h) for h in spacing]
    axes = np.ogrid[tuple(slice(-n, n + 1) for n in reach)]
    return sum((axis * h) ** 2 for axis, h in zip(axes, spacing, strict=True)) <= radius**2


@pytest.mark.parametrize(
    ("shape", "spacing", "radius"),
    [
        ((7, 9, 11), (1.0, 1.0, 1.0), 2.0),
        ((5, 12, 8), (2.5, 0.7, 1.1), 3.0),
        ((1, 9, 13), (4.0, 1.0, 0.5), 1.5),
        ((3, 4, 2), (1.0, 1.0, 1.0), 5.0),
        ((6, 5, 7), (2.0, 2.0, 2.0), 1.9),
    ],
)
def test_it_is_the_largest_value_in_the_ball(shape, spacing, radius):
    values = np.random.default_rng(3).normal(size=shape).astype(np.float32)
    out = np.full(shape, np.nan, np.float32)
    dilate(values, lines_of_ball(spacing, radius), out)
    expected = ndimage.maximum_filter(
        values, footprint=footprint(spacing, radius), mode="constant", cval=-np.inf
    )
    np.testing.assert_array_equal(out, expected)
    closed = ndimage.minimum_filter(
        expected, footprint=footprint(spacing, radius), mode="constant", cval=np.inf
    )
    np.testing.assert_array_equal(closed_mm(values, spacing, radius), closed)


def test_the_lines_are_the_ball():
    spacing, radius = (2.0, 0.7, 1.1), 4.0
    marked = np.zeros_like(footprint(spacing, radius))
    middle = [n // 2 for n in marked.shape]
    for z, y, half in lines_of_ball(spacing, radius):
        marked[middle[0] + z, middle[1] + y, middle[2] - half : middle[2] + half + 1] = True
    np.testing.assert_array_equal(marked, footprint(spacing, radius))
