"""Closest point on the zero level of the cubic interpolant of psi."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.interpolate import value_and_gradient

MAX_ITERATIONS = 6
#: The iteration ends once a correction is below this many voxels: the first, which knows nothing of the
#: curvature and leaves distance x curvature of it, and the later ones, which leave its square.
FIRST_TOLERANCE = 0.01
TOLERANCE = 0.05
#: Longest correction in one iteration, voxels: the interpolant is trusted only near the front.
MAX_MOVE = 1.5


@kernel
def closest_point(psi, grid, iz, iy, ix, foot, w):
    """Move ``foot`` (mm from cell iz, iy, ix; a first guess) to the closest point of psi = 0.

    Chopp's two corrections at once: down the gradient to the zero level, -psi g/|g|^2, and along the level
    until the cell lies on the normal, r - (r.g) g/|g|^2 with r the vector from the foot to the cell. The latter
    is too long by 1 + distance x curvature, which two successive residues tell (secant): so it converges also
    further off than the radius of curvature. Returns True when converged; ``foot`` is then the vector from the
    cell to the surface.
    """
    fz, fy, fx = foot[0], foot[1], foot[2]
    relax = 1.0
    last_z = last_y = last_x = last2 = 0.0
    first2 = 0.0
    for iteration in range(MAX_ITERATIONS):
        value, gz, gy, gx = value_and_gradient(psi, grid, iz + fz / grid.hz, iy + fy / grid.hy, ix + fx / grid.hx, w)
        g2 = gz * gz + gy * gy + gx * gx
        if not g2 > 0.04:
            return False
        along = (fz * gz + fy * gy + fx * gx) / g2
        tz, ty, tx = along * gz - fz, along * gy - fy, along * gx - fx
        if iteration > 0 and last2 > 0.0:
            left = (tz * last_z + ty * last_y + tx * last_x) / last2
            relax = min(max(relax / max(1.0 - left, 0.25), 0.1), 4.0)
        last_z, last_y, last_x, last2 = tz, ty, tx, tz * tz + ty * ty + tx * tx
        if iteration == 0:
            first2 = last2
        elif iteration >= 2 and last2 > 0.25 * first2:
            return False
        down = value / g2
        dz, dy, dx = relax * tz - down * gz, relax * ty - down * gy, relax * tx - down * gx
        move = np.sqrt((dz / grid.hz) ** 2 + (dy / grid.hy) ** 2 + (dx / grid.hx) ** 2)
        if move > MAX_MOVE:
            scale = MAX_MOVE / move
            dz *= scale
            dy *= scale
            dx *= scale
            last2 = 0.0
        fz += dz
        fy += dy
        fx += dx
        if move < (FIRST_TOLERANCE if iteration == 0 else TOLERANCE):
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
