"""Large arrays worked on a slab at a time, so that temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

#: Voxels of a slab.
SLAB_VOXELS = 1 << 20


def slabs(shape: Sequence[int], multiple: int = 1, at_least: int = 1) -> Iterator[slice]:
    """Yield runs of planes (along the first axis) of about `SLAB_VOXELS` voxels that cover a grid.

    Parameters
    ----------
    shape : sequence of 3 ints
        (nz, ny, nx).
    multiple : int, optional
        Each run but the last has a multiple of so many planes.
    at_least : int, optional
        Each run but the last has so many planes or more.

    Examples
    --------
    >>> list(slabs((5, 1024, 512)))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    >>> list(slabs((5, 1024, 512), at_least=4))
    [slice(0, 4, None), slice(4, 5, None)]
    """
    voxels = max(1, shape[1] * shape[2])  # 0 of an empty array
    planes = max(multiple * max(1, SLAB_VOXELS // (multiple * voxels)), at_least)
    for begin in range(0, shape[0], planes):
        yield slice(begin, min(begin + planes, shape[0]))


def sum_in_order(rows: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The sum of rows (m,), one added after the other: rows of 0 before, between and after them do not change it.

    Examples
    --------
    >>> sum_in_order(np.array([[0.0], [0.1], [0.0], [0.2], [0.3]]))
    array([0.6])
    """
    total: NDArray[np.float64] | None = None
    for row in rows:
        total = np.array(row, np.float64) if total is None else total + row
    if total is None:
        raise ValueError("no rows to add")
    return total


def runs(size: int) -> Iterator[slice]:
    """Yield runs of at most `SLAB_VOXELS` cells that cover a raveled array of ``size`` cells.

    Examples
    --------
    >>> list(runs(3))
    [slice(0, 3, None)]
    """
    for begin in range(0, size, SLAB_VOXELS):
        yield slice(begin, min(begin + SLAB_VOXELS, size))
