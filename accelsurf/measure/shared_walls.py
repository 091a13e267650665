"""Surfaces of several objects that share their walls: what parts two objects is one set of triangles, used by both.

Each cube of the grid is split into six tetrahedra in the same way (Kuhn's), so that the split fits across cubes. A
corner belongs to the object that it is inside of, or to none. On each edge between two objects lies a point, where
their psi are equal (of an object and none: where psi is 0); on each face with three of them one more, and in a
tetrahedron with four. Between them lie the polygons that part two objects [1]_. A point depends on its edge, face or
tetrahedron alone: so neither gaps nor overlaps can be, by construction.

References
----------
.. [1] G. M. Nielson and R. Franke, "Computing the separating surface for segmented data", Visualization '97, 1997.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.surface_mesh import Surface

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
#: Parts of an edge that a point keeps from its ends, so that no triangle collapses.
_MARGIN = 1e-3
#: Corners of the six tetrahedra of a cube as offsets z*4 + y*2 + x, each a chain from 0 to 7, and their orientation.
_CHAINS = [
    ((0, 1 << axes[0], (1 << axes[0]) | (1 << axes[1]), 7), float(np.linalg.det(np.eye(3)[list(axes)])))
    for axes in permutations(range(3))
]
#: Corners i, j, k, l in an even order: the wall of i and j has the corners edge, face, middle, face.
_EVEN = ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 2, 0), (2, 3, 0, 1))
#: By which of the labels in order differ from the one before: the corners, alike ones first, and the kind of walls.
_CASES: dict[tuple[bool, bool, bool], tuple[tuple[int, int, int, int], int]] = {
    (True, False, False): ((0, 1, 2, 3), 1),
    (False, False, True): ((3, 2, 1, 0), 1),
    (False, True, False): ((0, 1, 2, 3), 2),
    (False, True, True): ((0, 1, 2, 3), 3),
    (True, False, True): ((1, 2, 3, 0), 3),
    (True, True, False): ((2, 3, 0, 1), 3),
    (True, True, True): ((0, 1, 2, 3), 4),
}
#: Keys of a node: up to three corners of its cube, three bits each.
_CODES = 512


class LabelledObject(Protocol):
    """An object of a result, with what `extract` reads of it: see `accelsurf.run.result.SegmentedObject`."""

    @property
    def id(self) -> int:
        """Its value in the label map."""
        ...

    @property
    def box(self) -> Box:
        """Its part of the image's grid."""
        ...

    @property
    def psi(self) -> NDArray[np.float32]:
        """Signed distance on that part, mm, negative inside."""
        ...

    @property
    def labels(self) -> NDArray[np.uint8]:
        """1 where a voxel's centre is inside."""
        ...


@dataclass(frozen=True, eq=False)
class _Block:
    """The part of the grid around all objects, one node wider on each side.

    Attributes
    ----------
    labels : ndarray (nz, ny, nx), int64
        The id that each node belongs to; 0 of none.
    first : ndarray (3,)
        Index (z, y, x) of its first node on the objects' common grid.
    """

    labels: Ints
    first: Ints

    @property
    def offsets(self) -> Ints:
        """Offsets of the corners of a cube from its first in node numbers; corner z*4 + y*2 + x."""
        _, ny, nx = self.labels.shape
        return np.array([(o >> 2 & 1) * ny * nx + (o >> 1 & 1) * nx + (o & 1) for o in range(8)], np.int64)


def extract(objects: Sequence[LabelledObject], geometry: Geometry) -> dict[int, Surface]:
    """The closed surfaces of objects, by their ids; where two touch, both have the same triangles, turned round.

    Parameters
    ----------
    objects : sequence of LabelledObject
        Which do not overlap.
    geometry : Geometry
        The grid that their boxes lie on, of more than one slice along each axis.

    Returns
    -------
    dict of int to Surface
        Those that have a voxel.
    """
    present = [segmented for segmented in objects if segmented.labels.any()]
    if not present:
        return {}
    block = _block_of(present, geometry)
    polygons = _polygons(block, *_tetrahedra(block))
    keys, places = np.unique(np.concatenate([corners.ravel() for corners, _ in polygons]), return_inverse=True)
    world = geometry.index_to_world(_Points(block, present, geometry).of(keys))
    order = (0, 1, 2) if np.linalg.det(geometry.direction) > 0 else (2, 1, 0)
    triangles, sides, begin = [], [], 0
    for corners, pair in polygons:
        numbers = places[begin : begin + corners.size].reshape(corners.shape)
        begin += corners.size
        for last in range(2, corners.shape[1]):
            triangles.append(numbers[:, (0, last - 1, last)][:, order])
            sides.append(pair)
    faces, ids = np.concatenate(triangles), np.concatenate(sides)
    return {segmented.id: _surface_of(segmented.id, faces, ids, world) for segmented in present}


def _surface_of(object_id: int, faces: Ints, ids: Ints, world: Floats) -> Surface:
    """The triangles that part one object from all others, facing outwards."""
    mine = np.concatenate([faces[ids[:, 0] == object_id], faces[ids[:, 1] == object_id][:, ::-1]])
    used, numbers = np.unique(mine, return_inverse=True)
    return Surface(world[used], np.ascontiguousarray(numbers.reshape(-1, 3), np.int32))


def _block_of(objects: Sequence[LabelledObject], geometry: Geometry) -> _Block:
    boxes = [
        [side.indices(n)[:2] for side, n in zip(segmented.box, geometry.shape, strict=True)] for segmented in objects
    ]
    low = np.min([[side[0] for side in box] for box in boxes], axis=0) - 1
    high = np.max([[side[1] for side in box] for box in boxes], axis=0) + 1
    labels = np.zeros(high - low, np.int64)
    for segmented, box in zip(objects, boxes, strict=True):
        part = labels[tuple(slice(a - f, b - f) for (a, b), f in zip(box, low, strict=True))]
        part[segmented.labels > 0] = segmented.id
    return _Block(labels, low)


def _tetrahedra(block: _Block) -> tuple[Ints, Floats]:
    """Node numbers (n, 4) of the tetrahedra whose corners do not all belong to one, and their orientations."""
    offsets, flat = block.offsets, block.labels.ravel()
    numbers = np.arange(flat.size, dtype=np.int64).reshape(block.labels.shape)[:-1, :-1, :-1].ravel()
    mixed = np.zeros(len(numbers), bool)
    for offset in offsets[1:]:
        mixed |= flat[numbers + offset] != flat[numbers]
    cubes, found, signs = numbers[mixed], [], []
    for chain, sign in _CHAINS:
        corners = cubes[:, None] + offsets[list(chain)]
        some = (flat[corners] != flat[corners[:, :1]]).any(axis=1)
        found.append(corners[some])
        signs.append(np.full(int(some.sum()), sign))
    return np.concatenate(found), np.concatenate(signs)


def _polygons(block: _Block, tetrahedra: Ints, signs: Floats) -> list[tuple[Ints, Ints]]:
    """Corners (n, 3 or 4) of polygons as keys of points, and the ids (n, 2) from and to which their normals point."""
    labels = block.labels.ravel()[tetrahedra]
    order = np.argsort(labels, axis=1, kind="stable")
    nodes, ids = np.take_along_axis(tetrahedra, order, 1), np.take_along_axis(labels, order, 1)
    signs = signs * _parities(order)
    steps = ids[:, 1:] != ids[:, :-1]
    out: list[tuple[Ints, Ints]] = []
    for pattern, (corners, kind) in _CASES.items():
        some = (steps == pattern).all(axis=1)
        positive = signs[some] * _parities(np.array([corners]))[0] > 0
        picked = list(corners)
        for points, sides in _walls(block, nodes[some][:, picked], ids[some][:, picked], kind):
            out.append((np.where(positive[:, None], points, points[:, ::-1]), sides))
    return out


def _parities(order: Ints) -> Floats:
    """+1 for even orders of four, -1 for odd ones: by the number of pairs that are turned round."""
    pairs = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    turned = sum((order[:, a] > order[:, b]).astype(np.int64) for a, b in pairs)
    return np.where(turned % 2 == 0, 1.0, -1.0)


def _walls(block: _Block, nodes: Ints, ids: Ints, kind: int) -> list[tuple[Ints, Ints]]:
    """The polygons of tetrahedra of positive orientation, by how many kinds of corners there are in which order."""

    def point(*corners: int) -> Ints:
        return _keys(block, nodes[:, corners])

    def sides(a: int, b: int) -> Ints:
        return ids[:, (a, b)]

    if kind == 1:  # one corner against three
        return [(np.stack([point(0, 1), point(0, 2), point(0, 3)], 1), sides(0, 1))]
    if kind == 2:  # two against two
        return [(np.stack([point(0, 2), point(0, 3), point(1, 3), point(1, 2)], 1), sides(0, 2))]
    if kind == 3:  # two alike, and two of their own
        first, second = point(0, 2, 3), point(1, 2, 3)
        return [
            (np.stack([point(0, 2), first, second, point(1, 2)], 1), sides(0, 2)),
            (np.stack([first, point(0, 3), point(1, 3), second], 1), sides(0, 3)),
            (np.stack([point(2, 3), first, second], 1), sides(2, 3)),
        ]
    middle = point(0, 1, 2, 3)
    return [
        (np.stack([point(i, j), point(i, j, k), middle, point(i, j, m)], 1), sides(i, j)) for i, j, k, m in _EVEN
    ]


def _keys(block: _Block, nodes: Ints) -> Ints:
    """One number for an edge, face or tetrahedron: its first node, and which corners of its cube the others are."""
    ordered, keys = np.sort(nodes, axis=1), np.zeros(len(nodes), np.int64)
    for place in range(1, nodes.shape[1]):
        keys = keys * 8 + np.searchsorted(block.offsets, ordered[:, place] - ordered[:, 0])
    return ordered[:, 0] * _CODES + keys


class _Points:
    """Positions of the points of edges, faces and tetrahedra, as indices (z, y, x) on the objects' common grid."""

    def __init__(self, block: _Block, objects: Sequence[LabelledObject], geometry: Geometry) -> None:
        self._block, self._objects, self._shape = block, objects, np.array(geometry.shape)
        self._far = max(float(np.abs(segmented.psi).max()) for segmented in objects)

    def of(self, keys: Ints) -> Floats:
        """The places (n, 3) of points."""
        offsets, codes = self._block.offsets, keys % _CODES
        counts = 2 + (codes >= 8).astype(np.int64) + (codes >= 64)
        out = np.empty((len(keys), 3))
        for count in (2, 3, 4):
            some = counts == count
            first, code = keys[some] // _CODES, codes[some]
            nodes = [first, *(first + offsets[code >> 3 * (count - 2 - place) & 7] for place in range(count - 1))]
            edges = [self._of_edge(a, b) for n, a in enumerate(nodes) for b in nodes[n + 1 :]]
            out[some] = np.mean(edges, axis=0) if len(edges) > 1 else edges[0]
        return out

    def _of_edge(self, begins: Ints, ends_at: Ints) -> Floats:
        """Return the place on an edge where the psi of both ends' objects are equal; half a voxel beyond the border."""
        labels = self._block.labels.ravel()
        here, there = labels[begins], labels[ends_at]
        begin = self._psi(here, begins) - self._psi(there, begins)
        end = self._psi(here, ends_at) - self._psi(there, ends_at)
        ends = [self._index(nodes) for nodes in (begins, ends_at)]
        beyond = np.zeros(len(begins), bool)
        for index in ends:
            beyond |= ((index < 0) | (index >= self._shape)).any(axis=1)
        share = np.divide(begin, begin - end, out=np.full(len(begins), 0.5), where=(begin != end) & ~beyond)
        share = np.clip(share, _MARGIN, 1 - _MARGIN)[:, None]
        return (1 - share) * ends[0] + share * ends[1]

    def _index(self, nodes: Ints) -> Ints:
        return np.stack(np.unravel_index(nodes, self._block.labels.shape), axis=1) + self._block.first

    def _psi(self, labels: Ints, nodes: Ints) -> Floats:
        """The psi at nodes of the objects that labels name; 0 of none, far outside beyond an object's box."""
        out, index = np.zeros(len(nodes)), self._index(nodes)
        for segmented in self._objects:
            members = np.flatnonzero(labels == segmented.id)
            local = index[members] - [side.start or 0 for side in segmented.box]
            inside = ((local >= 0) & (local < segmented.psi.shape)).all(axis=1)
            out[members] = self._far
            out[members[inside]] = segmented.psi[tuple(local[inside].T)]
        return out
