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

from accelsurf.clicks.model.around import logits_around
from accelsurf.kernels.dense import layer

Floats = NDArray[np.float32]
#: Features are cut at so many standard deviations.
CUT = 5.0
#: Logits of single blocks are cut here.
MAX_LOGIT = 9.2
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
    around : tuple of (weights, biases) float32
        Layers of `accelsurf.clicks.model.around`, which see the answers around a block; none: there are none.
    """

    names: tuple[str, ...]
    middle: Floats
    spread: Floats
    layers: tuple[tuple[Floats, Floats], ...]
    around: tuple[tuple[Floats, Floats], ...] = ()

    def probability(self, features: Mapping[str, NDArray[np.floating]], shape: tuple[int, ...]) -> Floats:
        """Probability of each block, by features of this shape, or of no dimension where they are the same for all."""
        values = self.standardised(features, shape)
        answer = self.logits(values)
        if self.around:
            answer = logits_around(self.around, values, answer)
        return np.asarray(expit(answer), np.float32)

    def standardised(self, features: Mapping[str, NDArray[np.floating]], shape: tuple[int, ...]) -> Floats:
        """Features (n, *shape) less their means, in their standard deviations, cut; 0 where unknown."""
        out = np.empty((len(self.names), *shape), np.float32)
        for row, name, middle, spread in zip(out, self.names, self.middle, self.spread, strict=True):
            found = np.broadcast_to(np.asarray(features[name], np.float32), shape)
            row[...] = np.clip(np.nan_to_num((found - middle) / spread, nan=0.0), -CUT, CUT)
        return out

    def logits(self, values: Floats) -> Floats:
        """Logits of each block alone, of `standardised` features."""
        out = values.reshape(len(values), -1)
        for number, (weights, biases) in enumerate(self.layers):
            out = layer(out, weights, biases, number < len(self.layers) - 1)
        return np.clip(out[0], -MAX_LOGIT, MAX_LOGIT).reshape(values.shape[1:])

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return sum(w.size + b.size for w, b in (*self.layers, *self.around))


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
        for part, layers in (("", network.layers), ("around.", network.around)):
            for i, (weights, biases) in enumerate(layers):
                key = f"{name}.{part}{i}"
                arrays |= {f"{key}.weights": weights.astype(np.float16), f"{key}.biases": biases}
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load(file: Path | IO[bytes]) -> dict[str, Network]:
    """Read what `save` wrote."""
    with np.load(file, allow_pickle=False) as held:
        out = {}
        for name in sorted({key.partition(".")[0] for key in held.files}):
            texts = tuple(str(text) for text in held[f"{name}.names"])
            layers, around = _layers(held, name), _layers(held, f"{name}.around")
            out[name] = Network(texts, held[f"{name}.middle"], held[f"{name}.spread"], layers, around)
        return out


def _layers(held: Mapping[str, NDArray[np.generic]], name: str) -> tuple[tuple[Floats, Floats], ...]:
    """Layers of a network in a file, by its name and their numbers."""
    out, number = [], 0
    while f"{name}.{number}.weights" in held:
        weights, biases = (held[f"{name}.{number}.{part}"].astype(np.float32) for part in ("weights", "biases"))
        out.append((np.ascontiguousarray(weights), biases))
        number += 1
    return tuple(out)
