"""Closest point on the zero level of the cubic interpolant of psi."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.interpolate import value_and_gradient

MAX_ITERATIONS = 6
#: The iteration ends once a correction is below this many voxels: the first, which knows nothing of the
#: curvature and leaves distance x curvature of it, and the later ones, which leave its square. Further than a voxel
#: off, where the foot is only read from, the first may be larger in proportion to the distance.
FIRST_TOLERANCE = 0.015
TOLERANCE = 0.05
#: Least |grad psi|^2: below it psi has no zero level worth the name.
LEAST_SLOPE2 = 0.04
#: Longest correction in one iteration, voxels: the interpolant is trusted only near the front.
MAX_MOVE = 1.5


@kernel
def correction(fz, fy, fx, level, relax):
    """Chopp's two corrections of a foot (fz, fy, fx): down the gradient to the zero level, and along the level.

    -psi g/|g|^2, and, until the cell lies on the normal, r - (r.g) g/|g|^2 with r the vector from the foot to the cell,
    times ``relax``; ``level`` = (psi, gradient z, y, x) at the foot. Returns the step (dz, dy, dx) and the part along
    the level (tz, ty, tx), not relaxed; infinite or NaN where psi has no slope.
    """
    value, gz, gy, gx = level
    inverse = 1.0 / (gz * gz + gy * gy + gx * gx)
    along = (fz * gz + fy * gy + fx * gx) * inverse
    tz, ty, tx = along * gz - fz, along * gy - fy, along * gx - fx
    down = value * inverse
    return relax * tz - down * gz, relax * ty - down * gy, relax * tx - down * gx, tz, ty, tx


@kernel
def correct_once(count, grid, feet, levels, corrected, done):
    """First correction of ``count`` feet at once; ``done`` where it is so small that it is the last.

    Rows of ``feet`` and ``corrected`` (3, m) are z, y, x, those of ``levels`` (4, m) psi and its gradient, float32.
    """
    hz, hy, hx = np.float32(1.0 / grid.hz), np.float32(1.0 / grid.hy), np.float32(1.0 / grid.hx)
    one, most = np.float32(1.0), np.float32(FIRST_TOLERANCE**2)
    fz, fy, fx = feet[0], feet[1], feet[2]
    v, gz, gy, gx = levels[0], levels[1], levels[2], levels[3]
    cz, cy, cx = corrected[0], corrected[1], corrected[2]
    for i in range(np.uint64(count)):
        g2 = gz[i] * gz[i] + gy[i] * gy[i] + gx[i] * gx[i]
        inverse = one / g2
        along = (fz[i] * gz[i] + fy[i] * gy[i] + fx[i] * gx[i] - v[i]) * inverse
        z, y, x = along * gz[i], along * gy[i], along * gx[i]
        cz[i], cy[i], cx[i] = z, y, x
        z, y, x = (z - fz[i]) * hz, (y - fy[i]) * hy, (x - fx[i]) * hx
        far = (fz[i] * hz) ** 2 + (fy[i] * hy) ** 2 + (fx[i] * hx) ** 2
        done[i] = (g2 > np.float32(LEAST_SLOPE2)) & (z * z + y * y + x * x < most * max(one, far))


@kernel
def closest_point(psi, grid, iz, iy, ix, foot, w):
    """Move ``foot`` (mm from cell iz, iy, ix; a first guess) to the closest point of psi = 0; see `refine`."""
    pz, py, px = iz + foot[0] / grid.hz, iy + foot[1] / grid.hy, ix + foot[2] / grid.hx
    return refine(psi, grid, iz, iy, ix, foot, w, value_and_gradient(psi, grid, pz, py, px, w))


@kernel
def refine(psi, grid, iz, iy, ix, foot, w, level):
    """Move ``foot`` to the closest point of psi = 0; ``level`` = (value, gradient z, y, x) of psi there.

    The correction along the level is too long by 1 + distance x curvature, which two successive residues tell
    (secant): so it converges also further off than the radius of curvature. Returns True when converged; ``foot`` is
    then the vector from the cell to the surface.
    """
    fz, fy, fx = foot[0], foot[1], foot[2]
    hz, hy, hx = 1.0 / grid.hz, 1.0 / grid.hy, 1.0 / grid.hx
    far = max(1.0, np.sqrt((fz * hz) ** 2 + (fy * hy) ** 2 + (fx * hx) ** 2))
    relax = 1.0
    last_z = last_y = last_x = last2 = 0.0
    first2 = 0.0
    for iteration in range(MAX_ITERATIONS):
        if iteration > 0:
            level = value_and_gradient(psi, grid, iz + fz * hz, iy + fy * hy, ix + fx * hx, w)
        if not level[1] ** 2 + level[2] ** 2 + level[3] ** 2 > LEAST_SLOPE2:
            return False
        dz, dy, dx, tz, ty, tx = correction(fz, fy, fx, level, relax)
        if iteration > 0 and last2 > 0.0:
            left = (tz * last_z + ty * last_y + tx * last_x) / last2
            longer = min(max(relax / max(1.0 - left, 0.25), 0.1), 4.0)
            dz, dy, dx = dz + (longer - relax) * tz, dy + (longer - relax) * ty, dx + (longer - relax) * tx
            relax = longer
        last_z, last_y, last_x, last2 = tz, ty, tx, tz * tz + ty * ty + tx * tx
        if iteration == 0:
            first2 = last2
        elif iteration >= 2 and last2 > 0.25 * first2:
            return False
        move = np.sqrt((dz * hz) ** 2 + (dy * hy) ** 2 + (dx * hx) ** 2)
        if move > MAX_MOVE:
            scale = MAX_MOVE / move
            dz *= scale
            dy *= scale
            dx *= scale
            last2 = 0.0
        fz += dz
        fy += dy
        fx += dx
        if move < (FIRST_TOLERANCE * far if iteration == 0 else TOLERANCE):
            foot[0] = fz
            foot[1] = fy
            foot[2] = fx
            return True
    return False


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
            if other >= 0 and (psi[other] < 0.0) != inside:
                d = h * abs(value) / (abs(value) + abs(psi[other]) + 1e-30)
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
