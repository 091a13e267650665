"""Distance between two meshes: of points of each to the nearest triangle of the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from accelsurf.grid.arrays import Floats
from accelsurf.measure.surface_mesh import Surface

#: Points looked up at once, for the sake of memory.
BATCH = 1 << 14
#: Number of points looked up first, of the points that may be the farthest.
FIRST = 1 << 8
#: Parts of the side of a large triangle on which points are taken, at most.
MAX_PARTS = 64


def largest_distance(first: Surface, second: Surface, limit: float = np.inf) -> float:
    """The largest distance between two meshes, mm: of points of each to the nearest triangle of the other.

    The points are all vertices, the middles of all edges and the centres of all triangles of both meshes; on triangles
    whose longest side exceeds the mean side of ``first`` also a lattice at most half that mean apart. Between the
    points the distance can be larger, by no more than half the way between them.

    Parameters
    ----------
    first, second : Surface
    limit : float, optional
        The search ends at the first points beyond it; then a distance above the limit is returned.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
    >>> largest_distance(Surface(corners, faces), Surface(corners + [0, 0, -0.25], faces))
    0.25
    """
    step, largest = mean_side(first), 0.0
    for sampled, index in ((second, TriangleIndex(first)), (first, TriangleIndex(second))):
        points = samples(sampled, step)
        # The farthest come first by a cheap upper bound: a point bound below a found distance needs no search.
        bounds = index.bounds(points)
        order = np.argsort(-bounds, kind="stable")
        begin = 0
        size = FIRST
        while begin < len(points) and largest <= limit and bounds[order[begin]] > largest:
            some = order[begin : begin + size]
            largest = max(largest, float(index.closest(points[some])[0].max()))
            begin, size = begin + size, min(2 * size, BATCH)
        if largest > limit:
            return largest
    return largest


def sides(surface: Surface) -> NDArray[np.int64]:
    """The vertex numbers of each edge once, smaller first, (n, 2)."""
    pairs = np.sort(
        surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1
    )
    keys = np.unique(pairs[:, 0] * len(surface.vertices) + pairs[:, 1])
    return np.stack(np.divmod(keys, len(surface.vertices)), axis=1)


def mean_side(surface: Surface) -> float:
    """Mean length of the edges, mm."""
    ends = surface.vertices[sides(surface)]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def samples(surface: Surface, step: float) -> Floats:
    """Vertices, middles of edges, centres of triangles, and lattices half a step apart on large triangles."""
    used, corners = surface.vertices[np.unique(surface.faces)], surface.vertices[surface.faces]
    parts = [used, surface.vertices[sides(surface)].mean(axis=1), corners.mean(axis=1)]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.minimum(np.ceil(longest / step), MAX_PARTS).astype(int)
    for count in np.unique(counts[counts > 1]).tolist():
        i, j = (axis.ravel() for axis in np.indices((2 * count + 1, 2 * count + 1)))
        i, j = i[i + j <= 2 * count], j[i + j <= 2 * count]
        weights = np.stack([i, j, 2 * count - i - j], axis=1) / (2.0 * count)
        parts.append(np.einsum("pk,tkx->tpx", weights, corners[counts == count]).reshape(-1, 3))
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class TriangleIndex:
    """Finds the nearest triangle of a mesh, exactly.

    Triangles of about one size share a tree of their centres: those that can be nearer than the nearest vertex have
    their centre within that distance and the largest radius of the size.
    """

    surface: Surface

    @cached_property
    def _corners(self) -> Floats:
        return self.surface.vertices[self.surface.faces]

    @cached_property
    def _vertices(self) -> cKDTree:
        return cKDTree(self.surface.vertices[np.unique(self.surface.faces)])

    @cached_property
    def _centres(self) -> cKDTree:
        return cKDTree(self._corners.mean(axis=1))

    @cached_property
    def _classes(self) -> list[tuple[cKDTree, NDArray[np.int64], float]]:
        centres = self._corners.mean(axis=1)
        radii = np.linalg.norm(self._corners - centres[:, None], axis=2).max(axis=1)
        size = np.ceil(np.log2(np.maximum(radii, 1e-12))).astype(int)
        found = []
        for exponent in np.unique(size).tolist():
            members = np.flatnonzero(size == exponent)
            found.append((cKDTree(centres[members]), members, float(radii[members].max())))
        return found

    def bounds(self, points: Floats) -> Floats:
        """A distance (n,) that that of points (n, 3) is not above: to the nearest vertex, or to a triangle near by."""
        near = self._centres.query(points)[1]
        bound = np.linalg.norm(nearest_in(points, self._corners[near]) - points, axis=1)
        return np.asarray(np.minimum(bound, self._vertices.query(points)[0]))

    def closest(self, points: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Distance (n,), nearest place (n, 3) and its triangle (n,) for points (n, 3) in mm."""
        reach = self.bounds(points) * (1 + 1e-9) + 1e-12
        whose, which = [], []
        for tree, members, radius in self._classes:
            lists = tree.query_ball_point(points, reach + radius * (1 + 1e-9), return_sorted=False)
            counts = np.fromiter(map(len, lists), np.int64, len(lists))
            found = np.fromiter(chain.from_iterable(lists), np.int64, int(counts.sum()))
            whose.append(np.repeat(np.arange(len(points)), counts))
            which.append(members[found])
        point, triangle = np.concatenate(whose), np.concatenate(which)
        places = nearest_in(points[point], self._corners[triangle])
        distances = np.linalg.norm(places - points[point], axis=1)
        order = np.lexsort((triangle, distances, point))
        first = order[np.searchsorted(point[order], np.arange(len(points)))]
        return distances[first], places[first], triangle[first]


def nearest_in(points: Floats, corners: Floats) -> Floats:
    """Return the place in a triangle (n, 3, 3) that is nearest to its point (n, 3)."""
    from trimesh.triangles import closest_point  # loads half a second of modules

    # The tolerances of trimesh are lengths: triangles as large as 1 at their points make them shares of their size.
    away = corners - points[:, None]
    size = float(np.ptp(corners, axis=1).max(initial=0.0)) or 1.0
    return np.asarray(points + size * closest_point(away / size, np.zeros_like(points)))
