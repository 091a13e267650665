"""First guesses of the closest points: as the same arithmetic for many cells, one by one where that does not do."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, neighbours, unravel, unravel_in_vectors
from accelsurf.kernels.ridge import MIN_LENGTH, beyond_ridges, sides_beyond

#: Rows of the memory of `guess_feet`, `BATCH` long each: psi at the cell and around it (-z, +z, -y, +y, -x, +x);
#: the old psi; the old foot; the residue; the index z, y, x.
PSI, OLD, OLD_FOOT, RESIDUE, PLACE = (np.uint64(row * BATCH) for row in (0, 7, 8, 11, 12))
NEXT = np.uint64(BATCH)
ROWS = 15


@kernel
def guess_memory():
    """Memory for `guess_feet`: rows, and per cell whether it needs `first_guess`, and the sides of `sides_beyond`."""
    return np.zeros(ROWS * BATCH, np.float32), np.empty(BATCH, np.bool_), np.empty(BATCH, np.int32)


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
def guess_feet(slots, dense, grid, band, guide, scratch, out):
    """First guesses of the feet of ``slots``, at most `BATCH`.

    ``guide`` = (inner, residue (n,)). ``scratch`` = (near (6,), guess (3,), `guess_memory`).
    ``out`` = (guesses (3, `BATCH`), rows z, y, x, 0 where there is none; beside (`BATCH`,) bool; offset (`BATCH`,)
    float32), of which the first columns count, one for each slot. ``beside`` marks the cells with a neighbour on the
    other side of the surface, ``offset`` is the residue of the part of it that the guess is on. Where |psi| was above
    ``inner`` mm before the surface moved, centred differences would need cells beyond the band; where there is a
    residue, they may lie across a ridge: the guess is the old foot, scaled by the change of psi.
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
                guess[0], guess[1], guess[2] = 0.0, 0.0, 0.0
            guesses[0, i], guesses[1, i], guesses[2, i] = guess[0], guess[1], guess[2]


@kernel
def gather_around(slots, psi, grid, band, residue, rows):
    """Fill ``rows`` with what is known of the cells of ``slots``.

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
        at = OLD_FOOT + i
        rows[at], rows[at + NEXT] = band.to_closest[s, 0], band.to_closest[s, 1]
        rows[at + NEXT + NEXT] = band.to_closest[s, 2]
        at = PLACE + i
        rows[at], rows[at + NEXT], rows[at + NEXT + NEXT] = iz, iy, ix


@kernel
def guess_alike(grid, inner, memory, out):
    """The guesses of `guess_feet` without ridges, the same arithmetic for all cells, so that it runs in vectors.

    Of all columns, whether they are used or not: what is left over from vectors may be rounded otherwise.
    ``memory`` = `guess_memory`; sets in it which cells are left to `first_guess`, at the border of the volume and where
    the gradient is small, and the `sides_beyond` which a ridge may lie.
    """
    rows, alone, sides = memory
    guesses, beside, offset = out
    gz, gy, gx = guesses[0], guesses[1], guesses[2]
    hz, hy, hx = np.float32(grid.hz), np.float32(grid.hy), np.float32(grid.hx)
    least = min(hz, min(hy, hx))
    shortest, inner = np.float32(MIN_LENGTH) * least, np.float32(inner)
    pz, py, px = np.float32(0.5) / hz, np.float32(0.5) / hy, np.float32(0.5) / hx
    zero, unit, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    mz, my, mx = np.float32(grid.nz - 1), np.float32(grid.ny - 1), np.float32(grid.nx - 1)
    two, three, four = NEXT + NEXT, np.uint64(3) * NEXT, np.uint64(4) * NEXT
    five, six = np.uint64(5) * NEXT, np.uint64(6) * NEXT
    for i in range(np.uint64(BATCH)):
        value, old, residue = rows[PSI + i], rows[OLD + i], rows[RESIDUE + i]
        a, b = rows[PSI + NEXT + i], rows[PSI + two + i]
        c, d = rows[PSI + three + i], rows[PSI + four + i]
        e, f = rows[PSI + five + i], rows[PSI + six + i]
        low = min(min(min(a, b), min(c, d)), min(e, f))
        high = max(max(max(a, b), max(c, d)), max(e, f))
        beside[i] = (min(low, value) < zero) & (max(high, value) >= zero)
        offset[i] = residue
        is_scaled = abs(old) > (inner if residue == zero else shortest)
        ratio = value / (old if is_scaled else unit)
        z, y, x = ratio * rows[OLD_FOOT + i], ratio * rows[OLD_FOOT + NEXT + i], ratio * rows[OLD_FOOT + two + i]
        is_scaled = is_scaled & (abs(z) + abs(y) + abs(x) > zero)
        dz, dy, dx = pz * (b - a), py * (d - c), px * (f - e)
        slope = dz * dz + dy * dy + dx * dx
        scale = -value / max(slope, half)
        gz[i], gy[i] = z if is_scaled else scale * dz, y if is_scaled else scale * dy
        gx[i] = x if is_scaled else scale * dx
        iz, iy, ix = rows[PLACE + i], rows[PLACE + NEXT + i], rows[PLACE + two + i]
        # Beyond the border psi is only continued, at the band's edge from where it is no distance.
        near = (-iz * hz <= z) & (z <= (mz - iz) * hz) & (-iy * hy <= y) & (y <= (my - iy) * hy)
        near = near & (-ix * hx <= x) & (x <= (mx - ix) * hx)
        well = (iz > zero) & (iz < mz) & (iy > zero) & (iy < my) & (ix > zero) & (ix < mx) & (slope >= half)
        alone[i] = not (near if is_scaled else well)
        wall = np.int32(iz <= zero) | (np.int32(iz >= mz) << np.int32(1)) | (np.int32(iy <= zero) << np.int32(2))
        wall |= (np.int32(iy >= my) << np.int32(3)) | (np.int32(ix <= zero) << np.int32(4))
        wall |= np.int32(ix >= mx) << np.int32(5)
        around = sides_beyond(value, least, (a, b, c, d, e, f)) & ~wall
        sides[i] = around if is_scaled & (residue != zero) else np.int32(0)
