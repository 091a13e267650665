"""Layers of a small network, against numpy."""

import numpy as np
import pytest

from accelsurf.kernels.dense import TILE, layer

pytestmark = pytest.mark.nojit


@pytest.mark.parametrize("is_rectified", [True, False])
@pytest.mark.parametrize("count", [1, TILE, TILE + 3])
def test_a_layer_is_numpys(count, is_rectified):
    rng = np.random.default_rng(0)
    values, weights, biases = (rng.normal(size=shape).astype(np.float32) for shape in ((5, count), (5, 3), (3,)))
    expected = weights.T.astype(np.float64) @ values + biases[:, None]
    found = layer(values, weights, biases, is_rectified)
    assert found.dtype == np.float32 and (expected < 0).any()
    np.testing.assert_allclose(found, np.maximum(expected, 0.0) if is_rectified else expected, atol=1e-5)


def test_a_case_has_the_same_bytes_whatever_is_beside_it():
    rng = np.random.default_rng(1)
    values, weights, biases = (rng.normal(size=n).astype(np.float32) for n in ((40, 3 * TILE), (40, 2), 2))
    whole, alone = (layer(np.ascontiguousarray(part), weights, biases, True) for part in (values, values[:, 100:101]))
    assert whole[:, 100:101].tobytes() == alone.tobytes()
