"""Differences of psi on its grid: curvature, normals, Godunov's upwind gradient norm.

Differences of many cells at once: neighbours are gathered into rows, and the arithmetic runs over the rows.

Well inside the volume only; `differences` computes the same cell by cell, and is used at the border. In a row all cells
are treated in the same way, so that the compiler vectorizes it.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import BATCH, unravel


@kernel
def axis_differences(psi, cell, i, n, stride, h):
    """One-sided and second differences along an axis: (D-, D+, D2).

    At the border the surface is continued straight: the missing one-sided difference equals the other and
    the second difference is zero; on a single slice all are zero.
    """
    if n == 1:
        return 0.0, 0.0, 0.0
    if i == 0:
        up = (psi[cell + stride] - psi[cell]) / h
        return up, up, 0.0
    down = (psi[cell] - psi[cell - stride]) / h
    if i == n - 1:
        return down, down, 0.0
    up = (psi[cell + stride] - psi[cell]) / h
    return down, up, (up - down) / h


@kernel
def mixed_difference(psi, cell, at, stride, h):
    """Centred d2/dadb; ``at`` = (i_a, n_a, i_b, n_b), ``stride`` = (s_a, s_b), ``h`` = (h_a, h_b)."""
    ia, na, ib, nb = at
    sa, sb = stride
    a0 = -1 if ia > 0 else 0
    a1 = 1 if ia < na - 1 else 0
    b0 = -1 if ib > 0 else 0
    b1 = 1 if ib < nb - 1 else 0
    width = (a1 - a0) * (b1 - b0)
    if width == 0:
        return 0.0
    total = psi[cell + a1 * sa + b1 * sb] - psi[cell + a0 * sa + b1 * sb]
    total += psi[cell + a0 * sa + b0 * sb] - psi[cell + a1 * sa + b0 * sb]
    return total / (width * h[0] * h[1])


@kernel
def axis_derivatives(psi, cell, i, n, stride, h):
    """First and second derivative along an axis: centred, at the border those of the parabola through three voxels."""
    down, up, second = axis_differences(psi, cell, i, n, stride, h)
    if (i > 0 and i < n - 1) or n < 3:
        return 0.5 * (down + up), second
    if i == 0:
        second = ((psi[cell + 2 * stride] - psi[cell + stride]) / h - up) / h
        return up - 0.5 * h * second, second
    second = (down - (psi[cell - stride] - psi[cell - 2 * stride]) / h) / h
    return down + 0.5 * h * second, second


@kernel
def is_at_border(iz, iy, ix, grid):
    """Test if a cell has a face on the volume's border; an axis with one slice has none."""
    z = grid.nz - 1
    y = grid.ny - 1
    x = grid.nx - 1
    return (
        (z > 0 and (iz == 0 or iz == z))
        or (y > 0 and (iy == 0 or iy == y))
        or (x > 0 and (ix == 0 or ix == x))
    )


@kernel
def gradient(psi, cell, iz, iy, ix, grid):
    """Gradient (z, y, x) at a cell, of second order up to the border."""
    if is_at_border(iz, iy, ix, grid):
        pz, _ = axis_derivatives(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
        py, _ = axis_derivatives(psi, cell, iy, grid.ny, grid.nx, grid.hy)
        px, _ = axis_derivatives(psi, cell, ix, grid.nx, 1, grid.hx)
        return pz, py, px
    az, bz, _ = axis_differences(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
    ay, by, _ = axis_differences(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    ax, bx, _ = axis_differences(psi, cell, ix, grid.nx, 1, grid.hx)
    return 0.5 * (az + bz), 0.5 * (ay + by), 0.5 * (ax + bx)


@kernel
def curvatures(psi, cell, iz, iy, ix, grid):
    """Sum H and product K of the principal curvatures (1/mm, 1/mm2) of the level through a cell.

    H = div(g/|g|), K = g . adj(D2 psi) g / |g|^4; both positive on a sphere with psi negative inside. At the border
    psi is continued as a parabola: the curvature is that of the surface, whatever its angle with the border.
    """
    plane = grid.ny * grid.nx
    pz, pzz = axis_derivatives(psi, cell, iz, grid.nz, plane, grid.hz)
    py, pyy = axis_derivatives(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    px, pxx = axis_derivatives(psi, cell, ix, grid.nx, 1, grid.hx)
    pzy = mixed_difference(
        psi, cell, (iz, grid.nz, iy, grid.ny), (plane, grid.nx), (grid.hz, grid.hy)
    )
    pzx = mixed_difference(psi, cell, (iz, grid.nz, ix, grid.nx), (plane, 1), (grid.hz, grid.hx))
    pyx = mixed_difference(psi, cell, (iy, grid.ny, ix, grid.nx), (grid.nx, 1), (grid.hy, grid.hx))
    return level_curvatures((pz, py, px), (pzz, pyy, pxx), (pzy, pzx, pyx))


@kernel
def mirrored_curvatures(psi, cell, iz, iy, ix, grid):
    """Same as `curvatures`, with psi mirrored at the border's faces, half a voxel beyond the outermost voxel centres.

    The voxel beyond the border has the value of the border's own. So H is div(n) with no n through the border: where
    the surface meets it at another angle than the right one, H has the area's force on the contact line, n . n_border
    per length, spread over the border's voxels.
    """
    plane = grid.ny * grid.nx
    z0, z1 = plane if iz > 0 else 0, plane if iz < grid.nz - 1 else 0
    y0, y1 = grid.nx if iy > 0 else 0, grid.nx if iy < grid.ny - 1 else 0
    x0, x1 = 1 if ix > 0 else 0, 1 if ix < grid.nx - 1 else 0
    hz = grid.hz
    hy = grid.hy
    hx = grid.hx
    az, bz = (psi[cell] - psi[cell - z0]) / hz, (psi[cell + z1] - psi[cell]) / hz
    ay, by = (psi[cell] - psi[cell - y0]) / hy, (psi[cell + y1] - psi[cell]) / hy
    ax, bx = (psi[cell] - psi[cell - x0]) / hx, (psi[cell + x1] - psi[cell]) / hx
    pzy = (psi[cell + z1 + y1] - psi[cell - z0 + y1]) - (psi[cell + z1 - y0] - psi[cell - z0 - y0])
    pzx = (psi[cell + z1 + x1] - psi[cell - z0 + x1]) - (psi[cell + z1 - x0] - psi[cell - z0 - x0])
    pyx = (psi[cell + y1 + x1] - psi[cell - y0 + x1]) - (psi[cell + y1 - x0] - psi[cell - y0 - x0])
    slope = 0.5 * (az + bz), 0.5 * (ay + by), 0.5 * (ax + bx)
    mixed = 0.25 * pzy / (hz * hy), 0.25 * pzx / (hz * hx), 0.25 * pyx / (hy * hx)
    return level_curvatures(slope, ((bz - az) / hz, (by - ay) / hy, (bx - ax) / hx), mixed)


@kernel
def level_curvatures(slope, second, mixed):
    """(H, K) from the gradient (z, y, x), the second derivatives zz, yy, xx and the mixed ones zy, zx, yx."""
    pz, py, px = slope
    pzz, pyy, pxx = second
    pzy, pzx, pyx = mixed
    g2 = pz * pz + py * py + px * px
    if g2 < 1e-8:
        return 0.0, 0.0
    mean = pxx * (py * py + pz * pz) + pyy * (px * px + pz * pz) + pzz * (px * px + py * py)
    mean -= 2.0 * (px * py * pyx + px * pz * pzx + py * pz * pzy)
    gauss = (
        px * px * (pyy * pzz - pzy * pzy)
        + py * py * (pxx * pzz - pzx * pzx)
        + pz * pz * (pxx * pyy - pyx * pyx)
    )
    mixed = (
        px * py * (pzx * pzy - pyx * pzz)
        + py * pz * (pyx * pzx - pzy * pxx)
        + px * pz * (pyx * pzy - pzx * pyy)
    )
    gauss += 2.0 * mixed
    return mean / (g2 * np.sqrt(g2)), gauss / (g2 * g2)


@kernel
def mean_above_centre(psi, cell, iz, iy, ix, grid):
    """Mean of psi over a voxel less psi at its centre: sum of h_a^2 psi_aa over 24, mm."""
    _, zz = axis_derivatives(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
    _, yy = axis_derivatives(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    _, xx = axis_derivatives(psi, cell, ix, grid.nx, 1, grid.hx)
    return (grid.hz * grid.hz * zz + grid.hy * grid.hy * yy + grid.hx * grid.hx * xx) / 24.0


@kernel
def curvature_at_closest_point(mean, gauss, d, most):
    """Curvature H of the surface at the closest point of a cell at distance ``d``.

    The level through the cell has H = ``mean``, K = ``gauss``. The level through the cell is the surface moved by d
    along its normal, so its principal curvatures are k/(1 + d k); undone here:
    H = (H_d - 2 d K_d) / (1 - d H_d + d^2 K_d). Clipped to |H| <= ``most``.
    """
    denominator = 1.0 - d * mean + d * d * gauss
    h = (mean - 2.0 * d * gauss) / denominator if denominator > 0.2 else mean
    return min(max(h, -most), most)


@kernel
def minmod(a, b):
    """The smaller of two numbers of one sign, 0 when the signs differ."""
    if a * b <= 0.0:
        return 0.0
    return a if abs(a) < abs(b) else b


@kernel
def upwind_differences(psi, cell, i, n, stride, h):
    """Second-order one-sided differences (D-, D+) along an axis: ENO with the minmod of the second differences.

    Second order where psi is smooth; first order, and so smoothing, at corners and in noise.
    """
    down, up, second = axis_differences(psi, cell, i, n, stride, h)
    if i > 0 and i < n - 1:
        if i > 1:
            before = (psi[cell] - 2.0 * psi[cell - stride] + psi[cell - 2 * stride]) / (h * h)
            down += 0.5 * h * minmod(second, before)
        if i < n - 2:
            after = (psi[cell + 2 * stride] - 2.0 * psi[cell + stride] + psi[cell]) / (h * h)
            up -= 0.5 * h * minmod(second, after)
    return down, up


@kernel
def godunov_norm(psi, cell, iz, iy, ix, grid, shrinking):
    """|grad psi| of psi_t = beta |grad psi| by Godunov's upwind choice; ``shrinking``: beta > 0.

    beta > 0: max(min(D-, 0)^2, max(D+, 0)^2) per axis; beta < 0: max(max(D-, 0)^2, min(D+, 0)^2).
    """
    total = 0.0
    for axis in range(3):
        if axis == 0:
            down, up = upwind_differences(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
        elif axis == 1:
            down, up = upwind_differences(psi, cell, iy, grid.ny, grid.nx, grid.hy)
        else:
            down, up = upwind_differences(psi, cell, ix, grid.nx, 1, grid.hx)
        if shrinking:
            a, b = min(down, 0.0), max(up, 0.0)
        else:
            a, b = max(down, 0.0), min(up, 0.0)
        total += max(a * a, b * b)
    return np.sqrt(total)


@kernel(stage=Stage.ADVANCE)
def upwind_norms(start, stop, psi, grid, band, beta, front, out):
    """Godunov's |grad psi| at every front cell of the range, upwind for the speed ``beta`` (n,); 1 elsewhere."""
    # Columns of cells at the border are computed too, from any numbers, and not used.
    rows = np.zeros((15, BATCH), np.float32)
    norms = np.empty(BATCH, np.float32)
    sign = np.empty(BATCH, np.float32)
    well_inside = np.empty(BATCH, np.bool_)
    for first in range(start, stop, BATCH):
        count = min(BATCH, stop - first)
        gather_cross(first, count, psi, grid, band.cells, front, rows, well_inside)
        for i in range(count):
            sign[i] = 1.0 if beta[first + i] > 0.0 else -1.0
        godunov_norms(count, grid, rows, sign, norms)
        for i in range(count):
            s = first + i
            if well_inside[i]:
                out[s] = norms[i]
            elif front[s]:
                iz, iy, ix = unravel(band.cells[s], grid)
                out[s] = godunov_norm(psi, band.cells[s], iz, iy, ix, grid, beta[s] > 0.0)
            else:
                out[s] = 1.0


#: Where rows of `BATCH` begin in a memory, and rows of `block_memory`. Unsigned: numba tests a signed index for being
#: negative, and so the loop would not run in vectors.
ROW = tuple(np.uint64(row * BATCH) for row in range(26))
#: Rows of the gradient, z, y, x.
SLOPE = ROW[19]
#: Rows of H and K.
CURVATURES = ROW[22]


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
        if (
            iz < 2
            or iy < 2
            or ix < 2
            or iz >= grid.nz - 2
            or iy >= grid.ny - 2
            or ix >= grid.nx - 2
        ):
            continue
        well_inside[i] = True
        z = np.uint64(cell) - plane - plane
        y = np.uint64(cell) - row - row
        x = np.uint64(cell - 2)
        for k in range(np.uint64(5)):
            rows[k, i] = psi[z]
            rows[np.uint64(5) + k, i] = psi[y]
            rows[np.uint64(10) + k, i] = psi[x]
            z = z + plane
            y = y + row
            x = x + np.uint64(1)


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
    pz = np.float32(1.0 / grid.hz)
    py = np.float32(1.0 / grid.hy)
    px = np.float32(1.0 / grid.hx)
    z0 = rows[0]
    z1 = rows[1]
    z2 = rows[2]
    z3 = rows[3]
    z4 = rows[4]
    y0 = rows[5]
    y1 = rows[6]
    y2 = rows[7]
    y3 = rows[8]
    y4 = rows[9]
    x0 = rows[10]
    x1 = rows[11]
    x2 = rows[12]
    x3 = rows[13]
    x4 = rows[14]
    for i in range(np.uint64(count)):
        total = upwind_square(z0[i], z1[i], z2[i], z3[i], z4[i], pz, sign[i])
        total += upwind_square(y0[i], y1[i], y2[i], y3[i], y4[i], py, sign[i])
        total += upwind_square(x0[i], x1[i], x2[i], x3[i], x4[i], px, sign[i])
        out[i] = np.sqrt(total)


@kernel
def block_memory():
    """Memory for `gather_block` and `block_curvatures`: rows of `BATCH`.

    They are one array for the compiler to see that they are apart.
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
    i = np.uint64(i)
    at = np.uint64(cell)
    unit = np.uint64(1)
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
    half = np.float32(0.5)
    quarter = np.float32(0.25)
    two = np.float32(2.0)
    hz = np.float32(1.0 / grid.hz)
    hy = np.float32(1.0 / grid.hy)
    hx = np.float32(1.0 / grid.hx)
    part, huge = np.float32(1.0 / 24.0), np.float32(1e30)
    for i in range(np.uint64(BATCH)):
        c = memory[i]
        zm = memory[ROW[1] + i]
        zp = memory[ROW[2] + i]
        ym = memory[ROW[3] + i]
        yp = memory[ROW[4] + i]
        xm = memory[ROW[5] + i]
        xp = memory[ROW[6] + i]
        z = half * hz * (zp - zm)
        y = half * hy * (yp - ym)
        x = half * hx * (xp - xm)
        zz = (zp - c) - (c - zm)
        yy = (yp - c) - (c - ym)
        xx = (xp - c) - (c - xm)
        memory[CURVATURES + ROW[2] + i] = part * (zz + yy + xx)
        zz = hz * hz * zz
        yy = hy * hy * yy
        xx = hx * hx * xx
        zy = mixed(memory, ROW[7] + i)
        zx = mixed(memory, ROW[11] + i)
        yx = mixed(memory, ROW[15] + i)
        zy = quarter * hz * hy * zy
        zx = quarter * hz * hx * zx
        yx = quarter * hy * hx * yx
        z2 = z * z
        y2 = y * y
        x2 = x * x
        g2 = z2 + y2 + x2
        # A bound that nothing exceeds: so the compiler cannot choose which of two products it rounds before their sum.
        apart = max(x * z * zx, -huge)
        mean = (
            xx * (y2 + z2)
            + yy * (x2 + z2)
            + zz * (x2 + y2)
            - two * (x * y * yx + apart + y * z * zy)
        )
        gauss = x2 * (yy * zz - zy * zy) + y2 * (xx * zz - zx * zx) + z2 * (xx * yy - yx * yx)
        products = (
            x * y * (zx * zy - yx * zz) + y * z * (yx * zx - zy * xx) + x * z * (yx * zy - zx * yy)
        )
        has_slope = g2 >= np.float32(1e-8)
        inverse = np.float32(1.0) / (g2 if has_slope else np.float32(1.0))
        memory[SLOPE + i] = z
        memory[SLOPE + ROW[1] + i] = y
        memory[SLOPE + ROW[2] + i] = x
        memory[CURVATURES + i] = mean * inverse * np.sqrt(inverse) if has_slope else np.float32(0.0)
        memory[CURVATURES + ROW[1] + i] = (
            (gauss + two * products) * inverse * inverse if has_slope else np.float32(0.0)
        )


@kernel
def mixed(memory, at):
    """Sum of the edges ++ and -- less those of +- and -+, the first of them at ``at``."""
    return (memory[ROW[3] + at] - memory[ROW[1] + at]) - (memory[ROW[2] + at] - memory[at])
