"""Fast marching: distances and closest points outwards from the cells beside the surface, in order of distance.

Those cells know their closest points. From there every cell is accepted in order of its distance, ties by the cell's
index (Sethian): by a first-order estimate, and when accepted once more in second order, see `eikonal`. The closest
point is a field that is extended with it.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.closest import (
    FOUND,
    LIMITED,
    OFFSET,
    closest_points,
    crossing_point,
    feet_memory,
    is_near_volume,
)
from accelsurf.kernels.eikonal import (
    ACCEPTED,
    BEYOND,
    FAR,
    TRIAL,
    estimate,
    solve_distance,
    upwind_neighbours,
    upwind_weights,
)
from accelsurf.kernels.grid import BATCH, neighbours, step_of, unravel, voxels_along
from accelsurf.kernels.guesses import guess_feet, guess_memory
from accelsurf.kernels.march import MARGIN, accept_foot
from accelsurf.kernels.residues import known_point, nearest_slot

#: A closest point carried as a field counts where its distance is d within this part; else that of one neighbour.
TRUSTED = 0.1


@kernel(stage=Stage.CLOSEST_POINTS)
def cells_beside(start, stop, slot, grid, cells, psi, beside):
    """Mark in ``beside`` (n,) bool the slots with a 6-neighbour on the other side, by ``psi`` (n,) of the slots.

    Where a neighbour is not in the band there is no surface between.
    """
    near = np.empty(6, np.int64)
    for s in range(start, stop):
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        beside[s] = False
        for side in range(6):
            other = slot[near[side]] if near[side] >= 0 else -1
            if other >= 0 and (psi[other] < 0.0) != (psi[s] < 0.0):
                beside[s] = True


@kernel(stage=Stage.CLOSEST_POINTS)
def find_front_feet(start, stop, dense, grid, band, guide, on, foot):
    """Feet of the slots ``on`` (m,), all beside the surface, into ``foot`` (n, 3); as `march.find_feet` does there.

    ``guide`` = (inner, residue (n,), limited).
    """
    psi = dense.psi
    near, guess, plane, w = np.empty(6, np.int64), np.empty(3), np.empty(3), np.empty(24)
    scratch = near, guess, guess_memory()
    memory, feet, status = feet_memory()
    inner, residue, limited = guide
    offset = memory[OFFSET : OFFSET + BATCH]
    memory[LIMITED : LIMITED + BATCH] = limited
    beside, at = np.empty(BATCH, np.bool_), np.empty(BATCH, np.int64)
    for first in range(start, stop, BATCH):
        count = min(BATCH, stop - first)
        slots = on[first : first + count]
        guess_feet(slots, dense, grid, band, (inner, residue), scratch, (feet, beside, offset))
        for i in range(count):
            at[i] = band.cells[slots[i]]
        closest_points(count, psi, grid, at, memory, w)
        for i in range(count):
            s, cell = on[first + i], at[i]
            iz, iy, ix = unravel(cell, grid)
            guess[0], guess[1], guess[2] = feet[0, i], feet[1, i], feet[2, i]
            found = status[i] == FOUND and is_near_volume(grid, iz, iy, ix, guess, MARGIN)
            neighbours(cell, iz, iy, ix, grid, near)
            bound = crossing_point(psi, grid, cell, iz, iy, ix, near, plane)
            accept_foot(psi[cell], grid, plane, bound, guess, found, 0.5)
            foot[s, 0], foot[s, 1], foot[s, 2] = guess[0], guess[1], guess[2]


@kernel
def is_before(d, s, e, t, cells):
    """Test if slot ``s`` at distance ``d`` comes before slot ``t`` at ``e``: by distance, then by cell."""
    return d < e or (d == e and cells[s] < cells[t])


@kernel
def insert(keys, slots, size, key, s, cells):
    """Put slot ``s`` into the heap of ``size`` entries, which has room for it; the first entry is that before all."""
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if not is_before(key, s, keys[parent], slots[parent], cells):
            break
        keys[i], slots[i] = keys[parent], slots[parent]
        i = parent
    keys[i], slots[i] = key, s


@kernel
def pop(keys, slots, size, cells):
    """Slot of the first of ``size`` entries, which leaves the heap."""
    first, last = slots[0], size - 1
    key, s = keys[last], slots[last]
    i, child = 0, 1
    while child < last:
        if child + 1 < last and is_before(keys[child + 1], slots[child + 1], keys[child], slots[child], cells):
            child += 1
        if not is_before(keys[child], slots[child], key, s, cells):
            break
        keys[i], slots[i] = keys[child], slots[child]
        i, child = child, 2 * child + 1
    keys[i], slots[i] = key, s
    return first


@kernel
def carried_foot(s, d, grid, foot, up, weights):
    """Foot of slot ``s`` at ``d`` mm: the closest point as an extended field, put at that distance.

    Where its distance is another, as beside a ridge, that of the neighbour whose closest point is nearest.
    """
    slots, sides, terms = up
    upwind_weights(d, up, weights)
    best, mean = 1e30, (0.0, 0.0, 0.0)
    nearest = (0.0, 0.0, 0.0)
    for k in range(6):
        if slots[k] < 0:
            continue
        axis = k % 3
        sign = sides[axis] * (1 if k < 3 else 2)
        oz, oy, ox = step_of(2 * axis + 1, grid)
        z, y, x = foot[slots[k], 0] + sign * oz, foot[slots[k], 1] + sign * oy, foot[slots[k], 2] + sign * ox
        w = weights[k]
        mean = mean[0] + w * z, mean[1] + w * y, mean[2] + w * x
        length2 = z * z + y * y + x * x
        if k < 3 and w > 0.0 and length2 < best:
            best, nearest = length2, (z, y, x)
    length = np.sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2])
    if abs(length - d) > TRUSTED * d:
        mean, length = nearest, np.sqrt(best)
    scale = d / max(length, 1e-30)
    foot[s, 0], foot[s, 1], foot[s, 2] = mean[0] * scale, mean[1] * scale, mean[2] * scale


@kernel
def accept(s, dense, grid, known, up, weights):
    """Second-order distance and foot of slot ``s``, the nearest that is not accepted."""
    cells, foot, distance, state = known
    upwind_neighbours(cells[s], dense.slot, grid, known, 1e30, up)
    d = solve_distance(up, grid, True)
    carried_foot(s, d, grid, foot, up, weights)
    distance[s] = -d if dense.psi[cells[s]] < 0.0 else d
    state[s] = ACCEPTED


@kernel(stage=Stage.CLOSEST_POINTS)
def march_outwards(dense, grid, known, heap, counts, front, half_width):
    """Distances and feet outwards from the slots ``front`` (m,), up to ``half_width`` voxels; serial.

    ``known`` = (cells, foot (n, 3), distance (n,) float64, state (n,) int8), with room for more slots than n.
    ``distance`` (mm) has the sign of psi; ``state`` is ACCEPTED at ``front`` and FAR elsewhere. Cells that are met
    enter as slots from n on, in ``dense.slot`` too. ``heap`` = (keys float64, slots int64) of `insert`. ``counts``
    (3,) int64 = n, entries of the heap, slots of the front that have been handed on. Returns whether the march has
    ended; else it wants more room and goes on from where it is.
    """
    slot = dense.slot
    cells, foot, distance, state = known
    keys, slots = heap
    near, weights = np.empty(6, np.int64), np.empty(6)
    up = np.empty(6, np.int64), np.empty(3, np.int64), np.empty((4, 3))
    n, size, begun = counts[0], counts[1], counts[2]
    ended = True
    while begun < front.shape[0] or size > 0:
        if n + 6 > cells.shape[0] or size + 6 > keys.shape[0]:
            ended = False
            break
        if begun < front.shape[0]:
            s = front[begun]
            begun += 1
        else:
            s = pop(keys, slots, size, cells)
            size -= 1
            if state[s] != TRIAL:
                continue
            accept(s, dense, grid, known, up, weights)
        if voxels_along(foot[s, 0], foot[s, 1], foot[s, 2], grid) > half_width:
            state[s] = BEYOND
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        for side in range(6):
            if near[side] < 0:
                continue
            other = slot[near[side]]
            if other < 0:
                other, cells[n], state[n] = n, near[side], FAR
                slot[near[side]] = n
                n += 1
            if state[other] != FAR and state[other] != TRIAL:
                continue
            d = estimate(near[side], slot, grid, distance, state)
            if state[other] == FAR or d < distance[other]:
                insert(keys, slots, size, d, other, cells)
                size += 1
                distance[other], state[other] = d, TRIAL
    counts[0], counts[1], counts[2] = n, size, begun
    return ended


@kernel(stage=Stage.CLOSEST_POINTS)
def front_residues(start, stop, slot, grid, band, motion, beside, out):
    """Residue of every cell that is not ``beside`` (n,) the surface: that of the cell nearest its foot, if that is.

    ``out`` (n,) as `residues.own_residues` has filled it. Feet of the march err as its distances do: only those of the
    cells beside the surface lie on it. ``motion`` = (velocity (n, 3), dt).
    """
    for s in range(start, stop):
        if beside[s]:
            continue
        pz, py, px = known_point(s, grid, band, motion)
        nearest = nearest_slot(slot, grid, pz, py, px)
        out[s] = out[nearest] if nearest >= 0 and beside[nearest] else np.float32(0.0)


@kernel(stage=Stage.EXTENSION)
def order_of(distance):
    """Slots (n,) int64 in order of ``distance`` (n,) float32 >= 0, ties by slot: by 11 bits at a time; serial."""
    n = distance.shape[0]
    bits = distance.view(np.uint32)
    order, other = np.arange(n), np.empty(n, np.int64)
    count = np.empty(2049, np.int64)
    for part in range(3):
        shift = np.uint32(11 * part)
        count[:] = 0
        for s in range(n):
            count[((bits[s] >> shift) & np.uint32(2047)) + 1] += 1
        for i in range(2048):
            count[i + 1] += count[i]
        for k in range(n):
            s = order[k]
            at = (bits[s] >> shift) & np.uint32(2047)
            other[count[at]] = s
            count[at] += 1
        order, other = other, order
    return order


@kernel(stage=Stage.EXTENSION)
def upwind_table(start, stop, slot, grid, known, off, table):
    """Find the upwind neighbours that the slots ``off`` (m,) read an extended field's values from, and the weights.

    ``known`` = (cells, foot, distance (mm, signed), state) of the band. ``table`` = (slots (m, 6) int32, shares (m, 6)
    float32, 0 where none is read).
    """
    slots, shares = table
    up = np.empty(6, np.int64), np.empty(3, np.int64), np.empty((4, 3))
    weights = np.empty(6)
    distance = known[2]
    for row in range(start, stop):
        s = off[row]
        d = abs(distance[s])
        upwind_neighbours(known[0][s], slot, grid, known, d, up)
        upwind_weights(d, up, weights)
        for k in range(6):
            used = up[0][k] >= 0 and weights[k] != 0.0
            slots[row, k] = up[0][k] if used else s
            shares[row, k] = weights[k] if used else 0.0


@kernel(stage=Stage.EXTENSION)
def carry_outwards(off, slots, shares, values):
    """Overwrite ``values`` (n,) at the slots ``off`` (m,), in this order, by what `upwind_table` has for them; serial.

    No value leaves the range of those that it comes from: a difference of second order would.
    """
    for row in range(off.shape[0]):
        value, low, high = np.float32(0.0), np.float32(np.inf), np.float32(-np.inf)
        for k in range(6):
            share = shares[row, k]
            if share != 0.0:
                neighbour = values[slots[row, k]]
                value += share * neighbour
                low, high = min(low, neighbour), max(high, neighbour)
        values[off[row]] = min(max(value, low), high) if low <= high else np.float32(0.0)
