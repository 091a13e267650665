"""Small components of a surface, inside or outside: where |psi| has its peaks, and which are too small to stay.

Contact of a surface with another one on a grid of its own: the points that touch, and the cells in both.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import neighbours, unravel
from accelsurf.kernels.interpolate import linear_at


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


@kernel
def touching(points, dense, grid, corner, margin, width):
    """Points at most so far from the inside of another surface, and in its band.

    Parameters
    ----------
    points : ndarray (n, 3) float64
        In voxels of the common grid.
    dense : DenseArrays
        Of the other surface.
    grid : Grid
        Its grid.
    corner : ndarray (3,) float64
        Where that begins in the common one.
    margin : float
        Points beyond its border count as on it up to so many voxels, along each axis.
    width : float
        How far, mm.

    Returns
    -------
    near : ndarray (m,) int64
        Rising.
    slots : ndarray (m,) int32
        Of the other's band, the nearest voxel's.
    share : ndarray (m,) float32
        1 - gap/width, at most 1; the gap is the other's psi, between voxels linear.
    """
    n = len(points)
    near = np.empty(n, np.int64)
    slots = np.empty(n, np.int32)
    share = np.empty(n, np.float32)
    last_z = grid.nz - 1.0
    last_y = grid.ny - 1.0
    last_x = grid.nx - 1.0
    count = 0
    for i in range(n):
        z = points[i, 0] - corner[0]
        y = points[i, 1] - corner[1]
        x = points[i, 2] - corner[2]
        if not (
            -margin <= z <= last_z + margin
            and -margin <= y <= last_y + margin
            and -margin <= x <= last_x + margin
        ):
            continue
        z = min(max(z, 0.0), last_z)
        y = min(max(y, 0.0), last_y)
        x = min(max(x, 0.0), last_x)
        slot = dense.slot[
            (np.int64(np.rint(z)) * grid.ny + np.int64(np.rint(y))) * grid.nx + np.int64(np.rint(x))
        ]
        if slot < 0:
            continue
        gap = np.float32(linear_at(dense.psi, grid, z, y, x))
        part = np.float32(min(max(1.0 - gap / width, 0.0), 1.0))
        if part > 0:
            near[count] = i
            slots[count] = slot
            share[count] = part
            count += 1
    return near[:count].copy(), slots[:count].copy(), share[:count].copy()


@kernel
def shared_cells(cells, grid, psi, other, shift):
    """Find the cells that lie on another grid too: positions (m,) int64 in ``cells``, and the psi (m,) float32 there.

    Parameters
    ----------
    cells : ndarray (n,) int64
        Of ``grid``.
    grid : Grid
    psi : ndarray float32
        Dense, on the other grid.
    other : Grid
    shift : ndarray (3,) int64
        From an index to that in the other grid.
    """
    on, values = np.empty(len(cells), np.int64), np.empty(len(cells), np.float32)
    count = 0
    for i in range(len(cells)):
        iz, iy, ix = unravel(cells[i], grid)
        jz = iz + shift[0]
        jy = iy + shift[1]
        jx = ix + shift[2]
        if 0 <= jz < other.nz and 0 <= jy < other.ny and 0 <= jx < other.nx:
            on[count], values[count] = i, psi[(jz * other.ny + jy) * other.nx + jx]
            count += 1
    return on[:count].copy(), values[:count].copy()
