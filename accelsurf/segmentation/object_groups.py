"""Which objects of an image must be run at once, because they may meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import meeting

#: Positions of objects that are run at once, ascending.
Group = tuple[int, ...]


def united(
    groups: Sequence[Group],
    low: NDArray[np.integer],
    high: NDArray[np.integer],
    pairs: Sequence[tuple[int, int]] = (),
) -> list[Group]:
    """Return groups of which no two have objects whose boxes overlap; one that need not grow is as it was.

    Parameters
    ----------
    groups : sequence of tuple of int
        Disjoint.
    low, high : ndarray (n, 3) of int
        First voxel of the box of each object, and the one after its last. An empty box overlaps none.
    pairs : sequence of (int, int), optional
        Objects that belong to one group whatever their boxes are.

    Returns
    -------
    list of tuple of int
        In order of their first objects, whatever the order of ``groups``.

    Examples
    --------
    >>> low = np.array([[0, 0, 0], [9, 0, 0], [2, 0, 0], [9, 9, 9]])
    >>> united([(0,), (1,), (2,), (3,)], low, np.array([[3, 1, 1], [9, 0, 0], [4, 1, 1], [10, 10, 10]]))
    [(0, 2), (1,), (3,)]
    """
    members = np.array(sorted(place for group in groups for place in group), np.int64)
    group_of = {place: number for number, group in enumerate(groups) for place in group}
    parent = list(range(len(groups)))

    def root(number: int) -> int:
        while parent[number] != number:
            parent[number] = parent[parent[number]]
            number = parent[number]
        return number

    there = members[(low[members] < high[members]).all(axis=1)]
    near = meeting(low[there], high[there])
    overlaps = [(one, int(there[j])) for one, found in zip(there.tolist(), near, strict=True) for j in found]
    for one, other in (*pairs, *overlaps):
        first, second = sorted((root(group_of[one]), root(group_of[other])))
        parent[second] = first
    joined: dict[int, list[int]] = {}
    for number, group in enumerate(groups):
        joined.setdefault(root(number), []).extend(group)
    return sorted(tuple(sorted(group)) for group in joined.values())
