"""Surfaces that several tests start from."""

import numpy as np

from accelsurf.levelset import LevelSet
from tests.support.follow import Lattice


def spheroid(on: Lattice) -> LevelSet:
    """Half axes 1 along z and 0.8 along y and x; the function is no distance, so the first march is tested too."""
    z, y, x = on.points
    return LevelSet(np.sqrt((x**2 + y**2) / 0.64 + z**2) - 1.0, on.spacing)
