"""Ridges of the distance, where the closest points of neighbours lie on opposite parts of the surface."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import step_of

#: A cell takes another foot, of a neighbour or beyond a ridge, when that is closer by this many voxels.
MIN_GAIN = 0.02
#: Psi may rise by this many voxels on the side that a ridge came from and has left: a step is half a voxel at most.
PASSED = 0.25
#: Shortest foot, voxels, whose direction is a normal.
MIN_LENGTH = 0.1


@kernel
def beside(side, cell, at, grid):
    """Raveled neighbour number ``side`` of a cell at index ``at`` = (z, y, x), -1 beyond the border."""
    iz, iy, ix = at
    if side < 2:
        p, n, stride = iz, grid.nz, grid.ny * grid.nx
    elif side < 4:
        p, n, stride = iy, grid.ny, grid.nx
    else:
        p, n, stride = ix, grid.nx, 1
    step = 1 if side & 1 else -1
    return cell + step * stride if 0 <= p + step < n else -1


@kernel
def beyond_ridge(s, at, slot, grid, band, now, guess):
    """Move the ``guess`` of slot ``s`` to the surface beyond a ridge, where that has come closer.

    ``now`` = (psi of the cell at index ``at`` = (z, y, x), psi of its six neighbours (6,)).
    A neighbour is beyond a ridge when its foot lay the other way (``band``: when psi was a distance); its
    tangent plane, moved as psi has changed there, tells how far that surface is. In a thin plate the neighbour's foot
    itself is too far off sideways to tell. Returns the slot of the neighbour, -1 where the guess stays.
    """
    h = min(grid.hz, min(grid.hy, grid.hx))
    foot, old = band.to_closest, band.psi
    value, around = now
    least = np.sqrt(guess[0] * guess[0] + guess[1] * guess[1] + guess[2] * guess[2]) - MIN_GAIN * h
    inside = value < 0.0
    # So that psi counts away from the surface on either side of it.
    sign = -1.0 if inside else 1.0
    own = sign * value
    found, scale = -1, 0.0
    for side in range(6):
        # Where psi rises along the axis no ridge has come across the cell: most cells need no more than this.
        towards, back = sign * around[side], sign * around[side ^ 1]
        if max(towards, back - PASSED * h) > own or towards < 0.0:
            continue
        near = beside(side, band.cells[s], at, grid)
        other = slot[near] if near >= 0 else -1
        if other < 0 or (old[other] < 0.0) != inside or abs(old[other]) < MIN_LENGTH * h:
            continue
        if foot[other, 0] * foot[s, 0] + foot[other, 1] * foot[s, 1] + foot[other, 2] * foot[s, 2] >= 0.0:
            continue
        oz, oy, ox = step_of(side, grid)
        along = (oz * foot[other, 0] + oy * foot[other, 1] + ox * foot[other, 2]) / abs(old[other])
        d = towards + along
        if 0.0 < d < least:
            least, found, scale = d, other, d / abs(old[other])
    if found >= 0:
        for axis in range(3):
            guess[axis] = scale * foot[found, axis]
    return found
