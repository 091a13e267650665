"""Differences of many cells at once: neighbours are gathered into rows, and the arithmetic runs over the rows.

Well inside the volume only; `differences` computes the same cell by cell, and is used at the border. In a row all cells
are treated in the same way, so that the compiler vectorizes it.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, unravel

#: Where rows of `BATCH` begin in a memory, and rows of `block_memory`. Unsigned: numba tests a signed index for being
#: negative, and so the loop would not run in vectors.
ROW = tuple(np.uint64(row * BATCH) for row in range(26))
SLOPE, CURVATURES = ROW[19], ROW[22]


@kernel
def gather_cross(first, count, psi, grid, cells, wanted, rows, well_inside):
    """Psi at ``count`` cells from slot ``first`` on and at two neighbours to each side along z, y, x.

    Rows of ``rows`` (15, m): per axis -2, -1, 0, 1, 2. ``well_inside`` is False where one is beyond the border, and
    where the cell is not ``wanted`` (n,): these columns are not changed.
    """
    plane, row = np.uint64(grid.ny * grid.nx), np.uint64(grid.nx)
    for i in range(count):
        well_inside[i] = False
        if not wanted[first + i]:
            continue
        cell = cells[first + i]
        iz, iy, ix = unravel(cell, grid)
        if iz < 2 or iy < 2 or ix < 2 or iz >= grid.nz - 2 or iy >= grid.ny - 2 or ix >= grid.nx - 2:
            continue
        well_inside[i] = True
        z, y, x = np.uint64(cell) - plane - plane, np.uint64(cell) - row - row, np.uint64(cell - 2)
        for k in range(np.uint64(5)):
            rows[k, i], rows[np.uint64(5) + k, i], rows[np.uint64(10) + k, i] = psi[z], psi[y], psi[x]
            z, y, x = z + plane, y + row, x + np.uint64(1)


@kernel
def smaller(a, b):
    """`differences.minmod` without a branch."""
    least = a if abs(a) < abs(b) else b
    return least if a * b > np.float32(0.0) else np.float32(0.0)


@kernel
def upwind_square(far_below, below, here, above, far_above, per_mm, sign):
    """Square of Godunov's choice along an axis; ``sign`` is 1 for a shrinking surface, -1 for a growing one."""
    half, zero = np.float32(0.5), np.float32(0.0)
    down, up = here - below, above - here
    second = up - down
    down += half * smaller(second, down - (below - far_below))
    up -= half * smaller(second, (far_above - above) - up)
    a, b = min(sign * down, zero) * per_mm, max(sign * up, zero) * per_mm
    return max(a * a, b * b)


@kernel
def godunov_norms(count, grid, rows, sign, out):
    """`differences.godunov_norm` of ``count`` columns of `gather_cross`."""
    pz, py, px = np.float32(1.0 / grid.hz), np.float32(1.0 / grid.hy), np.float32(1.0 / grid.hx)
    z0, z1, z2, z3, z4 = rows[0], rows[1], rows[2], rows[3], rows[4]
    y0, y1, y2, y3, y4 = rows[5], rows[6], rows[7], rows[8], rows[9]
    x0, x1, x2, x3, x4 = rows[10], rows[11], rows[12], rows[13], rows[14]
    for i in range(np.uint64(count)):
        total = upwind_square(z0[i], z1[i], z2[i], z3[i], z4[i], pz, sign[i])
        total += upwind_square(y0[i], y1[i], y2[i], y3[i], y4[i], py, sign[i])
        total += upwind_square(x0[i], x1[i], x2[i], x3[i], x4[i], px, sign[i])
        out[i] = np.sqrt(total)


@kernel
def block_memory():
    """Memory for `gather_block` and `block_curvatures`: rows of `BATCH`, one array for the compiler to see that they
    are apart.

    19 rows of psi: the cell; -z, +z, -y, +y, -x, +x; then for zy, zx, yx the edges --, -+, +-, ++. Then `SLOPE`, the
    gradient z, y, x, and `CURVATURES`: H and K as `differences.gradient` and `differences.curvatures`, and
    `differences.mean_above_centre`.
    """
    return np.zeros(25 * BATCH, np.float32)


@kernel(inlined=True)
def gather_block(cell, iz, iy, ix, psi, grid, memory, i):
    """Psi at a cell and at the 18 neighbours that share a face or an edge, into column ``i`` of `block_memory`.

    Returns False, with nothing written, where one is beyond the border.
    """
    if not (0 < iz < grid.nz - 1 and 0 < iy < grid.ny - 1 and 0 < ix < grid.nx - 1):
        return False
    i, at, unit = np.uint64(i), np.uint64(cell), np.uint64(1)
    plane, row = np.uint64(grid.ny * grid.nx), np.uint64(grid.nx)
    below, above = at - plane, at + plane
    memory[i] = psi[at]
    memory[ROW[1] + i], memory[ROW[2] + i] = psi[below], psi[above]
    memory[ROW[3] + i], memory[ROW[4] + i] = psi[at - row], psi[at + row]
    memory[ROW[5] + i], memory[ROW[6] + i] = psi[at - unit], psi[at + unit]
    memory[ROW[7] + i], memory[ROW[8] + i] = psi[below - row], psi[below + row]
    memory[ROW[9] + i], memory[ROW[10] + i] = psi[above - row], psi[above + row]
    memory[ROW[11] + i], memory[ROW[12] + i] = psi[below - unit], psi[below + unit]
    memory[ROW[13] + i], memory[ROW[14] + i] = psi[above - unit], psi[above + unit]
    memory[ROW[15] + i], memory[ROW[16] + i] = psi[at - row - unit], psi[at - row + unit]
    memory[ROW[17] + i], memory[ROW[18] + i] = psi[at + row - unit], psi[at + row + unit]
    return True


@kernel
def block_curvatures(grid, memory):
    """Gradient, curvatures and mean of all columns of `block_memory`, into its last rows."""
    half, quarter, two = np.float32(0.5), np.float32(0.25), np.float32(2.0)
    hz, hy, hx = np.float32(1.0 / grid.hz), np.float32(1.0 / grid.hy), np.float32(1.0 / grid.hx)
    part, huge = np.float32(1.0 / 24.0), np.float32(1e30)
    for i in range(np.uint64(BATCH)):
        c, zm, zp = memory[i], memory[ROW[1] + i], memory[ROW[2] + i]
        ym, yp, xm, xp = memory[ROW[3] + i], memory[ROW[4] + i], memory[ROW[5] + i], memory[ROW[6] + i]
        z, y, x = half * hz * (zp - zm), half * hy * (yp - ym), half * hx * (xp - xm)
        zz = (zp - c) - (c - zm)
        yy = (yp - c) - (c - ym)
        xx = (xp - c) - (c - xm)
        memory[CURVATURES + ROW[2] + i] = part * (zz + yy + xx)
        zz, yy, xx = hz * hz * zz, hy * hy * yy, hx * hx * xx
        zy, zx, yx = mixed(memory, ROW[7] + i), mixed(memory, ROW[11] + i), mixed(memory, ROW[15] + i)
        zy, zx, yx = quarter * hz * hy * zy, quarter * hz * hx * zx, quarter * hy * hx * yx
        z2, y2, x2 = z * z, y * y, x * x
        g2 = z2 + y2 + x2
        # A bound that nothing exceeds: so the compiler cannot choose which of two products it rounds before their sum.
        apart = max(x * z * zx, -huge)
        mean = xx * (y2 + z2) + yy * (x2 + z2) + zz * (x2 + y2) - two * (x * y * yx + apart + y * z * zy)
        gauss = x2 * (yy * zz - zy * zy) + y2 * (xx * zz - zx * zx) + z2 * (xx * yy - yx * yx)
        products = x * y * (zx * zy - yx * zz) + y * z * (yx * zx - zy * xx) + x * z * (yx * zy - zx * yy)
        has_slope = g2 >= np.float32(1e-8)
        inverse = np.float32(1.0) / (g2 if has_slope else np.float32(1.0))
        memory[SLOPE + i], memory[SLOPE + ROW[1] + i], memory[SLOPE + ROW[2] + i] = z, y, x
        memory[CURVATURES + i] = mean * inverse * np.sqrt(inverse) if has_slope else np.float32(0.0)
        memory[CURVATURES + ROW[1] + i] = (gauss + two * products) * inverse * inverse if has_slope else np.float32(0.0)


@kernel
def mixed(memory, at):
    """Sum of the edges ++ and -- less those of +- and -+, the first of them at ``at``."""
    return (memory[ROW[3] + at] - memory[ROW[1] + at]) - (memory[ROW[2] + at] - memory[at])
