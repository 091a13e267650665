"""A surface put aside and taken back, bit for bit: its band, and one sign for each stretch of voxels beyond it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels import band as band_kernels
from accelsurf.kernels.grid import Band
from accelsurf.levelset.level_set import LevelSet


class SurfaceState(NamedTuple):
    """What `restore_surface` needs.

    ``cells`` (n,) of the band, uint32 where that is enough; ``psi`` (n,) and ``foot`` (n, 3) as in the band;
    ``inside`` bits, whether each stretch of a row beyond the band is inside; ``inside_beyond`` number of such voxels;
    ``requested_half_width`` of the band.
    """

    cells: np.ndarray
    psi: np.ndarray
    foot: np.ndarray
    inside: np.ndarray
    inside_beyond: int
    requested_half_width: float

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return int(self.cells.nbytes + self.psi.nbytes + self.foot.nbytes + self.inside.nbytes)


def checkpoint_surface(surface: LevelSet) -> SurfaceState:
    """Put a surface aside; to be called between two steps.

    The arrays of the band are shared: a step makes new ones and leaves the old as they are.
    """
    band = surface.band
    inside = np.packbits(surface.dense.psi[_stretches(band.cells, surface)] < 0)
    small = surface.dense.psi.size < 2**32
    cells = band.cells.astype(np.uint32) if small else band.cells
    return SurfaceState(cells, band.psi, band.foot, inside, surface._inside_beyond_band, surface.requested_half_width)


def restore_surface(surface: LevelSet, kept: SurfaceState) -> None:
    """Make ``surface``, on the same grid, what it was when ``kept`` was put aside."""
    dense, cells = surface.dense, kept.cells.astype(np.int64)
    first = _stretches(cells, surface)
    signs = np.unpackbits(kept.inside, count=first.size).astype(np.bool_)
    surface._set_width(kept.requested_half_width)
    # Band cells do not matter here: a stretch that they end may run on over them.
    lead = int(first[0]) if first.size else dense.psi.size
    dense.psi[:lead] = surface.gamma
    dense.psi[lead:] = np.repeat(np.where(signs, -surface.gamma, surface.gamma), np.diff(first, append=dense.psi.size))
    dense.slot.fill(-1)
    surface._inside_beyond_band = kept.inside_beyond
    surface.workers.run(band_kernels.store_band, cells.size, dense, Band(cells, kept.psi, kept.foot))
    surface.take_band(Band(cells, kept.psi, kept.foot))


def _stretches(cells: np.ndarray, surface: LevelSet) -> np.ndarray:
    """First voxel of each stretch beyond the band: after a band cell, or at the beginning of a row; in raster order.

    The surface crosses no pair of neighbours outside the band, so a stretch within a row is on one side.
    """
    nx, total = surface.grid.nx, surface.dense.psi.size
    # Few cells of the band are the last ones of a run of neighbours.
    after = cells[np.diff(cells, append=total + 1) != 1] + 1 if cells.size else cells
    after = after[(after < total) & (after % nx != 0)]
    rows = np.arange(0, total, nx)
    if cells.size:
        rows = rows[cells[np.minimum(np.searchsorted(cells, rows), cells.size - 1)] != rows]
    first = np.concatenate([after, rows])
    first.sort(kind="stable")
    return first
