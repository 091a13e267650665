"""The graph cut that both sets of peers take: of least cost, by SciPy's maximum flow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow


def pairs_of(shape: Sequence[int]) -> list[tuple[NDArray[np.int32], NDArray[np.int32]]]:
    """For each axis the flat indices of neighbouring voxels: of the first ones, and of those beyond them."""
    cells = np.arange(int(np.prod(shape)), dtype=np.int32).reshape(shape)
    moved = [np.moveaxis(cells, axis, 0) for axis in range(len(shape))]
    return [(before[:-1].ravel(), before[1:].ravel()) for before in moved]


def least_cut(
    to_source: NDArray[np.int32],
    to_sink: NDArray[np.int32],
    links: Sequence[tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]],
) -> NDArray[np.bool_]:
    """The voxels (n,) on the source's side of the least cut.

    Parameters
    ----------
    to_source, to_sink : ndarray (n,) int32
        What it costs to part a voxel from them.
    links : sequence of (one, other, cost)
        Voxels, and what it costs to part them from each other.

    Examples
    --------
    >>> one, other, cost = (np.array([value], np.int32) for value in (0, 1, 2))
    >>> least_cut(np.array([9, 0], np.int32), np.array([0, 1], np.int32), [(one, other, cost)]).tolist()
    [True, True]
    """
    size = len(to_source)
    every = np.arange(size)
    source = np.full(size, size)
    sink = np.full(size, size + 1)
    rows = np.concatenate(
        [*(voxels for one, other, _ in links for voxels in (one, other)), source, every]
    )
    columns = np.concatenate(
        [*(voxels for one, other, _ in links for voxels in (other, one)), every, sink]
    )
    costs = np.concatenate(
        [*(cost for *_, cost in links for _ in range(2)), to_source, to_sink]
    ).astype(np.int32)
    counts = costs > 0
    graph = coo_array(
        (costs[counts], (rows[counts], columns[counts])), shape=(size + 2, size + 2)
    ).tocsr()
    left = graph - maximum_flow(graph, size, size + 1).flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    reached = np.zeros(size + 2, np.bool_)
    reached[breadth_first_order(left, size, return_predecessors=False)] = True
    return reached[:size]
