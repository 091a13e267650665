"""Closed meshes as sets of voxels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, corner_of
from accelsurf.grid.geometry import Geometry
from accelsurf.io import mesh_closing
from accelsurf.io.files import naming
from accelsurf.io.formats.mesh_header import MeshContent, is_ras
from accelsurf.io.memory import available_memory
from accelsurf.settings import budgets
from accelsurf.settings.mesh_formats import MESH_FORMATS
from accelsurf.settings.registry import load

#: mm; beyond it differences of coordinates are no longer exact to a voxel.
MAX_COORDINATE = 1e12
#: Rows of voxels tested against triangles at once, for the sake of memory.
BATCH_ROWS = 1 << 17


def inside(
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
        What its points are, as of `read`.
    box : tuple of slice, optional
        By default the whole grid.

    Returns
    -------
    ndarray, shape of the box, of bool

    Raises
    ------
    InputError
        As `read`.
    """
    points, triangles = read(path, space)
    index = geometry.world_to_index(points)
    if box is None:
        return voxels_inside(index, triangles, geometry.shape)
    z, y, x = (s.stop - s.start for s in box)
    return voxels_inside(index - np.array(corner_of(box)), triangles, (z, y, x))


def read(path: str | Path, space: str = "") -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a closed mesh; points that are RAS are turned to LPS, by half a turn about z.

    Parameters
    ----------
    path : str or Path
        In one of the formats of `accelsurf.settings.mesh_formats` that can be read.
    space : {"", "lps", "ras"}
        What its points are, where the file does not say it; LPS unless given.

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
        readers = {form.suffix: form.read for form in MESH_FORMATS.values() if form.read is not None}
        if suffix not in readers:
            raise InputError("no mesh format that accelsurf reads", f"one of {', '.join(readers)}")
        if not path.is_file():
            raise InputError("there is no such file", "check the path")
        size = path.stat().st_size
        budgets.MESH_FILE.check(size * budgets.MESH_BYTES_PER_FILE_BYTE, factor=available_memory())
        content = path.read_bytes()
        try:
            mesh = MeshContent(*load(readers[suffix])(content))
            points = np.asarray(mesh.points, np.float64).reshape(-1, 3)
        except MemoryError:
            raise
        except Exception as error:  # whatever a reader makes of a damaged file
            reason = " ".join(str(error).split())[:200]
            hint = error.hint if isinstance(error, InputError) else ""
            raise InputError(f"cannot be read as a mesh ({reason})", hint or "is the file complete?") from None
        if is_ras(mesh.header, space):
            points = points * (-1.0, -1.0, 1.0)
        return closed_mesh(points, mesh.triangles)


def closed_mesh(points: NDArray[Any], triangles: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the same surface with points at the same place made one; refuse what is damaged or open.

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
        `accelsurf.io.mesh_closing.TOLERANCES` says. A triangle that is there several times is there once.

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
    triangles, open_edges = mesh_closing.closed(points, triangles)
    if len(triangles) == 0:
        raise InputError("no triangle in it, expected a closed surface", "is the file complete?")
    if open_edges:
        raise InputError(
            f"{len(triangles)} triangles with {open_edges} open edges, expected a closed surface",
            "close its holes first",
        )
    named, triangles = np.unique(triangles, return_inverse=True)
    return points[named], triangles.reshape(-1, 3)


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
    budgets.MESH_ROWS.check(rows, f"a mesh of {len(triangles)} triangles, which together span many rows of voxels")
    crossings = np.zeros((shape[0], shape[1], shape[2] + 1), np.uint8)  # only odd or even counts: it may overflow
    for begin in range(0, rows, BATCH_ROWS):
        row = np.arange(begin, min(begin + BATCH_ROWS, rows))
        t = np.searchsorted(last, row, side="right")
        nth = row - (last[t] - wide[t, 0] * wide[t, 1])
        at = _crossings(plane[t], corners[t, :, 2], low[t, 0] + nth // wide[t, 1], low[t, 1] + nth % wide[t, 1])
        # The first voxel beyond the crossing.
        np.add.at(crossings, (at[0], at[1], np.clip(np.ceil(at[2]), 0, shape[2]).astype(np.int64)), 1)
    np.cumsum(crossings, axis=2, dtype=np.uint8, out=crossings)
    crossings &= 1
    return np.ascontiguousarray(crossings[:, :, :-1]).view(np.bool_)


def _crossings(
    plane: NDArray[np.float64], depth: NDArray[np.float64], z: NDArray[np.int64], y: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows (z, y) and places x where triangles cross them: of each row the corners' (z, y) and x of one triangle."""
    a, b, c = plane[:, 0], plane[:, 1], plane[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    with np.errstate(all="ignore"):  # triangles seen edge on cross no row: infinite, or not numbers
        v = ((z - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y - a[:, 1])) / area
        w = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (z - a[:, 0]) * (b[:, 1] - a[:, 1])) / area
        hit = (area != 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    depth, v, w = depth[hit], v[hit], w[hit]
    x = depth[:, 0] + v * (depth[:, 1] - depth[:, 0]) + w * (depth[:, 2] - depth[:, 0])
    return z[hit], y[hit], x
