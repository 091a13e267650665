"""Networks: sums in one order, files that keep them, features that are not known."""

import hashlib
import json
from importlib import resources

import numpy as np

from accelsurf.clicks.model.network import WEIGHTS, Layer, Network, load, networks, save


def made():
    random = np.random.default_rng(2)
    layers = tuple(
        Layer(
            random.normal(size=size).astype(np.float32),
            random.normal(size=size[1]).astype(np.float32),
        )
        for size in ((2, 4), (4, 1))
    )
    return Network(
        ("a", "b"), np.array([1.0, 0.0], np.float32), np.array([2.0, 1.0], np.float32), layers
    )


def test_the_probability_is_that_of_standardised_features(tmp_path):
    network, random = made(), np.random.default_rng(3)
    a, b = random.normal(size=(2, 3, 4, 5))
    (w1, b1), (w2, b2) = network.layers
    hidden = np.maximum(np.stack([(a - 1.0) / 2.0, b], -1) @ w1 + b1, 0.0)
    expected = 1.0 / (1.0 + np.exp(-(hidden @ w2 + b2)[..., 0]))
    np.testing.assert_allclose(network.probability({"a": a, "b": b}, a.shape), expected, atol=1e-5)
    # The same for all blocks; and unknown, which is the mean.
    np.testing.assert_allclose(
        network.probability({"a": np.array(np.nan), "b": b}, a.shape),
        network.probability({"a": np.array(1.0), "b": b}, a.shape),
    )
    save(tmp_path / "weights.npz", {"some": network})
    again = load(tmp_path / "weights.npz")["some"]
    assert again.names == network.names and again.parameters == network.parameters == 17
    np.testing.assert_allclose(again.probability({"a": a, "b": b}, a.shape), expected, atol=5e-3)


def test_weights_are_those_of_the_record_and_small():
    content = (resources.files("accelsurf.clicks.model") / WEIGHTS).read_bytes()
    record = json.loads((resources.files("accelsurf.clicks.model") / "weights.json").read_text())
    assert hashlib.sha256(content).hexdigest() == record["sha256"]
    assert len(content) <= 300_000 and {"first", "later", "boundary"} <= set(networks())
