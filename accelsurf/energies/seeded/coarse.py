"""Blocks of voxels: how many voxels they have, and the means in them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.appearance import Spacing
from accelsurf.grid.boxes import Box
from accelsurf.kernels.blocks import sums_along


def coarsening(box: Box, spacing: Spacing, most: int) -> tuple[int, int, int]:
    """Whole steps by which a box is coarsened to at most so many voxels, the finest axis first.

    Examples
    --------
    >>> coarsening((slice(0, 40), slice(0, 40), slice(0, 40)), (3.0, 1.0, 1.0), 20000)
    (1, 2, 2)
    """
    counts, steps = [s.stop - s.start for s in box], [1, 1, 1]
    while np.prod([-(-n // step) for n, step in zip(counts, steps, strict=True)]) > most:
        axis = min((i for i in range(3) if steps[i] < counts[i]), key=lambda i: (steps[i] * spacing[i], -i))
        steps[axis] += 1
    return steps[0], steps[1], steps[2]


def block_means(values: NDArray[np.float32], steps: Sequence[int]) -> NDArray[np.float32]:
    """Means of blocks; those at the far ends may be smaller.

    Examples
    --------
    >>> block_means(np.array([[[1, 3, 5]]], np.float32), (1, 1, 2)).tolist()
    [[[2.0, 5.0]]]
    """
    values = np.ascontiguousarray(values)
    for axis, step in enumerate(steps):
        if step > 1:
            before, count, after = values.shape[:axis], values.shape[axis], values.shape[axis + 1 :]
            sums = sums_along(values.reshape(math.prod(before), count, math.prod(after)), step)
            sizes = np.diff(np.append(np.arange(0, count, step), count)).astype(np.float32)
            values = (sums / sizes[:, None]).reshape(*before, -1, *after)
    return values
