"""Differences of psi on its grid: curvature, normals, Godunov's upwind gradient norm."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import BATCH, unravel
from accelsurf.kernels.stencils import gather_cross, godunov_norms


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
    z, y, x = grid.nz - 1, grid.ny - 1, grid.nx - 1
    return (z > 0 and (iz == 0 or iz == z)) or (y > 0 and (iy == 0 or iy == y)) or (x > 0 and (ix == 0 or ix == x))


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
    pzy = mixed_difference(psi, cell, (iz, grid.nz, iy, grid.ny), (plane, grid.nx), (grid.hz, grid.hy))
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
    hz, hy, hx = grid.hz, grid.hy, grid.hx
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
    gauss = px * px * (pyy * pzz - pzy * pzy) + py * py * (pxx * pzz - pzx * pzx) + pz * pz * (pxx * pyy - pyx * pyx)
    mixed = px * py * (pzx * pzy - pyx * pzz) + py * pz * (pyx * pzx - pzy * pxx) + px * pz * (pyx * pzy - pzx * pyy)
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
def curvature_at_foot(mean, gauss, d, most):
    """Curvature H of the surface at the foot of a cell at distance ``d`` whose level has H = ``mean``, K = ``gauss``.

    The level through the cell is the surface moved by d along its normal, so its principal curvatures are
    k/(1 + d k); undone here: H = (H_d - 2 d K_d) / (1 - d H_d + d^2 K_d). Clipped to |H| <= ``most``.
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
