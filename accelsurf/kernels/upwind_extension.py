"""Fields extended in order of distance, each cell from its upwind neighbours: a fast march of values."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.eikonal import upwind_neighbours, upwind_weights
from accelsurf.kernels.stages import Stage


@kernel(stage=Stage.EXTENSION)
def order_of(distance):
    """Slots (n,) int64 in order of ``distance`` (n,) float32 >= 0, ties by slot: by 11 bits at a time; serial."""
    n = distance.shape[0]
    bits = distance.view(np.uint32)
    order, other = np.arange(n), np.empty(n, np.int64)
    count = np.empty(2049, np.int64)
    for part in range(3):
        shift = np.uint32(11 * part)
        count[:] = 0
        for s in range(n):
            count[((bits[s] >> shift) & np.uint32(2047)) + 1] += 1
        for i in range(2048):
            count[i + 1] += count[i]
        for k in range(n):
            s = order[k]
            at = (bits[s] >> shift) & np.uint32(2047)
            other[count[at]] = s
            count[at] += 1
        order, other = other, order
    return order


@kernel(stage=Stage.EXTENSION)
def upwind_table(start, stop, slot, grid, known, off, table):
    """Where the slots ``off`` (m,) read the values of an extended field: their upwind neighbours, and the weights.

    ``known`` = (cells, foot, distance (mm, signed), state) of the band. ``table`` = (slots (m, 6) int32, shares (m, 6)
    float32, 0 where none is read).
    """
    slots, shares = table
    up = np.empty(6, np.int64), np.empty(3, np.int64), np.empty((4, 3))
    weights = np.empty(6)
    distance = known[2]
    for row in range(start, stop):
        s = off[row]
        d = abs(distance[s])
        upwind_neighbours(known[0][s], slot, grid, known, d, up)
        upwind_weights(d, up, weights)
        for k in range(6):
            used = up[0][k] >= 0 and weights[k] != 0.0
            slots[row, k] = up[0][k] if used else s
            shares[row, k] = weights[k] if used else 0.0


@kernel(stage=Stage.EXTENSION)
def carry_outwards(off, slots, shares, values):
    """Overwrite ``values`` (n,) at the slots ``off`` (m,), in this order, by what `upwind_table` has for them; serial.

    No value leaves the range of those that it comes from: a difference of second order would.
    """
    for row in range(off.shape[0]):
        value, low, high = np.float32(0.0), np.float32(np.inf), np.float32(-np.inf)
        for k in range(6):
            share = shares[row, k]
            if share != 0.0:
                one = values[slots[row, k]]
                value += share * one
                low, high = min(low, one), max(high, one)
        values[off[row]] = min(max(value, low), high) if low <= high else np.float32(0.0)
