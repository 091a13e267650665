"""Training of small networks on rows of features, by numpy alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from accelsurf.clicks.model.network import Layer, Network, standardised

Floats = NDArray[np.float32]
#: Rows in a step of the training, its largest step and decay of the weights; part of the steps in which steps grow.
BATCH, STEP, DECAY, WARM = 4096, 4e-3, 1e-4, 0.1


def trained(
    names: Sequence[str],
    table: Floats,
    wanted: Floats,
    hidden: Sequence[int],
    passes: int,
    batch: int = BATCH,
) -> Network:
    """Train on rows by Adam on the cross entropy.

    Parameters
    ----------
    names : sequence of str
    table : ndarray (k, n) float16 or float32
        Features.
    wanted : ndarray (k,) float32
        Shares of blocks that are object, 0 to 1.
    hidden : sequence of int
        Widths of the layers between.
    passes : int
        Over all rows.
    batch : int, optional
        Rows of a step.
    """
    random = np.random.default_rng(0)
    some = table[:: max(len(table) // 400_000, 1)].astype(np.float32)
    middle = np.nanmean(some, axis=0).astype(np.float32)
    spread = (np.nanstd(some, axis=0) + 1e-3).astype(np.float32)
    widths = [table.shape[1], *hidden, 1]
    parts: list[Floats] = []
    for rows, columns in zip(widths, widths[1:], strict=False):
        parts.append(
            (random.standard_normal((rows, columns)) * np.sqrt(2.0 / rows)).astype(np.float32)
        )
        parts.append(np.zeros(columns, np.float32))
    first, second = ([np.zeros_like(part) for part in parts] for _ in range(2))
    total, step = passes * (len(wanted) // batch), 0
    for _ in range(passes):
        order = random.permutation(len(wanted))
        for start in range(0, len(wanted) - batch + 1, batch):
            rows_ = order[start : start + batch]
            slopes = _slopes(parts, standardised(table[rows_], middle, spread), wanted[rows_])
            step += 1
            share = step / total
            rate = STEP * (
                min(share / WARM, 1.0)
                * 0.5
                * (1.0 + np.cos(np.pi * max(share - WARM, 0.0) / (1.0 - WARM)))
            )
            for i, slope in enumerate(slopes):
                first[i] += 0.1 * (slope - first[i])
                second[i] += 0.001 * (slope**2 - second[i])
                change = (first[i] / (1.0 - 0.9**step)) / (
                    np.sqrt(second[i] / (1.0 - 0.999**step)) + 1e-8
                )
                parts[i] -= np.float32(rate) * (change + DECAY * parts[i] * (i % 2 == 0))
    return Network(tuple(names), middle, spread, tuple(map(Layer, parts[::2], parts[1::2])))


def _slopes(parts: Sequence[Floats], values: Floats, wanted: Floats) -> list[Floats]:
    """Derivatives of the mean cross entropy of some rows."""
    held = [values]
    for i in range(0, len(parts), 2):
        values = values @ parts[i] + parts[i + 1]
        values = np.maximum(values, 0.0) if i < len(parts) - 2 else values
        held.append(values)
    error = ((expit(held[-1][:, 0]) - wanted) / len(wanted))[:, None].astype(np.float32)
    out: list[Floats] = [np.zeros(0, np.float32)] * len(parts)
    for i in range(len(parts) - 2, -1, -2):
        out[i], out[i + 1] = held[i // 2].T @ error, error.sum(axis=0)
        if i:
            error = (error @ parts[i].T) * (held[i // 2] > 0)
    return out


def loss(network: Network, table: Floats, wanted: Floats) -> float:
    """Mean cross entropy."""
    columns = dict(zip(network.names, table.astype(np.float32).T, strict=True))
    p = np.clip(network.probability(columns, wanted.shape), 1e-6, 1.0 - 1e-6)
    return float(-np.mean(wanted * np.log(p) + (1.0 - wanted) * np.log(1.0 - p)))
