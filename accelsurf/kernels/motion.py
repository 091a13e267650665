"""One step of the surface: sampling of forces, kick, diffusion, advance of psi."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.differences import gradient
from accelsurf.kernels.grid import neighbours, unravel, voxels_along
from accelsurf.kernels.interpolate import linear_at, linear_cell, value_at
from accelsurf.kernels.simd.cubic import cubic_value


@kernel(stage=Stage.ENERGY)
def sample_image(start, stop, image, grid, band, front, out):
    """Cubic interpolation of a raveled dense image at the closest point of every front cell (0 elsewhere)."""
    w = np.empty(24)
    for s in range(np.uint64(start), np.uint64(stop)):
        out[s] = 0.0
        if front[s]:
            iz, iy, ix = unravel(band.cells[s], grid)
            pz = iz + band.to_closest[s, 0] / grid.hz
            py = iy + band.to_closest[s, 1] / grid.hy
            px = ix + band.to_closest[s, 2] / grid.hx
            bz = int(pz) - 1
            by = int(py) - 1
            bx = int(px) - 1
            # Well inside the volume, without the cases and the slopes of value_at.
            if 0 <= bz <= grid.nz - 4 and 0 <= by <= grid.ny - 4 and 0 <= bx <= grid.nx - 4:
                at = (bz * grid.ny + by) * grid.nx + bx
                uz = np.float32(pz - bz)
                uy = np.float32(py - by)
                ux = np.float32(px - bx)
                out[s] = cubic_value(image, at, grid.nx, grid.ny * grid.nx, uz, uy, ux)
            else:
                out[s] = value_at(image, grid, pz, py, px, w)


@kernel(stage=Stage.ENERGY)
def mean_across(start, stop, psi, image, band, front, settings, out):
    """Mean of a I^2 + b I + c across the surface at the closest point of every front cell (0 elsewhere).

    Weighted by the smeared delta function (1 + cos(pi s/epsilon))/(2 epsilon) of the region sums, and by the
    area 1 + s H of the level at distance s, at five points along the normal, the raveled dense image I
    interpolated linearly; ``settings`` = (grid, epsilon in voxels along the normal, (a, b, c), curvature H).
    Where the smeared layer is not resolved, |s H| is clipped to 1/2.
    """
    grid, epsilon, polynomial, curvature = settings
    a, b, c = polynomial
    hz = 1.0 / grid.hz
    hy = 1.0 / grid.hy
    hx = 1.0 / grid.hx
    row, plane = grid.nx, grid.ny * grid.nx
    # A little more, for rounding.
    extent = 2.0 / 3.0 * epsilon + 1e-6
    for s in range(start, stop):
        out[s] = 0.0
        if not front[s]:
            continue
        cell = band.cells[s]
        iz, iy, ix = unravel(cell, grid)
        nz = band.to_closest[s, 0] * hz
        ny = band.to_closest[s, 1] * hy
        nx = band.to_closest[s, 2] * hx
        # Counted from the cell: so the same rounding on every box that contains it.
        fz = nz
        fy = ny
        fx = nx
        pz = iz + nz
        py = iy + ny
        px = ix + nx
        norm = np.sqrt(nz * nz + ny * ny + nx * nx)
        outward = -1.0 if band.psi[s] > 0.0 else 1.0
        if norm < 0.01:
            gz, gy, gx = gradient(psi, cell, iz, iy, ix, grid)
            nz = gz * hz
            ny = gy * hy
            nx = gx * hx
            norm = max(np.sqrt(nz * nz + ny * ny + nx * nx), 1e-12)
            outward = 1.0
        # Voxels along the normal to mm, times the curvature.
        unit = 1.0 / norm
        nz = nz * unit
        ny = ny * unit
        nx = nx * unit
        mm = np.sqrt((nz * grid.hz) ** 2 + (ny * grid.hy) ** 2 + (nx * grid.hx) ** 2)
        area_growth = outward * mm * curvature[s]
        inside = extent <= pz < grid.nz - 1 - extent and extent <= py < grid.ny - 1 - extent
        inside = inside and extent <= px < grid.nx - 1 - extent
        total = 0.0
        for m in range(-2, 3):
            u = m * epsilon / 3.0
            share = 1.0 / 3.0 if m == 0 else (0.25 if abs(m) == 1 else 1.0 / 12.0)
            share *= 1.0 + min(max(u * area_growth, -0.5), 0.5)
            qz = fz + u * nz
            qy = fy + u * ny
            qx = fx + u * nx
            if inside:
                jz = np.floor(qz)
                jy = np.floor(qy)
                jx = np.floor(qx)
                at = ((iz + int(jz)) * grid.ny + iy + int(jy)) * row + ix + int(jx)
                tz = np.float32(qz - jz)
                ty = np.float32(qy - jy)
                tx = np.float32(qx - jx)
                value = linear_cell(image, at, row, plane, tz, ty, tx)
            else:
                value = linear_at(image, grid, iz + qz, iy + qy, ix + qx)
            total += share * ((a * value + b) * value + c)
        out[s] = total


@kernel(stage=Stage.FLOW)
def kick(start, stop, beta, gain, curvature, front, rates):
    """Leap-frog kick, centred in time, of the front's speeds (in place); numerics of the surface system.

    beta+ = [beta (1 - gamma dm/2) + gain] / [1 + gamma dm/2 - dm beta H/2], the transport term 1/2 beta^2 H taken
    as 1/2 beta beta+ H, which makes the scheme second order. ``gain`` is dm w f/rho; ``rates`` = (gamma dm, dm).
    The denominator is at least 0.2.
    """
    damping, dm = rates
    for s in range(start, stop):
        if front[s]:
            b = beta[s]
            denominator = max(1.0 + 0.5 * damping - 0.5 * dm * b * curvature[s], 0.2)
            beta[s] = (b * (1.0 - 0.5 * damping) + gain[s]) / denominator


@kernel(stage=Stage.DIFFUSION)
def neighbour_slots(start, stop, slot, grid, cells, on, out):
    """Slots of the 6-neighbours of the cells of the slots ``on`` (m,): for `diffusion_stage`.

    ``out`` = (table (m, 6) int32, walls (m,) int8, near (n,) bool). A neighbour that is not in the band or beyond the
    border is the cell itself, so that no flux passes. ``walls`` has bit a set for the cells with a face on the border
    across axis a. ``near`` is set for all slots in the table.
    """
    table, walls, near = out
    sides = np.empty(6, np.int64)
    for row in range(np.uint64(start), np.uint64(stop)):
        s = on[row]
        cell = cells[np.uint64(s)]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, sides)
        for side in range(6):
            other = slot[np.uint64(sides[side])] if sides[side] >= 0 else -1
            other = other if other >= 0 else s
            table[row, side] = other
            # Several threads may write it here, all the same.
            near[np.uint64(other)] = True
        walls[row] = 0
        for axis in range(3):
            walls[row] |= np.int8((sides[2 * axis] < 0) != (sides[2 * axis + 1] < 0)) << np.int8(
                axis
            )


@kernel(stage=Stage.DIFFUSION)
def rows_of_slots(start, stop, row_of, table, out):
    """The rows (m, k) uint32, into ``out``, of the slots in ``table`` (m, k); ``row_of`` (n,) has them by slot."""
    for row in range(start, stop):
        for k in range(np.uint64(table.shape[1])):
            out[row, k] = row_of[np.uint32(table[row, k])]


@kernel(stage=Stage.DIFFUSION)
def diffusion_stage(start, stop, on, table, grid, stages, weights, out):
    """A stage of Runge-Kutta-Legendre at the cells ``on``, slots or rows: mu old + mu' Lap old + nu older.

    ``weights`` = (mu, mu', nu); ``table`` (m, 6) from `neighbour_slots`; ``stages`` = (old (n,), older (n,)).
    Lap is the 7-point Laplacian of an extended field, the surface Laplacian since
    grad F.grad psi = 0.
    """
    mu, rate, nu = weights
    old, older = stages
    pz = np.float32(1.0 / grid.hz**2)
    py = np.float32(1.0 / grid.hy**2)
    px = np.float32(1.0 / grid.hx**2)
    for row in range(np.uint64(start), np.uint64(stop)):
        s = on[row]
        here = old[s]
        lap = pz * ((old[table[row, 0]] - here) + (old[table[row, 1]] - here))
        lap += py * ((old[table[row, 2]] - here) + (old[table[row, 3]] - here))
        lap += px * ((old[table[row, 4]] - here) + (old[table[row, 5]] - here))
        out[s] = mu * here + rate * lap + nu * older[s]


@kernel(stage=Stage.FLOW)
def voxel_rates(start, stop, grid, band, front, beta, out):
    """Speed of every front cell in voxels along its normal per unit time, |beta| |n/h| (0 elsewhere)."""
    if grid.hz == grid.hy and grid.hy == grid.hx:
        per_mm = np.float32(1.0 / grid.hz)
        for s in range(start, stop):
            out[s] = abs(beta[s]) * per_mm if front[s] else np.float32(0.0)
        return
    for s in range(start, stop):
        out[s] = 0.0
        if front[s]:
            d = abs(band.psi[s])
            v = voxels_along(
                band.to_closest[s, 0], band.to_closest[s, 1], band.to_closest[s, 2], grid
            )
            out[s] = abs(beta[s]) * v / d


@kernel(stage=Stage.ADVANCE)
def advance_psi(start, stop, psi, band, beta, norm, dt):
    """Psi += dt beta |grad psi| at the cells of the range, with ``beta`` (n,) and |grad psi| (n,) in ``norm``."""
    for s in range(start, stop):
        psi[band.cells[s]] = band.psi[s] + dt * beta[s] * norm[s]
