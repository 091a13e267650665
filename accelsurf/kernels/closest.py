"""Closest point on the zero level of the cubic interpolant of psi.

Ridges of the distance, where the closest points of neighbours lie on opposite parts of the surface.

First guesses of the closest points: as the same arithmetic for many cells, one by one where that does not do.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, THICK, neighbours, step_of, unravel, unravel_in_vectors
from accelsurf.kernels.interpolate import (
    LEVELS,
    enter_point,
    limited_in_vectors,
    limited_memory,
    value_and_gradient,
)
from accelsurf.kernels.simd.cubic import cubic


@kernel
def is_near_volume(grid, iz, iy, ix, closest_point, margin):
    """Test if a closest point lies within ``margin`` voxels of the outermost voxel centres.

    Beyond, psi is only continued. Along axes of `THICK` slices it must not lie beyond at all: a voxel there is many of
    the others, and psi continued so far has a zero level of its own, which came into the volume far from the object.
    """
    thick = THICK * min(grid.hz, min(grid.hy, grid.hx))
    mz = margin if grid.hz < thick else 1e-3
    my = margin if grid.hy < thick else 1e-3
    mx = margin if grid.hx < thick else 1e-3
    lz = -(iz + mz) * grid.hz
    ly = -(iy + my) * grid.hy
    lx = -(ix + mx) * grid.hx
    uz, uy = (grid.nz - 1.0 - iz + mz) * grid.hz, (grid.ny - 1.0 - iy + my) * grid.hy
    ux = (grid.nx - 1.0 - ix + mx) * grid.hx
    z = closest_point[0]
    y = closest_point[1]
    x = closest_point[2]
    # Without branches: with them this took as long as all the rest of a closest point.
    return (lz <= z) & (z <= uz) & (ly <= y) & (y <= uy) & (lx <= x) & (x <= ux)


@kernel(inlined=True)
def is_between_signs(psi, grid, iz, iy, ix, closest_point):
    """Test if psi changes its sign among the voxels around a closest point.

    Else no voxel is on the other side, and the zero level there is an overshoot of the interpolant, as between thick
    slices: a surface that the labels do not have. A smooth surface may pass a corner of a cube of voxels and change no
    sign there: the next voxels count too, along axes as fine as the finest.
    """
    bz = int(iz + closest_point[0] / grid.hz)
    by = int(iy + closest_point[1] / grid.hy)
    bx = int(ix + closest_point[2] / grid.hx)
    inside = psi[np.uint64((iz * grid.ny + iy) * grid.nx + ix)] < 0.0
    # The voxel beyond the surface, if there is one: nearly always this ends it.
    az = min(bz + 1, grid.nz - 1) if closest_point[0] > 0.0 else bz
    ay = min(by + 1, grid.ny - 1) if closest_point[1] > 0.0 else by
    ax = min(bx + 1, grid.nx - 1) if closest_point[2] > 0.0 else bx
    if (psi[np.uint64((az * grid.ny + ay) * grid.nx + ax)] < 0.0) != inside:
        return True
    fine = 2.0 * min(grid.hz, min(grid.hy, grid.hx))
    mz = 1 if grid.hz < fine else 0
    my = 1 if grid.hy < fine else 0
    mx = 1 if grid.hx < fine else 0
    for more in range(2):
        for az in range(max(bz - more * mz, 0), min(bz + 2 + more * mz, grid.nz)):
            for ay in range(max(by - more * my, 0), min(by + 2 + more * my, grid.ny)):
                row = (az * grid.ny + ay) * grid.nx
                for ax in range(max(bx - more * mx, 0), min(bx + 2 + more * mx, grid.nx)):
                    if (psi[row + ax] < 0.0) != inside:
                        return True
    return False


MAX_ITERATIONS = 6
#: The iteration ends once a correction is below this many voxels: the first, which knows nothing of the
#: curvature and leaves distance x curvature of it, and the later ones, which leave its square. Further than a voxel
#: off, where the closest point is only read from, the first may be larger in proportion to the distance.
FIRST_TOLERANCE = 0.015
TOLERANCE = 0.05
#: Smallest |grad psi|^2: below it the zero level of psi is not determined.
MIN_SLOPE2 = 0.04
#: Longest correction in one iteration, voxels: the interpolant is trusted only near the front.
MAX_MOVE = 1.5
#: Status of a closest point in `closest_points`: it still moves.
ACTIVE = 0.0
#: It lies on the surface.
FOUND = 1.0
#: There is none, or it left the volume.
LOST = 2.0
# Rows of the memory of `closest_points`, `BATCH` long each, one array for the compiler to see that they are apart.
#: Closest point, z, y, x.
CLOSEST = np.uint64(0 * BATCH)
#: Its status.
STATUS = np.uint64(3 * BATCH)
#: Last correction along the level, z, y, x.
LAST = np.uint64(4 * BATCH)
#: Square of the last correction.
SQUARE = np.uint64(7 * BATCH)
#: Relaxation.
RELAX = np.uint64(8 * BATCH)
#: Square of the first correction.
START = np.uint64(9 * BATCH)
#: Psi and its gradient at the closest point.
LEVEL = np.uint64(10 * BATCH)
#: Value of psi where the surface lies, see `residues`.
OFFSET = np.uint64(14 * BATCH)
#: Above 0: limit the interpolant, see `limited`.
LIMITED = np.uint64(15 * BATCH)
NEXT = np.uint64(BATCH)
ROWS = 16


@kernel
def closest_point_memory():
    """Memory for `closest_points`, and in it the closest points (3, `BATCH`) and their status (`BATCH`,)."""
    memory = np.zeros(ROWS * BATCH, np.float32)
    return memory, memory[: 3 * BATCH].reshape(3, BATCH), memory[3 * BATCH : 4 * BATCH]


@kernel
def nodes_memory():
    """Memory for `levels_at`, `BATCH` columns each.

    The cell's index z, y, x; where its closest point lies among the four nodes of each axis; the first of these nodes
    in psi, -1 where they are not all well inside; a list of columns.
    `limited_levels_at` has the first nodes in the order of that list.
    """
    return (
        np.zeros(3 * BATCH, np.float32),
        np.zeros(3 * BATCH, np.float32),
        np.zeros(BATCH, np.int64),
        np.zeros(BATCH, np.int64),
    )


@kernel
def closest_points(count, psi, grid, cells, memory, w):
    """Move the closest points in ``memory``, mm from the first ``count`` of ``cells``, to the surface psi = 0.

    Chopp's two corrections at once: down the gradient to the zero level, -psi g/|g|^2, and along the level until the
    cell lies on the normal, r - (r.g) g/|g|^2 with r the vector from the closest point to the cell. The latter is too
    long by 1 + distance x curvature, which two successive residues tell (secant): so it converges also further off than
    the radius of curvature. ``memory`` (`ROWS` x `BATCH`,) float32 holds the closest points, and then their status:
    FOUND where one has converged; its row OFFSET, set before, is the value (mm) that stands for 0 above. ``w`` (24,) is
    scratch.
    """
    for i in range(count):
        memory[STATUS + np.uint64(i)] = ACTIVE
    limited = memory[LIMITED] > 0.0
    nodes = nodes_memory()
    places_of(count, grid, cells, nodes)
    if limited:
        lines = limited_memory(grid)
        for iteration in range(MAX_ITERATIONS):
            if limited_levels_at(count, psi, grid, nodes, memory, lines) == 0:
                return
            correct(count, iteration, grid, memory)
        return
    for iteration in range(MAX_ITERATIONS):
        if levels_at(count, psi, grid, nodes, memory, w) == 0:
            return
        correct(count, iteration, grid, memory)


@kernel
def places_of(count, grid, cells, nodes):
    """Write the indices of the first ``count`` of ``cells`` to ``nodes``: once, as division is slow."""
    place = nodes[0]
    for n in range(count):
        i = np.uint64(n)
        place[i], place[i + NEXT], place[i + NEXT + NEXT] = unravel_in_vectors(cells[n], grid)


@kernel
def find_nodes(i, grid, nodes, memory):
    """Find the nodes around the closest point in column ``i`` of ``memory``, without a branch."""
    place, inner, first, _ = nodes
    pz = place[i] + memory[CLOSEST + i] * (1.0 / grid.hz)
    py = place[i + NEXT] + memory[CLOSEST + NEXT + i] * (1.0 / grid.hy)
    px = place[i + NEXT + NEXT] + memory[CLOSEST + NEXT + NEXT + i] * (1.0 / grid.hx)
    unit = np.int32(1)
    bz = np.int32(pz) - unit
    by = np.int32(py) - unit
    bx = np.int32(px) - unit
    inner[i] = np.float32(pz - bz)
    inner[i + NEXT] = np.float32(py - by)
    inner[i + NEXT + NEXT] = np.float32(px - bx)
    # Well inside the volume, without the cases that value_and_gradient is for.
    inside = (
        (0 <= bz)
        & (bz <= grid.nz - 4)
        & (0 <= by)
        & (by <= grid.ny - 4)
        & (0 <= bx)
        & (bx <= grid.nx - 4)
    )
    first[i] = (bz * grid.ny + by) * grid.nx + bx if inside else -1


@kernel
def active_columns(count, memory, columns):
    """Write the active ones of the first ``count`` columns of ``memory`` to ``columns``; returns how many there are."""
    # Without branches, which nobody could predict.
    active = 0
    for n in range(count):
        columns[active] = n
        active += np.int64(memory[STATUS + np.uint64(n)] == ACTIVE)
    return active


@kernel
def levels_at(count, psi, grid, nodes, memory, w):
    """Psi and its gradient at the active closest points of ``memory``; returns how many there are.

    ``nodes`` = `nodes_memory`, with the cells' indices.
    """
    place, inner, first, columns = nodes
    hz = 1.0 / grid.hz
    hy = 1.0 / grid.hy
    hx = 1.0 / grid.hx
    sy, sz = grid.nx, grid.ny * grid.nx
    active = active_columns(count, memory, columns)
    if active == 0:
        return 0
    # Of all columns, so that it runs in vectors.
    for i in range(np.uint64(count)):
        find_nodes(i, grid, nodes, memory)
    for n in range(active):
        i = np.uint64(columns[n])
        if first[i] >= 0:
            uz = inner[i]
            uy = inner[i + NEXT]
            ux = inner[i + NEXT + NEXT]
            level, gz, gy, gx = cubic(psi, first[i], sy, sz, uz, uy, ux)
            gz = gz * hz
            gy = gy * hy
            gx = gx * hx
        else:
            pz, py = (
                place[i] + memory[CLOSEST + i] * hz,
                place[i + NEXT] + memory[CLOSEST + NEXT + i] * hy,
            )
            px = place[i + NEXT + NEXT] + memory[CLOSEST + NEXT + NEXT + i] * hx
            level, gz, gy, gx = value_and_gradient(psi, grid, pz, py, px, w)
        at = LEVEL + i
        memory[at] = level
        memory[at + NEXT] = gz
        memory[at + NEXT + NEXT] = gy
        memory[at + NEXT + NEXT + NEXT] = gx
    return active


@kernel
def limited_levels_at(count, psi, grid, nodes, memory, lines):
    """Same as `levels_at`, of the limited interpolant; ``lines`` = `limited_memory`."""
    place, _, first, columns = nodes
    active = active_columns(count, memory, columns)
    for n in range(active):
        i = np.uint64(columns[n])
        pz = place[i] + memory[CLOSEST + i] / grid.hz
        py = place[i + NEXT] + memory[CLOSEST + NEXT + i] / grid.hy
        px = place[i + NEXT + NEXT] + memory[CLOSEST + NEXT + NEXT + i] / grid.hx
        first[n] = enter_point(np.uint64(n), grid, pz, py, px, lines)
    limited_in_vectors(active, psi, grid, first, lines)
    for n in range(active):
        at, row = LEVEL + np.uint64(columns[n]), LEVELS + np.uint64(n)
        for _ in range(4):
            memory[at] = lines[row]
            at, row = at + NEXT, row + NEXT
    return active


@kernel
def correct(count, iteration, grid, memory):
    """One correction of the active closest points, see `closest_points`; all columns alike, to run in vectors."""
    hz = np.float32(1.0 / grid.hz)
    hy = np.float32(1.0 / grid.hy)
    hx = np.float32(1.0 / grid.hx)
    zero = np.float32(0.0)
    unit = np.float32(1.0)
    quarter = np.float32(0.25)
    active = np.float32(ACTIVE)
    found = np.float32(FOUND)
    lost = np.float32(LOST)
    shortest = np.float32(0.1)
    longest = np.float32(4.0)
    tiny = np.float32(1e-30)
    least, most = np.float32(MIN_SLOPE2), np.float32(MAX_MOVE)
    first, later = iteration == 0, iteration >= 2
    enough = np.float32(FIRST_TOLERANCE if first else TOLERANCE)
    for i in range(np.uint64(count)):
        z = memory[CLOSEST + i]
        y = memory[CLOSEST + NEXT + i]
        x = memory[CLOSEST + NEXT + NEXT + i]
        v, gz = memory[LEVEL + i] - memory[OFFSET + i], memory[LEVEL + NEXT + i]
        gy, gx = memory[LEVEL + NEXT + NEXT + i], memory[LEVEL + NEXT + NEXT + NEXT + i]
        g2 = gz * gz + gy * gy + gx * gx
        inverse = unit / max(g2, tiny)
        along = (z * gz + y * gy + x * gx) * inverse
        tz = along * gz - z
        ty = along * gy - y
        tx = along * gx - x
        t2 = tz * tz + ty * ty + tx * tx
        before = memory[SQUARE + i]
        relax = memory[RELAX + i]
        begun = memory[START + i]
        left = (
            tz * memory[LAST + i]
            + ty * memory[LAST + NEXT + i]
            + tx * memory[LAST + NEXT + NEXT + i]
        )
        longer = min(max(relax / max(unit - left / max(before, tiny), quarter), shortest), longest)
        longer = longer if before > zero else relax
        factor = unit if first else longer
        begun = t2 if first else begun
        down = v * inverse
        dz = factor * tz - down * gz
        dy = factor * ty - down * gy
        dx = factor * tx - down * gx
        move = np.sqrt(dz * hz * dz * hz + dy * hy * dy * hy + dx * hx * dx * hx)
        scale = min(unit, most / max(move, tiny))
        distance = np.sqrt(z * hz * z * hz + y * hy * y * hy + x * hx * x * hx)
        distance = max(unit, distance) if first else unit
        status = memory[STATUS + i]
        now = found if move < enough * distance else active
        # Also where psi is no number.
        now = now if g2 > least else lost
        # Residues that do not fall.
        now = lost if later & (t2 > quarter * begun) else now
        scale = scale if (status == active) & (now != lost) else zero
        memory[CLOSEST + i] = z + scale * dz
        memory[CLOSEST + NEXT + i] = y + scale * dy
        memory[CLOSEST + NEXT + NEXT + i] = x + scale * dx
        memory[LAST + i] = tz
        memory[LAST + NEXT + i] = ty
        memory[LAST + NEXT + NEXT + i] = tx
        memory[SQUARE + i] = zero if move > most else t2
        memory[RELAX + i], memory[START + i] = factor, begun
        memory[STATUS + i] = now if status == active else status


@kernel
def crossing_point(psi, grid, cell, iz, iy, ix, near, closest_point):
    """Closest point of a cell beside the front from its linear edge crossings: the plane through the nearest per axis.

    ``near`` holds the 6-neighbours of the cell (-1 beyond the border). Returns the shortest single crossing
    (mm, an upper bound of the distance), or -1 when no neighbour lies on the other side.
    """
    value = psi[cell]
    inside = value < 0.0
    shortest = 1e30
    inverse = 0.0
    for axis in range(3):
        h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
        best = 1e30
        sign = 0.0
        for side in range(2):
            other = near[2 * axis + side]
            if other >= 0 and (psi[np.uint64(other)] < 0.0) != inside:
                d = h * abs(value) / (abs(value) + abs(psi[np.uint64(other)]) + 1e-30)
                if d < best:
                    best = d
                    sign = 1.0 if side == 1 else -1.0
        closest_point[axis] = 0.0
        if best < 1e29:
            best = max(best, 1e-6 * h)
            shortest = min(shortest, best)
            inverse += 1.0 / (best * best)
            closest_point[axis] = sign / best
    if inverse == 0.0:
        return -1.0
    for axis in range(3):
        closest_point[axis] /= inverse
    return shortest


#: A cell takes another closest point, of a neighbour or beyond a ridge, when that is closer by this many voxels.
MIN_GAIN = 0.02
#: Psi may rise by this many voxels on the side that a ridge came from and has left: a step is half a voxel at most.
PASSED = 0.25
#: Shortest closest point, voxels, whose direction is a normal.
MIN_LENGTH = 0.1


@kernel
def towards_ridge(value, towards, back, least):
    """Test if a ridge may have come across a cell of psi = ``value`` from the neighbour ``towards``, of psi: 1 or 0.

    ``value`` and ``towards``, and ``back`` on the opposite side, count away from the surface; ``least`` is the smallest
    spacing. Where psi rises along the axis none has: most cells need no more than this.
    """
    passed = np.float32(PASSED) * least
    return np.int32((towards <= value) & (back - passed <= value) & (towards >= np.float32(0.0)))


@kernel
def sides_beyond(value, least, around):
    """The sides of a cell of psi = ``value`` beyond which a ridge may lie, a bit each; ``around`` = psi at them."""
    a, b, c, d, e, f = around
    sign = np.float32(-1.0) if value < np.float32(0.0) else np.float32(1.0)
    value = sign * value
    a = sign * a
    b = sign * b
    c = sign * c
    d = sign * d
    e = sign * e
    f = sign * f
    sides = towards_ridge(value, a, b, least) | (towards_ridge(value, b, a, least) << np.int32(1))
    sides |= (towards_ridge(value, c, d, least) << np.int32(2)) | (
        towards_ridge(value, d, c, least) << np.int32(3)
    )
    sides |= (towards_ridge(value, e, f, least) << np.int32(4)) | (
        towards_ridge(value, f, e, least) << np.int32(5)
    )
    return sides


@kernel
def beyond_ridges(slots, slot, grid, band, residue, memory, out):
    """Move guesses of the closest points of ``slots`` to the surface beyond a ridge, where that has come closer.

    A neighbour is beyond a ridge when its closest point lay the other way (``band``: when psi was a distance); its
    tangent plane, moved as psi has changed there, tells how far that surface is. In a thin plate the neighbour's
    closest point itself is too far off sideways to tell. ``memory`` and ``out`` as in `guesses.guess_closest_points`:
    the guess comes with the neighbour's residue.
    """
    # The first rows are psi at the cell and at its sides.
    rows, alone, sides = memory
    guesses, _, offset = out
    closest_point, old = band.to_closest, band.psi
    h = min(grid.hz, min(grid.hy, grid.hx))
    moved, strides = np.empty(3), np.zeros(33, np.int64)
    for side in range(6):
        stride = grid.ny * grid.nx if side < 2 else (grid.nx if side < 4 else 1)
        strides[1 << side] = stride if side & 1 else -stride
    for i in range(slots.shape[0]):
        left = sides[i]
        if left == 0:
            continue
        s = slots[i]
        cell = band.cells[s]
        to_closest = closest_point[s]
        inside = rows[i] < 0.0
        # So that psi counts away from the surface on either side of it.
        sign = -1.0 if inside else 1.0
        z = guesses[0, i]
        y = guesses[1, i]
        x = guesses[2, i]
        least = np.sqrt(z * z + y * y + x * x) - MIN_GAIN * h
        found, scale = -1, 0.0
        while left != 0:
            bit = left & -left
            left ^= bit
            other = slot[cell + strides[bit]]
            if other < 0:
                continue
            # Nearly always this ends it.
            if (
                closest_point[other, 0] * to_closest[0]
                + closest_point[other, 1] * to_closest[1]
                + closest_point[other, 2] * to_closest[2]
                >= 0.0
            ):
                continue
            if (old[other] < 0.0) != inside or abs(old[other]) < MIN_LENGTH * h:
                continue
            side = 0
            while bit >> side != 1:
                side += 1
            oz, oy, ox = step_of(side, grid)
            along = (
                oz * closest_point[other, 0]
                + oy * closest_point[other, 1]
                + ox * closest_point[other, 2]
            ) / abs(old[other])
            d = sign * rows[(1 + side) * BATCH + i] + along
            if 0.0 < d < least:
                least = d
                found = other
                scale = d / abs(old[other])
        if found >= 0:
            for axis in range(3):
                moved[axis] = scale * closest_point[found, axis]
                guesses[axis, i] = moved[axis]
            offset[i] = residue[found]
            iz, iy, ix = unravel(cell, grid)
            alone[i] = not is_near_volume(grid, iz, iy, ix, moved, 0.0)


# Rows of the memory of `guess_closest_points`, `BATCH` long each.
#: Psi at the cell and around it (-z, +z, -y, +y, -x, +x).
PSI = np.uint64(0 * BATCH)
#: Old psi.
OLD = np.uint64(7 * BATCH)
#: Old closest point, z, y, x.
OLD_CLOSEST = np.uint64(8 * BATCH)
#: Residue.
RESIDUE = np.uint64(11 * BATCH)
#: Index z, y, x.
PLACE = np.uint64(12 * BATCH)

GUESS_ROWS = 15


@kernel
def guess_memory():
    """Memory for `guess_closest_points`.

    Rows, and per cell whether it needs `first_guess`, and the sides of `sides_beyond`.
    """
    return (
        np.zeros(GUESS_ROWS * BATCH, np.float32),
        np.empty(BATCH, np.bool_),
        np.empty(BATCH, np.int32),
    )


@kernel
def first_guess(psi, grid, cell, iz, iy, ix, near, closest_point):
    """Closest point at -psi grad psi/|grad psi|^2, by central differences, one-sided towards the front at a ridge."""
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
        closest_point[axis] = g
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
            closest_point[axis] = g if centre >= 0.0 else -g
            g2 += g * g
    if g2 < 1e-6:
        return False
    for axis in range(3):
        closest_point[axis] *= -centre / g2
    return True


@kernel
def guess_closest_points(slots, dense, grid, band, guide, scratch, out):
    """First guesses of the closest points of ``slots``, at most `BATCH`.

    ``guide`` = (inner, residue (n,)). ``scratch`` = (near (6,), guess (3,), `guess_memory`).
    ``out`` = (guesses (3, `BATCH`), rows z, y, x, 0 where there is none; beside (`BATCH`,) bool; offset (`BATCH`,)
    float32), of which the first columns count, one for each slot. ``beside`` marks the cells with a neighbour on the
    other side of the surface, ``offset`` is the residue of the part of it that the guess is on. Where |psi| was above
    ``inner`` mm before the surface moved, centred differences would need cells beyond the band; where there is a
    residue, they may lie across a ridge: the guess is the old closest point, scaled by the change of psi.
    """
    near, guess, memory = scratch
    rows, alone, _ = memory
    guesses, _, _ = out
    gather_around(slots, dense.psi, grid, band, guide[1], rows)
    guess_alike(grid, guide[0], memory, out)
    beyond_ridges(slots, dense.slot, grid, band, guide[1], memory, out)
    for i in range(slots.shape[0]):
        if alone[i]:
            cell = band.cells[slots[i]]
            iz, iy, ix = unravel(cell, grid)
            neighbours(cell, iz, iy, ix, grid, near)
            if not first_guess(dense.psi, grid, cell, iz, iy, ix, near, guess):
                guess[0] = 0.0
                guess[1] = 0.0
                guess[2] = 0.0
            guesses[0, i] = guess[0]
            guesses[1, i] = guess[1]
            guesses[2, i] = guess[2]


@kernel
def gather_around(slots, psi, grid, band, residue, rows):
    """Fill ``rows`` with psi, closest points and residues of the cells of ``slots``.

    Beyond the border psi is as in the cell.
    """
    plane, row = grid.ny * grid.nx, grid.nx
    for n in range(slots.shape[0]):
        s = np.uint64(slots[n])
        i = np.uint64(n)
        cell = band.cells[s]
        iz, iy, ix = unravel_in_vectors(cell, grid)
        at, here = PSI + i, np.uint64(cell)
        rows[at] = psi[here]
        rows[at + NEXT] = psi[here - np.uint64(plane if iz > 0 else 0)]
        rows[at + np.uint64(2) * NEXT] = psi[here + np.uint64(plane if iz < grid.nz - 1 else 0)]
        rows[at + np.uint64(3) * NEXT] = psi[here - np.uint64(row if iy > 0 else 0)]
        rows[at + np.uint64(4) * NEXT] = psi[here + np.uint64(row if iy < grid.ny - 1 else 0)]
        rows[at + np.uint64(5) * NEXT] = psi[here - np.uint64(1 if ix > 0 else 0)]
        rows[at + np.uint64(6) * NEXT] = psi[here + np.uint64(1 if ix < grid.nx - 1 else 0)]
        rows[OLD + i], rows[RESIDUE + i] = band.psi[s], residue[s]
        at = OLD_CLOSEST + i
        rows[at], rows[at + NEXT] = band.to_closest[s, 0], band.to_closest[s, 1]
        rows[at + NEXT + NEXT] = band.to_closest[s, 2]
        at = PLACE + i
        rows[at] = iz
        rows[at + NEXT] = iy
        rows[at + NEXT + NEXT] = ix


@kernel
def guess_alike(grid, inner, memory, out):
    """The guesses of `guess_closest_points` without ridges.

    The arithmetic is the same for all cells, so that it runs in vectors. Of all columns, whether they are used or not:
    what is left over from vectors may be rounded otherwise. ``memory`` = `guess_memory`; sets in it which cells are
    left to `first_guess`, at the border of the volume and where the gradient is small, and the `sides_beyond` which a
    ridge may lie.
    """
    rows, alone, sides = memory
    guesses, beside, offset = out
    gz = guesses[0]
    gy = guesses[1]
    gx = guesses[2]
    hz = np.float32(grid.hz)
    hy = np.float32(grid.hy)
    hx = np.float32(grid.hx)
    least = min(hz, min(hy, hx))
    shortest, inner = np.float32(MIN_LENGTH) * least, np.float32(inner)
    pz = np.float32(0.5) / hz
    py = np.float32(0.5) / hy
    px = np.float32(0.5) / hx
    zero = np.float32(0.0)
    unit = np.float32(1.0)
    half = np.float32(0.5)
    mz = np.float32(grid.nz - 1)
    my = np.float32(grid.ny - 1)
    mx = np.float32(grid.nx - 1)
    two = NEXT + NEXT
    three = np.uint64(3) * NEXT
    four = np.uint64(4) * NEXT
    five, six = np.uint64(5) * NEXT, np.uint64(6) * NEXT
    for i in range(np.uint64(BATCH)):
        value = rows[PSI + i]
        old = rows[OLD + i]
        residue = rows[RESIDUE + i]
        a, b = rows[PSI + NEXT + i], rows[PSI + two + i]
        c, d = rows[PSI + three + i], rows[PSI + four + i]
        e, f = rows[PSI + five + i], rows[PSI + six + i]
        low = min(min(min(a, b), min(c, d)), min(e, f))
        high = max(max(max(a, b), max(c, d)), max(e, f))
        beside[i] = (min(low, value) < zero) & (max(high, value) >= zero)
        offset[i] = residue
        is_scaled = abs(old) > (inner if residue == zero else shortest)
        ratio = value / (old if is_scaled else unit)
        z = ratio * rows[OLD_CLOSEST + i]
        y = ratio * rows[OLD_CLOSEST + NEXT + i]
        x = ratio * rows[OLD_CLOSEST + two + i]
        is_scaled = is_scaled & (abs(z) + abs(y) + abs(x) > zero)
        dz = pz * (b - a)
        dy = py * (d - c)
        dx = px * (f - e)
        slope = dz * dz + dy * dy + dx * dx
        scale = -value / max(slope, half)
        gz[i], gy[i] = z if is_scaled else scale * dz, y if is_scaled else scale * dy
        gx[i] = x if is_scaled else scale * dx
        iz = rows[PLACE + i]
        iy = rows[PLACE + NEXT + i]
        ix = rows[PLACE + two + i]
        # Beyond the border psi is only continued, at the band's edge from where it is no distance.
        near = (-iz * hz <= z) & (z <= (mz - iz) * hz) & (-iy * hy <= y) & (y <= (my - iy) * hy)
        near = near & (-ix * hx <= x) & (x <= (mx - ix) * hx)
        well = (
            (iz > zero)
            & (iz < mz)
            & (iy > zero)
            & (iy < my)
            & (ix > zero)
            & (ix < mx)
            & (slope >= half)
        )
        alone[i] = not (near if is_scaled else well)
        wall = (
            np.int32(iz <= zero)
            | (np.int32(iz >= mz) << np.int32(1))
            | (np.int32(iy <= zero) << np.int32(2))
        )
        wall |= (np.int32(iy >= my) << np.int32(3)) | (np.int32(ix <= zero) << np.int32(4))
        wall |= np.int32(ix >= mx) << np.int32(5)
        around = sides_beyond(value, least, (a, b, c, d, e, f)) & ~wall
        sides[i] = around if is_scaled & (residue != zero) else np.int32(0)
