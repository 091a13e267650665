"""Surfaces whose triangles repeat their corners: equal corners made one, repeated triangles taken once.

Many programs write each triangle with corners of its own, so that an edge is shared only where the numbers agree.
Where they agree except for rounding, the surface is closed all the same.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Corners at open edges are made one within the first of these distances with which the surface closes, in units of its
#: largest coordinate: what rounding makes of 64-bit floats, of 32-bit floats, and of numbers of six digits. Closer than
#: half of it they always are one.
TOLERANCES = (2.0**-45, 2.0**-18, 2.0**-15)
#: And never farther apart than this share of the usual open edge, so that small triangles stay.
MAX_EDGE_SHARE = 0.25


class Edges(NamedTuple):
    """Edges of triangles: their two points (k, 2), how many triangles each has (k,), and those of each (m, 3)."""

    ends: Ints
    counts: Ints
    of_triangles: Ints


def edges_of(triangles: Ints) -> Edges:
    """The edges of triangles (m, 3)."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    width = int(triangles.max(initial=0)) + 1
    keys, number, counts = np.unique(sides[:, 0] * width + sides[:, 1], return_inverse=True, return_counts=True)
    return Edges(np.stack(np.divmod(keys, width), axis=1), counts, number.reshape(-1, 3))


def closed(points: Floats, triangles: Ints) -> tuple[Ints, int]:
    """Triangles of a closed surface with the same points, and how many edges are open: 0, or they are as they were.

    Parameters
    ----------
    points : ndarray (n, 3) of float64
        No two of them equal.
    triangles : ndarray (m, 3) of int64
    """
    triangles = _with_three_corners(triangles)
    if (edges_of(triangles).counts == 2).all():
        return triangles, 0
    given = without_copies(triangles)
    still_open = _open(given)
    if not len(still_open):
        return given, 0
    # A copy of a triangle may hide that its edges are open.
    ragged = _open(_distinct(triangles)[0])
    corners = np.unique(ragged)
    usual = float(np.median(np.linalg.norm(points[ragged[:, 0]] - points[ragged[:, 1]], axis=1)))
    largest = float(np.abs(points).max())
    for tolerance in TOLERANCES:
        number = np.arange(len(points))
        number[corners] = corners[_welded(points[corners], min(tolerance * largest, MAX_EDGE_SHARE * usual))]
        welded = without_copies(_with_three_corners(number[triangles]))
        if len(welded) and not len(_open(welded)):
            return welded, 0
    return given, len(still_open)


def without_copies(triangles: Ints) -> Ints:
    """Triangles with those that are there several times taken once, or not at all.

    Where a patch is there twice, it is a slip if the surface closes with the patch once, and a wall between two bodies
    if it closes without. If both are so, the directions of its triangles tell: of a wall they are opposite.
    """
    from scipy import sparse

    distinct, counts, has_both_directions = _distinct(triangles)
    twice = np.flatnonzero(counts % 2 == 0)
    if not len(twice):
        return distinct
    _, _, edges = edges_of(distinct)
    # Odd edges without the patches, and what the patches add to each.
    odd = np.bincount(np.delete(edges, twice, axis=0).ravel(), minlength=edges.max() + 1) % 2
    added = np.bincount(edges[twice].ravel(), minlength=len(odd)) % 2
    # Triangles and edges are the nodes: two triangles that share an edge are of one patch.
    links = np.repeat(np.arange(len(twice)), 3), len(twice) + edges[twice].ravel()
    nodes = len(twice) + len(odd)
    graph = sparse.coo_matrix((np.ones(len(links[0]), bool), links), (nodes, nodes))
    patches, patch = sparse.csgraph.connected_components(graph, directed=False)
    patch = patch[: len(twice)]
    opens_without, opens_once, has_two_sides = (np.zeros(patches, bool) for _ in range(3))
    np.logical_or.at(opens_without, patch, odd[edges[twice]].any(axis=1))
    np.logical_or.at(opens_once, patch, ((odd + added) % 2)[edges[twice]].any(axis=1))
    np.logical_or.at(has_two_sides, patch, has_both_directions[twice])
    is_wall = ~opens_without & (opens_once | has_two_sides)
    stays = np.ones(len(distinct), bool)
    stays[twice] = ~is_wall[patch]
    return distinct[stays]


def _distinct(triangles: Ints) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Triangles without copies, in order; how often each is there; and whether as often in either direction."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T[::-1])
    is_first = np.ones(len(order), bool)
    is_first[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    group = np.cumsum(is_first) - 1
    turns = ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    forward = np.any([(triangles == corners[:, turn]).all(axis=1) for turn in turns], axis=0)
    counts = np.bincount(group)
    ahead = np.bincount(group, weights=forward[order]).astype(np.int64)
    first = order[is_first]
    sequence = np.argsort(first)
    return triangles[first[sequence]], counts[sequence], (2 * ahead == counts)[sequence]


def _with_three_corners(triangles: Ints) -> Ints:
    """Triangles that are no line and no point."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _open(triangles: Ints) -> Ints:
    """The ends (k, 2) of open edges: a closed surface has an even number of triangles at each."""
    found = edges_of(triangles)
    return found.ends[found.counts % 2 == 1]


def _welded(places: Floats, cell: float) -> Ints:
    """For each place (n, 3) the number of the first that it is one with: those in a cell of a lattice are.

    Eight lattices, each shifted by half a cell along some axes: what is closer than that shares a cell in one of them.
    """
    from scipy import sparse

    count = len(places)
    if cell <= 0:
        return np.arange(count)
    scaled = (places - places.min(axis=0)) / cell
    before, after = [], []
    for shift in product((0.0, 0.5), repeat=3):
        cells = np.floor(scaled + shift)
        order = np.lexsort(cells.T)
        same = (cells[order[1:]] == cells[order[:-1]]).all(axis=1)
        before.append(order[:-1][same])
        after.append(order[1:][same])
    links = np.concatenate(before), np.concatenate(after)
    graph = sparse.coo_matrix((np.ones(len(links[0]), bool), links), (count, count))
    _, group = sparse.csgraph.connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    return first[group]
