"""Bodies that travel through frames, with exact distances, and how far a surface is from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.track.momentum import SurfaceMomentum
from accelsurf.track.records import SurfacePiece

CUBE = Geometry((24, 24, 24), (1.0, 1.0, 1.0))


def positions(geometry: Geometry) -> np.ndarray:
    """Voxel centres (nz, ny, nx, 3), z y x, mm along the grid's axes."""
    return np.stack(np.indices(geometry.shape), axis=-1) * np.array(geometry.spacing)


def ellipsoid(geometry: Geometry, centre: Sequence[float], axes: Sequence[float]) -> np.ndarray:
    """A function with the sign and nearly the size of the distance (mm) from an ellipsoid, z y x; flat axes: 0."""
    away, half = positions(geometry) - np.asarray(centre, float), np.asarray(axes, float)
    wide = np.array(geometry.shape) > 1
    away, half = away[..., wide], half[wide]
    level = np.sqrt(((away / half) ** 2).sum(axis=-1))
    slope = np.sqrt(((away / half**2) ** 2).sum(axis=-1)) / np.maximum(level, 1e-9)
    return np.asarray((level - 1.0) / np.maximum(slope, 1e-9), np.float32)


def ball(geometry: Geometry, centre: Sequence[float], radius: float) -> np.ndarray:
    """Distance (mm) from a ball, a disc on a single slice."""
    return ellipsoid(geometry, centre, (radius, radius, radius))


def off_ellipsoid(
    momentum: SurfaceMomentum, centre: Sequence[float], axes: Sequence[float]
) -> float:
    """The largest distance (mm, first order) of a surface's points from an ellipsoid."""
    on = momentum.boxed
    points = on.closest_points()[on.surface.front(1.0)] - np.asarray(centre, float)
    points, half = points[:, on.wide], np.asarray(axes, float)[on.wide]
    level = np.sqrt(((points / half) ** 2).sum(axis=1))
    slope = np.sqrt(((points / half**2) ** 2).sum(axis=1)) / level
    return float(np.abs((level - 1.0) / slope).max())


def whole(psi: np.ndarray) -> SurfacePiece:
    """A surface on the whole grid of the frames."""
    return SurfacePiece((0, 0, 0), np.asarray(psi, np.float32))
