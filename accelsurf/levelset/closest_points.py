"""Closest points of the surface for the cells of the band, and for those that may enter it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels import fast_marching, march, residues
from accelsurf.kernels.grid import THICK
from accelsurf.levelset.extension import FAST_MARCHING
from accelsurf.levelset.measures import Motion, NarrowBand

#: Rounds in which closest points are passed on: more than the cells of a path through the band.
MAX_ROUNDS = 64


class ClosestPoints(NamedTuple):
    """Closest points of the first ``size`` rows, the slots of the band and then the cells that may enter.

    ``cells`` (m,) int64 raveled; ``to_closest`` (m, 3) float32, see `kernels.grid.Band`; ``state`` (m,) int8, see
    `kernels.march`. There is room for more than ``size``.
    """

    cells: np.ndarray
    to_closest: np.ndarray
    state: np.ndarray
    size: int


def find_closest_points(surface: NarrowBand) -> ClosestPoints:
    """Find the closest points of the zero level of psi as it is; cells that may enter get a slot in ``dense.slot``.

    Where ``surface.residues`` is None psi has been no distance yet: the interpolation is limited instead.
    """
    parallel = surface.workers.parallel
    grid = surface.grid
    dense = surface.dense
    n = surface.size
    # Room for the cells that enter in one step.
    room = n + n // 4 + 1024
    cells = np.empty(room, np.int64)
    to_closest = np.empty((room, 3), np.float32)
    state = np.empty(room, np.int8)
    cells[:n] = surface.band.cells
    inner, found = inner_distance(surface), np.empty(n, np.int8)
    residue, known_residues = np.zeros(room, np.float32), surface.residues
    limited = known_residues is None
    if known_residues is not None:
        residue[:n] = known_residues
    parallel(
        march.find_closest_points,
        n,
        dense,
        grid,
        surface.band,
        (inner, residue, limited),
        to_closest,
        found,
    )
    parallel(
        march.classify_closest_points, n, dense, grid, surface.band.cells, to_closest, found, state
    )
    open_slots, sources = (
        np.flatnonzero(state[:n] == march.OPEN),
        np.flatnonzero(state[:n] == march.EDGE),
    )
    active, refine_later = np.zeros(room, np.bool_), np.zeros(room, np.bool_)
    active[open_slots] = True
    size = n
    for _ in range(MAX_ROUNDS):
        known, entering = (cells, to_closest, state, active), np.empty(sources.size, np.uint8)
        around = grid, known, sources, surface.half_width
        parallel(march.wake_neighbours, sources.size, dense, *around, entering)
        (cells, to_closest, state, active), size = surface.workers.serial(
            march.enter_neighbours, dense.slot, grid, known, size, sources, entering
        )
        if cells.size > residue.size:
            more = cells.size - residue.size
            residue, refine_later = np.pad(residue, (0, more)), np.pad(refine_later, (0, more))
        active_slots = surface.workers.serial(march.take_active, open_slots, n, size, active)
        if active_slots.size == 0:
            break
        changed, was_open = np.empty(active_slots.size, np.bool_), state[active_slots] == march.OPEN
        nearer = (
            np.empty((active_slots.size, 3), np.float32),
            changed,
            np.empty(active_slots.size, np.float32),
        )
        rows = cells, to_closest, state, residue
        parallel(
            march.propagate_closest_points,
            active_slots.size,
            dense,
            grid,
            rows,
            active_slots,
            nearer,
        )
        parallel(
            march.update_closest_points,
            active_slots.size,
            active_slots,
            nearer,
            (to_closest, state, residue),
        )
        # The first closest point of a cell is moved to its own at once, as neighbours take it over; the others at the
        # end.
        sources, first = surface.workers.serial(
            march.sort_changes, active_slots, changed, was_open, refine_later
        )
        parallel(
            march.refine_closest_points,
            first.size,
            dense.psi,
            grid,
            cells,
            first,
            to_closest,
            (residue, limited),
        )
    later = np.flatnonzero(refine_later[:size])
    parallel(
        march.refine_closest_points,
        later.size,
        dense.psi,
        grid,
        cells,
        later,
        to_closest,
        (residue, limited),
    )
    return ClosestPoints(cells, to_closest, state, size)


def inner_distance(surface: NarrowBand) -> float:
    """Distance from the surface, mm, within which the neighbours of a cell are in the band."""
    grid = surface.grid
    finest, coarsest = min(grid.hz, grid.hy, grid.hx), max(grid.hz, grid.hy, grid.hx)
    return float(surface.gamma - 1.5 * coarsest) if coarsest < THICK * finest else finest


def find_residues(surface: NarrowBand, moved: Motion) -> np.ndarray:
    """Residues (n,) float32 of psi at the closest points of the band, ``moved`` since."""
    parallel = surface.workers.parallel
    psi = surface.dense.psi
    slot = surface.dense.slot
    motion = np.ascontiguousarray(moved.velocity, np.float32), float(moved.dt)
    out, near = np.empty(surface.size, np.float32), np.empty(surface.size, np.bool_)
    parallel(
        residues.own_residues, surface.size, psi, surface.grid, surface.band, motion, (out, near)
    )
    # A smooth surface has none that count.
    if out.any() and surface.extension == FAST_MARCHING:
        beside = beside_surface(surface, surface.band.psi)
        where = slot, surface.grid, surface.band, motion
        parallel(fast_marching.front_residues, surface.size, *where, beside, out)
    elif out.any():
        parallel(
            residues.distant_residues,
            surface.size,
            slot,
            surface.grid,
            surface.band,
            motion,
            (out, near),
        )
    return out


def beside_surface(surface: NarrowBand, psi: np.ndarray) -> np.ndarray:
    """Mask (n,) of the band cells with a neighbour on the other side, by ``psi`` (n,)."""
    beside, where = (
        np.empty(surface.size, np.bool_),
        (surface.dense.slot, surface.grid, surface.band.cells),
    )
    surface.workers.parallel(fast_marching.cells_beside, surface.size, *where, psi, beside)
    return beside
