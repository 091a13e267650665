"""Measures on the band: shares of voxels, area, curvature, displacement, and its changes by redistancing."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from accelsurf.kernels import statistics
from accelsurf.kernels.grid import Band, DenseArrays, Grid
from accelsurf.levelset.threads import Workers


class NarrowBand(Protocol):
    """A surface on a narrow band, with the attributes that measures, extensions and closest points read.

    It is a `LevelSet`, which says more of each.
    """

    shape: tuple[int, int, int]
    grid: Grid
    dense: DenseArrays
    band: Band
    workers: Workers
    extension: str
    half_width: float
    gamma: np.float32

    @property
    def size(self) -> int:
        """Number of band cells."""
        ...

    @property
    def smallest_spacing(self) -> float:
        """Smallest spacing of the axes with more than one slice, mm."""
        ...

    @property
    def residues(self) -> np.ndarray | None:
        """Psi (mm) interpolated at the closest point of every cell, (n,); None until psi is a distance."""
        ...

    def fraction_and_area(self) -> tuple[np.ndarray, np.ndarray]:
        """Share of each band voxel that is inside, and its part of the surface's area (mm2), both (n,)."""
        ...


class Measures(NamedTuple):
    """Measures on the band, see `LevelSet.fraction_and_area` and `LevelSet.curvature`.

    ``fraction`` and ``area`` (n,); ``curvature`` and ``variation`` (n,), where they could be measured, as ``resolved``
    (n,) says.
    """

    fraction: np.ndarray
    area: np.ndarray
    curvature: np.ndarray
    variation: np.ndarray
    resolved: np.ndarray


class Motion(NamedTuple):
    """Motion of the band by ``velocity`` (n, 3), mm per unit time, for a time ``dt``."""

    velocity: np.ndarray
    dt: float


class BandChange(NamedTuple):
    """Change of the band by a redistancing.

    ``entered_inside`` and ``left_inside`` are the raveled cells with psi < 0 that came into the band and
    that left it; ``fields`` are the extended fields on the new band.
    """

    entered_inside: np.ndarray
    left_inside: np.ndarray
    fields: list[np.ndarray]


#: A part of the surface that is further than this, voxels, from an earlier surface is still moving.
FAR = 2.0


class Snapshot(NamedTuple):
    """Band cells in raster order and their psi (mm) at one moment."""

    cells: np.ndarray
    psi: np.ndarray


class Displacement(NamedTuple):
    """Displacement of a surface, voxels: the ``mean`` over its area, and the share of it beyond `FAR`."""

    mean: float
    far: float


def displacement(surface: NarrowBand, before: Snapshot) -> Displacement:
    """Distance of a surface from an earlier one, in voxels along the normal and weighted by area.

    Measured at the voxels that the surface cuts now; where the earlier band did not extend, its half width counts.
    """
    _, area = surface.fraction_and_area()
    if before.cells.size == 0:
        return Displacement(surface.half_width, 1.0)
    # A run keeps cells as uint32: the kernel shall not be compiled for both.
    earlier, limits = (
        (before.cells.astype(np.int64, copy=False), before.psi),
        (FAR, surface.half_width),
    )
    whole, moved, far = surface.workers.block_sums(
        statistics.displacement_sums,
        area.size,
        3,
        surface.grid,
        surface.band,
        area,
        earlier,
        limits,
    )
    if whole == 0:
        return Displacement(surface.half_width, 1.0)
    return Displacement(float(moved / whole), float(far / whole))
