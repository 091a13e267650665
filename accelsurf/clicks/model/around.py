"""A network that sees a first one's answers around each block: convolutions at three resolutions.

The first layer works on blocks; then come means of 2x2x2 blocks and of 4x4x4, and the way back, where what was seen
before is added. Each layer but the last has a rectifier.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.kernels.dense import layer

Floats = NDArray[np.float32]
#: Windows are filled up to a multiple of this.
MULTIPLE = 4


def logits_around(layers: Sequence[tuple[Floats, Floats]], features: Floats, answer: Floats) -> Floats:
    """Logits of each block by what is around it.

    Parameters
    ----------
    layers : sequence of (weights, biases)
        Eight; the rows of a convolution's weights are those of the neighbours (z, y, x), the last axis first, and in
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


def _single(values: Floats, weights: tuple[Floats, Floats], is_rectified: bool = True) -> Floats:
    out = layer(np.ascontiguousarray(values.reshape(len(values), -1)), *weights, is_rectified)
    return np.asarray(out).reshape(-1, *values.shape[1:])


def _cube(values: Floats, weights: tuple[Floats, Floats]) -> Floats:
    """A layer on the 3x3x3 neighbours of each block, 0 beyond the window."""
    padded = np.pad(values, [(0, 0), (1, 1), (1, 1), (1, 1)])
    _, nz, ny, nx = values.shape
    shifted = [padded[:, z : z + nz, y : y + ny, x : x + nx] for z in range(3) for y in range(3) for x in range(3)]
    return _single(np.concatenate(shifted), weights)


def _halved(values: Floats) -> Floats:
    n, nz, ny, nx = values.shape
    return values.reshape(n, nz // 2, 2, ny // 2, 2, nx // 2, 2).mean((2, 4, 6), dtype=np.float32)


def _doubled(values: Floats) -> Floats:
    return values.repeat(2, 1).repeat(2, 2).repeat(2, 3)
