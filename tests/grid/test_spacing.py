"""Spacings of the axes that count, and a Gaussian in mm."""

import numpy as np
import pytest

from accelsurf.grid.smoothing import gaussian_smoothed
from accelsurf.grid.spacing import counted_spacings, largest_spacing, smallest_spacing


@pytest.mark.parametrize(
    ("shape", "counted"), [((4, 5, 6), (3.0, 0.5, 0.7)), ((1, 5, 6), (0.5, 0.7)), ((4, 1, 1), (3.0,)), ((1, 1, 1), ())]
)
def test_an_axis_of_one_slice_does_not_count(shape, counted):
    spacing = (3, 0.5, 0.7)
    assert counted_spacings(shape, spacing) == counted
    assert smallest_spacing(shape, spacing) == min(counted or (1.0,))
    assert largest_spacing(shape, spacing) == max(counted or (1.0,))


def test_the_gaussian_is_as_wide_in_mm_along_every_axis():
    spacing, sigma = (2.0, 1.0, 0.5), 3.0
    image = np.zeros((41, 61, 101))
    image[20, 30, 50] = 1
    out = gaussian_smoothed(image, spacing, sigma)
    assert out.dtype == np.float32 and out.sum() == pytest.approx(1, abs=1e-3)
    for axis, h in enumerate(spacing):
        along = out.sum(axis=tuple(a for a in range(3) if a != axis))
        place = (np.arange(along.size) - along.size // 2) * h
        assert np.sqrt((along * place**2).sum()) == pytest.approx(sigma, rel=0.02)


def test_the_gaussian_leaves_an_axis_of_one_slice_and_the_image_alone():
    image = np.random.default_rng(1).normal(size=(1, 20, 20)).astype(np.float32)
    before = image.copy()
    thin, thick = (gaussian_smoothed(image, (h, 1.0, 1.0), 2.0) for h in (0.1, 10.0))
    np.testing.assert_array_equal(thin, thick)
    np.testing.assert_array_equal(image, before)
    assert thin.std() < 0.5 * image.std()
