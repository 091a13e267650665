"""Differences of many cells at once: neighbours are gathered into rows, and the arithmetic runs over the rows.

Well inside the volume only; `differences` computes the same cell by cell, and is used at the border. In a row all cells
are treated in the same way, so that the compiler vectorizes it.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel


@kernel
def gather_cross(first, count, psi, grid, cells, wanted, rows, well_inside):
    """Psi at ``count`` cells from slot ``first`` on and at two neighbours to each side along z, y, x.

    Rows of ``rows`` (15, m): per axis -2, -1, 0, 1, 2. ``well_inside`` is False where one is beyond the border, and
    where the cell is not ``wanted`` (n,): these columns are not changed.
    """
    plane = grid.ny * grid.nx
    for i in range(count):
        well_inside[i] = False
        if not wanted[first + i]:
            continue
        cell = cells[first + i]
        iz, iy, ix = unravel(cell, grid)
        if iz < 2 or iy < 2 or ix < 2 or iz >= grid.nz - 2 or iy >= grid.ny - 2 or ix >= grid.nx - 2:
            continue
        well_inside[i] = True
        for k in range(5):
            rows[k, i] = psi[cell + (k - 2) * plane]
            rows[5 + k, i] = psi[cell + (k - 2) * grid.nx]
            rows[10 + k, i] = psi[cell + (k - 2)]


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


@kernel(inlined=True)
def gather_block(cell, iz, iy, ix, psi, grid, rows, i):
    """Psi at a cell and at the 18 neighbours that share a face or an edge, into column ``i`` of ``rows`` (19, m).

    Rows: the cell; -z, +z, -y, +y, -x, +x; then for zy, zx, yx the edges --, -+, +-, ++. Returns False, with nothing
    written, where one is beyond the border.
    """
    if not (0 < iz < grid.nz - 1 and 0 < iy < grid.ny - 1 and 0 < ix < grid.nx - 1):
        return False
    plane, row = grid.ny * grid.nx, grid.nx
    rows[0, i] = psi[cell]
    rows[1, i], rows[2, i] = psi[cell - plane], psi[cell + plane]
    rows[3, i], rows[4, i] = psi[cell - row], psi[cell + row]
    rows[5, i], rows[6, i] = psi[cell - 1], psi[cell + 1]
    rows[7, i], rows[8, i] = psi[cell - plane - row], psi[cell - plane + row]
    rows[9, i], rows[10, i] = psi[cell + plane - row], psi[cell + plane + row]
    rows[11, i], rows[12, i] = psi[cell - plane - 1], psi[cell - plane + 1]
    rows[13, i], rows[14, i] = psi[cell + plane - 1], psi[cell + plane + 1]
    rows[15, i], rows[16, i] = psi[cell - row - 1], psi[cell - row + 1]
    rows[17, i], rows[18, i] = psi[cell + row - 1], psi[cell + row + 1]
    return True


@kernel
def block_curvatures(count, grid, rows, out):
    """Gradient, curvatures and mean of ``count`` columns of `gather_block`: rows of ``out`` (6, m).

    Rows z, y, x, H, K as `differences.gradient` and `differences.curvatures`, then `differences.mean_above_centre`.
    """
    half, quarter, two = np.float32(0.5), np.float32(0.25), np.float32(2.0)
    hz, hy, hx = np.float32(1.0 / grid.hz), np.float32(1.0 / grid.hy), np.float32(1.0 / grid.hx)
    c, zm, zp, ym, yp, xm, xp = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6]
    zy0, zy1, zy2, zy3 = rows[7], rows[8], rows[9], rows[10]
    zx0, zx1, zx2, zx3 = rows[11], rows[12], rows[13], rows[14]
    yx0, yx1, yx2, yx3 = rows[15], rows[16], rows[17], rows[18]
    out_z, out_y, out_x, out_h, out_k, out_mean = out[0], out[1], out[2], out[3], out[4], out[5]
    part = np.float32(1.0 / 24.0)
    for i in range(np.uint64(count)):
        z, y, x = half * hz * (zp[i] - zm[i]), half * hy * (yp[i] - ym[i]), half * hx * (xp[i] - xm[i])
        zz = (zp[i] - c[i]) - (c[i] - zm[i])
        yy = (yp[i] - c[i]) - (c[i] - ym[i])
        xx = (xp[i] - c[i]) - (c[i] - xm[i])
        out_mean[i] = part * (zz + yy + xx)
        zz, yy, xx = hz * hz * zz, hy * hy * yy, hx * hx * xx
        zy = quarter * hz * hy * ((zy3[i] - zy1[i]) - (zy2[i] - zy0[i]))
        zx = quarter * hz * hx * ((zx3[i] - zx1[i]) - (zx2[i] - zx0[i]))
        yx = quarter * hy * hx * ((yx3[i] - yx1[i]) - (yx2[i] - yx0[i]))
        z2, y2, x2 = z * z, y * y, x * x
        g2 = z2 + y2 + x2
        mean = xx * (y2 + z2) + yy * (x2 + z2) + zz * (x2 + y2) - two * (x * y * yx + x * z * zx + y * z * zy)
        gauss = x2 * (yy * zz - zy * zy) + y2 * (xx * zz - zx * zx) + z2 * (xx * yy - yx * yx)
        mixed = x * y * (zx * zy - yx * zz) + y * z * (yx * zx - zy * xx) + x * z * (yx * zy - zx * yy)
        has_slope = g2 >= np.float32(1e-8)
        inverse = np.float32(1.0) / (g2 if has_slope else np.float32(1.0))
        out_z[i], out_y[i], out_x[i] = z, y, x
        out_h[i] = mean * inverse * np.sqrt(inverse) if has_slope else np.float32(0.0)
        out_k[i] = (gauss + two * mixed) * inverse * inverse if has_slope else np.float32(0.0)
