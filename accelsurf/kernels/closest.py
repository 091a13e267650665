"""Closest point on the zero level of the cubic interpolant of psi."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, unravel_in_vectors
from accelsurf.kernels.interpolate import value_and_gradient
from accelsurf.kernels.limited import LEVELS, enter_point, limited_in_vectors, limited_memory
from accelsurf.kernels.simd.cubic import cubic

#: Slices are thick from this ratio of the spacings on.
THICK = 4.0


@kernel
def is_near_volume(grid, iz, iy, ix, foot, margin):
    """Test if a foot lies within ``margin`` voxels of the outermost voxel centres: beyond, psi is only continued.

    Along axes of `THICK` slices it must not lie beyond at all: a voxel there is many of the others, and psi continued
    so far has a zero level of its own, which came into the volume far from the object.
    """
    thick = THICK * min(grid.hz, min(grid.hy, grid.hx))
    mz = margin if grid.hz < thick else 1e-3
    my = margin if grid.hy < thick else 1e-3
    mx = margin if grid.hx < thick else 1e-3
    lz, ly, lx = -(iz + mz) * grid.hz, -(iy + my) * grid.hy, -(ix + mx) * grid.hx
    uz, uy = (grid.nz - 1.0 - iz + mz) * grid.hz, (grid.ny - 1.0 - iy + my) * grid.hy
    ux = (grid.nx - 1.0 - ix + mx) * grid.hx
    z, y, x = foot[0], foot[1], foot[2]
    # Without branches: with them this took as long as all the rest of a closest point.
    return (lz <= z) & (z <= uz) & (ly <= y) & (y <= uy) & (lx <= x) & (x <= ux)


@kernel(inlined=True)
def is_between_signs(psi, grid, iz, iy, ix, foot):
    """Test if psi changes its sign among the voxels around a foot.

    Else no voxel is on the other side, and the zero level there is an overshoot of the interpolant, as between thick
    slices: a surface that the labels do not have. A smooth surface may pass a corner of a cube of voxels and change no
    sign there: the next voxels count too, along axes as fine as the finest.
    """
    bz, by, bx = int(iz + foot[0] / grid.hz), int(iy + foot[1] / grid.hy), int(ix + foot[2] / grid.hx)
    inside = psi[np.uint64((iz * grid.ny + iy) * grid.nx + ix)] < 0.0
    # The voxel beyond the surface, if there is one: nearly always this ends it.
    az = min(bz + 1, grid.nz - 1) if foot[0] > 0.0 else bz
    ay = min(by + 1, grid.ny - 1) if foot[1] > 0.0 else by
    ax = min(bx + 1, grid.nx - 1) if foot[2] > 0.0 else bx
    if (psi[np.uint64((az * grid.ny + ay) * grid.nx + ax)] < 0.0) != inside:
        return True
    fine = 2.0 * min(grid.hz, min(grid.hy, grid.hx))
    mz, my, mx = 1 if grid.hz < fine else 0, 1 if grid.hy < fine else 0, 1 if grid.hx < fine else 0
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
#: off, where the foot is only read from, the first may be larger in proportion to the distance.
FIRST_TOLERANCE = 0.015
TOLERANCE = 0.05
#: Smallest |grad psi|^2: below it the zero level of psi is not determined.
MIN_SLOPE2 = 0.04
#: Longest correction in one iteration, voxels: the interpolant is trusted only near the front.
MAX_MOVE = 1.5
#: Status of a foot in `closest_points`.
ACTIVE, FOUND, LOST = 0.0, 1.0, 2.0
#: Rows of the memory of `closest_points`, `BATCH` long each, one array for the compiler to see that they are apart:
#: the foot; its status; the last correction along the level, its square and relaxation; the square of the first one;
#: psi and its gradient at the foot; the value of psi where the surface lies, see `residues`; whether to limit the
#: interpolant, see `limited`.
FOOT, STATUS, LAST, SQUARE, RELAX, START, LEVEL, OFFSET, LIMITED = (
    np.uint64(row * BATCH) for row in (0, 3, 4, 7, 8, 9, 10, 14, 15)
)
NEXT = np.uint64(BATCH)
ROWS = 16


@kernel
def feet_memory():
    """Memory for `closest_points`, and in it the feet (3, `BATCH`) and their status (`BATCH`,)."""
    memory = np.zeros(ROWS * BATCH, np.float32)
    return memory, memory[: 3 * BATCH].reshape(3, BATCH), memory[3 * BATCH : 4 * BATCH]


@kernel
def nodes_memory():
    """Memory for `levels_at`, `BATCH` columns each: the cell's index z, y, x; where its foot lies among the four nodes
    of each axis; the first of these nodes in psi, -1 where they are not all well inside; a list of columns.

    `limited_levels_at` has the first nodes in the order of that list.
    """
    return (
        np.zeros(3 * BATCH, np.float32), np.zeros(3 * BATCH, np.float32), np.zeros(BATCH, np.int64),
        np.zeros(BATCH, np.int64),
    )


@kernel
def closest_points(count, psi, grid, cells, memory, w):
    """Move the feet in ``memory``, mm from the first ``count`` of ``cells``, to the closest points of psi = 0.

    Chopp's two corrections at once: down the gradient to the zero level, -psi g/|g|^2, and along the level until the
    cell lies on the normal, r - (r.g) g/|g|^2 with r the vector from the foot to the cell. The latter is too long by
    1 + distance x curvature, which two successive residues tell (secant): so it converges also further off than the
    radius of curvature. ``memory`` (`ROWS` x `BATCH`,) float32 holds the feet, and then their status: FOUND where
    one has converged; its row OFFSET, set before, is the value (mm) that stands for 0 above. ``w`` (24,) is scratch.
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
    """Find the nodes around the foot in column ``i`` of ``memory``, without a branch."""
    place, inner, first, _ = nodes
    pz = place[i] + memory[FOOT + i] * (1.0 / grid.hz)
    py = place[i + NEXT] + memory[FOOT + NEXT + i] * (1.0 / grid.hy)
    px = place[i + NEXT + NEXT] + memory[FOOT + NEXT + NEXT + i] * (1.0 / grid.hx)
    unit = np.int32(1)
    bz, by, bx = np.int32(pz) - unit, np.int32(py) - unit, np.int32(px) - unit
    inner[i], inner[i + NEXT], inner[i + NEXT + NEXT] = np.float32(pz - bz), np.float32(py - by), np.float32(px - bx)
    # Well inside the volume, without the cases that value_and_gradient is for.
    inside = (0 <= bz) & (bz <= grid.nz - 4) & (0 <= by) & (by <= grid.ny - 4) & (0 <= bx) & (bx <= grid.nx - 4)
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
    """Psi and its gradient at the active feet of ``memory``; returns how many there are.

    ``nodes`` = `nodes_memory`, with the cells' indices.
    """
    place, inner, first, columns = nodes
    hz, hy, hx = 1.0 / grid.hz, 1.0 / grid.hy, 1.0 / grid.hx
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
            uz, uy, ux = inner[i], inner[i + NEXT], inner[i + NEXT + NEXT]
            level, gz, gy, gx = cubic(psi, first[i], sy, sz, uz, uy, ux)
            gz, gy, gx = gz * hz, gy * hy, gx * hx
        else:
            pz, py = place[i] + memory[FOOT + i] * hz, place[i + NEXT] + memory[FOOT + NEXT + i] * hy
            px = place[i + NEXT + NEXT] + memory[FOOT + NEXT + NEXT + i] * hx
            level, gz, gy, gx = value_and_gradient(psi, grid, pz, py, px, w)
        at = LEVEL + i
        memory[at], memory[at + NEXT], memory[at + NEXT + NEXT], memory[at + NEXT + NEXT + NEXT] = level, gz, gy, gx
    return active


@kernel
def limited_levels_at(count, psi, grid, nodes, memory, lines):
    """Same as `levels_at`, of the limited interpolant; ``lines`` = `limited_memory`."""
    place, _, first, columns = nodes
    active = active_columns(count, memory, columns)
    for n in range(active):
        i = np.uint64(columns[n])
        pz = place[i] + memory[FOOT + i] / grid.hz
        py = place[i + NEXT] + memory[FOOT + NEXT + i] / grid.hy
        px = place[i + NEXT + NEXT] + memory[FOOT + NEXT + NEXT + i] / grid.hx
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
    """One correction of the active feet, see `closest_points`; all columns alike, so that it runs in vectors."""
    hz, hy, hx = np.float32(1.0 / grid.hz), np.float32(1.0 / grid.hy), np.float32(1.0 / grid.hx)
    zero, unit, quarter = np.float32(0.0), np.float32(1.0), np.float32(0.25)
    active, found, lost = np.float32(ACTIVE), np.float32(FOUND), np.float32(LOST)
    shortest, longest, tiny = np.float32(0.1), np.float32(4.0), np.float32(1e-30)
    least, most = np.float32(MIN_SLOPE2), np.float32(MAX_MOVE)
    first, later = iteration == 0, iteration >= 2
    enough = np.float32(FIRST_TOLERANCE if first else TOLERANCE)
    for i in range(np.uint64(count)):
        z, y, x = memory[FOOT + i], memory[FOOT + NEXT + i], memory[FOOT + NEXT + NEXT + i]
        v, gz = memory[LEVEL + i] - memory[OFFSET + i], memory[LEVEL + NEXT + i]
        gy, gx = memory[LEVEL + NEXT + NEXT + i], memory[LEVEL + NEXT + NEXT + NEXT + i]
        g2 = gz * gz + gy * gy + gx * gx
        inverse = unit / max(g2, tiny)
        along = (z * gz + y * gy + x * gx) * inverse
        tz, ty, tx = along * gz - z, along * gy - y, along * gx - x
        t2 = tz * tz + ty * ty + tx * tx
        before, relax, begun = memory[SQUARE + i], memory[RELAX + i], memory[START + i]
        left = tz * memory[LAST + i] + ty * memory[LAST + NEXT + i] + tx * memory[LAST + NEXT + NEXT + i]
        longer = min(max(relax / max(unit - left / max(before, tiny), quarter), shortest), longest)
        longer = longer if before > zero else relax
        factor = unit if first else longer
        begun = t2 if first else begun
        down = v * inverse
        dz, dy, dx = factor * tz - down * gz, factor * ty - down * gy, factor * tx - down * gx
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
        memory[FOOT + i] = z + scale * dz
        memory[FOOT + NEXT + i] = y + scale * dy
        memory[FOOT + NEXT + NEXT + i] = x + scale * dx
        memory[LAST + i], memory[LAST + NEXT + i], memory[LAST + NEXT + NEXT + i] = tz, ty, tx
        memory[SQUARE + i] = zero if move > most else t2
        memory[RELAX + i], memory[START + i] = factor, begun
        memory[STATUS + i] = now if status == active else status


@kernel
def crossing_point(psi, grid, cell, iz, iy, ix, near, foot):
    """Foot of a cell beside the front from its linear edge crossings: the plane through the nearest per axis.

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
        foot[axis] = 0.0
        if best < 1e29:
            best = max(best, 1e-6 * h)
            shortest = min(shortest, best)
            inverse += 1.0 / (best * best)
            foot[axis] = sign / best
    if inverse == 0.0:
        return -1.0
    for axis in range(3):
        foot[axis] /= inverse
    return shortest
