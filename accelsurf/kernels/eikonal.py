"""Upwind differences from accepted neighbours: the distance of a cell, and the weights of the values that it reads.

The distance d of a cell solves, with the upwind differences of second order,

    sum over axes ((d - t)/e)^2 = 1,   t = (4 d_1 - d_2)/3, e = 2h/3   (first order: t = d_1, e = h)

with d_1, d_2 those of the nearer neighbour along the axis and of the next beyond it. A field F with
grad F . grad psi = 0 in the same differences is F = sum w F_up/sum w, w = (d - t)/e^2, F_up = (4 F_1 - F_2)/3
(Adalsteinsson and Sethian).
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel

#: State of a slot in a march: not reached; with a first estimate; accepted; accepted beyond the band, which no other
#: reads.
FAR, TRIAL, ACCEPTED, BEYOND = 0, 1, 2, 3
#: The neighbour beyond a neighbour counts where both have their closest points on the same piece of surface: then
#: |p_1 - p_2|^2 + (d_1 - d_2)^2 = h^2 on a plane, and it may be at most this many h^2.
SAME_SHEET = 1.5
#: Largest slope across a border that is carried along it.
MAX_ACROSS = 0.98


@kernel
def offset_of(foot, slot, other, grid, axis, sign):
    """Squared distance (mm2) of the closest points of two slots, ``other`` a voxel further along ``axis``."""
    total = 0.0
    for a in range(3):
        h = grid.hz if a == 0 else (grid.hy if a == 1 else grid.hx)
        d = foot[other, a] - foot[slot, a] + (sign * h if a == axis else 0.0)
        total += d * d
    return total


@kernel
def upwind_neighbours(cell, slot, grid, known, furthest, up):
    """The accepted neighbours of a cell from which its distance follows, per axis.

    ``known`` = (cells, foot, distance (mm, signed), state); only those nearer than ``furthest`` mm count. ``up`` =
    (slots (6,) int64: per axis the nearer of the two neighbours (-1: none) and the next beyond it (-1: first order);
    sides (3,): -1, 1; terms (4, 3): d_1, t, e and the slope across a border, see `slope_across`).
    """
    _, foot, distance, state = known
    slots, sides, terms = up
    iz, iy, ix = unravel(cell, grid)
    nearest = -1
    for axis in range(3):
        h, n, stride = grid.hz, grid.nz, grid.ny * grid.nx
        at = iz
        if axis == 1:
            h, n, stride, at = grid.hy, grid.ny, grid.nx, iy
        elif axis == 2:
            h, n, stride, at = grid.hx, grid.nx, 1, ix
        slots[axis], slots[3 + axis], terms[0, axis], terms[3, axis] = -1, -1, 1e30, 0.0
        for sign in (-1, 1):
            s = slot[cell + sign * stride] if 0 <= at + sign < n else -1
            if s >= 0 and state[s] == ACCEPTED and abs(distance[s]) < min(furthest, terms[0, axis]):
                slots[axis], sides[axis], terms[0, axis] = s, sign, abs(distance[s])
        s, sign = slots[axis], sides[axis]
        if s < 0:
            continue
        if nearest < 0 or terms[0, axis] < terms[0, nearest]:
            nearest = axis
        terms[1, axis], terms[2, axis] = terms[0, axis], h
        other = slot[cell + 2 * sign * stride] if 0 <= at + 2 * sign < n else -1
        if other >= 0 and state[other] == ACCEPTED:
            # Beyond the surface the distance goes on with the other sign.
            d = abs(distance[other]) * (1.0 if (distance[s] < 0.0) == (distance[other] < 0.0) else -1.0)
            rise = terms[0, axis] - d
            if rise >= 0.0 and offset_of(foot, s, other, grid, axis, sign) + rise * rise <= SAME_SHEET * h * h:
                slots[3 + axis] = other
                terms[1, axis], terms[2, axis] = (4.0 * terms[0, axis] - d) / 3.0, 2.0 * h / 3.0
    wall = (iz == 0) | (iz == grid.nz - 1) | (iy == 0) | (iy == grid.ny - 1) | (ix == 0) | (ix == grid.nx - 1)
    if wall and nearest >= 0:
        slope_across((iz, iy, ix), grid, known, nearest, up)


@kernel
def slope_across(index, grid, known, nearest, up):
    """Slopes across the borders that a cell at ``index`` lies at, into row 3 of the terms of ``up``.

    Where the closest points lie beyond a border there is no neighbour to take the distance from: psi is continued
    straight, its slope across the border being that of the nearest neighbour.
    """
    _, foot, distance, _ = known
    slots, _, terms = up
    s = slots[nearest]
    d = abs(distance[s])
    if d <= 0.0:
        return
    for axis in range(3):
        n, at = (grid.nz, index[0]) if axis == 0 else ((grid.ny, index[1]) if axis == 1 else (grid.nx, index[2]))
        out = -1.0 if at == 0 else 1.0
        if n > 1 and (at == 0 or at == n - 1) and axis != nearest and out * foot[s, axis] > 0.0:
            # A neighbour further in is not what the distance comes from.
            slots[axis], slots[3 + axis], terms[0, axis] = -1, -1, 1e30
            terms[3, axis] = min(abs(foot[s, axis]) / d, MAX_ACROSS)


@kernel
def solve_distance(up, grid, second):
    """Distance (mm) from the ``up`` of `upwind_neighbours`, with the second-order terms or without.

    Where a neighbour would be further than the result, by the first-order terms, without the furthest if need be.
    """
    slots, _, terms = up
    rest = 1.0
    for axis in range(3):
        rest -= terms[3, axis] * terms[3, axis]
    rest = max(rest, 1.0 - MAX_ACROSS * MAX_ACROSS)
    most = 1e30
    for axis in range(3):
        h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
        most = min(most, terms[0, axis] + h)
    limit, furthest = 1e29, 0.0
    while furthest >= 0.0:
        a, b, c, furthest = 0.0, 0.0, 0.0, -1.0
        for axis in range(3):
            d = terms[0, axis]
            if slots[axis] < 0 or d >= limit:
                continue
            h = grid.hz if axis == 0 else (grid.hy if axis == 1 else grid.hx)
            t, e = (terms[1, axis], terms[2, axis]) if second else (d, h)
            w = 1.0 / (e * e)
            a, b, c, furthest = a + w, b + w * t, c + w * t * t, max(furthest, d)
        disc = b * b - a * (c - rest)
        if furthest >= 0.0 and disc >= 0.0 and b + np.sqrt(disc) > a * furthest:
            return min((b + np.sqrt(disc)) / a, most)
        # First order, and then without the furthest neighbour.
        limit = limit if second else furthest
        second = False
    return most


@kernel
def upwind_weights(d, up, weights):
    """Weights (6,) of the values of ``up``'s slots in a field extended to a cell at ``d`` mm; their sum is 1."""
    slots, _, terms = up
    total = 0.0
    for k in range(6):
        weights[k] = 0.0
    nearest = 0
    for axis in range(3):
        if slots[axis] < 0:
            continue
        if slots[nearest] < 0 or terms[0, axis] < terms[0, nearest]:
            nearest = axis
        w = max(d - terms[1, axis], 0.0) / (terms[2, axis] * terms[2, axis]) if terms[0, axis] < d else 0.0
        total += w
        if slots[3 + axis] >= 0:
            weights[axis], weights[3 + axis] = 4.0 * w / 3.0, -w / 3.0
        else:
            weights[axis] = w
    if total <= 0.0:
        weights[nearest], total = 1.0, 1.0
    for k in range(6):
        weights[k] /= total


@kernel
def estimate(cell, slot, grid, distance, state):
    """First-order distance (mm) of a cell from its accepted neighbours, of which there is one at least."""
    iz, iy, ix = unravel(cell, grid)
    d0, w0, d1, w1, d2, w2 = 1e30, 0.0, 1e30, 0.0, 1e30, 0.0
    for axis in range(3):
        h, n, stride, at = grid.hz, grid.nz, grid.ny * grid.nx, iz
        if axis == 1:
            h, n, stride, at = grid.hy, grid.ny, grid.nx, iy
        elif axis == 2:
            h, n, stride, at = grid.hx, grid.nx, 1, ix
        d, w = 1e30, 1.0 / (h * h)
        for sign in (-1, 1):
            s = slot[cell + sign * stride] if 0 <= at + sign < n else -1
            if s >= 0 and state[s] == ACCEPTED:
                d = min(d, abs(distance[s]))
        # Nearest first.
        if d < d0:
            d0, w0, d1, w1, d2, w2 = d, w, d0, w0, d1, w1
        elif d < d1:
            d1, w1, d2, w2 = d, w, d1, w1
        else:
            d2, w2 = d, w
    # (d - d0)^2 w0 + (d - d1)^2 w1 + ... = 1, measured from d0, with as many terms as are nearer than d.
    best = 1.0 / np.sqrt(w0)
    a, b, c = w0, 0.0, -1.0
    if d1 - d0 < best:
        u = d1 - d0
        a, b, c = a + w1, b + w1 * u, c + w1 * u * u
        best = (b + np.sqrt(max(b * b - a * c, 0.0))) / a
        if d2 - d0 < best:
            u = d2 - d0
            a, b, c = a + w2, b + w2 * u, c + w2 * u * u
            best = (b + np.sqrt(max(b * b - a * c, 0.0))) / a
    return d0 + best
