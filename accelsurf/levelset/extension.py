"""Fields on the band: extended along normals, and transferred to a new band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.kernels import band as band_kernels
from accelsurf.kernels import motion, transport
from accelsurf.kernels.grid import Band
from accelsurf.levelset.measures import Motion, NarrowBand
from accelsurf.levelset.threads import Workers

#: How distances and fields get from the front to the cells further off: by closest points, or by a fast march.
CLOSEST_POINT = "closest-point"
FAST_MARCHING = "fast-marching"


class ExtensionTable(NamedTuple):
    """Table of the places where cells off the front read the front's values, see `kernels.band.outward_table`.

    ``front`` (n,) bool; ``off`` (m,) uint32 slots that are extended to; ``slots`` (m, 8) uint32 and ``shares`` (m, 8)
    float32 of the cells that they read. Unsigned: a kernel tests a signed index for being negative.
    """

    front: np.ndarray
    off: np.ndarray
    slots: np.ndarray
    shares: np.ndarray

    def extend(self, workers: Workers, values: np.ndarray) -> None:
        """Overwrite ``values`` (n,) at the slots ``off``."""
        workers.parallel(
            band_kernels.extend_outwards, self.off.size, self.off, self.slots, self.shares, values
        )


def extension_table(surface: NarrowBand, front: np.ndarray, off: np.ndarray) -> ExtensionTable:
    """Return the table by which the slots ``off`` (m,) read the cells of ``front`` (n,)."""
    off = off.astype(np.uint32)
    table = np.empty((off.size, 8), np.uint32), np.empty((off.size, 8), np.float32)
    surface.workers.parallel(
        band_kernels.outward_table,
        off.size,
        surface.dense.slot,
        surface.grid,
        surface.band,
        front,
        off,
        table,
    )
    return ExtensionTable(front, off, *table)


class FrontRows(NamedTuple):
    """The front and the cells beside it one after the other: the stages of a diffusion read and write these rows alone.

    ``front`` (n,) bool; ``on`` (m,) and ``off`` (k,) are the slots of the rows; ``order`` (m + k,) the rows' numbers;
    ``neighbours`` (m, 6) the rows of the 6-neighbours of those on the front. ``read`` (k, 10) are the rows that those
    beside it read, by ``shares`` (k, 10), with quadratic interpolation: `kernels.band.quadratic_table`. A Laplacian
    divides the error of an extension by h^2: that of linear interpolation would not vanish with h. ``mirrored`` (k,)
    int8 has bit a set where values beyond a border across axis a count, ``walls`` (m,) int8 at the cells beside it.
    Rows are uint32, as a kernel tests a signed index for being negative; slots are int64, with which numpy gathers.
    """

    front: np.ndarray
    on: np.ndarray
    off: np.ndarray
    order: np.ndarray
    neighbours: np.ndarray
    read: np.ndarray
    shares: np.ndarray
    mirrored: np.ndarray
    walls: np.ndarray

    def extend(self, workers: Workers, values: np.ndarray) -> None:
        """Overwrite ``values`` (m + k,) in the rows beside the front."""
        beside = self.order[self.on.size :]
        workers.parallel(
            band_kernels.extend_quadratically, self.off.size, beside, self.read, self.shares, values
        )

    def turned(self, surface: NarrowBand, component: int) -> FrontRows:
        """The rows of a vector's ``component``: beyond the borders across that axis it has the other sign."""
        turning = np.flatnonzero(self.mirrored & (1 << component))
        if turning.size == 0:
            return self
        row_of = np.full(surface.size, -1, np.int32)
        row_of[self.on] = self.order[: self.on.size]
        shares = self.shares.copy()
        _, shares[turning], _ = _quadratic_table(surface, row_of, self.off[turning], component)
        return self._replace(shares=shares)


def front_rows(surface: NarrowBand, front: np.ndarray) -> FrontRows:
    """The rows of the ``front`` (n,) and of the cells beside it: a Laplacian on the front reads no others."""
    parallel = surface.workers.parallel
    n = surface.size
    on = np.flatnonzero(front)
    slots = np.empty((on.size, 6), np.int32)
    walls = np.empty(on.size, np.int8)
    near = np.zeros(n, np.bool_)
    where = surface.dense.slot, surface.grid, surface.band.cells
    parallel(motion.neighbour_slots, on.size, *where, on, (slots, walls, near))
    off = np.flatnonzero(near > front)
    order = np.arange(on.size + off.size, dtype=np.uint32)
    row_of = np.full(n, -1, np.int32)
    row_of[on] = order[: on.size]
    table = _quadratic_table(surface, row_of, off, -1)
    row_of[off] = order[on.size :]
    neighbours = np.empty(slots.shape, np.uint32)
    parallel(motion.rows_of_slots, on.size, row_of, slots, neighbours)
    return FrontRows(front, on, off, order, neighbours, *table, walls)


def _quadratic_table(
    surface: NarrowBand, row_of: np.ndarray, off: np.ndarray, component: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find how the slots ``off`` (k,) read the rows ``row_of`` (n,) has: (read, shares, mirrored), see `FrontRows`."""
    table = (
        np.empty((off.size, 10), np.uint32),
        np.empty((off.size, 10), np.float32),
        np.empty(off.size, np.int8),
    )
    where = surface.dense.slot, surface.grid, surface.band
    surface.workers.parallel(
        band_kernels.quadratic_table, off.size, *where, row_of, off, component, table
    )
    return table


def sampled(
    surface: NarrowBand, new: Band, front: np.ndarray, fields: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return fields (n_old,) on the ``front`` (n,) of a new band: their values at each closest point."""
    if not fields:
        return []
    values = np.stack([np.asarray(field, np.float32) for field in fields])
    out = np.empty((len(fields), new.cells.size), np.float32)
    surface.workers.parallel(
        band_kernels.sample_at_closest_points,
        new.cells.size,
        surface.dense.slot,
        surface.grid,
        new,
        front,
        values,
        out,
    )
    return list(out)


def advected(
    surface: NarrowBand, new: Band, fields: Sequence[np.ndarray], moved: Motion
) -> list[np.ndarray]:
    """Return fields (n_old,) on a new band, from the points that ``moved`` there.

    The first three are the velocity's components; transported fields, like a density, are interpolated and limited.
    """
    if not fields:
        return []
    values = np.stack(fields, axis=1).astype(np.float32, copy=False)
    out = np.empty((new.cells.size, len(fields)), np.float32)
    motion = four_columns(moved.velocity), moved.dt, 3
    surface.workers.parallel(
        transport.advect_fields,
        new.cells.size,
        surface.dense.slot,
        surface.grid,
        new,
        motion,
        values,
        out,
    )
    return [np.ascontiguousarray(out[:, c]) for c in range(len(fields))]


def four_columns(velocity: np.ndarray) -> np.ndarray:
    """A velocity (n, 3) with a column of 0, (n, 4) float32: four columns are interpolated in vectors."""
    out = np.zeros((velocity.shape[0], 4), np.float32)
    out[:, :3] = velocity
    return out
