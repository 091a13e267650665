"""Fast marching of closest points: distance, band membership and extension in one ordered sweep.

Every cell carries the vector to its closest point on the surface (its foot). Cells beside the front get it
from the cubic interpolant; the others are frozen in order of distance, each starting from the foot of a
frozen neighbour and polishing it. A field is extended by its value at the foot, so grad F . grad psi = 0.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.closest import closest_point, crossing_point
from accelsurf.kernels.grid import neighbours, unravel, voxels_along

#: What is known of a slot's foot.
OPEN, FROZEN, EDGE = 0, 1, 2
#: A cell whose neighbour knows a closer surface by this many voxels is marched again.
CLOSER = 0.02
#: Key of the march overestimates the polished distance by less than this, voxels.
SLACK = 0.3
#: Width of the march's buckets, voxels.
BUCKET = 0.25


@kernel
def first_guess(psi, grid, cell, iz, iy, ix, near, foot):
    """Foot at -psi grad psi/|grad psi|^2, by central differences, one-sided towards the front at a ridge."""
    centre = psi[cell]
    g2 = 0.0
    for axis in range(3):
        h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
        a, b = near[2 * axis], near[2 * axis + 1]
        if a >= 0 and b >= 0:
            g = (psi[b] - psi[a]) / (2.0 * h)
        elif b >= 0:
            g = (psi[b] - centre) / h
        elif a >= 0:
            g = (centre - psi[a]) / h
        else:
            g = 0.0
        foot[axis] = g
        g2 += g * g
    if g2 < 0.5:
        g2 = 0.0
        for axis in range(3):
            h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
            a, b = near[2 * axis], near[2 * axis + 1]
            down = abs(centre) - abs(psi[a]) if a >= 0 else 0.0
            up = abs(centre) - abs(psi[b]) if b >= 0 else 0.0
            g = 0.0
            if down > 0.0 or up > 0.0:
                g = down / h if down >= up else -up / h
            foot[axis] = g if centre >= 0.0 else -g
            g2 += g * g
    if g2 < 1e-6:
        return False
    for axis in range(3):
        foot[axis] *= -centre / g2
    return True


@kernel
def is_near_volume(grid, iz, iy, ix, foot):
    """Whether a foot lies within a voxel of the outermost voxel centres: beyond, psi is only continued.

    A surface that has left the volume is gone.
    """
    pz, py, px = iz + foot[0] / grid.hz, iy + foot[1] / grid.hy, ix + foot[2] / grid.hx
    return -1.0 <= pz <= grid.nz and -1.0 <= py <= grid.ny and -1.0 <= px <= grid.nx


@kernel
def find_feet(start, stop, dense, grid, cells, foot, state):
    """Foot of every cell of the range from psi as it is; ``state`` becomes OPEN where it is not found.

    Cells beside the front always find one: the closest point of the interpolant, or, where that fails or
    lies beyond the nearest edge crossing (voxel-sized features), the linear plane through the crossings.
    """
    psi = dense.psi
    w = np.empty(24)
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    plane = np.empty(3)
    h = min(grid.hz, min(grid.hy, grid.hx))
    for s in range(start, stop):
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        bound = crossing_point(psi, grid, cell, iz, iy, ix, near, plane)
        found = first_guess(psi, grid, cell, iz, iy, ix, near, guess)
        if found:
            found = closest_point(psi, grid, iz, iy, ix, guess, w) and is_near_volume(grid, iz, iy, ix, guess)
        distance = np.sqrt(guess[0] ** 2 + guess[1] ** 2 + guess[2] ** 2)
        if bound >= 0.0 and (not found or distance > bound + 0.1 * h):
            for axis in range(3):
                foot[s, axis] = plane[axis]
            state[s] = FROZEN
        elif found and (bound >= 0.0 or 0.5 * abs(psi[cell]) <= distance <= abs(psi[cell]) + 2.0 * h):
            # Much closer than psi said is no surface: the interpolant beyond the border, from the jump to +-gamma.
            for axis in range(3):
                foot[s, axis] = guess[axis]
            state[s] = FROZEN
        else:
            state[s] = OPEN


@kernel
def length(v, s):
    """Length of row ``s`` of an (n, 3) array."""
    return np.sqrt(v[s, 0] * v[s, 0] + v[s, 1] * v[s, 1] + v[s, 2] * v[s, 2])


@kernel
def review_feet(start, stop, dense, grid, cells, foot, state, reviewed):
    """Compare each cell's foot with those of its neighbours, reading ``state`` and writing ``reviewed``.

    OPEN when a neighbour's foot is closer; EDGE when a neighbour is not in the band (the march starts here).
    """
    near = np.empty(6, np.int64)
    h = min(grid.hz, min(grid.hy, grid.hx))
    for s in range(start, stop):
        reviewed[s] = state[s]
        if state[s] == OPEN:
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        own = length(foot, s)
        for side in range(6):
            if near[side] < 0:
                continue
            other = dense.slot[near[side]]
            if other < 0:
                reviewed[s] = EDGE
            elif state[other] != OPEN:
                oz, oy, ox = step_of(side, grid)
                d = np.sqrt((oz + foot[other, 0]) ** 2 + (oy + foot[other, 1]) ** 2 + (ox + foot[other, 2]) ** 2)
                if d < own - CLOSER * h:
                    reviewed[s] = OPEN
                    break


@kernel
def step_of(side, grid):
    """Vector (mm) from a cell to its neighbour number ``side``."""
    sign = 1.0 if side % 2 == 1 else -1.0
    axis = side // 2
    return (
        sign * grid.hz if axis == 0 else 0.0,
        sign * grid.hy if axis == 1 else 0.0,
        sign * grid.hx if axis == 2 else 0.0,
    )


@kernel
def grown(array, size):
    """``array`` with room for at least one entry more than ``size``, doubled when full."""
    if size < array.shape[0]:
        return array
    larger = np.empty(2 * array.shape[0] + 1024, array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def grown_rows(array, size):
    """As ``grown``, for rows of three."""
    if size < array.shape[0]:
        return array
    larger = np.empty((2 * array.shape[0] + 1024, 3), array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def march(dense, grid, cells, foot, state, half_width):
    """Freeze the OPEN cells, and the cells beyond the EDGE ones, in order of distance up to ``half_width`` voxels.

    ``dense.slot`` is extended with the cells that enter. Returns (cells, foot, state, n) with room to spare;
    slots from the old length on are new, in the order in which the march met them.
    """
    n_old = cells.shape[0]
    n = n_old
    psi, slot = dense.psi, dense.slot
    best = np.full(n, 1e30)
    lowest = np.full(n, 1 << 30)
    # Untidy queue: linked lists of slots, one per bucket of distance. A slot whose distance falls is entered
    # again in the lower bucket; what is left of it in the higher one is passed over, being frozen by then.
    width = BUCKET * min(grid.hz, min(grid.hy, grid.hx))
    buckets = int((half_width + SLACK) * max(grid.hz, max(grid.hy, grid.hx)) / width) + 2
    head = np.full(buckets, -1, np.int64)
    entry_slot = np.empty(1024, np.int64)
    entry_next = np.empty(1024, np.int64)
    entries = 0
    bucket = 0
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    w = np.empty(24)
    reach = half_width + SLACK
    # Sources: for an OPEN cell its frozen neighbours; for a cell not in the band its EDGE neighbours.
    cursor = 0
    source = -1
    while True:
        if cursor < n_old:
            source = cursor
            cursor += 1
            if state[source] == FROZEN:
                continue
            if state[source] == OPEN:
                pull = True
            else:
                pull = False
        else:
            while bucket < buckets and head[bucket] < 0:
                bucket += 1
            if bucket == buckets:
                break
            source = entry_slot[head[bucket]]
            head[bucket] = entry_next[head[bucket]]
            if state[source] != OPEN:
                continue
            cell = cells[source]
            iz, iy, ix = unravel(cell, grid)
            for axis in range(3):
                guess[axis] = foot[source, axis]
            state[source] = FROZEN
            # Polished where that converges; a cell further off than the radius of curvature keeps the
            # neighbour's foot.
            if closest_point(psi, grid, iz, iy, ix, guess, w) and is_near_volume(grid, iz, iy, ix, guess):
                d = np.sqrt(guess[0] ** 2 + guess[1] ** 2 + guess[2] ** 2)
                if d <= best[source] * (1.0 + 1e-3):
                    for axis in range(3):
                        foot[source, axis] = guess[axis]
            pull = False
            if voxels_along(foot[source, 0], foot[source, 1], foot[source, 2], grid) > half_width:
                continue
        cell = cells[source]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        for side in range(6):
            other_cell = near[side]
            if other_cell < 0:
                continue
            other = slot[other_cell]
            oz, oy, ox = step_of(side, grid)
            if pull:
                if other < 0 or other >= n_old or state[other] == OPEN:
                    continue
                target = source
                cz = foot[other, 0] + oz
                cy = foot[other, 1] + oy
                cx = foot[other, 2] + ox
            else:
                if other >= 0 and state[other] != OPEN:
                    continue
                target = other
                cz = foot[source, 0] - oz
                cy = foot[source, 1] - oy
                cx = foot[source, 2] - ox
            if voxels_along(cz, cy, cx, grid) > reach:
                continue
            if target < 0:
                target = n
                cells = grown(cells, n)
                foot = grown_rows(foot, n)
                state = grown(state, n)
                best = grown(best, n)
                lowest = grown(lowest, n)
                cells[n] = other_cell
                state[n] = OPEN
                best[n] = 1e30
                lowest[n] = 1 << 30
                slot[other_cell] = n
                n += 1
            d = np.sqrt(cz * cz + cy * cy + cx * cx)
            if d < best[target]:
                best[target] = d
                foot[target, 0] = cz
                foot[target, 1] = cy
                foot[target, 2] = cx
                into = max(int(d / width), bucket)
                if into < lowest[target]:
                    lowest[target] = into
                    entry_slot = grown(entry_slot, entries)
                    entry_next = grown(entry_next, entries)
                    entry_slot[entries] = target
                    entry_next[entries] = head[into]
                    head[into] = entries
                    entries += 1
    return cells, foot, state, n


@kernel
def front_cells(dense, grid, out):
    """Raveled cells of the whole volume with a 6-neighbour on the other side of the surface, in raster order.

    With ``out`` too short, only the count is right: call again with room. Returns the count.
    """
    psi = dense.psi
    count = 0
    near = np.empty(6, np.int64)
    for iz in range(grid.nz):
        for iy in range(grid.ny):
            for ix in range(grid.nx):
                cell = (iz * grid.ny + iy) * grid.nx + ix
                neighbours(cell, iz, iy, ix, grid, near)
                inside = psi[cell] < 0.0
                for side in range(6):
                    if near[side] >= 0 and (psi[near[side]] < 0.0) != inside:
                        if count < out.shape[0]:
                            out[count] = cell
                        count += 1
                        break
    return count
