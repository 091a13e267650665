"""Fast marching on the band: distances, closest points and fields outwards from the cells beside the surface."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.kernels import fast_marching, march
from accelsurf.kernels.band import MIN_DISTANCE
from accelsurf.kernels.fast_marching import ACCEPTED, FAR
from accelsurf.levelset.closest_points import (
    MAX_ROUNDS,
    ClosestPoints,
    beside_surface,
    inner_distance,
)
from accelsurf.levelset.extension import FAST_MARCHING, ExtensionTable, extension_table
from accelsurf.levelset.measures import NarrowBand
from accelsurf.levelset.threads import Workers


def march_outwards(surface: NarrowBand) -> ClosestPoints:
    """Find closest points as `closest_points.find_closest_points`, with only those beside the surface sought in psi.

    Distances further off are a fast march's, and the closest points fields that it carries.
    """
    grid = surface.grid
    dense = surface.dense
    n = surface.size
    room = n + n // 4 + 1024
    cells, to_closest = np.empty(room, np.int64), np.empty((room, 3), np.float32)
    cells[:n] = surface.band.cells
    psi = dense.psi[surface.band.cells]
    front = np.flatnonzero(beside_surface(surface, psi))
    _find_closest_beside(surface, front, to_closest)
    distance, state = np.zeros(room), np.full(room, FAR, np.int8)
    length = np.sqrt((to_closest[front].astype(np.float64) ** 2).sum(axis=1))
    distance[front] = np.copysign(
        np.maximum(length, MIN_DISTANCE * surface.smallest_spacing), psi[front]
    )
    state[front] = ACCEPTED
    known: tuple[np.ndarray, ...] = cells, to_closest, distance, state
    heap: tuple[np.ndarray, ...] = np.empty(room), np.empty(room, np.int64)
    counts, width = np.array([n, 0, 0]), surface.half_width
    serial = surface.workers.serial
    while not serial(fast_marching.march_outwards, dense, grid, known, heap, counts, front, width):
        known, heap = _with_room(known, heap)
    cells, to_closest, _, state = known
    reached = np.where(state == FAR, np.int8(march.OPEN), np.int8(march.FROZEN))
    return ClosestPoints(cells, to_closest, reached, int(counts[0]))


def _with_room(
    known: tuple[np.ndarray, ...], heap: tuple[np.ndarray, ...]
) -> tuple[tuple[np.ndarray, ...], ...]:
    """The arrays of a march with room for half as many entries again."""
    more = known[0].size // 2 + 1024
    rows = tuple(
        np.concatenate([row, np.zeros((more, *row.shape[1:]), row.dtype)]) for row in known
    )
    return rows, tuple(np.concatenate([row, np.zeros(more, row.dtype)]) for row in heap)


def _find_closest_beside(surface: NarrowBand, front: np.ndarray, to_closest: np.ndarray) -> None:
    """Closest points of the slots ``front`` (m,) into ``to_closest``: from psi, and closer ones from each other."""
    parallel = surface.workers.parallel
    grid = surface.grid
    dense = surface.dense
    n = surface.size
    known = surface.residues
    residue, limited = np.zeros(n, np.float32) if known is None else known.copy(), known is None
    start = inner_distance(surface), residue, limited
    parallel(
        fast_marching.find_front_closest_points,
        front.size,
        dense,
        grid,
        surface.band,
        start,
        front,
        to_closest,
    )
    state = np.full(n, march.OPEN, np.int8)
    state[front] = march.FROZEN
    closest, on = to_closest[:n], front
    for _ in range(MAX_ROUNDS):
        nearer = (
            np.empty((on.size, 3), np.float32),
            np.empty(on.size, np.bool_),
            np.empty(on.size, np.float32),
        )
        parallel(
            march.propagate_closest_points,
            on.size,
            dense,
            grid,
            (surface.band.cells, closest, state, residue),
            on,
            nearer,
        )
        parallel(march.update_closest_points, on.size, on, nearer, (closest, state, residue))
        changed = on[nearer[1]]
        if changed.size == 0:
            break
        psi, guide = dense.psi, (residue, limited)
        parallel(
            march.refine_closest_points,
            changed.size,
            psi,
            grid,
            surface.band.cells,
            changed,
            closest,
            guide,
        )


class UpwindExtension(NamedTuple):
    """Order and weights in which the band reads the values known beside the surface, see `kernels.fast_marching`.

    ``front`` (n,) bool is where values are given; of these, those beside the surface count. ``known`` fills in the
    cells there that are not on the front, and those that are `_cut_off`, at their closest points. ``off`` (m,) int64
    are the other slots in order of distance; ``slots`` (m, 6) int32 and ``shares`` (m, 6) float32.
    """

    front: np.ndarray
    known: ExtensionTable
    off: np.ndarray
    slots: np.ndarray
    shares: np.ndarray

    def extend(self, workers: Workers, values: np.ndarray) -> None:
        """Overwrite ``values`` (n,) at all slots but those on the front and beside the surface."""
        self.known.extend(workers, values)
        workers.serial(fast_marching.carry_outwards, self.off, self.slots, self.shares, values)


def extension_from(surface: NarrowBand, front: np.ndarray) -> ExtensionTable | UpwindExtension:
    """The extension of values known on the ``front`` (n,) to the band, as the surface's setting has it."""
    if surface.extension != FAST_MARCHING:
        return extension_table(surface, front, np.flatnonzero(~front))
    workers, band = surface.workers, surface.band
    beside = beside_surface(surface, band.psi)
    order = workers.serial(fast_marching.order_of, np.abs(band.psi))
    given = beside | _cut_off(surface)
    off = order[~given[order]]
    slots, shares = np.empty((off.size, 6), np.int32), np.empty((off.size, 6), np.float32)
    known = band.cells, band.to_closest, band.psi, np.full(surface.size, ACCEPTED, np.int8)
    workers.parallel(
        fast_marching.upwind_table,
        off.size,
        surface.dense.slot,
        surface.grid,
        known,
        off,
        (slots, shares),
    )
    read = front & beside
    return UpwindExtension(
        front,
        extension_table(surface, read, np.flatnonzero(given & ~read)),
        off,
        slots,
        shares,
    )


def _cut_off(surface: NarrowBand) -> np.ndarray:
    """Mask (n,) of the band cells with an upwind neighbour in the volume that is not in the band.

    Where the spacings differ, a neighbour nearer to the surface in mm may be further off in voxels. Read from the
    others alone, a field would be that of another place.
    """
    cells = surface.band.cells
    slot = surface.dense.slot
    grid = surface.grid
    counts, spacing = (grid.nz, grid.ny, grid.nx), (grid.hz, grid.hy, grid.hx)
    cut = np.zeros(surface.size, np.bool_)
    for axis, index in enumerate(np.unravel_index(cells, counts)):
        # The neighbour that is nearer to the closest point.
        side = np.rint(np.clip(surface.band.to_closest[:, axis] / spacing[axis], -1.0, 1.0))
        step = side.astype(np.int64)
        inside = (step != 0) & (index + step >= 0) & (index + step < counts[axis])
        stride = math.prod(counts[axis + 1 :])
        cut[inside] |= slot[(cells + step * stride)[inside]] < 0
    return cut
