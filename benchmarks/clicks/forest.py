"""A classifier as ITK-SNAP's: trees with random splits over a few features of each voxel, learned from the clicks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.clicks.compiled import vote
from benchmarks.clicks.domain import INSIDE, OUTSIDE, Domain

#: Number of trees, their depth, splits tried at a node, voxels that a node must hold to be split, voxels per side.
TREES, DEPTH, TRIES, SPLIT, SAMPLES = 50, 8, 6, 8, 2000
SIGMAS = (1.0, 2.0, 4.0)


def features(domain: Domain, position: bool) -> NDArray[np.float32]:
    """Value, smoothed values, gradient and Laplacian at three widths, and where the voxel lies if wanted."""
    bank = [domain.values]
    for sigma in SIGMAS:
        widths = [sigma / h for h in domain.spacing]
        bank.append(ndimage.gaussian_filter(domain.values, widths))
        bank.append(ndimage.gaussian_gradient_magnitude(domain.values, widths))
        bank.append(ndimage.gaussian_laplace(domain.values, widths))
    if position:
        shape = domain.values.shape
        bank += [
            np.broadcast_to(axis * h, shape)
            for axis, h in zip(np.ogrid[tuple(map(slice, shape))], domain.spacing, strict=True)
        ]
    return np.stack([each.ravel() for each in bank], axis=1).astype(np.float32)


def learned(
    rows: NDArray[np.float32], inside: NDArray[np.bool_], seed: int
) -> tuple[NDArray, NDArray, NDArray]:
    """Trees as `vote` takes them; each split is the best of a few random ones (extremely randomised trees)."""
    random = np.random.default_rng(seed)
    nodes = 2 ** (DEPTH + 1) - 1
    feature = np.full((TREES, nodes), -1, np.int64)
    threshold, share = np.zeros((TREES, nodes), np.float32), np.zeros((TREES, nodes), np.float32)
    for tree in range(TREES):
        held: dict[int, NDArray[np.int64]] = {0: random.integers(0, len(rows), len(rows))}
        for node in range(nodes):
            rows_held = held.pop(node, None)
            if rows_held is None:
                continue
            share[tree, node] = inside[rows_held].mean()
            if 2 * node + 2 >= nodes or rows_held.size < SPLIT or share[tree, node] in (0.0, 1.0):
                continue
            split = _best_split(rows[rows_held], inside[rows_held], random)
            if split is None:
                continue
            feature[tree, node], threshold[tree, node] = split
            left = rows[rows_held, split[0]] <= np.float32(split[1])
            held[2 * node + 1], held[2 * node + 2] = rows_held[left], rows_held[~left]
    return feature, threshold, share


def _best_split(
    rows: NDArray[np.float32], inside: NDArray[np.bool_], random: np.random.Generator
) -> tuple[int, float] | None:
    """The random split with the lowest Gini impurity; None where all tried leave one side empty."""
    best: tuple[float, int, float] | None = None
    for column in random.integers(0, rows.shape[1], TRIES):
        values = rows[:, column]
        at = np.float32(random.uniform(values.min(), values.max()))
        left = values <= at
        count = int(left.sum())
        if count in (0, left.size):
            continue
        p, q = inside[left].mean(), inside[~left].mean()
        impurity = count * p * (1 - p) + (left.size - count) * q * (1 - q)
        if best is None or impurity < best[0]:
            best = float(impurity), int(column), float(at)
    return None if best is None else best[1:]


def probability(domain: Domain, position: bool, seed: int = 0) -> NDArray[np.float32]:
    """How sure each voxel is inside, 0 to 1, by trees learned from the seeds, as many of either side."""
    bank, seeds = features(domain, position), domain.seeds.ravel()
    random = np.random.default_rng(seed)
    sides = [np.flatnonzero(seeds == side) for side in (INSIDE, OUTSIDE)]
    count = min(max(map(len, sides)), SAMPLES)
    drawn = np.concatenate(
        [random.choice(side, count, replace=len(side) < count) for side in sides]
    )
    trees = learned(bank[drawn], seeds[drawn] == INSIDE, seed)
    return np.asarray(vote(bank, *trees)).reshape(domain.values.shape)
