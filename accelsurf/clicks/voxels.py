"""Clicks as sets of voxels: of a ball, a path, single voxels or a mask; and on the grid of the image."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import (
    Box,
    Corner,
    box_at,
    enclosing,
    on_box,
    placed_at,
    tightened,
    whole_box,
    widened,
)
from accelsurf.grid.clicks import Click, Clicks, Side
from accelsurf.grid.geometry import Geometry, ball_distance
from accelsurf.settings import budgets

#: Places along the line, of the smallest step from voxel to voxel, whose voxels always belong to it.
_FINE = 0.4
#: A voxel whose centre lies on a ball or a stroke is clicked, up to this part of the radius: a ball of one voxel has 7.
_ROUNDED = 1e-6


def click_of_mask(side: Side, mask: NDArray[np.bool_], id: int = 1) -> Click:
    """Return a click of the voxels of a mask (nz, ny, nx), which has some."""
    tight = tightened(whole_box(mask.shape), mask)
    assert tight is not None
    return Click(side, *tight, id)


def click_of_ball(
    side: Side, centre: Sequence[float], radius: float, geometry: Geometry, id: int = 1
) -> Click:
    """Return a click of the voxels in a ball: its ``centre`` as index (z, y, x), its ``radius`` in mm."""
    nearest = np.clip(np.rint(centre), 0, np.array(geometry.shape) - 1).astype(int)
    a, b, c = (slice(int(i), int(i) + 1) for i in nearest)
    reach = [math.ceil(radius / h) + 1 for h in geometry.spacing]
    box = widened((a, b, c), geometry.shape, reach)
    tight = tightened(
        box, np.asarray(ball_distance(box, geometry.spacing, centre, radius) <= _ROUNDED * radius)
    )
    assert tight is not None
    return Click(side, *tight, id)


def click_of_voxels(side: Side, voxels: NDArray[np.int64], id: int = 1) -> Click:
    """Return a click of some voxels (n, 3), z y x."""
    low, high = voxels.min(axis=0), voxels.max(axis=0) + 1
    mask = np.zeros(tuple(high - low), np.bool_)
    mask[tuple((voxels - low).T)] = True
    z, y, x = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    return Click(side, (z, y, x), mask, id)


def click_of_path(
    side: Side, places: Floats, radii: Floats, geometry: Geometry, id: int = 1
) -> Click | None:
    """Return a click of the voxels of a path; None where none lies in the volume.

    Parameters
    ----------
    side : {"inside", "outside"}
    places : ndarray (n, 3)
        Indices (z, y, x) along it.
    radii : ndarray (n,)
        There, mm; between two places the radius changes linearly.
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
    InputError
        When it is too large.
    """
    pieces = [(places[i : i + 2], radii[i : i + 2]) for i in range(max(len(places) - 1, 1))]
    boxes = (_extent(*piece, geometry) for piece in pieces)
    budgets.PATH_VOXELS.check(
        sum(int(np.prod(np.maximum(b - a, 0), dtype=object)) for a, b in boxes), f"{side} path"
    )
    parts = [segment_voxels(*piece, geometry) for piece in pieces]
    found = [part for part in parts if part is not None]
    if not found:
        return None
    box = functools.reduce(enclosing, (part_box for part_box, _ in found))
    mask = np.zeros([s.stop - s.start for s in box], np.bool_)
    for part_box, voxels in found:
        mask |= on_box(voxels, part_box, box, False)
    return Click(side, box, mask, id)


def segment_voxels(
    places: Floats, radii: Sequence[float] | Floats, geometry: Geometry
) -> tuple[Box, NDArray] | None:
    """Voxels of a piece of a path, in their box; None where none lies in the volume.

    Parameters
    ----------
    places : ndarray (1 or 2, 3)
        Its ends as indices (z, y, x).
    radii : sequence of float
        There, mm.
    geometry : Geometry
    """
    spacing = np.array(geometry.spacing)
    first = places[0]
    last = places[-1]
    low, high = _extent(places, radii, geometry)
    if (low >= high).any():
        return None
    axes = np.meshgrid(
        *[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij", sparse=True
    )
    along = (last - first) * spacing
    offsets = [(axis - c) * h for axis, c, h in zip(axes, first, spacing, strict=True)]
    length2 = float(along @ along)
    share = (
        sum(o * a for o, a in zip(offsets, along, strict=True)) / length2 if length2 > 0 else 0.0
    )
    share = np.clip(share, 0.0, 1.0)
    distance2 = sum((o - share * a) ** 2 for o, a in zip(offsets, along, strict=True))
    reach = (1.0 + _ROUNDED) * (radii[0] + share * (radii[-1] - radii[0]))
    mask = np.asarray(distance2 <= reach**2)
    mask = np.array(np.broadcast_to(mask, tuple(high - low)))
    count = int(np.sqrt(length2) / (_FINE * min(geometry.steps))) + 2
    line = np.rint(np.linspace(first, last, count)).astype(int) - low
    line = line[((line >= 0) & (line < mask.shape)).all(axis=1)]
    mask[tuple(line.T)] = True
    return tightened(box_at((int(low[0]), int(low[1]), int(low[2])), mask.shape), mask)


def _extent(
    places: Floats, radii: Sequence[float] | Floats, geometry: Geometry
) -> tuple[NDArray, NDArray]:
    """First voxel that a piece of a path may reach in the volume, and the one after the last."""
    width, shape = max(radii) / np.array(geometry.spacing), np.array(geometry.shape)
    low = np.clip(np.floor(places.min(axis=0) - width), 0, shape)
    return low.astype(int), np.clip(np.ceil(places.max(axis=0) + width) + 1, 0, shape).astype(int)


def on_image(clicks: Clicks | None, first: Corner, shape: tuple[int, int, int]) -> Clicks | None:
    """Clicks on the image's grid; None without any.

    Parameters
    ----------
    clicks : Clicks or None
        On the grid of the region of interest.
    first : (z, y, x)
        First voxel of that region in the image.
    shape : (nz, ny, nx)
        Of the image.
    """
    if clicks is None or not clicks.clicks:
        return None
    return Clicks(
        tuple(click._replace(box=placed_at(click.box, first)) for click in clicks.clicks), shape
    )


def clicked_voxels(
    clicks: Clicks | None, id: int, first: Corner, box: Box
) -> NDArray[np.bool_] | None:
    """Voxels that are clicked inside or outside of an object; None without clicks.

    Parameters
    ----------
    clicks : Clicks or None
        On the grid of the region of interest.
    id : int
        The object's id.
    first : (z, y, x)
        First voxel of that region in the image.
    box : tuple of slice
        The object's part of the image's grid.
    """
    if clicks is None:
        return None
    marked = np.zeros(tuple(s.stop - s.start for s in box), np.bool_)
    for click in clicks.clicks:
        if click.id == id:
            marked |= on_box(click.mask, placed_at(click.box, first), box, False)
    return marked
