"""The noise of an image, and the area weight that follows from it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from accelsurf.image.noise import WEIGHT, area_for_noise, noise_of


def objects(shape, seed, noise):
    """Edges, a ramp, and white noise."""
    z, y, x = np.indices(shape)
    image = 3.0 * ((z // 20 + y // 22 + x // 21) % 2) + 0.2 * x
    return (image + np.random.default_rng(seed).normal(0, noise, shape)).astype(np.float32)


@pytest.mark.parametrize("shape", [(40, 44, 36), (1, 120, 90), (90, 80, 70)])
@pytest.mark.parametrize("noise", [0.05, 0.5])
def test_the_noise_is_told_beside_edges_and_a_ramp(shape, noise):
    """Along each axis one voxel of ten lies beside an edge."""
    assert noise_of(objects(shape, 1, noise)) == pytest.approx(noise, rel=0.2)
    flat = np.random.default_rng(2).normal(0, noise, shape).astype(np.float32)
    assert noise_of(flat) == pytest.approx(noise, rel=0.03)


def test_the_axis_along_which_the_image_changes_least_counts():
    image = np.random.default_rng(3).normal(0, 0.1, (40, 40, 40)).astype(np.float32)
    image[::2] += 1.0  # slices that differ
    assert noise_of(image) == pytest.approx(0.1, rel=0.05)


def test_even_parts_have_none_and_smooth_noise_has_little():
    image = (np.indices((30, 30, 30)).sum(axis=0) > 45).astype(np.float32)
    assert noise_of(image) == 0.0 and noise_of(np.zeros((1, 1, 2), np.float32)) == 0.0
    from scipy import ndimage

    white = np.random.default_rng(4).normal(0, 1, (40, 40, 40))
    smooth = ndimage.gaussian_filter(white, 1.5).astype(np.float32)
    assert noise_of(smooth) < 0.3 * smooth.std()


@pytest.mark.parametrize("shape", [(20, 21, 22), (66, 67, 65)])
def test_the_order_and_direction_of_the_axes_do_not_count(shape):
    """Also where only some of the voxels are looked at."""
    image = objects(shape, 5, 0.3)
    want = noise_of(image)
    for axes in itertools.permutations(range(3)):
        for flips in itertools.product((1, -1), repeat=3):
            turned = image.transpose(axes)[:: flips[0], :: flips[1], :: flips[2]]
            assert noise_of(turned) == want


def test_the_weight_is_that_of_the_smallest_step():
    assert area_for_noise(1.0, (9, 9, 9), (3.0, 1.0, 2.0)) == WEIGHT
    # In one slice its thickness is no step.
    assert area_for_noise(0.5, (1, 9, 9), (0.1, 2.0, 3.0)) == WEIGHT * 0.5
