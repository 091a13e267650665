"""Semi-Lagrangian advection of a surface and its fields: departure points, and the stretch of its area."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.differences import gradient
from accelsurf.kernels.grid import neighbours, unravel
from accelsurf.kernels.interpolate import axis_weights, linear_band_value, value_and_gradient

#: Fixed-point iterations for a departure point; each gains a factor dt |grad V|, at most about 1/10. The first needs
#: no more than linear interpolation.
ITERATIONS = 3
#: Largest distance of a departure point per axis, voxels: beyond it is another part of the surface.
MAX_DEPARTURE = 2.0
#: Part of a value by which cubic interpolation may go beyond the nodes around, in a field that must stay positive.
LIMIT = 0.1


@kernel
def continue_weights(beyond, count, w, o):
    """Continue the ``count`` weights of an axis, as of `axis_weights`, to a point ``beyond`` voxels off its end.

    Linear up to the border's face, where the volume ends, half a voxel off, and held further out: the part of a
    velocity that goes through the border may be 0 on the face and has a slope there.
    """
    if count > 1 and beyond < 0.0:
        off = max(beyond, -0.5)
        w[o] -= off
        w[o + 1] += off
    elif count > 1 and beyond > 0.0:
        off = min(beyond, 0.5)
        w[o + count - 1] += off
        w[o + count - 2] -= off


@kernel
def band_vector_at(values, slot, grid, position, w, out):
    """Interpolate band fields ``values`` (n, m) at ``position`` (index coordinates) into ``out`` (m,).

    Cubic where all nodes are in the band, beyond the border as `continue_weights` has it; else linear over those of the
    eight surrounding cells that are in it. Returns False when none of these is. Four fields are the fastest.
    """
    n, m = values.shape
    for c in range(m):
        out[c] = 0.0
    bz, mz, ez = axis_weights(position[0], grid.nz, w, 0)
    by, my, ey = axis_weights(position[1], grid.ny, w, 8)
    bx, mx, ex = axis_weights(position[2], grid.nx, w, 16)
    continue_weights(ez, mz, w, 0)
    continue_weights(ey, my, w, 8)
    continue_weights(ex, mx, w, 16)
    if m == 4 and mz == 4 and my == 4 and mx == 4:
        first = (bz * grid.ny + by) * grid.nx + bx
        if four_fields_at(values, slot, first, grid.nx, grid.ny * grid.nx, w, out):
            return True
        return linear_band_vector(values, slot, grid, position, out)
    for i in range(mz):
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            share = w[i] * w[8 + j]
            for k in range(mx):
                s = slot[at + k]
                if s < 0 or s >= n:
                    return linear_band_vector(values, slot, grid, position, out)
                for c in range(m):
                    out[c] += share * w[16 + k] * values[s, c]
    return True


@kernel
def four_fields_at(values, slot, first, sy, sz, w, out):
    """`band_vector_at` of four fields by their weights ``w``, 4 x 4 x 4 nodes from cell ``first`` on; strides sy, sz.

    Rows of cells have consecutive slots: four values of four nodes are one piece of memory, and the sums run in a
    vector, each in the order of `band_vector_at`. False where a node is not in the band.
    """
    n = values.shape[0]
    a = 0.0
    b = 0.0
    c = 0.0
    d = 0.0
    for i in range(4):
        for j in range(4):
            at = first + i * sz + j * sy
            s, last = slot[at], slot[at + 3]
            if s < 0 or last - s != 3 or last >= n:
                return False
            share = w[i] * w[8 + j]
            for k in range(4):
                weight, row = share * w[16 + k], np.uint64(s + k)
                a += weight * values[row, 0]
                b += weight * values[row, 1]
                c += weight * values[row, 2]
                d += weight * values[row, 3]
    out[0] = a
    out[1] = b
    out[2] = c
    out[3] = d
    return True


@kernel
def linear_band_vector(values, slot, grid, position, out):
    """Linear interpolation of band fields over those of the eight surrounding cells that are in the band."""
    n, m = values.shape
    for c in range(m):
        out[c] = 0.0
    pz = min(max(position[0], 0.0), grid.nz - 1.0)
    py = min(max(position[1], 0.0), grid.ny - 1.0)
    px = min(max(position[2], 0.0), grid.nx - 1.0)
    iz = int(np.floor(pz))
    iy = int(np.floor(py))
    ix = int(np.floor(px))
    weight = 0.0
    for corner in range(8):
        i = corner >> 2
        j = (corner >> 1) & 1
        k = corner & 1
        share = (pz - iz if i == 1 else 1.0 - (pz - iz)) * (py - iy if j == 1 else 1.0 - (py - iy))
        share *= px - ix if k == 1 else 1.0 - (px - ix)
        if share <= 1e-6:
            continue
        s = slot[((iz + i) * grid.ny + iy + j) * grid.nx + ix + k]
        if s >= 0 and s < n:
            weight += share
            for c in range(m):
                out[c] += share * values[s, c]
    if weight <= 0.0:
        return False
    for c in range(m):
        out[c] /= weight
    return True


@kernel
def limit(values, slot, grid, position, c, out):
    """Clamp ``out[c]``, field ``c`` at ``position``, to the known values of the eight nodes around, +- `LIMIT`.

    A positive field stays positive, and grows at no jump by more than that part; where it varies by less from voxel to
    voxel, nothing changes.
    """
    iz = int(min(max(position[0], 0.0), grid.nz - 1.0))
    iy = int(min(max(position[1], 0.0), grid.ny - 1.0))
    ix = int(min(max(position[2], 0.0), grid.nx - 1.0))
    low, high = np.inf, -np.inf
    for i in range(iz, min(iz + 2, grid.nz)):
        for j in range(iy, min(iy + 2, grid.ny)):
            for k in range(ix, min(ix + 2, grid.nx)):
                s = slot[(i * grid.ny + j) * grid.nx + k]
                if s >= 0 and s < values.shape[0]:
                    low, high = min(low, values[s, c]), max(high, values[s, c])
    out[c] = min(max(out[c], low - LIMIT * abs(low)), high + LIMIT * abs(high))


@kernel
def departure_point(velocity, slot, grid, target, dt, scratch, at):
    """Point ``at`` (index coordinates) that ``velocity`` (n, m) takes to ``target`` in ``dt``: at + dt V(at) = target.

    The first three fields are the velocity; ``scratch`` = (w (24,), v (m,)). Where no velocity is known the point stays
    at the target.
    """
    w, v = scratch
    for axis in range(3):
        at[axis] = target[axis]
    for iteration in range(ITERATIONS):
        if iteration == 0:
            if not linear_band_vector(velocity, slot, grid, at, v):
                return
        elif not band_vector_at(velocity, slot, grid, at, w, v):
            return
        for axis in range(3):
            h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
            back = min(max(dt * v[axis] / h, -MAX_DEPARTURE), MAX_DEPARTURE)
            at[axis] = target[axis] - back


@kernel
def has_stencil(slot, grid, position, w):
    """Test if all nodes of the cubic interpolation at ``position`` are in the band."""
    bz, mz, _ = axis_weights(position[0], grid.nz, w, 0)
    by, my, _ = axis_weights(position[1], grid.ny, w, 8)
    bx, mx, _ = axis_weights(position[2], grid.nx, w, 16)
    # Only -1 has its sign.
    missing = np.int32(0)
    for i in range(mz):
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            for k in range(mx):
                missing |= slot[at + k]
    return missing >= 0


@kernel(stage=Stage.ADVANCE)
def advect_psi(start, stop, dense, grid, band, velocity, dt, out):
    """Psi of every cell after ``dt`` of psi_t = -V . grad psi: psi at the departure point of the cell.

    ``velocity`` (n, 3 or more). Beyond the border psi is continued linearly: a constant there would stop a surface that
    moves inwards. Near the band's edge, where the interpolation would need cells beyond it, psi - dt V . n with the
    normal n of the distance that psi was.
    """
    w = np.empty(24)
    v = np.empty(velocity.shape[1])
    target = np.empty(3)
    at = np.empty(3)
    for s in range(start, stop):
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        target[0] = iz
        target[1] = iy
        target[2] = ix
        departure_point(velocity, dense.slot, grid, target, dt, (w, v), at)
        if has_stencil(dense.slot, grid, at, w):
            out[s], _, _, _ = value_and_gradient(dense.psi, grid, at[0], at[1], at[2], w)
            continue
        d = band.psi[s]
        nz, ny, nx = outward(dense.psi, band, s, cell, iz, iy, ix, grid)
        out[s] = d - dt * (velocity[s, 0] * nz + velocity[s, 1] * ny + velocity[s, 2] * nx)


@kernel
def outward(psi, band, s, cell, iz, iy, ix, grid):
    """Outward unit normal at the closest point of slot ``s``.

    It points away from the closest point where that is well off the cell.
    """
    d = band.psi[s]
    if abs(d) > 0.5 * min(grid.hz, min(grid.hy, grid.hx)):
        return -band.to_closest[s, 0] / d, -band.to_closest[s, 1] / d, -band.to_closest[s, 2] / d
    gz, gy, gx = gradient(psi, cell, iz, iy, ix, grid)
    norm = max(np.sqrt(gz * gz + gy * gy + gx * gx), 1e-12)
    return gz / norm, gy / norm, gx / norm


@kernel(stage=Stage.FLOW)
def normals(start, stop, psi, grid, band, out):
    """Inward unit normal N at the closest point of every cell, into ``out`` (n, 3)."""
    for s in range(start, stop):
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        nz, ny, nx = outward(psi, band, s, cell, iz, iy, ix, grid)
        out[s, 0] = -nz
        out[s, 1] = -ny
        out[s, 2] = -nx


@kernel
def slope(values, c, s, below, above, h):
    """Difference quotient of field ``c`` at slot ``s``: centred, or one-sided where a neighbour (-1) is missing."""
    if below >= 0 and above >= 0:
        return (values[above, c] - values[below, c]) / (2.0 * h)
    if above >= 0:
        return (values[above, c] - values[s, c]) / h
    if below >= 0:
        return (values[s, c] - values[below, c]) / h
    return 0.0


@kernel
def near_slots(slot, grid, cell, iz, iy, ix, near, out):
    """Slots of the six neighbours of a cell, -1 where one is not in the band."""
    neighbours(cell, iz, iy, ix, grid, near)
    for side in range(6):
        out[side] = slot[near[side]] if near[side] >= 0 else -1


@kernel(stage=Stage.FLOW)
def area_stretch(start, stop, slot, grid, cells, front, motion, out):
    """Factor by which ``dt`` of motion stretches the surface at every front cell (1 elsewhere): J = |cof(F) n|.

    ``motion`` = (velocity V (n, 3), extended; normal (n, 3); dt). F = I + dt grad V:
    exact for the map x + dt V, det F |F^-T n|.
    """
    near = np.empty(6, np.int64)
    at = np.empty(6, np.int64)
    f = np.empty((3, 3))
    velocity, normal, dt = motion
    for s in range(start, stop):
        out[s] = 1.0
        if not front[s]:
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        near_slots(slot, grid, cell, iz, iy, ix, near, at)
        for c in range(3):
            for axis in range(3):
                h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
                f[c, axis] = dt * slope(velocity, c, s, at[2 * axis], at[2 * axis + 1], h)
            f[c, c] += 1.0
        total = 0.0
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            component = 0.0
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                component += (f[b, j] * f[c, k] - f[b, k] * f[c, j]) * normal[s, i]
            total += component * component
        out[s] = np.sqrt(total)


@kernel(stage=Stage.FLOW)
def surface_gradient(start, stop, slot, grid, cells, front, field, out):
    """Surface gradient (n, 3) of an extended field at the front cells, tangential; 0 elsewhere.

    ``field`` = (values (n, 1), normal (n, 3)).
    """
    near = np.empty(6, np.int64)
    at = np.empty(6, np.int64)
    g = np.empty(3)
    values, normal = field
    for s in range(start, stop):
        out[s, 0] = 0.0
        out[s, 1] = 0.0
        out[s, 2] = 0.0
        if not front[s]:
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        near_slots(slot, grid, cell, iz, iy, ix, near, at)
        for axis in range(3):
            h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
            g[axis] = slope(values, 0, s, at[2 * axis], at[2 * axis + 1], h)
        along = g[0] * normal[s, 0] + g[1] * normal[s, 1] + g[2] * normal[s, 2]
        for axis in range(3):
            out[s, axis] = g[axis] - along * normal[s, axis]


@kernel(stage=Stage.EXTENSION)
def advect_fields(start, stop, slot, grid, band, motion, values, out):
    """Fields (n, m) of the new ``band`` advected from the old one, which ``slot`` still maps to.

    ``motion`` = (velocity (n_old, 3 or more), dt, limited). Each cell gets the values at the point of the old surface
    that moved to its closest point, the fields from column ``limited`` on within `LIMIT` of the values around that
    point. A cell with nothing known there has its own old values, or 0 when it was not in the band.
    """
    w = np.empty(24)
    target = np.empty(3)
    at = np.empty(3)
    velocity, dt, limited = motion
    v = np.empty(velocity.shape[1])
    m = values.shape[1]
    found = np.empty(m)
    for s in range(start, stop):
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        target[0] = iz + band.to_closest[s, 0] / grid.hz
        target[1] = iy + band.to_closest[s, 1] / grid.hy
        target[2] = ix + band.to_closest[s, 2] / grid.hx
        departure_point(velocity, slot, grid, target, dt, (w, v), at)
        previous = slot[cell]
        known = band_vector_at(values, slot, grid, at, w, found)
        for c in range(limited, m):
            if known:
                limit(values, slot, grid, at, c, found)
        for c in range(m):
            if known:
                out[s, c] = found[c]
            else:
                out[s, c] = (
                    values[previous, c] if previous >= 0 and previous < values.shape[0] else 0.0
                )


@kernel(stage=Stage.EXTENSION)
def fields_between(start, stop, coarse, band, grid, place, fields, out):
    """Fields (m, n) at the closest points of a ``band`` on another grid: linear there over the band cells around.

    ``coarse`` = (slot, grid) of the level of the values; ``place`` (2, 3) takes an index position of the
    band's ``grid`` to one of it: factor and addition. ``fields`` = (values (m, n_old) float32, fill values (m,) for
    where there is nothing).
    """
    slot, old = coarse
    values, fill_values = fields
    at = np.empty(3)
    for s in range(start, stop):
        iz, iy, ix = unravel(band.cells[s], grid)
        at[0] = (iz + band.to_closest[s, 0] / grid.hz) * place[0, 0] + place[1, 0]
        at[1] = (iy + band.to_closest[s, 1] / grid.hy) * place[0, 1] + place[1, 1]
        at[2] = (ix + band.to_closest[s, 2] / grid.hx) * place[0, 2] + place[1, 2]
        for field in range(values.shape[0]):
            value, found = linear_band_value(values[field], slot, values.shape[1], old, at)
            out[field, s] = value if found else fill_values[field]
