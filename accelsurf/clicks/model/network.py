"""Small networks of dense layers that map the features of a block to a probability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from accelsurf.clicks.kernels.dense import layer
from accelsurf.grid.arrays import Singles

#: Features are cut at this number of standard deviations.
CUT = 5.0
#: Windows are filled up to a multiple of this, for blocks of blocks.
MULTIPLE = 4
#: Logits of single blocks are cut here.
MAX_LOGIT = 9.2
#: The networks that come with the package; how they were trained stands in the file of the same name, .json.
WEIGHTS = "weights.npz"


class Layer(NamedTuple):
    """Dense layer: ``weights`` (n, m) and ``biases`` (m,), float32."""

    weights: Singles
    biases: Singles


@dataclass(frozen=True, eq=False)
class Network:
    """Dense layers with rectifiers between.

    Attributes
    ----------
    names : tuple of str
        Of the features, in their order.
    middle, spread : ndarray (n,) float32
        Means and standard deviations of the features; an unknown feature, nan, counts as its mean.
    layers : tuple of Layer
    around : tuple of Layer
        Layers of `logits_around`, which see the answers around a block; may be empty.
    """

    names: tuple[str, ...]
    middle: Singles
    spread: Singles
    layers: tuple[Layer, ...]
    around: tuple[Layer, ...] = ()

    def probability(
        self, features: Mapping[str, NDArray[np.floating]], shape: tuple[int, ...]
    ) -> Singles:
        """Probability of each block, by features of this shape, or of no dimension where they are the same for all."""
        values = self.standardised(features, shape)
        answer = self.logits(values)
        if self.around:
            answer = logits_around(self.around, values, answer)
        return np.asarray(expit(answer), np.float32)

    def standardised(
        self, features: Mapping[str, NDArray[np.floating]], shape: tuple[int, ...]
    ) -> Singles:
        """Features (n, *shape) less their means, in their standard deviations, cut; 0 where unknown."""
        out = np.empty((len(self.names), *shape), np.float32)
        for row, name, middle, spread in zip(
            out, self.names, self.middle, self.spread, strict=True
        ):
            found = np.broadcast_to(np.asarray(features[name], np.float32), shape)
            row[...] = standardised(found, middle, spread)
        return out

    def logits(self, values: Singles) -> Singles:
        """Logits of each block alone, of `standardised` features."""
        out = values.reshape(len(values), -1)
        for number, (weights, biases) in enumerate(self.layers):
            out = layer(out, weights, biases, number < len(self.layers) - 1)
        return np.clip(out[0], -MAX_LOGIT, MAX_LOGIT).reshape(values.shape[1:])

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return sum(w.size + b.size for w, b in (*self.layers, *self.around))


def standardised(values: Singles, middle: Singles, spread: Singles) -> Singles:
    """Values less their means, in their standard deviations, cut; 0 where unknown."""
    return np.clip(np.nan_to_num((values - middle) / spread, nan=0.0), -CUT, CUT).astype(np.float32)


def logits_around(layers: Sequence[Layer], features: Singles, answer: Singles) -> Singles:
    """Logits of each block by its surroundings: convolutions at three resolutions.

    The first layer works on blocks; then come means of 2x2x2 blocks and of 4x4x4, and the way back, where earlier
    outputs of a resolution are added. Each layer but the last has a rectifier.

    Parameters
    ----------
    layers : sequence of (weights, biases)
        Eight; the rows of a convolution's weights belong to the neighbours (z, y, x), the last axis first, and in
        each the channels.
    features : ndarray (n, nz, ny, nx), float32
        Standardised.
    answer : ndarray (nz, ny, nx), float32
        Logits by the first network, to which the others are added.
    """
    given = np.concatenate([features, answer[None] / np.float32(2.0)])
    given = np.pad(given, [(0, 0), *((0, -n % MULTIPLE) for n in answer.shape)], mode="edge")
    near = _single(given, layers[0])
    half = _cube(_cube(_halved(near), layers[1]), layers[2])
    quarter = _cube(_cube(_halved(half), layers[3]), layers[4])
    half = _cube(half + _doubled(quarter), layers[5])
    near = _cube(near + _doubled(half), layers[6])
    z, y, x = answer.shape
    return np.asarray(_single(near, layers[7], False)[0, :z, :y, :x] + answer)


def _single(values: Singles, dense: Layer, is_rectified: bool = True) -> Singles:
    out = layer(np.ascontiguousarray(values.reshape(len(values), -1)), *dense, is_rectified)
    return np.asarray(out).reshape(-1, *values.shape[1:])


def _cube(values: Singles, dense: Layer) -> Singles:
    """A layer on the 3x3x3 neighbours of each block, 0 beyond the window."""
    padded = np.pad(values, [(0, 0), (1, 1), (1, 1), (1, 1)])
    _, nz, ny, nx = values.shape
    shifted = [
        padded[:, z : z + nz, y : y + ny, x : x + nx]
        for z in range(3)
        for y in range(3)
        for x in range(3)
    ]
    return _single(np.concatenate(shifted), dense)


def _halved(values: Singles) -> Singles:
    n, nz, ny, nx = values.shape
    return values.reshape(n, nz // 2, 2, ny // 2, 2, nx // 2, 2).mean((2, 4, 6), dtype=np.float32)


def _doubled(values: Singles) -> Singles:
    return values.repeat(2, 1).repeat(2, 2).repeat(2, 3)


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
    """Read networks by name from a file that `save` wrote."""
    with np.load(file, allow_pickle=False) as held:
        out = {}
        for name in sorted({key.partition(".")[0] for key in held.files}):
            texts = tuple(str(text) for text in held[f"{name}.names"])
            layers, around = _layers(held, name), _layers(held, f"{name}.around")
            out[name] = Network(
                texts, held[f"{name}.middle"], held[f"{name}.spread"], layers, around
            )
        return out


def _layers(held: Mapping[str, NDArray[np.generic]], name: str) -> tuple[Layer, ...]:
    """Layers of a network in a file, by its name and their numbers."""
    out, number = [], 0
    while f"{name}.{number}.weights" in held:
        weights, biases = (
            held[f"{name}.{number}.{part}"].astype(np.float32) for part in ("weights", "biases")
        )
        out.append(Layer(np.ascontiguousarray(weights), biases))
        number += 1
    return tuple(out)
