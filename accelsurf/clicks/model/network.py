"""Small networks of dense layers that map the features of a block to a probability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from accelsurf.kernels.dense import layer

Floats = NDArray[np.float32]
#: Features are cut at so many standard deviations.
CUT = 5.0
#: The networks that come with the package; how they were trained stands in the file of the same name, .json.
WEIGHTS = "weights.npz"


@dataclass(frozen=True, eq=False)
class Network:
    """Dense layers with rectifiers between.

    Attributes
    ----------
    names : tuple of str
        Of the features, in their order.
    middle, spread : ndarray (n,) float32
        What features are standardised by; an unknown feature, nan, counts as its mean.
    layers : tuple of (weights (n, m), biases (m,)) float32
    """

    names: tuple[str, ...]
    middle: Floats
    spread: Floats
    layers: tuple[tuple[Floats, Floats], ...]

    def probability(self, features: Mapping[str, NDArray[np.floating]], shape: tuple[int, ...]) -> Floats:
        """Probability of each block, by features of this shape, or of no dimension where they are the same for all."""
        values = np.empty((len(self.names), int(np.prod(shape))), np.float32)
        for row, name, middle, spread in zip(values, self.names, self.middle, self.spread, strict=True):
            found = np.broadcast_to(np.asarray(features[name], np.float32), shape)
            row[:] = np.clip(np.nan_to_num((found - middle) / spread, nan=0.0), -CUT, CUT).ravel()
        for number, (weights, biases) in enumerate(self.layers):
            values = layer(values, weights, biases, number < len(self.layers) - 1)
        return np.asarray(expit(values[0]), np.float32).reshape(shape)

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return sum(w.size + b.size for w, b in self.layers)


@lru_cache(maxsize=1)
def networks() -> Mapping[str, Network]:
    """The networks "first" and "later" of the package, read once."""
    with (resources.files(__package__) / WEIGHTS).open("rb") as file:
        return load(file)


def save(path: Path, made: Mapping[str, Network]) -> None:
    """Write networks by name into a file."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, network in made.items():
        arrays |= {
            f"{name}.names": np.array(network.names),
            f"{name}.middle": network.middle,
            f"{name}.spread": network.spread,
        }
        for i, (weights, biases) in enumerate(network.layers):
            arrays |= {f"{name}.{i}.weights": weights.astype(np.float16), f"{name}.{i}.biases": biases}
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load(file: Path | IO[bytes]) -> dict[str, Network]:
    """Read what `save` wrote."""
    with np.load(file, allow_pickle=False) as held:
        out = {}
        for name in sorted({key.partition(".")[0] for key in held.files}):
            count = sum(key.startswith(f"{name}.") and key.endswith(".weights") for key in held.files)
            layers = tuple(
                (held[f"{name}.{i}.weights"].astype(np.float32), held[f"{name}.{i}.biases"]) for i in range(count)
            )
            texts = tuple(str(text) for text in held[f"{name}.names"])
            out[name] = Network(texts, held[f"{name}.middle"], held[f"{name}.spread"], layers)
        return out
