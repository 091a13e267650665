"""Where on its grid a surface is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.kernels import band
from accelsurf.levelset.level_set import LevelSet


def extent_of(surface: LevelSet) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First voxel (3,) of a surface's band, and the one after its last; both 0 without a band."""
    return _extent_of_cells(surface, surface.band.cells)


def inside_extent_of(surface: LevelSet) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First voxel (3,) inside, of those in the band, and the one after the last; both 0 where there are none."""
    return _extent_of_cells(surface, surface.band.cells[surface.band.psi < 0])


def _extent_of_cells(surface: LevelSet, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    out = np.zeros((2, 3), np.int64)
    if cells.size:
        surface.workers.serial(band.extent, cells, surface.grid, out)
    return out[0], out[1]
