"""Sums over blocks of voxels, against numpy."""

import numpy as np
import pytest

from accelsurf.image.blocks import block_means
from accelsurf.kernels.blocks import sums_along

pytestmark = pytest.mark.nojit


@pytest.mark.parametrize("step", [1, 2, 4, 9, 12])
def test_sums_of_blocks_are_numpys(step):
    """The last block may be smaller."""
    values = np.random.default_rng(5).normal(2, 3, (3, 9, 4)).astype(np.float32)
    found = sums_along(values, step)
    assert found.dtype == np.float32
    expected = np.add.reduceat(values.astype(np.float64), np.arange(0, 9, step), axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("steps", [(1, 1, 1), (1, 2, 3), (3, 1, 2), (5, 9, 4)])
def test_means_of_blocks_are_numpys(steps):
    """Of a part of an image, blocks at its ends smaller."""
    part = np.random.default_rng(5).normal(2, 3, (7, 9, 12)).astype(np.float32)[1:6, :, 2:]
    expected = part.astype(np.float64)
    for axis, step in enumerate(steps):
        at = np.arange(0, part.shape[axis], step)
        sizes = np.diff(np.append(at, part.shape[axis]))
        expected = np.add.reduceat(expected, at, axis) / np.expand_dims(sizes, [i for i in range(3) if i != axis])
    found = block_means(part, steps)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5)
