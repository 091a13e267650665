"""A network that sees a first one's answer around a block: convolutions at three resolutions, by numpy alone.

Each layer of `SHAPE` is a convolution of 3x3x3 blocks or of a single one, with a rectifier. The first layer works on
blocks; then come means of 2x2x2 blocks and of 4x4x4, and the way back, where what was seen before is added.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Layers = Sequence[tuple[Floats, Floats]]
#: Layers: name, channels that go in (0: features and the first answer), channels that come out, blocks along a side.
SHAPE = (
    ("near", 0, 12, 1),
    ("half", 12, 16, 3),
    ("half again", 16, 16, 3),
    ("quarter", 16, 24, 3),
    ("quarter again", 24, 16, 3),
    ("half back", 16, 12, 3),
    ("near back", 12, 8, 3),
    ("answer", 8, 1, 1),
)
#: Windows are filled up to a multiple of this.
MULTIPLE = 4


def started(features: int) -> list[tuple[Floats, Floats]]:
    """Layers to train: random ones, and a last one that leaves the first answer as it is."""
    random, out = np.random.default_rng(0), []
    for name, before, after, side in SHAPE:
        rows = (before or features + 1) * side**3
        scale = 0.0 if name == "answer" else np.sqrt(2.0 / rows)
        weights = (scale * random.standard_normal((rows, after))).astype(np.float32)
        out.append((weights, np.zeros(after, np.float32)))
    return out


def forward(layers: Layers, features: Floats, answer: Floats) -> tuple[Floats, list[Floats]]:
    """Logits of a window, and what each layer was given and gave, for `backward`."""
    shape = answer.shape
    given = np.concatenate([features, answer[..., None] / 2.0], -1)
    given = np.pad(given, [(0, -n % MULTIPLE) for n in shape] + [(0, 0)], mode="edge")
    near = _relu(_single(given, *layers[0]))
    in1 = _halved(near)
    half1 = _relu(_cube(in1, *layers[1]))
    half2 = _relu(_cube(half1, *layers[2]))
    in3 = _halved(half2)
    quarter1 = _relu(_cube(in3, *layers[3]))
    quarter2 = _relu(_cube(quarter1, *layers[4]))
    in5 = half2 + _doubled(quarter2)
    half3 = _relu(_cube(in5, *layers[5]))
    in6 = near + _doubled(half3)
    near2 = _relu(_cube(in6, *layers[6]))
    out = _single(near2, *layers[7])[..., 0][tuple(slice(0, n) for n in shape)] + answer
    return out, [given, near, in1, half1, half2, in3, quarter1, quarter2, in5, half3, in6, near2]


def backward(layers: Layers, held: Sequence[Floats], slope: Floats) -> list[tuple[Floats, Floats]]:
    """Derivatives of layers, of those of the logits."""
    given, near, in1, half1, half2, in3, quarter1, quarter2, in5, half3, in6, near2 = held
    full = np.zeros((*given.shape[:3], 1), given.dtype)
    full[tuple(slice(0, n) for n in slope.shape)] = slope[..., None]
    out: list[tuple[Floats, Floats]] = [(full, full)] * len(layers)
    s, out[7] = _single_back(near2, layers[7][0], full)
    s, out[6] = _cube_back(in6, layers[6][0], s * (near2 > 0))
    to_near = s
    s, out[5] = _cube_back(in5, layers[5][0], _summed(s) * (half3 > 0))
    to_half = s
    s, out[4] = _cube_back(quarter1, layers[4][0], _summed(s) * (quarter2 > 0))
    s, out[3] = _cube_back(in3, layers[3][0], s * (quarter1 > 0))
    s, out[2] = _cube_back(half1, layers[2][0], (to_half + _doubled(s) / 8.0) * (half2 > 0))
    s, out[1] = _cube_back(in1, layers[1][0], s * (half1 > 0))
    s = (to_near + _doubled(s) / 8.0) * (near > 0)
    out[0] = (_flat(given).T @ _flat(s), _flat(s).sum(0))
    return out


def _relu(values: Floats) -> Floats:
    return np.maximum(values, 0.0)


def _flat(values: Floats) -> Floats:
    return values.reshape(-1, values.shape[-1])


def _single(values: Floats, weights: Floats, biases: Floats) -> Floats:
    return (_flat(values) @ weights + biases).reshape(*values.shape[:3], -1)


def _single_back(
    values: Floats, weights: Floats, slope: Floats
) -> tuple[Floats, tuple[Floats, Floats]]:
    flat = _flat(slope)
    return (flat @ weights.T).reshape(values.shape), (_flat(values).T @ flat, flat.sum(0))


def _slabs(values: Floats) -> Floats:
    """View (nz, ny, nx, 3, 3, 3 k) of the neighbours of each block, 0 beyond the window."""
    padded = np.pad(values, [(1, 1)] * 3 + [(0, 0)])
    z, y, x, k = padded.strides
    nz, ny, nx, n = values.shape
    return np.lib.stride_tricks.as_strided(
        padded, (nz, ny, nx, 3, 3, 3 * n), (z, y, x, z, y, k), writeable=False
    )


def _cube(values: Floats, weights: Floats, biases: Floats) -> Floats:
    nz, ny, nx, _ = values.shape
    out = np.empty((nz, ny, nx, len(biases)), values.dtype)
    for slab, part in zip(_slabs(values), out, strict=True):
        np.add(slab.reshape(ny * nx, -1) @ weights, biases, out=part.reshape(ny * nx, -1))
    return out


def _cube_back(
    values: Floats, weights: Floats, slope: Floats
) -> tuple[Floats, tuple[Floats, Floats]]:
    nz, ny, nx, n = values.shape
    total = np.zeros_like(weights)
    for slab, part in zip(_slabs(values), slope, strict=True):
        total += slab.reshape(ny * nx, -1).T @ part.reshape(ny * nx, -1)
    m = weights.shape[1]
    turned = np.ascontiguousarray(
        weights.reshape(27, n, m)[::-1].transpose(0, 2, 1).reshape(27 * m, n)
    )
    return _cube(slope, turned, np.zeros(n, weights.dtype)), (total, _flat(slope).sum(0))


def _summed(values: Floats) -> Floats:
    nz, ny, nx, n = values.shape
    return values.reshape(nz // 2, 2, ny // 2, 2, nx // 2, 2, n).sum((1, 3, 5))


def _halved(values: Floats) -> Floats:
    return _summed(values) / np.float32(8.0)


def _doubled(values: Floats) -> Floats:
    return values.repeat(2, 0).repeat(2, 1).repeat(2, 2)
