"""Where on its grid a surface is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.kernels import band
from accelsurf.levelset.level_set import LevelSet


def extent_of(surface: LevelSet) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First voxel (3,) of a surface's band, and the one after its last; both 0 without a band."""
    out = np.zeros((2, 3), np.int64)
    if surface.size:
        surface.workers.serial(band.extent, surface.band.cells, surface.grid, out)
    return out[0], out[1]
