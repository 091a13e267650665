"""Fast marching of closest points: distance, band membership and extension in one ordered sweep.

Every cell carries the vector to its closest point on the surface (its foot). Cells beside the front get it
from the cubic interpolant; the others are frozen in order of distance, each starting from the foot of a
frozen neighbour and polishing it. A field is extended by its value at the foot, so grad F . grad psi = 0.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.closest import closest_point, correct_once, crossing_point, refine
from accelsurf.kernels.cubic import cubic
from accelsurf.kernels.grid import neighbours, unravel, voxels_along
from accelsurf.kernels.interpolate import value_and_gradient

#: What is known of a slot's foot.
OPEN, FROZEN, EDGE = 0, 1, 2
#: A cell whose neighbour knows a closer surface by this many voxels is marched again.
CLOSER = 0.02
#: A cell is met when its neighbour's tangent plane says that it is at most this much beyond the band, voxels.
SLACK = 0.1
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


#: Cells whose first correction is done together: independent of each other, they overlap in the processor.
TOGETHER = 128


@kernel
def guess_feet(first, count, dense, grid, band, inner, near, guess, guesses, beside):
    """First guesses of ``count`` feet from slot ``first`` on, as rows z, y, x of ``guesses``; 0 where there is none.

    ``beside`` marks the cells with a neighbour on the other side of the surface. Where |psi| was above ``inner`` mm
    before the surface moved, centred differences would reach beyond the band: the guess is the old foot, drawn out or
    in by what psi has changed.
    """
    psi = dense.psi
    for i in range(count):
        s = first + i
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        value = psi[cell]
        inside = value < 0.0
        crossed = False
        for side in range(6):
            if near[side] >= 0 and (psi[near[side]] < 0.0) != inside:
                crossed = True
        beside[i] = crossed
        ratio = value / band.psi[s] if abs(band.psi[s]) > inner else 0.0
        for axis in range(3):
            guess[axis] = ratio * band.foot[s, axis]
        if guess[0] == 0.0 and guess[1] == 0.0 and guess[2] == 0.0:
            if not first_guess(psi, grid, cell, iz, iy, ix, near, guess):
                guess[0], guess[1], guess[2] = 0.0, 0.0, 0.0
        guesses[0, i], guesses[1, i], guesses[2, i] = guess[0], guess[1], guess[2]


@kernel
def levels_at(first, count, psi, grid, cells, w, feet, levels):
    """Psi and its gradient at ``count`` feet from slot ``first`` on, as rows of ``levels``."""
    hz, hy, hx = 1.0 / grid.hz, 1.0 / grid.hy, 1.0 / grid.hx
    sy, sz = grid.nx, grid.ny * grid.nx
    for i in range(count):
        iz, iy, ix = unravel(cells[first + i], grid)
        pz, py, px = iz + feet[0, i] * hz, iy + feet[1, i] * hy, ix + feet[2, i] * hx
        bz, by, bx = int(pz) - 1, int(py) - 1, int(px) - 1
        # Well inside the volume, without what value_and_gradient does for the others.
        if 0 <= bz <= grid.nz - 4 and 0 <= by <= grid.ny - 4 and 0 <= bx <= grid.nx - 4:
            uz, uy, ux = np.float32(pz - bz), np.float32(py - by), np.float32(px - bx)
            level, gz, gy, gx = cubic(psi, (bz * grid.ny + by) * grid.nx + bx, sy, sz, uz, uy, ux)
            levels[0, i], levels[1, i], levels[2, i], levels[3, i] = level, gz * hz, gy * hy, gx * hx
        else:
            levels[0, i], levels[1, i], levels[2, i], levels[3, i] = value_and_gradient(psi, grid, pz, py, px, w)


@kernel
def find_feet(start, stop, dense, grid, band, inner, foot, state):
    """Foot of every cell of the range from psi as it is; ``state`` becomes OPEN where it is not found.

    Cells beside the front always find one: the closest point of the interpolant, or, where that fails or
    lies beyond the nearest edge crossing (voxel-sized features), the linear plane through the crossings.
    ``band`` is the band when psi was last a distance; see `guess_feet` for ``inner``.
    """
    psi = dense.psi
    w = np.empty(24)
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    plane = np.empty(3)
    guesses = np.empty((3, TOGETHER), np.float32)
    feet = np.empty((3, TOGETHER), np.float32)
    levels = np.empty((4, TOGETHER), np.float32)
    beside = np.empty(TOGETHER, np.bool_)
    done = np.empty(TOGETHER, np.bool_)
    for first in range(start, stop, TOGETHER):
        count = min(TOGETHER, stop - first)
        guess_feet(first, count, dense, grid, band, inner, near, guess, guesses, beside)
        levels_at(first, count, psi, grid, band.cells, w, guesses, levels)
        correct_once(count, grid, guesses, levels, feet, done)
        for i in range(count):
            s = first + i
            cell = band.cells[s]
            iz, iy, ix = unravel(cell, grid)
            found = done[i]
            if found:
                guess[0], guess[1], guess[2] = feet[0, i], feet[1, i], feet[2, i]
            else:
                guess[0], guess[1], guess[2] = guesses[0, i], guesses[1, i], guesses[2, i]
                level = (levels[0, i], levels[1, i], levels[2, i], levels[3, i])
                found = refine(psi, grid, iz, iy, ix, guess, w, level)
            found = found and is_near_volume(grid, iz, iy, ix, guess)
            bound = -1.0
            if beside[i]:
                neighbours(cell, iz, iy, ix, grid, near)
                bound = crossing_point(psi, grid, cell, iz, iy, ix, near, plane)
            state[s] = settle(psi[cell], grid, plane, bound, guess, found)
            foot[s, 0], foot[s, 1], foot[s, 2] = guess[0], guess[1], guess[2]


@kernel
def settle(value, grid, plane, bound, guess, found):
    """Whether a foot, ``found`` at ``guess``, holds for a cell with psi = ``value``: FROZEN or OPEN.

    Where an edge crossing, ``bound`` mm off (-1: there is none), lies closer, the foot of its ``plane`` is put there.
    """
    h = min(grid.hz, min(grid.hy, grid.hx))
    distance = np.sqrt(guess[0] * guess[0] + guess[1] * guess[1] + guess[2] * guess[2])
    if bound >= 0.0 and (not found or distance > bound + 0.1 * h):
        for axis in range(3):
            guess[axis] = plane[axis]
        return FROZEN
    # Much closer than psi said is no surface: the interpolant beyond the border, from the jump to +-gamma.
    if found and (bound >= 0.0 or 0.5 * abs(value) <= distance <= abs(value) + 2.0 * h):
        return FROZEN
    return OPEN


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
    """``array`` with room for at least one entry more than ``size``, half as long again when full."""
    if size < array.shape[0]:
        return array
    larger = np.empty(array.shape[0] + array.shape[0] // 2 + 1024, array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def grown_rows(array, size):
    """As ``grown``, for rows of three."""
    if size < array.shape[0]:
        return array
    larger = np.empty((array.shape[0] + array.shape[0] // 2 + 1024, 3), array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def flattened(foot, via, grid, cz, cy, cx, out):
    """Foot (into ``out``) of a cell whose neighbour ``via`` has the foot (cz, cy, cx) from the cell.

    The point where the neighbour's tangent plane is closest: right on a plane, and as good a guess as psi's slope
    gives. The neighbour's own foot where that neighbour is too close to the surface to tell its normal.
    Returns its length in voxels.
    """
    fz, fy, fx = foot[via, 0], foot[via, 1], foot[via, 2]
    length2 = fz * fz + fy * fy + fx * fx
    h = min(grid.hz, min(grid.hy, grid.hx))
    if length2 > 0.1 * h * h:
        along = (cz * fz + cy * fy + cx * fx) / length2
        cz, cy, cx = along * fz, along * fy, along * fx
    out[0], out[1], out[2] = cz, cy, cx
    return voxels_along(cz, cy, cx, grid)


@kernel
def freeze(psi, grid, cell, foot, via, best, source, guess, w):
    """Polish the foot of slot ``source``, found through its neighbour ``via``, where that converges.

    A cell further off than the radius of curvature keeps the neighbour's foot.
    """
    iz, iy, ix = unravel(cell, grid)
    flattened(foot, via, grid, foot[source, 0], foot[source, 1], foot[source, 2], guess)
    if closest_point(psi, grid, iz, iy, ix, guess, w) and is_near_volume(grid, iz, iy, ix, guess):
        d = np.sqrt(guess[0] * guess[0] + guess[1] * guess[1] + guess[2] * guess[2])
        if d <= best * (1.0 + 1e-3):
            foot[source, 0], foot[source, 1], foot[source, 2] = guess[0], guess[1], guess[2]


@kernel
def march(dense, grid, cells, n_old, foot, state, half_width):
    """Freeze the OPEN cells, and the cells beyond the EDGE ones, in order of distance up to ``half_width`` voxels.

    ``cells``, ``foot`` and ``state`` hold ``n_old`` slots and may have room for more; they are changed in place while
    the room lasts. ``dense.slot`` is extended with the cells that enter. Returns (cells, foot, state, n) with room to
    spare; slots from ``n_old`` on are new, in the order in which the march met them.
    """
    n = n_old
    psi, slot = dense.psi, dense.slot
    room = cells.shape[0]
    best = np.full(room, np.float32(1e30))
    lowest = np.full(room, np.int32(1 << 30))
    via = np.empty(room, np.int32)
    # Untidy queue: linked lists of slots, one per bucket of distance. A slot whose distance falls is entered
    # again in the lower bucket; what is left of it in the higher one is passed over, being frozen by then.
    width = BUCKET * min(grid.hz, min(grid.hy, grid.hx))
    reach = half_width + SLACK
    buckets = int((reach + 2.0) * max(grid.hz, max(grid.hy, grid.hx)) / width) + 2
    head = np.full(buckets, -1, np.int64)
    entry_slot = np.empty(1024, np.int64)
    entry_next = np.empty(1024, np.int64)
    entries = 0
    bucket = 0
    near = np.empty(6, np.int64)
    steps = np.empty((6, 3))
    for side in range(6):
        steps[side, 0], steps[side, 1], steps[side, 2] = step_of(side, grid)
    guess = np.empty(3)
    w = np.empty(24)
    # Sources: for an OPEN cell its frozen neighbours; for a cell not in the band its EDGE neighbours.
    cursor = 0
    source = -1
    while True:
        pull = False
        if cursor < n_old:
            source = cursor
            cursor += 1
            if state[source] == FROZEN:
                continue
            pull = state[source] == OPEN
        else:
            while bucket < buckets and head[bucket] < 0:
                bucket += 1
            if bucket == buckets:
                break
            source = entry_slot[head[bucket]]
            head[bucket] = entry_next[head[bucket]]
            if state[source] != OPEN:
                continue
            freeze(psi, grid, cells[source], foot, via[source], best[source], source, guess, w)
            state[source] = FROZEN
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
            if pull:
                if other < 0 or other >= n_old or state[other] == OPEN:
                    continue
                target, through, sign = source, other, 1.0
            else:
                if other >= 0 and state[other] != OPEN:
                    continue
                target, through, sign = other, source, -1.0
            cz = foot[through, 0] + sign * steps[side, 0]
            cy = foot[through, 1] + sign * steps[side, 1]
            cx = foot[through, 2] + sign * steps[side, 2]
            if flattened(foot, through, grid, cz, cy, cx, guess) > reach:
                continue
            if target < 0:
                target = n
                cells = grown(cells, n)
                foot = grown_rows(foot, n)
                state = grown(state, n)
                best = grown(best, n)
                lowest = grown(lowest, n)
                via = grown(via, n)
                cells[n] = other_cell
                state[n] = OPEN
                best[n] = 1e30
                lowest[n] = 1 << 30
                slot[other_cell] = n
                n += 1
            d = np.sqrt(cz * cz + cy * cy + cx * cx)
            if d < best[target]:
                best[target] = d
                via[target] = through
                foot[target, 0] = cz
                foot[target, 1] = cy
                foot[target, 2] = cx
                into = min(max(int(d / width), bucket), buckets - 1)
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
