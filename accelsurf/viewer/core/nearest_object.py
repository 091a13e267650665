"""The object of a run that a click is meant for, when the user has not said so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner
from accelsurf.grid.geometry import Geometry
from accelsurf.run.clicks import BallEdit
from accelsurf.run.evolving_object import EvolvingObject
from accelsurf.run.run import Run
from accelsurf.settings.coordinates import split_suffix
from accelsurf.starts import starts


def nearest_object(run: Run, where: str) -> int:
    """Return the id of the object that is nearest to a place; the one that contains it, if there is one.

    Parameters
    ----------
    run : Run
        Between two steps.
    where : str
        ``ball:X,Y,Z,R``, of which it is the centre, ``point:X,Y,Z``, or ``path:X,Y,Z,R;...``, which begins there.

    Raises
    ------
    UsageError, InputError
        When it is no such place or lies outside.
    """
    centre = BallEdit("add", *starts.ball_of(_as_ball(where, run.geometry), run.geometry)).on_level(run.grid)[0]
    return min(run.objects, key=lambda evolving: _distance(evolving, centre)).id


def place_of(where: str, geometry: Geometry) -> NDArray[np.float64]:
    """Return a place, as `nearest_object` takes it, as an index (z, y, x) of a grid.

    Raises
    ------
    UsageError, InputError
        When it is no such place or lies outside.
    """
    return np.array(starts.ball_of(_as_ball(where, geometry), geometry)[0], float)


def distance_of(
    psi: NDArray[np.float32], corner: Corner, box: Box | None, place: NDArray[np.float64],
    spacing: tuple[float, float, float],
) -> float:
    """Return the distance, mm, of a place from an object; below 0 in it; inf where it has no voxel.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        Negative inside, from voxel ``corner`` on.
    corner : (z, y, x)
    box : tuple of slice or None
        Where it may be inside; counted as ``place``.
    place : (z, y, x)
        Index.
    spacing : (hz, hy, hx)
    """
    if box is None:
        return float("inf")
    z, y, x = (slice(max(s.start - c, 0), max(s.stop - c, 0)) for s, c in zip(box, corner, strict=True))
    part = psi[z, y, x]
    at = place - np.array(corner) - np.array([z.start, y.start, x.start])
    return _depth(part, at) or _away(np.argwhere(part < 0), at, spacing)


def _as_ball(where: str, geometry: Geometry) -> str:
    """A ball at a place."""
    kind, _, rest = where.partition(":")
    if kind in ("point", "path"):
        body, suffix = split_suffix(rest)
        first = body.partition(";")[0].split(",")[:3]
        try:
            numbers = [repr(number) for number in suffix.in_lps([float(word) for word in first])]
        except ValueError:
            numbers = first  # the reader of the ball says what is wrong
        # Its voxel has its centre within a ball of this radius.
        radius = float(np.linalg.norm(geometry.spacing)) + 1.0
        where = f"ball:{','.join(numbers)},{radius:g}{'vox' if suffix.vox else ''}"
    return where


def _distance(evolving: EvolvingObject, place: np.ndarray) -> float:
    """Distance, mm, of an index (z, y, x) on the level's grid from an object; not above 0 in it; inf without a surface.

    Accurate to about a voxel.
    """
    surface = evolving.surface
    if surface.size == 0:
        return float("inf")
    at = place - evolving.corner
    cells = surface.band.cells[surface.band.psi < 0]
    inside = np.stack(np.unravel_index(cells, surface.shape), axis=1)
    return _depth(surface.psi, at) or _away(inside, at, evolving.grid.spacing)


def _depth(psi: NDArray[np.float32], place: NDArray[np.float64]) -> float:
    """Psi at the voxel of a place where that is inside, which is below 0; else 0."""
    voxel = np.rint(place).astype(int)
    is_there = (voxel >= 0).all() and (voxel < psi.shape).all()
    return min(float(psi[tuple(voxel)]), 0.0) if is_there else 0.0


def _away(
    voxels: NDArray[np.int64], place: NDArray[np.float64], spacing: tuple[float, float, float]
) -> float:
    """Distance, mm, of a place from the nearest of some voxels (n, 3); inf where there are none."""
    return float(np.linalg.norm((voxels - place) * spacing, axis=1).min(initial=np.inf))
