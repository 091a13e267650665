"""Layers of a network beside numpy."""

import numpy as np
import pytest

from accelsurf.clicks.kernels.dense import TILE, layer

pytestmark = pytest.mark.nojit


@pytest.mark.parametrize("columns", [0, 1, 7, TILE, TILE + 3])
@pytest.mark.parametrize("is_rectified", [False, True])
def test_a_layer_is_a_product_and_a_sum(columns, is_rectified):
    random = np.random.default_rng(1)
    values, weights = random.normal(size=(5, columns)), random.normal(size=(5, 3))
    biases = random.normal(size=3)
    found = layer(*(a.astype(np.float32) for a in (values, weights, biases)), is_rectified)
    expected = weights.T @ values + biases[:, None]
    np.testing.assert_allclose(
        found, np.maximum(expected, 0.0) if is_rectified else expected, atol=1e-5
    )
    assert found.dtype == np.float32
