"""How far a surface has moved since an earlier moment."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from accelsurf.kernels import statistics

if TYPE_CHECKING:
    from accelsurf.levelset.level_set import LevelSet

#: A part of the surface that is further than so many voxels from an earlier surface is still moving.
FAR = 2.0


class Snapshot(NamedTuple):
    """Band cells in raster order and their psi (mm) at one moment."""

    cells: np.ndarray
    psi: np.ndarray


class Displacement(NamedTuple):
    """How far a surface has moved, voxels: the ``mean`` over its area, and the share of it beyond `FAR`."""

    mean: float
    far: float


def displacement(surface: LevelSet, before: Snapshot) -> Displacement:
    """Distance of a surface from an earlier one, in voxels along the normal and weighted by area.

    Measured at the voxels that the surface cuts now; where the earlier band did not extend, its half width counts.
    """
    _, area = surface.fraction_and_area()
    if before.cells.size == 0:
        return Displacement(surface.half_width, 1.0)
    # A run keeps cells as uint32: the kernel shall not be compiled for both.
    earlier, limits = (before.cells.astype(np.int64, copy=False), before.psi), (FAR, surface.half_width)
    whole, moved, far = surface.workers.block_sums(
        statistics.displacement_sums, area.size, 3, surface.grid, surface.band, area, earlier, limits
    )
    if whole == 0:
        return Displacement(surface.half_width, 1.0)
    return Displacement(float(moved / whole), float(far / whole))
