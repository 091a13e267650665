"""Fields on the band: extended along normals, and transferred to a new band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from accelsurf.kernels import band as band_kernels
from accelsurf.kernels import transport
from accelsurf.kernels.grid import Band

if TYPE_CHECKING:
    from accelsurf.levelset.level_set import LevelSet
    from accelsurf.levelset.threads import Workers


#: How distances and fields get from the front to the cells further off: by closest points, or by a fast march.
CLOSEST_POINT, FAST_MARCHING = "closest-point", "fast-marching"


class ExtensionTable(NamedTuple):
    """Where cells off the front read the front's values, see `kernels.band.outward_table`.

    ``front`` (n,) bool; ``off`` (m,) uint32 slots that are extended to; ``slots`` (m, 8) uint32 and ``shares`` (m, 8)
    float32 of the cells that they read. Unsigned: a kernel tests a signed index for being negative.
    """

    front: np.ndarray
    off: np.ndarray
    slots: np.ndarray
    shares: np.ndarray

    def extend(self, workers: Workers, values: np.ndarray) -> None:
        """Overwrite ``values`` (n,) at the slots ``off``."""
        workers.parallel(band_kernels.extend_outwards, self.off.size, self.off, self.slots, self.shares, values)


def extension_table(surface: LevelSet, front: np.ndarray, off: np.ndarray) -> ExtensionTable:
    """Return the table by which the slots ``off`` (m,) read the cells of ``front`` (n,)."""
    off = off.astype(np.uint32)
    table = np.empty((off.size, 8), np.uint32), np.empty((off.size, 8), np.float32)
    surface.workers.parallel(
        band_kernels.outward_table, off.size, surface.dense.slot, surface.grid, surface.band, front, off, table
    )
    return ExtensionTable(front, off, *table)


class QuadraticExtension(NamedTuple):
    """As `ExtensionTable`, with quadratic interpolation among the front's cells: `kernels.band.quadratic_table`.

    A Laplacian divides the error of an extension by h^2: that of linear interpolation would not vanish with h.
    ``mirrored`` (m,) int8 has bit a set where values beyond a border across axis a count.
    """

    front: np.ndarray
    off: np.ndarray
    slots: np.ndarray
    shares: np.ndarray
    mirrored: np.ndarray

    def extend(self, workers: Workers, values: np.ndarray) -> None:
        """Overwrite ``values`` (n,) at the slots ``off``."""
        workers.parallel(band_kernels.extend_quadratically, self.off.size, self.off, self.slots, self.shares, values)

    def turned(self, surface: LevelSet, component: int) -> QuadraticExtension:
        """The extension of a vector's ``component``: beyond the borders across that axis it has the other sign."""
        rows = np.flatnonzero(self.mirrored & (1 << component))
        if rows.size == 0:
            return self
        shares = self.shares.copy()
        shares[rows] = quadratic_extension(surface, self.front, self.off[rows], component).shares
        return self._replace(shares=shares)


def cells_beside(surface: LevelSet, front: np.ndarray) -> np.ndarray:
    """Slots (m,) off the ``front`` (n,) with a 6-neighbour on it: a Laplacian there needs no others."""
    off = np.flatnonzero(~front)
    beside = np.empty(off.size, np.bool_)
    where = surface.dense.slot, surface.grid, surface.band.cells
    surface.workers.parallel(band_kernels.beside_front, off.size, *where, front, off, beside)
    return off[beside]


def quadratic_extension(
    surface: LevelSet, front: np.ndarray, off: np.ndarray, component: int = -1
) -> QuadraticExtension:
    """Return the table by which the slots ``off`` (m,) read the cells of ``front`` (n,), see `turned` of the result."""
    off = off.astype(np.uint32)
    table = np.empty((off.size, 10), np.uint32), np.empty((off.size, 10), np.float32), np.empty(off.size, np.int8)
    where = surface.dense.slot, surface.grid, surface.band
    surface.workers.parallel(band_kernels.quadratic_table, off.size, *where, front, off, component, table)
    return QuadraticExtension(front, off, *table)


def sampled(
    surface: LevelSet, new: Band, front: np.ndarray, fields: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return fields (n_old,) on the ``front`` (n,) of a new band: their values at each closest point."""
    if not fields:
        return []
    values = np.stack([np.asarray(field, np.float32) for field in fields])
    out = np.empty((len(fields), new.cells.size), np.float32)
    surface.workers.parallel(
        band_kernels.sample_at_feet, new.cells.size, surface.dense.slot, surface.grid, new, front, values, out
    )
    return list(out)


def advected(
    surface: LevelSet, new: Band, fields: Sequence[np.ndarray], velocity: np.ndarray, dt: float
) -> list[np.ndarray]:
    """Return fields (n_old,) on a new band, from the points that ``velocity`` (n_old, 3) moved there in ``dt``.

    The first three are the velocity's components; what it transports, such as a density, is interpolated and limited.
    """
    values = np.stack(fields, axis=1).astype(np.float32, copy=False)
    out = np.empty((new.cells.size, len(fields)), np.float32)
    surface.workers.parallel(
        transport.advect_fields, new.cells.size, surface.dense.slot, surface.grid, new, (velocity, dt, 3), values, out
    )
    return [np.ascontiguousarray(out[:, c]) for c in range(len(fields))]
