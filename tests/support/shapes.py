"""Surfaces that several tests start from."""

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet
from tests.support.follow import Lattice


def spheroid(on: Lattice) -> LevelSet:
    """Half axes 1 along z and 0.8 along y and x; the function is no distance, so the first march is tested too."""
    z, y, x = on.points
    return LevelSet(np.sqrt((x**2 + y**2) / 0.64 + z**2) - 1.0, on.spacing)


def ball_on_grid(shape=(12, 16, 20), spacing=(2.0, 1.0, 1.0), direction=None, radius=6.0):
    """psi of a ball in the middle of a grid, and the grid."""
    geometry = Geometry(
        shape, spacing, (-3.0, 4.0, 5.0), np.eye(3) if direction is None else direction
    )
    grid = np.meshgrid(
        *((np.arange(n) - (n - 1) / 2) * h for n, h in zip(shape, spacing, strict=True)),
        indexing="ij",
    )
    psi = (np.sqrt(sum(g**2 for g in grid)) - radius).astype(np.float32)
    return psi, geometry
