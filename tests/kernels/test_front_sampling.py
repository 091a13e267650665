"""Normals at the surface, and an image's slope along them: against plain numpy."""

import numpy as np
import pytest

from accelsurf.kernels import point_sampling
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
SHAPES = [(7, 9, 8), (1, 9, 12), (2, 5, 6), (3, 4, 5)]


def scene(shape, seed):
    """A whole band with random closest points (mm), some beyond the border, a front mask, an image."""
    rng = np.random.default_rng(seed)
    closest_point = rng.uniform(-1.2, 1.2, (int(np.prod(shape)), 3)) * SPACING
    if shape[0] == 1:
        closest_point[:, 0] = 0
    dense, band = reference.whole_band(reference.smooth_noise(shape, seed + 1), closest_point)
    return (
        dense,
        band,
        rng.random(len(closest_point)) < 0.7,
        reference.smooth_noise(shape, seed + 2),
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_normals_are_the_centred_gradient_of_length_1(shape):
    dense, band, front, _ = scene(shape, 1)
    out = np.full((front.size, 3), np.nan, np.float32)
    point_sampling.outward_normals(
        0, front.size, dense.psi, reference.grid_of(shape, SPACING), band, front, out
    )
    gradient = reference.derivatives(dense.psi.reshape(shape), SPACING)[0].reshape(-1, 3)
    want = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(out[front], want[front], atol=1e-5)
    assert not out[~front].any()


def test_where_psi_is_flat_there_is_no_normal():
    shape = (3, 4, 5)
    dense, band = reference.whole_band(np.full(shape, 2.0))
    out = np.full((60, 3), np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    point_sampling.outward_normals(0, 60, dense.psi, grid, band, np.ones(60, bool), out)
    assert not out.any()


@pytest.mark.parametrize("shape", SHAPES)
def test_value_and_slope_are_the_interpolants_held_at_the_border(shape):
    _, band, front, image = scene(shape, 2)
    normals = np.random.default_rng(3).normal(size=(front.size, 3)).astype(np.float32)
    out = np.full((front.size, 2), np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    point_sampling.value_and_slope(0, front.size, image.ravel(), grid, band, normals, front, out)
    closest_points = np.argwhere(np.ones(shape, bool)) + band.to_closest.astype(float) / SPACING
    value, gradient = reference.interpolate(
        image, np.clip(closest_points, 0, np.array(shape) - 1.0)
    )
    slope = (gradient / SPACING * normals).sum(axis=1)
    np.testing.assert_allclose(out[front], np.stack([value, slope], axis=1)[front], atol=5e-5)
    assert not out[~front].any()


def test_only_the_range_is_touched():
    shape = (3, 4, 5)
    dense, band, _, image = scene(shape, 5)
    grid, front = reference.grid_of(shape, SPACING), np.ones(60, bool)
    normals, out = np.full((60, 3), 7, np.float32), np.full((60, 2), 7, np.float32)
    point_sampling.outward_normals(10, 20, dense.psi, grid, band, front, normals)
    point_sampling.value_and_slope(10, 20, image.ravel(), grid, band, normals, front, out)
    for array in (normals, out):
        assert (array[:10] == 7).all() and (array[20:] == 7).all() and not (array[10:20] == 7).any()
