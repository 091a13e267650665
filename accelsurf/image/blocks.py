"""Blocks of voxels: means over them, and their values back on voxels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.image.kernels.blocks import sums_along


def coarsening(counts: Sequence[int], spacing: Sequence[float], most: int) -> tuple[int, int, int]:
    """Whole steps by which a grid is restricted to at most ``most`` voxels, the finest axis first.

    Parameters
    ----------
    counts : (int, int, int)
        Number of voxels along z, y, x.
    spacing : (hz, hy, hx)
        mm.
    most : int

    Examples
    --------
    >>> coarsening((40, 40, 40), (3.0, 1.0, 1.0), 20000)
    (1, 2, 2)
    """
    steps = [1, 1, 1]
    while math.prod(-(-n // step) for n, step in zip(counts, steps, strict=True)) > most:
        axis = min(
            (i for i in range(3) if steps[i] < counts[i]), key=lambda i: (steps[i] * spacing[i], -i)
        )
        steps[axis] += 1
    return steps[0], steps[1], steps[2]


def block_means(values: NDArray[np.float32], steps: Sequence[int]) -> NDArray[np.float32]:
    """Means of blocks; those at the far ends may be smaller.

    Parameters
    ----------
    values : ndarray (nz, ny, nx), float32
    steps : (int, int, int)
        Voxels of a block along z, y, x.

    Examples
    --------
    >>> block_means(np.array([[[1, 3, 5]]], np.float32), (1, 1, 2)).tolist()
    [[[2.0, 5.0]]]
    """
    values = np.ascontiguousarray(values)
    for axis, step in enumerate(steps):
        if step > 1:
            before = values.shape[:axis]
            count = values.shape[axis]
            after = values.shape[axis + 1 :]
            sums = sums_along(values.reshape(math.prod(before), count, math.prod(after)), step)
            sizes = np.diff(np.append(np.arange(0, count, step), count)).astype(np.float32)
            values = (sums / sizes[:, None]).reshape(*before, -1, *after)
    return values


def on_voxels(
    blocks: NDArray[np.float32], steps: Sequence[int], shape: Sequence[int]
) -> NDArray[np.float32]:
    """Values of blocks at voxels, linear between the middles of blocks and constant beyond the outermost.

    Parameters
    ----------
    blocks : ndarray (nz, ny, nx), float32
    steps : (int, int, int)
        Voxels of a block along z, y, x.
    shape : (int, int, int)
        Number of voxels along each axis.

    Examples
    --------
    >>> on_voxels(np.array([[[2.0, 6.0]]], np.float32), (1, 1, 2), (1, 1, 4)).tolist()
    [[[2.0, 3.0, 5.0, 6.0]]]
    """
    out = blocks
    for axis, step in enumerate(steps):
        if step > 1:
            at = np.clip(
                (np.arange(shape[axis]) - 0.5 * (step - 1)) / step, 0.0, out.shape[axis] - 1
            )
            below = np.floor(at).astype(np.int64)
            above = np.minimum(below + 1, out.shape[axis] - 1)
            part = (
                (at - below).astype(np.float32).reshape([-1 if i == axis else 1 for i in range(3)])
            )
            out = np.take(out, below, axis) * (1 - part) + np.take(out, above, axis) * part
    return np.ascontiguousarray(out)
