"""Sums over blocks, their means, and their values on voxels, against numpy."""

import numpy as np
import pytest

from accelsurf.image.blocks import block_means, on_voxels
from accelsurf.image.kernels.blocks import sums_along

pytestmark = pytest.mark.nojit


@pytest.mark.parametrize(
    ("shape", "step"), [((2, 7, 3), 3), ((1, 4, 1), 4), ((3, 5, 2), 1), ((2, 3, 2), 5)]
)
def test_sums_are_those_of_slices(shape, step):
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    expected = [values[:, at : at + step].sum(axis=1) for at in range(0, shape[1], step)]
    np.testing.assert_allclose(sums_along(values, step), np.stack(expected, axis=1), atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "steps"),
    [
        ((5, 7, 4), (2, 3, 1)),
        ((1, 9, 7), (1, 4, 3)),
        ((3, 3, 3), (1, 1, 1)),
        ((2, 5, 3), (4, 6, 3)),
    ],
)
def test_means_of_blocks_and_back(shape, steps):
    values = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    found = block_means(values, steps)
    for index in np.ndindex(found.shape):
        block = tuple(slice(i * step, (i + 1) * step) for i, step in zip(index, steps, strict=True))
        assert found[index] == pytest.approx(values[block].mean(), abs=1e-5)
    expected = found.astype(np.float64)
    for axis, (count, step) in enumerate(zip(shape, steps, strict=True)):
        at = np.clip((np.arange(count) - 0.5 * (step - 1)) / step, 0, found.shape[axis] - 1)
        below = np.floor(at).astype(int)
        share = np.expand_dims(at - below, [i for i in range(3) if i != axis])
        above = np.minimum(below + 1, found.shape[axis] - 1)
        expected = (
            np.take(expected, below, axis) * (1 - share) + np.take(expected, above, axis) * share
        )
    np.testing.assert_allclose(on_voxels(found, steps, shape), expected, atol=1e-5)
