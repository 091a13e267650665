"""Small components of a surface, inside or outside: where |psi| has its peaks, and which are too small to stay."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import neighbours, unravel


@kernel(stage=Stage.BAND)
def find_peaks(start, stop, dense, grid, band, depth, peak):
    """Mark in ``peak`` (n,) the slots of the range with |psi| up to ``depth`` (mm) that no neighbour exceeds."""
    psi, cells = dense.psi, band.cells
    plane, row = grid.ny * grid.nx, grid.nx
    for s in range(np.uint64(start), np.uint64(stop)):
        cell = cells[s]
        value = psi[cell]
        peak[s] = abs(value) <= depth
        if peak[s]:
            iz, iy, ix = unravel(cell, grid)
            at = np.uint64(cell)
            # As `is_peak`, without branches: beyond the border is the cell itself, which does not exceed it.
            higher = exceeds(psi[at - np.uint64(plane if iz > 0 else 0)], value)
            higher |= exceeds(psi[at + np.uint64(plane if iz < grid.nz - 1 else 0)], value)
            higher |= exceeds(psi[at - np.uint64(row if iy > 0 else 0)], value)
            higher |= exceeds(psi[at + np.uint64(row if iy < grid.ny - 1 else 0)], value)
            higher |= exceeds(psi[at - np.uint64(1 if ix > 0 else 0)], value)
            higher |= exceeds(psi[at + np.uint64(1 if ix < grid.nx - 1 else 0)], value)
            peak[s] = not higher


@kernel
def exceeds(other, value):
    """Test if ``other`` is on the same side of the surface as ``value``, and larger."""
    return ((other < 0.0) == (value < 0.0)) & (abs(other) > abs(value))


@kernel
def is_peak(psi, grid, cell, near):
    """Test if no 6-neighbour on the cell's side of the surface has a larger |psi|; ``near`` (6,) is scratch."""
    iz, iy, ix = unravel(cell, grid)
    neighbours(cell, iz, iy, ix, grid, near)
    value = psi[cell]
    for side in range(6):
        other = near[side]
        if other >= 0 and exceeds(psi[other], value):
            return False
    return True


@kernel(stage=Stage.BAND)
def small_components(dense, grid, band, peaks, most, held, turned):
    """Flip the sign of psi on every component, inside or outside, of at most ``most`` cells and none of ``held``.

    Each has a cell that no 6-neighbour on its side exceeds in |psi|, among the slots ``peaks``; the flood starts there
    and stops beyond ``most`` cells. A component that touches the border of the volume counts like any other.
    ``held`` are raveled cells in rising order; ``turned`` (n,) bool gets which slots have another sign than before.
    Returns (components removed inside, outside, cells flipped).
    """
    psi = dense.psi
    near = np.empty(6, np.int64)
    flood = np.empty(most + 1, np.int64)
    removed_inside = 0
    removed_outside = 0
    flipped = 0
    for s in peaks:
        cell = band.cells[s]
        # What was removed before may have changed that.
        if not is_peak(psi, grid, cell, near):
            continue
        inside = psi[cell] < 0.0
        count = flood_component(psi, grid, cell, inside, flood, near)
        if count > most or holds_any(flood, count, held):
            continue
        for i in range(count):
            psi[flood[i]] = -psi[flood[i]]
            slot = dense.slot[flood[i]]
            if slot >= 0:
                turned[slot] = not turned[slot]
        flipped += count
        if inside:
            removed_inside += 1
        else:
            removed_outside += 1
    return removed_inside, removed_outside, flipped


@kernel
def holds_any(flood, count, held):
    """Test if one of the first ``count`` cells of ``flood`` is among ``held``, which is in rising order."""
    if held.shape[0] == 0:
        return False
    for i in range(count):
        at = np.searchsorted(held, flood[i])
        if at < held.shape[0] and held[at] == flood[i]:
            return True
    return False


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
