"""Closed meshes as sets of voxels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry

SUFFIXES = (".ply", ".stl", ".obj", ".vtp")
#: Triangles worked on at once, for the sake of memory.
TRIANGLES = 1 << 16


def inside(path: str | Path, geometry: Geometry, ras: bool = False) -> NDArray[np.bool_]:
    """Voxels whose centres are inside a closed mesh.

    Parameters
    ----------
    path : str or Path
        .ply, .stl, .obj or .vtp; mm.
    geometry : Geometry
        The grid.
    ras : bool
        Whether its points are RAS, not LPS.

    Returns
    -------
    ndarray (nz, ny, nx) of bool

    Raises
    ------
    InputError
        When the file cannot be read, or its surface is not closed.
    """
    points, triangles = _read(Path(path))
    if ras:
        points = points * (-1.0, -1.0, 1.0)
    index = geometry.world_to_index(points)
    return _filled(index, triangles, geometry.shape)


def _read(path: Path) -> tuple[NDArray[np.float64], Any]:
    import pyvista

    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: no mesh format that accelsurf reads", f"one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file", "check the path")
    try:
        mesh = pyvista.read(path)
        surface = mesh.extract_surface(algorithm="dataset_surface").triangulate().clean()
    except Exception as error:  # whatever VTK makes of a damaged file
        raise InputError(f"{path}: cannot be read as a mesh ({error})", "is the file complete?") from None
    if surface.n_cells == 0 or surface.n_open_edges > 0:
        raise InputError(
            f"{path}: {surface.n_cells} triangles with {surface.n_open_edges} open edges, expected a closed surface",
            "close its holes first",
        )
    return np.asarray(surface.points, np.float64), surface.regular_faces


def _filled(index: NDArray[np.float64], triangles: Any, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Scan lines along x through every row of voxels: inside after an odd number of crossings of the surface.

    A row that meets an edge exactly is looked at a hair's breadth beside it.
    """
    corners = index[np.asarray(triangles)]
    # (z, y) of the corners, moved off the rows by irrational parts of a voxel.
    plane = corners[:, :, :2] + np.array([1.4142e-7, 1.7321e-7])
    low = np.maximum(np.ceil(plane.min(axis=1)).astype(np.int64), 0)
    high = np.minimum(np.floor(plane.max(axis=1)).astype(np.int64), np.array(shape[:2]) - 1)
    crossings = np.zeros((shape[0], shape[1], shape[2] + 1), np.int32)
    for begin in range(0, len(corners), TRIANGLES):
        some = slice(begin, begin + TRIANGLES)
        at = _crossings(plane[some], corners[some, :, 2], low[some], high[some])
        # The first voxel beyond the crossing.
        np.add.at(crossings, (at[0], at[1], np.clip(np.ceil(at[2]), 0, shape[2]).astype(np.int64)), 1)
    return np.asarray(np.cumsum(crossings, axis=2)[:, :, :-1] % 2 == 1)


def _crossings(
    plane: NDArray[np.float64], depth: NDArray[np.float64], low: NDArray[np.int64], high: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows (z, y) and places x where triangles cross them: their corners' (z, y), x, and the rows they may reach."""
    wide = np.maximum(high - low + 1, 0)
    count = wide[:, 0] * wide[:, 1]
    t = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(t)) - np.repeat(np.cumsum(count) - count, count)
    z, y = low[t, 0] + nth // wide[t, 1], low[t, 1] + nth % wide[t, 1]
    a, b, c = plane[t, 0], plane[t, 1], plane[t, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):  # triangles seen edge on cross no row
        v = ((z - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y - a[:, 1])) / area
        w = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (z - a[:, 0]) * (b[:, 1] - a[:, 1])) / area
    hit = (area != 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    t, v, w = t[hit], v[hit], w[hit]
    x = depth[t, 0] + v * (depth[t, 1] - depth[t, 0]) + w * (depth[t, 2] - depth[t, 0])
    return z[hit], y[hit], x
