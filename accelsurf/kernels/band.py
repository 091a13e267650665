"""Bookkeeping of the band: which cells stay, which enter, and the dense arrays that follow."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import neighbours, unravel, voxels_along
from accelsurf.kernels.interpolate import band_value_at, linear_band_value
from accelsurf.kernels.march import OPEN, length

#: The smallest distance that a cell may be given, as a part of the smallest spacing: the sign must survive.
LEAST = 1e-6


@kernel
def keep_mask(start, stop, grid, foot, state, half_width, keep):
    """Mark the slots whose foot is known and within ``half_width`` voxels."""
    for s in range(start, stop):
        keep[s] = state[s] != OPEN and voxels_along(foot[s, 0], foot[s, 1], foot[s, 2], grid) <= half_width


@kernel
def merged_order(cells, n_old, keep, entered):
    """Slots of the new band in raster order: the kept old ones (sorted already) merged with ``entered`` slots.

    ``entered`` are the kept new slots sorted by cell.
    """
    count = entered.shape[0]
    for s in range(n_old):
        if keep[s]:
            count += 1
    order = np.empty(count, np.int64)
    at = 0
    e = 0
    for s in range(n_old):
        if not keep[s]:
            continue
        while e < entered.shape[0] and cells[entered[e]] < cells[s]:
            order[at] = entered[e]
            at += 1
            e += 1
        order[at] = s
        at += 1
    while e < entered.shape[0]:
        order[at] = entered[e]
        at += 1
        e += 1
    return order


@kernel
def gather_band(start, stop, dense_psi, grid, order, old, new):
    """Fill the range of the ``new`` band from ``old`` (cells, foot) slots in ``order``; psi = sign x |foot|."""
    least = LEAST * min(grid.hz, min(grid.hy, grid.hx))
    for s in range(start, stop):
        source = order[s]
        cell = old.cells[source]
        new.cells[s] = cell
        for axis in range(3):
            new.foot[s, axis] = old.foot[source, axis]
        d = max(length(old.foot, source), least)
        new.psi[s] = -d if dense_psi[cell] < 0.0 else d


@kernel
def sample_at_feet(start, stop, slot, grid, band, n_old, known, values, out):
    """Extend a field to the new ``band``: its value at each foot, interpolated from the old slots.

    ``values`` (n_old,) belongs to the old band and ``slot`` still maps to it. A cell with nothing known
    around its foot keeps its own old value, or 0 when it was not in the band.
    """
    w = np.empty(24)
    position = np.empty(3)
    for s in range(start, stop):
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        position[0] = iz + band.foot[s, 0] / grid.hz
        position[1] = iy + band.foot[s, 1] / grid.hy
        position[2] = ix + band.foot[s, 2] / grid.hx
        value, found = band_value_at(values, slot, n_old, grid, position, w, known)
        if not found:
            own = slot[cell]
            value = values[own] if own >= 0 and own < n_old and known[own] else 0.0
        out[s] = value


@kernel
def extend_outwards(start, stop, slot, grid, band, front, values):
    """Overwrite ``values`` off the front by the linear interpolation of the front's values at the foot."""
    position = np.empty(3)
    n = band.cells.shape[0]
    for s in range(start, stop):
        if front[s]:
            continue
        iz, iy, ix = unravel(band.cells[s], grid)
        position[0] = iz + band.foot[s, 0] / grid.hz
        position[1] = iy + band.foot[s, 1] / grid.hy
        position[2] = ix + band.foot[s, 2] / grid.hx
        value, found = linear_band_value(values, slot, n, grid, position, front)
        values[s] = value if found else 0.0


@kernel
def drop_cells(start, stop, dense, cells, keep, gamma):
    """Take the dropped slots of the range off the dense arrays: psi = +-gamma, slot = -1."""
    for s in range(start, stop):
        if not keep[s]:
            cell = cells[s]
            dense.slot[cell] = -1
            dense.psi[cell] = -gamma if dense.psi[cell] < 0.0 else gamma


@kernel
def store_band(start, stop, dense, band):
    """Write the range of the band's psi and slots to the dense arrays."""
    for s in range(start, stop):
        cell = band.cells[s]
        dense.slot[cell] = s
        dense.psi[cell] = band.psi[s]


@kernel
def front_mask(start, stop, grid, band, width, front):
    """Mark the slots within ``width`` voxels of the surface."""
    for s in range(start, stop):
        front[s] = voxels_along(band.foot[s, 0], band.foot[s, 1], band.foot[s, 2], grid) <= width


@kernel
def small_components(dense, grid, band, most, depth):
    """Flip the sign of psi on every component, inside or outside, of at most ``most`` cells.

    A component that small has a cell with |psi| below ``depth`` (mm) that no 6-neighbour on its side
    exceeds; the flood starts there and gives up beyond ``most`` cells. A component that touches the border
    of the volume counts like any other. Returns (components removed inside, outside, cells flipped).
    """
    psi = dense.psi
    near = np.empty(6, np.int64)
    flood = np.empty(most + 1, np.int64)
    removed_inside = 0
    removed_outside = 0
    flipped = 0
    for s in range(band.cells.shape[0]):
        cell = band.cells[s]
        value = psi[cell]
        if abs(value) > depth:
            continue
        inside = value < 0.0
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        peak = True
        for side in range(6):
            other = near[side]
            if other >= 0 and (psi[other] < 0.0) == inside and abs(psi[other]) > abs(value):
                peak = False
                break
        if not peak:
            continue
        count = flood_component(psi, grid, cell, inside, flood, near)
        if count > most:
            continue
        for i in range(count):
            psi[flood[i]] = -psi[flood[i]]
        flipped += count
        if inside:
            removed_inside += 1
        else:
            removed_outside += 1
    return removed_inside, removed_outside, flipped


@kernel
def flood_component(psi, grid, cell, inside, flood, near):
    """Cells 6-connected to ``cell`` on its side, up to the length of ``flood``; returns how many were met."""
    flood[0] = cell
    count = 1
    done = 0
    most = flood.shape[0]
    while done < count:
        current = flood[done]
        done += 1
        iz, iy, ix = unravel(current, grid)
        neighbours(current, iz, iy, ix, grid, near)
        for side in range(6):
            other = near[side]
            if other < 0 or (psi[other] < 0.0) != inside:
                continue
            seen = False
            for i in range(count):
                if flood[i] == other:
                    seen = True
                    break
            if seen:
                continue
            if count == most:
                return most + 1
            flood[count] = other
            count += 1
    return count
