"""How far a surface has moved since an earlier moment."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from accelsurf.levelset.threads import dot

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
    on = np.flatnonzero(area)
    if on.size == 0 or before.cells.size == 0:
        return Displacement(surface.half_width, 1.0)
    band, grid = surface.band, surface.grid
    at = np.minimum(np.searchsorted(before.cells, band.cells[on]), before.cells.size - 1)
    known = before.cells[at] == band.cells[on]
    distance = np.abs(band.psi[on].astype(np.float64) - before.psi[at])
    to_closest, h = band.to_closest[on].astype(np.float64), np.array([grid.hz, grid.hy, grid.hx])
    per_mm = np.sqrt(((to_closest / h) ** 2).sum(axis=1) / np.maximum((to_closest**2).sum(axis=1), 1e-300))
    voxels = np.where(known, distance * per_mm, surface.half_width)
    whole = float(area[on].sum())
    return Displacement(dot(area[on], voxels) / whole, float(area[on][voxels > FAR].sum()) / whole)
