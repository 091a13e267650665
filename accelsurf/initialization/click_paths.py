"""A painted stroke as one click: all voxels within a radius of a line, written ``path:X,Y,Z,R;X,Y,Z,R;...``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Box, bounding_box, box_at, enclosing, on_box
from accelsurf.grid.clicks import Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.initialization import starts
from accelsurf.settings import budgets
from accelsurf.settings.wording import shown

#: How it is written; with the suffix ``vox`` in voxels, as a ball.
FORM = "path:X,Y,Z,R;X,Y,Z,R;..."
#: Places along the line, of the smallest step from voxel to voxel, whose voxels always belong to it.
_FINE = 0.4

Floats = NDArray[np.float64]


def parse_path(text: str) -> tuple[Floats, bool]:
    """Read the numbers of a path: rows x, y, z, r, and whether they are voxels.

    Raises
    ------
    UsageError
        When it is not of the form.

    Examples
    --------
    >>> parse_path("path:1,2,3,4;5,6,7,4")[0].tolist()
    [[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 4.0]]
    """
    budgets.PATH.check(len(text), "a path", kind=UsageError)
    rest = text.strip().removeprefix("path:")
    is_vox = rest.endswith("vox")
    try:
        rows = [[float(value) for value in row.split(",")] for row in rest.removesuffix("vox").split(";")]
    except ValueError:
        rows = [[]]
    if any(len(row) != 4 or not 0 <= row[3] or not all(abs(v) <= starts.MAX_LENGTH for v in row) for row in rows):
        raise UsageError(f"click {shown(text)!r}: x, y, z and a radius for each place expected", f"as in {FORM}")
    return np.array(rows), is_vox


def click_of_path(text: str, side: Side, geometry: Geometry, id: int = 1) -> Click:
    """Return the click of a path.

    Parameters
    ----------
    text : str
        ``path:X,Y,Z,R;...``. Between two places the radius changes linearly.
    side : {"inside", "outside"}
    geometry : Geometry
        The image's grid.
    id : int, optional
        Of the object.

    Returns
    -------
    Click
        The voxels whose centres are closer to the line than its radius there, and those that the line passes.

    Raises
    ------
    UsageError
        When it is not of the form.
    InputError
        When no voxel is in it.
    """
    rows, is_vox = parse_path(text)
    finest = min(geometry.steps)
    places = rows[:, 2::-1] if is_vox else geometry.world_to_index(rows[:, :3])
    radii = rows[:, 3] * finest if is_vox else rows[:, 3]
    pieces = [(places[i : i + 2], radii[i : i + 2]) for i in range(max(len(rows) - 1, 1))]
    boxes = (_extent(*piece, geometry) for piece in pieces)
    budgets.PATH_VOXELS.check(sum(int(np.prod(np.maximum(b - a, 0), dtype=object)) for a, b in boxes), f"{side} path")
    parts = [segment_voxels(*piece, geometry) for piece in pieces]
    found = [part for part in parts if part is not None]
    if not found:
        raise InputError(f"{side} {shown(text)!r}: no voxel is in it", starts.extent_hint(geometry))
    box = found[0][0]
    for other, _ in found[1:]:
        box = enclosing(box, other)
    mask = np.zeros([s.stop - s.start for s in box], np.bool_)
    for part_box, voxels in found:
        mask |= on_box(voxels, part_box, box, False)
    return Click(side, box, mask, id)


def segment_voxels(places: Floats, radii: Sequence[float] | Floats, geometry: Geometry) -> tuple[Box, NDArray] | None:
    """Voxels of a piece of a path, in their box; None where none lies in the volume.

    Parameters
    ----------
    places : ndarray (1 or 2, 3)
        Its ends as indices (z, y, x).
    radii : sequence of float
        There, mm.
    geometry : Geometry
    """
    spacing, first, last = np.array(geometry.spacing), places[0], places[-1]
    low, high = _extent(places, radii, geometry)
    if (low >= high).any():
        return None
    axes = np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij", sparse=True)
    along = (last - first) * spacing
    offsets = [(axis - c) * h for axis, c, h in zip(axes, first, spacing, strict=True)]
    length2 = float(along @ along)
    share = sum(o * a for o, a in zip(offsets, along, strict=True)) / length2 if length2 > 0 else 0.0
    share = np.clip(share, 0.0, 1.0)
    distance2 = sum((o - share * a) ** 2 for o, a in zip(offsets, along, strict=True))
    mask = np.asarray(distance2 < (radii[0] + share * (radii[-1] - radii[0])) ** 2)
    mask = np.array(np.broadcast_to(mask, tuple(high - low)))
    count = int(np.sqrt(length2) / (_FINE * min(geometry.steps))) + 2
    line = np.rint(np.linspace(first, last, count)).astype(int) - low
    line = line[((line >= 0) & (line < mask.shape)).all(axis=1)]
    mask[tuple(line.T)] = True
    inner = bounding_box(mask)
    if inner is None:
        return None
    corner = [int(a) + s.start for a, s in zip(low, inner, strict=True)]
    mask = np.ascontiguousarray(mask[inner])
    return box_at((corner[0], corner[1], corner[2]), mask.shape), mask


def _extent(places: Floats, radii: Sequence[float] | Floats, geometry: Geometry) -> tuple[NDArray, NDArray]:
    """First voxel that a piece of a path may reach in the volume, and the one after the last."""
    width, shape = max(radii) / np.array(geometry.spacing), np.array(geometry.shape)
    low = np.clip(np.floor(places.min(axis=0) - width), 0, shape)
    return low.astype(int), np.clip(np.ceil(places.max(axis=0) + width) + 1, 0, shape).astype(int)
