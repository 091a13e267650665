"""Closed meshes: read from files, corners that were written several times joined, and as sets of voxels.

Many programs write each triangle with corners of its own, so that an edge is shared only where the numbers agree.
Where they agree except for rounding, the surface is closed all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.arrays import Floats, Ints
from accelsurf.grid.boxes import Box, corner_of
from accelsurf.grid.geometry import Geometry
from accelsurf.io.files import naming
from accelsurf.io.formats.surface_files import MeshContent, is_ras, read_obj, read_ply, read_stl
from accelsurf.io.memory import available_memory
from accelsurf.settings import budgets

#: Corners at open edges are made one within the first of these distances with which the surface closes, in units of its
#: largest coordinate: the rounding of 64-bit floats, of 32-bit floats, and of numbers of six digits. Closer than
#: half of it they always are one.
TOLERANCES = (2.0**-45, 2.0**-18, 2.0**-15)
#: And never farther apart than this share of the usual open edge, so that small triangles stay.
MAX_EDGE_SHARE = 0.25
#: mm; beyond it differences of coordinates are no longer exact to a voxel.
MAX_COORDINATE = 1e12
#: By the suffix of a file: of its bytes, returns points (n, 3), triangles (m, 3), and the file's description of itself,
#: in which SPACE=RAS is looked for, if it can say that; anything that it raises is reported as a damaged file.
MESH_READERS: dict[str, Callable[[bytes], Any]] = {
    ".ply": read_ply,
    ".stl": read_stl,
    ".obj": read_obj,
}
#: Rows of voxels tested against triangles at once, for the sake of memory.
BATCH_ROWS = 1 << 17


def read_mesh(path: str | Path, space: str = "") -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a closed mesh; points that are RAS are turned to LPS, by half a turn about z.

    Parameters
    ----------
    path : str or Path
        In one of the formats of `accelsurf.settings.mesh_formats` that can be read.
    space : {"", "lps", "ras"}
        Space of its points, where the file does not say it; LPS unless given.

    Returns
    -------
    ndarray (n, 3) of float64, ndarray (m, 3) of int64
        Points in mm, LPS, no two at the same place, and the point numbers of the triangles.

    Raises
    ------
    InputError
        When the file cannot be read, names points that it does not have, its surface is not closed, or its header says
        a space that is not understood or another than ``space``.
    """
    path = Path(path)
    with naming(path):
        suffix = path.suffix.lower()
        if suffix not in MESH_READERS:
            raise InputError(
                "no mesh format that accelsurf reads", f"one of {', '.join(MESH_READERS)}"
            )
        if not path.is_file():
            raise InputError("there is no such file", "check the path")
        size = path.stat().st_size
        budgets.MESH_FILE.check(size * budgets.MESH_BYTES_PER_FILE_BYTE, factor=available_memory())
        content = path.read_bytes()
        try:
            mesh = MeshContent(*MESH_READERS[suffix](content))
            points = np.asarray(mesh.points, np.float64).reshape(-1, 3)
        except MemoryError:
            raise
        except Exception as error:  # whatever a reader makes of a damaged file
            reason = " ".join(str(error).split())[:200]
            hint = error.hint if isinstance(error, InputError) else ""
            raise InputError(
                f"cannot be read as a mesh ({reason})", hint or "is the file complete?"
            ) from None
        if is_ras(mesh.header, space):
            points = points * (-1.0, -1.0, 1.0)
        return closed_mesh(points, mesh.triangles)


def closed_mesh(
    points: NDArray[Any], triangles: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the same surface with points at the same place made one; refuse a damaged or open one.

    Parameters
    ----------
    points : ndarray (n, 3)
        mm.
    triangles : ndarray (m, 3)
        Point numbers.

    Returns
    -------
    ndarray (k, 3) of float64, ndarray (l, 3) of int64
        Where the surface is closed except for rounding, corners that differ by it are one, as
        `TOLERANCES` says. A triangle that is there several times is there once.

    Raises
    ------
    InputError
        When triangles name points that there are not, a corner is no place, or the surface is not closed.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    triangles = np.asarray(triangles, np.int64).reshape(-1, 3)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
        raise InputError(
            f"its triangles name points {triangles.min()} to {triangles.max()}, it has {len(points)}, counted from 0",
            "is the file complete?",
        )
    if not (np.abs(points[triangles]) < MAX_COORDINATE).all():
        raise InputError(
            f"a corner of a triangle is not finite or beyond {MAX_COORDINATE:g} mm, numbers expected",
            "export the mesh again",
        )
    named, triangles = np.unique(triangles, return_inverse=True)
    # Zeros have a sign.
    points, same = np.unique(points[named] + 0.0, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[triangles.reshape(-1, 3)]
    triangles, open_edges = closed_triangles(points, triangles)
    if len(triangles) == 0:
        raise InputError("no triangle in it, expected a closed surface", "is the file complete?")
    if open_edges:
        raise InputError(
            f"{len(triangles)} triangles with {open_edges} open edges, expected a closed surface",
            "close its holes first",
        )
    named, triangles = np.unique(triangles, return_inverse=True)
    return points[named], triangles.reshape(-1, 3)


def closed_triangles(points: Floats, triangles: Ints) -> tuple[Ints, int]:
    """Triangles of a closed surface with the same points, and how many edges are open: 0, or they are as they were.

    Parameters
    ----------
    points : ndarray (n, 3) of float64
        No two of them equal.
    triangles : ndarray (m, 3) of int64
    """
    triangles = _with_three_corners(triangles)
    if (_edges(triangles)[1] == 2).all():
        return triangles, 0
    given = _without_copies(triangles)
    ragged = _open(given)
    if not len(ragged):
        return given, 0
    corners = np.unique(ragged)
    usual = float(np.median(np.linalg.norm(points[ragged[:, 0]] - points[ragged[:, 1]], axis=1)))
    largest = float(np.abs(points).max())
    for tolerance in TOLERANCES:
        number = np.arange(len(points))
        number[corners] = corners[
            _welded(points[corners], min(tolerance * largest, MAX_EDGE_SHARE * usual))
        ]
        welded = _without_copies(_with_three_corners(number[triangles]))
        if len(welded) and not len(_open(welded)):
            return welded, 0
    return given, len(ragged)


def _without_copies(triangles: Ints) -> Ints:
    """Triangles that are there several times, once; or where that leaves edges open, none of those that are a wall."""
    _, first, counts = np.unique(
        np.sort(triangles, axis=1), axis=0, return_index=True, return_counts=True
    )
    once, without = triangles[np.sort(first)], triangles[np.sort(first[counts % 2 == 1])]
    return without if len(without) and len(_open(once)) and not len(_open(without)) else once


def _with_three_corners(triangles: Ints) -> Ints:
    """Triangles that are no line and no point."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _open(triangles: Ints) -> Ints:
    """The ends (k, 2) of open edges: a closed surface has an even number of triangles at each."""
    ends, counts = _edges(triangles)
    return ends[counts % 2 == 1]


def _welded(places: Floats, cell: float) -> Ints:
    """For each place (n, 3) the number of the first that it is one with: those in a cell of a lattice are.

    Eight lattices, each shifted by half a cell along some axes: places closer than that share a cell in one of them.
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


def _edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Edges of triangles (m, 3): their two points (k, 2), and how many triangles each has (k,)."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    width = int(triangles.max(initial=0)) + 1
    keys, counts = np.unique(sides[:, 0] * width + sides[:, 1], return_counts=True)
    return np.stack(np.divmod(keys, width), axis=1), counts


def voxels_in_mesh(
    path: str | Path, geometry: Geometry, space: str = "", box: Box | None = None
) -> NDArray[np.bool_]:
    """Voxels of a grid, or of a box of it, whose centres are inside a closed mesh.

    Parameters
    ----------
    path : str or Path
        In one of the formats of `accelsurf.settings.mesh_formats` that can be read; mm.
    geometry : Geometry
        The grid.
    space : {"", "lps", "ras"}
        Space of its points, as of `read_mesh`.
    box : tuple of slice, optional
        By default the whole grid.

    Returns
    -------
    ndarray, shape of the box, of bool

    Raises
    ------
    InputError
        As `read_mesh`.
    """
    points, triangles = read_mesh(path, space)
    index = geometry.world_to_index(points)
    if box is None:
        return voxels_inside(index, triangles, geometry.shape)
    z, y, x = (s.stop - s.start for s in box)
    return voxels_inside(index - np.array(corner_of(box)), triangles, (z, y, x))


def voxels_inside(
    index: NDArray[np.float64], triangles: NDArray[np.int64], shape: tuple[int, int, int]
) -> NDArray[np.bool_]:
    """Scan lines along x through every row of voxels: inside after an odd number of crossings of the surface.

    A row that would meet an edge exactly is tested slightly beside it.

    Raises
    ------
    InputError
        When the triangles span more rows together than can be tested.
    """
    corners = index[triangles]
    # (z, y) of the corners, moved off the rows by irrational parts of a voxel.
    plane = corners[:, :, :2] + np.array([1.4142e-7, 1.7321e-7])
    ends = np.array(shape[:2])
    low = np.clip(np.ceil(plane.min(axis=1)), 0, ends).astype(np.int64)
    high = np.clip(np.floor(plane.max(axis=1)), -1, ends - 1).astype(np.int64)
    wide = np.maximum(high - low + 1, 0)
    last = np.cumsum(wide[:, 0] * wide[:, 1])  # of the rows of all triangles, one after the other
    rows = int(last[-1]) if len(last) else 0
    budgets.MESH_ROWS.check(
        rows, f"a mesh of {len(triangles)} triangles, which together span many rows of voxels"
    )
    crossings = np.zeros(
        (shape[0], shape[1], shape[2] + 1), np.uint8
    )  # only odd or even counts: it may overflow
    for begin in range(0, rows, BATCH_ROWS):
        row = np.arange(begin, min(begin + BATCH_ROWS, rows))
        t = np.searchsorted(last, row, side="right")
        nth = row - (last[t] - wide[t, 0] * wide[t, 1])
        at = _crossings(
            plane[t], corners[t, :, 2], low[t, 0] + nth // wide[t, 1], low[t, 1] + nth % wide[t, 1]
        )
        # The first voxel beyond the crossing.
        np.add.at(
            crossings, (at[0], at[1], np.clip(np.ceil(at[2]), 0, shape[2]).astype(np.int64)), 1
        )
    np.cumsum(crossings, axis=2, dtype=np.uint8, out=crossings)
    crossings &= 1
    return np.ascontiguousarray(crossings[:, :, :-1]).view(np.bool_)


def _crossings(
    plane: NDArray[np.float64],
    depth: NDArray[np.float64],
    z: NDArray[np.int64],
    y: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows (z, y) and places x where triangles cross them: of each row the corners' (z, y) and x of one triangle."""
    a = plane[:, 0]
    b = plane[:, 1]
    c = plane[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    with np.errstate(all="ignore"):  # triangles seen edge on cross no row: infinite, or not numbers
        v = ((z - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y - a[:, 1])) / area
        w = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (z - a[:, 0]) * (b[:, 1] - a[:, 1])) / area
        hit = (area != 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    depth = depth[hit]
    v = v[hit]
    w = w[hit]
    x = depth[:, 0] + v * (depth[:, 1] - depth[:, 0]) + w * (depth[:, 2] - depth[:, 0])
    return z[hit], y[hit], x
