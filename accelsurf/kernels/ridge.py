"""Ridges of the distance, where the closest points of neighbours lie on opposite parts of the surface."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.closest import is_near_volume
from accelsurf.kernels.grid import BATCH, step_of, unravel

#: A cell takes another foot, of a neighbour or beyond a ridge, when that is closer by this many voxels.
MIN_GAIN = 0.02
#: Psi may rise by this many voxels on the side that a ridge came from and has left: a step is half a voxel at most.
PASSED = 0.25
#: Shortest foot, voxels, whose direction is a normal.
MIN_LENGTH = 0.1


@kernel
def towards_ridge(value, towards, back, least):
    """Test if a ridge may have come across a cell of psi = ``value`` from the neighbour ``towards``, of psi: 1 or 0.

    ``value`` and ``towards``, and ``back`` on the opposite side, count away from the surface; ``least`` is the smallest
    spacing. Where psi rises along the axis none has: most cells need no more than this.
    """
    passed = np.float32(PASSED) * least
    return np.int32((towards <= value) & (back - passed <= value) & (towards >= np.float32(0.0)))


@kernel
def sides_beyond(value, least, around):
    """The sides of a cell of psi = ``value`` beyond which a ridge may lie, a bit each; ``around`` = psi at them."""
    a, b, c, d, e, f = around
    sign = np.float32(-1.0) if value < np.float32(0.0) else np.float32(1.0)
    value, a, b, c, d, e, f = sign * value, sign * a, sign * b, sign * c, sign * d, sign * e, sign * f
    sides = towards_ridge(value, a, b, least) | (towards_ridge(value, b, a, least) << np.int32(1))
    sides |= (towards_ridge(value, c, d, least) << np.int32(2)) | (towards_ridge(value, d, c, least) << np.int32(3))
    sides |= (towards_ridge(value, e, f, least) << np.int32(4)) | (towards_ridge(value, f, e, least) << np.int32(5))
    return sides


@kernel
def beyond_ridges(slots, slot, grid, band, residue, memory, out):
    """Move guesses of the feet of ``slots`` to the surface beyond a ridge, where that has come closer.

    A neighbour is beyond a ridge when its foot lay the other way (``band``: when psi was a distance); its
    tangent plane, moved as psi has changed there, tells how far that surface is. In a thin plate the neighbour's foot
    itself is too far off sideways to tell. ``memory`` and ``out`` as in `guesses.guess_feet`: the guess comes with the
    neighbour's residue.
    """
    # The first rows are psi at the cell and at its sides.
    rows, alone, sides = memory
    guesses, _, offset = out
    foot, old = band.to_closest, band.psi
    h = min(grid.hz, min(grid.hy, grid.hx))
    moved, strides = np.empty(3), np.zeros(33, np.int64)
    for side in range(6):
        stride = grid.ny * grid.nx if side < 2 else (grid.nx if side < 4 else 1)
        strides[1 << side] = stride if side & 1 else -stride
    for i in range(slots.shape[0]):
        left = sides[i]
        if left == 0:
            continue
        s = slots[i]
        cell = band.cells[s]
        to_closest = foot[s]
        inside = rows[i] < 0.0
        # So that psi counts away from the surface on either side of it.
        sign = -1.0 if inside else 1.0
        z, y, x = guesses[0, i], guesses[1, i], guesses[2, i]
        least = np.sqrt(z * z + y * y + x * x) - MIN_GAIN * h
        found, scale = -1, 0.0
        while left != 0:
            bit = left & -left
            left ^= bit
            other = slot[cell + strides[bit]]
            if other < 0:
                continue
            # Nearly always this ends it.
            if foot[other, 0] * to_closest[0] + foot[other, 1] * to_closest[1] + foot[other, 2] * to_closest[2] >= 0.0:
                continue
            if (old[other] < 0.0) != inside or abs(old[other]) < MIN_LENGTH * h:
                continue
            side = 0
            while bit >> side != 1:
                side += 1
            oz, oy, ox = step_of(side, grid)
            along = (oz * foot[other, 0] + oy * foot[other, 1] + ox * foot[other, 2]) / abs(old[other])
            d = sign * rows[(1 + side) * BATCH + i] + along
            if 0.0 < d < least:
                least, found, scale = d, other, d / abs(old[other])
        if found >= 0:
            for axis in range(3):
                moved[axis] = scale * foot[found, axis]
                guesses[axis, i] = moved[axis]
            offset[i] = residue[found]
            iz, iy, ix = unravel(cell, grid)
            alone[i] = not is_near_volume(grid, iz, iy, ix, moved, 0.0)
