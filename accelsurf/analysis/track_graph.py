"""Tracks as a graph: an object in a frame is a vertex, and links lead from a frame to a later one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np


class Stretch(NamedTuple):
    """Frames in which an object is seen without a break: what the Cell Tracking Challenge calls a track.

    ``label`` is its own number, ``id`` the object's; ``parents`` are labels of the stretches that it continues: the one
    before a gap, those that divided or merged into it.
    """

    label: int
    id: int
    first: int
    last: int
    parents: tuple[int, ...] = ()


def stretches(frames: Mapping[int, Sequence[int]], parents: Mapping[int, Iterable[int]]) -> list[Stretch]:
    """Return the stretches of objects, by label.

    The first of an object has the object's id as its label, further ones have labels above all ids.

    Parameters
    ----------
    frames : mapping of int to sequence of int
        Of each object the frames in which it is seen, rising.
    parents : mapping of int to iterable of int
        Of each object those that it came from; one that is never seen before it counts for nothing.

    Examples
    --------
    >>> for one in stretches({1: [0, 1, 4], 2: [5]}, {2: [1]}):
    ...     print(one)
    Stretch(label=1, id=1, first=0, last=1, parents=())
    Stretch(label=2, id=2, first=5, last=5, parents=(3,))
    Stretch(label=3, id=1, first=4, last=4, parents=(1,))
    """
    seen = {own: numbers for own, numbers in frames.items() if len(numbers)}
    found: list[Stretch] = []
    runs_of: dict[int, list[Stretch]] = {}
    fresh = max(seen, default=0)
    for own in sorted(seen, key=lambda n: (seen[n][0], n)):
        before = (_before(runs_of.get(parent, ()), seen[own][0]) for parent in sorted(parents.get(own, ())))
        came_from = tuple(one.label for one in before if one is not None)
        for number, (first, last) in enumerate(runs(seen[own])):
            label = own
            if number:
                fresh += 1
                label = fresh
            found.append(Stretch(label, own, first, last, came_from))
            runs_of.setdefault(own, []).append(found[-1])
            came_from = (label,)
    return sorted(found)


def _before(of_parent: Iterable[Stretch], frame: int) -> Stretch | None:
    """The last stretch that ends before a frame."""
    return max((one for one in of_parent if one.last < frame), key=lambda one: one.last, default=None)


def runs(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers.

    Examples
    --------
    >>> runs([0, 1, 2, 5, 7, 8])
    [(0, 2), (5, 5), (7, 8)]
    """
    places = np.asarray(numbers)
    parts = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return [(int(one[0]), int(one[-1])) for one in parts]
