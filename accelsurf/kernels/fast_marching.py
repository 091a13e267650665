"""Fast marching: distances and closest points outwards from the cells beside the surface, in order of distance.

Those cells know their closest points. From there every cell is accepted in order of its distance, ties by the cell's
index (Sethian): by a first-order estimate, and when accepted once more in second order, see `eikonal`. The closest
point is a field that is extended with it.

Upwind differences from accepted neighbours: the distance of a cell, and the weights of the values that it reads.

The distance d of a cell solves, with the upwind differences of second order,

    sum over axes ((d - t)/e)^2 = 1,   t = (4 d_1 - d_2)/3, e = 2h/3   (first order: t = d_1, e = h)

with d_1, d_2 those of the nearer neighbour along the axis and of the next beyond it. A field F with
grad F . grad psi = 0 in the same differences is F = sum w F_up/sum w, w = (d - t)/e^2, F_up = (4 F_1 - F_2)/3
(Adalsteinsson and Sethian).
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.closest import (
    FOUND,
    LIMITED,
    OFFSET,
    closest_point_memory,
    closest_points,
    crossing_point,
    guess_closest_points,
    guess_memory,
    is_near_volume,
)
from accelsurf.kernels.grid import BATCH, neighbours, step_of, unravel, voxels_along
from accelsurf.kernels.march import MARGIN, accept_closest_point
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
def find_front_closest_points(start, stop, dense, grid, band, guide, on, closest_point):
    """Closest points of the slots ``on`` (m,), all beside the surface, into ``closest_point`` (n, 3).

    As `march.find_closest_points` finds them there. ``guide`` = (inner, residue (n,), limited).
    """
    psi = dense.psi
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    plane = np.empty(3)
    w = np.empty(24)
    scratch = near, guess, guess_memory()
    memory, points, status = closest_point_memory()
    inner, residue, limited = guide
    offset = memory[OFFSET : OFFSET + BATCH]
    memory[LIMITED : LIMITED + BATCH] = limited
    beside, at = np.empty(BATCH, np.bool_), np.empty(BATCH, np.int64)
    for first in range(start, stop, BATCH):
        count = min(BATCH, stop - first)
        slots = on[first : first + count]
        guess_closest_points(
            slots, dense, grid, band, (inner, residue), scratch, (points, beside, offset)
        )
        for i in range(count):
            at[i] = band.cells[slots[i]]
        closest_points(count, psi, grid, at, memory, w)
        for i in range(count):
            s, cell = on[first + i], at[i]
            iz, iy, ix = unravel(cell, grid)
            guess[0] = points[0, i]
            guess[1] = points[1, i]
            guess[2] = points[2, i]
            found = status[i] == FOUND and is_near_volume(grid, iz, iy, ix, guess, MARGIN)
            neighbours(cell, iz, iy, ix, grid, near)
            bound = crossing_point(psi, grid, cell, iz, iy, ix, near, plane)
            accept_closest_point(psi[cell], grid, plane, bound, guess, found, 0.5)
            closest_point[s, 0] = guess[0]
            closest_point[s, 1] = guess[1]
            closest_point[s, 2] = guess[2]


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
        if child + 1 < last and is_before(
            keys[child + 1], slots[child + 1], keys[child], slots[child], cells
        ):
            child += 1
        if not is_before(keys[child], slots[child], key, s, cells):
            break
        keys[i], slots[i] = keys[child], slots[child]
        i, child = child, 2 * child + 1
    keys[i], slots[i] = key, s
    return first


@kernel
def extended_closest_point(s, d, grid, closest_point, up, weights):
    """Closest point of slot ``s`` at ``d`` mm: the closest point as an extended field, put at that distance.

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
        z = closest_point[slots[k], 0] + sign * oz
        y = closest_point[slots[k], 1] + sign * oy
        x = closest_point[slots[k], 2] + sign * ox
        w = weights[k]
        mean = mean[0] + w * z, mean[1] + w * y, mean[2] + w * x
        length2 = z * z + y * y + x * x
        if k < 3 and w > 0.0 and length2 < best:
            best, nearest = length2, (z, y, x)
    length = np.sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2])
    if abs(length - d) > TRUSTED * d:
        mean, length = nearest, np.sqrt(best)
    scale = d / max(length, 1e-30)
    closest_point[s, 0] = mean[0] * scale
    closest_point[s, 1] = mean[1] * scale
    closest_point[s, 2] = mean[2] * scale


@kernel
def accept(s, dense, grid, known, up, weights):
    """Second-order distance and closest point of slot ``s``, the nearest that is not accepted."""
    cells, closest_point, distance, state = known
    upwind_neighbours(cells[s], dense.slot, grid, known, 1e30, up)
    d = solve_distance(up, grid, True)
    extended_closest_point(s, d, grid, closest_point, up, weights)
    distance[s] = -d if dense.psi[cells[s]] < 0.0 else d
    state[s] = ACCEPTED


@kernel(stage=Stage.CLOSEST_POINTS)
def march_outwards(dense, grid, known, heap, counts, front, half_width):
    """Distances and closest points outwards from the slots ``front`` (m,), up to ``half_width`` voxels; serial.

    ``known`` = (cells, closest point (n, 3), distance (n,) float64, state (n,) int8), with room for more slots than n.
    ``distance`` (mm) has the sign of psi; ``state`` is ACCEPTED at ``front`` and FAR elsewhere. Cells that are met
    enter as slots from n on, in ``dense.slot`` too. ``heap`` = (keys float64, slots int64) of `insert`. ``counts``
    (3,) int64 = n, entries of the heap, slots of the front that have been handed on. Returns whether the march has
    ended; else it wants more room and goes on from where it is.
    """
    slot = dense.slot
    cells, closest_point, distance, state = known
    keys, slots = heap
    near, weights = np.empty(6, np.int64), np.empty(6)
    up = np.empty(6, np.int64), np.empty(3, np.int64), np.empty((4, 3))
    n = counts[0]
    size = counts[1]
    begun = counts[2]
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
        # Beyond the band a cell hands on nothing but is read: where the spacings differ a neighbour nearer in mm may
        # lie further off in voxels, and without it the distance would be that along a detour.
        if (
            voxels_along(closest_point[s, 0], closest_point[s, 1], closest_point[s, 2], grid)
            > half_width
        ):
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        for side in range(6):
            if near[side] < 0:
                continue
            other = slot[near[side]]
            if other < 0:
                other = n
                cells[n] = near[side]
                state[n] = FAR
                slot[near[side]] = n
                n += 1
            if state[other] != FAR and state[other] != TRIAL:
                continue
            d = estimate(near[side], slot, grid, distance, state)
            if state[other] == FAR or d < distance[other]:
                insert(keys, slots, size, d, other, cells)
                size += 1
                distance[other], state[other] = d, TRIAL
    counts[0] = n
    counts[1] = size
    counts[2] = begun
    return ended


@kernel(stage=Stage.CLOSEST_POINTS)
def front_residues(start, stop, slot, grid, band, motion, beside, out):
    """Residue of every cell that is not ``beside`` (n,) the surface.

    It is that of the cell nearest its closest point, if that is beside it. ``out`` (n,) as `residues.own_residues` has
    filled it. Closest points of the march err as its distances do: only those of the cells beside the surface lie on
    it. ``motion`` = (velocity (n, 3), dt).
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

    ``known`` = (cells, closest point, distance (mm, signed), state) of the band. ``table`` = (slots (m, 6) int32,
    shares (m, 6) float32, 0 where none is read).
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
    """Overwrite ``values`` (n,) at the slots ``off`` (m,), in this order, by the means of `upwind_table`; serial.

    No value leaves the range of those that it comes from: a difference of second order would.
    """
    for row in range(off.shape[0]):
        value = np.float32(0.0)
        low = np.float32(np.inf)
        high = np.float32(-np.inf)
        for k in range(6):
            share = shares[row, k]
            if share != 0.0:
                neighbour = values[slots[row, k]]
                value += share * neighbour
                low, high = min(low, neighbour), max(high, neighbour)
        values[off[row]] = min(max(value, low), high) if low <= high else np.float32(0.0)


#: State of a slot in a march: not reached yet.
FAR = 0
#: With a first estimate.
TRIAL = 1
#: Accepted: its distance is final.
ACCEPTED = 2
#: The neighbour beyond a neighbour counts where both have their closest points on the same piece of surface: then
#: |p_1 - p_2|^2 + (d_1 - d_2)^2 = h^2 on a plane, and it may be at most this many h^2.
SAME_SHEET = 1.5
#: Largest slope across a border that is carried along it.
MAX_ACROSS = 0.98


@kernel
def offset_of(closest_point, slot, other, grid, axis, sign):
    """Squared distance (mm2) of the closest points of two slots, ``other`` a voxel further along ``axis``."""
    total = 0.0
    for a in range(3):
        h = grid.hz if a == 0 else (grid.hy if a == 1 else grid.hx)
        d = closest_point[other, a] - closest_point[slot, a] + (sign * h if a == axis else 0.0)
        total += d * d
    return total


@kernel
def upwind_neighbours(cell, slot, grid, known, furthest, up):
    """The accepted neighbours of a cell from which its distance follows, per axis.

    ``known`` = (cells, closest point, distance (mm, signed), state); only those nearer than ``furthest`` mm count.
    ``up`` = (slots (6,) int64: per axis the nearer of the two neighbours (-1: none) and the next beyond it (-1: first
    order); sides (3,): -1, 1; terms (4, 3): d_1, t, e and the slope across a border, see `slope_across`).
    """
    _, closest_point, distance, state = known
    slots, sides, terms = up
    iz, iy, ix = unravel(cell, grid)
    nearest = -1
    for axis in range(3):
        h = grid.hz
        n = grid.nz
        stride = grid.ny * grid.nx
        at = iz
        if axis == 1:
            h = grid.hy
            n = grid.ny
            stride = grid.nx
            at = iy
        elif axis == 2:
            h = grid.hx
            n = grid.nx
            stride = 1
            at = ix
        slots[axis] = -1
        slots[3 + axis] = -1
        terms[0, axis] = 1e30
        terms[3, axis] = 0.0
        for sign in (-1, 1):
            s = slot[cell + sign * stride] if 0 <= at + sign < n else -1
            if s >= 0 and state[s] == ACCEPTED and abs(distance[s]) < min(furthest, terms[0, axis]):
                slots[axis] = s
                sides[axis] = sign
                terms[0, axis] = abs(distance[s])
        s, sign = slots[axis], sides[axis]
        if s < 0:
            continue
        if nearest < 0 or terms[0, axis] < terms[0, nearest]:
            nearest = axis
        terms[1, axis], terms[2, axis] = terms[0, axis], h
        other = slot[cell + 2 * sign * stride] if 0 <= at + 2 * sign < n else -1
        if other >= 0 and state[other] == ACCEPTED:
            # Beyond the surface the distance goes on with the other sign.
            d = abs(distance[other]) * (
                1.0 if (distance[s] < 0.0) == (distance[other] < 0.0) else -1.0
            )
            rise = terms[0, axis] - d
            if (
                rise >= 0.0
                and offset_of(closest_point, s, other, grid, axis, sign) + rise * rise
                <= SAME_SHEET * h * h
            ):
                slots[3 + axis] = other
                terms[1, axis], terms[2, axis] = (4.0 * terms[0, axis] - d) / 3.0, 2.0 * h / 3.0
    wall = (
        (iz == 0)
        | (iz == grid.nz - 1)
        | (iy == 0)
        | (iy == grid.ny - 1)
        | (ix == 0)
        | (ix == grid.nx - 1)
    )
    if wall and nearest >= 0:
        slope_across((iz, iy, ix), grid, known, nearest, up)


@kernel
def slope_across(index, grid, known, nearest, up):
    """Slopes across the borders that a cell at ``index`` lies at, into row 3 of the terms of ``up``.

    Where the closest points lie beyond a border there is no neighbour to take the distance from: psi is continued
    straight, its slope across the border being that of the nearest neighbour.
    """
    _, closest_point, distance, _ = known
    slots, _, terms = up
    s = slots[nearest]
    d = abs(distance[s])
    if d <= 0.0:
        return
    for axis in range(3):
        n, at = (
            (grid.nz, index[0])
            if axis == 0
            else ((grid.ny, index[1]) if axis == 1 else (grid.nx, index[2]))
        )
        out = -1.0 if at == 0 else 1.0
        if (
            n > 1
            and (at == 0 or at == n - 1)
            and axis != nearest
            and out * closest_point[s, axis] > 0.0
        ):
            # The distance does not come from a neighbour further in.
            slots[axis] = -1
            slots[3 + axis] = -1
            terms[0, axis] = 1e30
            terms[3, axis] = min(abs(closest_point[s, axis]) / d, MAX_ACROSS)


@kernel
def solve_distance(up, grid, second):
    """Distance (mm) from the ``up`` of `upwind_neighbours`, with the second-order terms or without.

    Where a neighbour would be further than the result, by the first-order terms, without the furthest if need be.
    """
    slots, _, terms = up
    rest = 1.0
    for axis in range(3):
        rest -= terms[3, axis] * terms[3, axis]
    rest = max(rest, 1.0 - MAX_ACROSS * MAX_ACROSS)
    most = 1e30
    for axis in range(3):
        h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
        most = min(most, terms[0, axis] + h)
    limit, furthest = 1e29, 0.0
    while furthest >= 0.0:
        a = 0.0
        b = 0.0
        c = 0.0
        furthest = -1.0
        for axis in range(3):
            d = terms[0, axis]
            if slots[axis] < 0 or d >= limit:
                continue
            h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
            t, e = (terms[1, axis], terms[2, axis]) if second else (d, h)
            w = 1.0 / (e * e)
            a = a + w
            b = b + w * t
            c = c + w * t * t
            furthest = max(furthest, d)
        disc = b * b - a * (c - rest)
        if furthest >= 0.0 and disc >= 0.0 and b + np.sqrt(disc) > a * furthest:
            return min((b + np.sqrt(disc)) / a, most)
        # First order, and then without the furthest neighbour.
        limit = limit if second else furthest
        second = False
    return most


@kernel
def upwind_weights(d, up, weights):
    """Weights (6,) of the values of ``up``'s slots in a field extended to a cell at ``d`` mm; their sum is 1."""
    slots, _, terms = up
    total = 0.0
    for k in range(6):
        weights[k] = 0.0
    nearest = 0
    for axis in range(3):
        if slots[axis] < 0:
            continue
        if slots[nearest] < 0 or terms[0, axis] < terms[0, nearest]:
            nearest = axis
        w = (
            max(d - terms[1, axis], 0.0) / (terms[2, axis] * terms[2, axis])
            if terms[0, axis] < d
            else 0.0
        )
        total += w
        if slots[3 + axis] >= 0:
            weights[axis], weights[3 + axis] = 4.0 * w / 3.0, -w / 3.0
        else:
            weights[axis] = w
    if total <= 0.0:
        weights[nearest], total = 1.0, 1.0
    for k in range(6):
        weights[k] /= total


@kernel
def estimate(cell, slot, grid, distance, state):
    """First-order distance (mm) of a cell from its accepted neighbours, of which there is one at least."""
    iz, iy, ix = unravel(cell, grid)
    d0 = 1e30
    w0 = 0.0
    d1 = 1e30
    w1 = 0.0
    d2 = 1e30
    w2 = 0.0
    for axis in range(3):
        h = grid.hz
        n = grid.nz
        stride = grid.ny * grid.nx
        at = iz
        if axis == 1:
            h = grid.hy
            n = grid.ny
            stride = grid.nx
            at = iy
        elif axis == 2:
            h = grid.hx
            n = grid.nx
            stride = 1
            at = ix
        d, w = 1e30, 1.0 / (h * h)
        for sign in (-1, 1):
            s = slot[cell + sign * stride] if 0 <= at + sign < n else -1
            if s >= 0 and state[s] == ACCEPTED:
                d = min(d, abs(distance[s]))
        # Nearest first.
        if d < d0:
            d0, w0, d1, w1, d2, w2 = d, w, d0, w0, d1, w1
        elif d < d1:
            d1, w1, d2, w2 = d, w, d1, w1
        else:
            d2, w2 = d, w
    # (d - d0)^2 w0 + (d - d1)^2 w1 + ... = 1, measured from d0, with as many terms as are nearer than d.
    best = 1.0 / np.sqrt(w0)
    a = w0
    b = 0.0
    c = -1.0
    if d1 - d0 < best:
        u = d1 - d0
        a = a + w1
        b = b + w1 * u
        c = c + w1 * u * u
        best = (b + np.sqrt(max(b * b - a * c, 0.0))) / a
        if d2 - d0 < best:
            u = d2 - d0
            a = a + w2
            b = b + w2 * u
            c = c + w2 * u * u
            best = (b + np.sqrt(max(b * b - a * c, 0.0))) / a
    return d0 + best
