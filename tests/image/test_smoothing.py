"""The Gaussian's width is in mm on every grid, and it does nothing across a single slice."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.image.smoothing import gaussian_mm, gradient_magnitude


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.7, 1.0, 1.3)])
def test_a_point_becomes_as_wide_as_sigma(spacing):
    image, sigma = np.zeros((41, 41, 41), np.float32), 3.0
    image[20, 20, 20] = 1
    smooth = gaussian_mm(image, spacing, sigma)
    assert smooth.dtype == np.float32 and smooth.sum() == pytest.approx(1, rel=1e-5)
    for axis, h in enumerate(spacing):
        profile = smooth.sum(axis=tuple(other for other in range(3) if other != axis))
        assert (profile * ((np.arange(41) - 20) * h) ** 2).sum() == pytest.approx(
            sigma**2, rel=0.02
        )


def test_a_single_slice_is_smoothed_within_itself():
    image = np.random.default_rng(1).random((1, 30, 20)).astype(np.float32)
    thin, thick = (gaussian_mm(image, (h, 1.0, 2.0), 1.5) for h in (0.1, 50.0))
    np.testing.assert_array_equal(thin, thick)
    stack = gaussian_mm(np.repeat(image, 9, axis=0), (1.0, 1.0, 2.0), 1.5)
    np.testing.assert_allclose(stack[4], thin[0], atol=1e-6)


def test_beyond_the_border_the_image_is_mirrored():
    ramp = np.tile(np.arange(20, dtype=np.float32), (1, 5, 1))
    smooth = gaussian_mm(ramp, (1.0, 1.0, 1.0), 2.0)
    # As in the middle of the image with its mirror image before it.
    both = gaussian_mm(np.concatenate([ramp[..., ::-1], ramp], axis=2), (1.0, 1.0, 1.0), 2.0)
    np.testing.assert_allclose(smooth[..., :10], both[..., 20:30], atol=1e-5)
    np.testing.assert_allclose(smooth.mean(), ramp.mean(), rtol=1e-6)


def test_the_image_is_not_changed():
    image = np.random.default_rng(2).random((5, 6, 7)).astype(np.float32)
    before = image.copy()
    assert gaussian_mm(image, (1.0, 1.0, 1.0), 0.0) is not image
    gaussian_mm(image, (1.0, 1.0, 1.0), 2.0)
    np.testing.assert_array_equal(image, before)


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [(9, 14, 11), (1, 30, 17), (3, 2, 40)])
@pytest.mark.parametrize("sigma", [0.0, 0.6, 1.3, 4.0])
def test_it_is_scipy_s_gaussian(shape, sigma):
    image = np.random.default_rng(3).normal(size=shape).astype(np.float32)
    spacing = (2.0, 1.0, 0.8)
    widths = [sigma / h if n > 1 else 0.0 for n, h in zip(shape, spacing, strict=True)]
    expected = ndimage.gaussian_filter(image, widths, output=np.float32, mode="reflect")
    np.testing.assert_allclose(gaussian_mm(image, spacing, sigma), expected, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(
        gaussian_mm(np.asfortranarray(image), spacing, sigma), gaussian_mm(image, spacing, sigma)
    )


def test_gradients_are_per_mm_at_any_scale():
    """Of a ramp: exact inside, whatever the spacings, also for a Gaussian far narrower than a voxel."""
    z, y, x = np.meshgrid(
        np.arange(12) * 3.0, np.arange(30) * 1.0, np.arange(40) * 0.5, indexing="ij"
    )
    for scale in (0.3, 1.0):
        got = gradient_magnitude(0.2 * z - 0.1 * y + 0.05 * x, (3.0, 1.0, 0.5), scale)
        np.testing.assert_allclose(got[2:-2, 5:-5, 9:-9], np.sqrt(0.04 + 0.01 + 0.0025), rtol=1e-4)


def test_a_single_slice_has_no_slope_across():
    image = np.random.default_rng(1).normal(size=(1, 20, 22))
    one = gradient_magnitude(image, (5.0, 1.0, 0.8), 1.5)
    many = gradient_magnitude(np.repeat(image, 9, axis=0), (5.0, 1.0, 0.8), 1.5)
    np.testing.assert_allclose(one[0], many[4], rtol=1e-5)
