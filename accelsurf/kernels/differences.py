"""Differences of psi on its grid: curvature, normals, Godunov's upwind gradient norm."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, unravel
from accelsurf.kernels.stages import Stage
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
def gradient(psi, cell, iz, iy, ix, grid):
    """Centred gradient (z, y, x) at a cell."""
    az, bz, _ = axis_differences(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
    ay, by, _ = axis_differences(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    ax, bx, _ = axis_differences(psi, cell, ix, grid.nx, 1, grid.hx)
    return 0.5 * (az + bz), 0.5 * (ay + by), 0.5 * (ax + bx)


@kernel
def curvatures(psi, cell, iz, iy, ix, grid):
    """Of the level through a cell: (H, K), the sum and the product of the principal curvatures (1/mm, 1/mm2).

    H = div(g/|g|), K = g . adj(D2 psi) g / |g|^4; both positive on a sphere with psi negative inside.
    """
    plane = grid.ny * grid.nx
    az, bz, pzz = axis_differences(psi, cell, iz, grid.nz, plane, grid.hz)
    ay, by, pyy = axis_differences(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    ax, bx, pxx = axis_differences(psi, cell, ix, grid.nx, 1, grid.hx)
    pz, py, px = 0.5 * (az + bz), 0.5 * (ay + by), 0.5 * (ax + bx)
    pzy = mixed_difference(psi, cell, (iz, grid.nz, iy, grid.ny), (plane, grid.nx), (grid.hz, grid.hy))
    pzx = mixed_difference(psi, cell, (iz, grid.nz, ix, grid.nx), (plane, 1), (grid.hz, grid.hx))
    pyx = mixed_difference(psi, cell, (iy, grid.ny, ix, grid.nx), (grid.nx, 1), (grid.hy, grid.hx))
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
    _, _, zz = axis_differences(psi, cell, iz, grid.nz, grid.ny * grid.nx, grid.hz)
    _, _, yy = axis_differences(psi, cell, iy, grid.ny, grid.nx, grid.hy)
    _, _, xx = axis_differences(psi, cell, ix, grid.nx, 1, grid.hx)
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
