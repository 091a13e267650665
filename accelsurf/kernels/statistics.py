"""Statistics of many values without copies: order statistics by their bits, sums by blocks of slots and by cubes."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BLOCK
from accelsurf.kernels.stages import Stage


@kernel
def magnitude_at_rank(values, where, rank):
    """The ``rank``-th smallest (from 0) of |values| (float32) where ``where`` is set; exact.

    The bits of positive floats are in the order of the floats: three histograms, each of the next bits of those that
    agree with the bits found so far, tell the value. Those that agree with the first are few, and put together.
    """
    bits = values.view(np.uint32)
    histogram = np.zeros(2048, np.int64)
    sign, first = np.uint32(0x7FFFFFFF), np.uint32(20)
    for i in range(bits.shape[0]):
        histogram[(bits[i] & sign) >> first] += where[i]
    top = 0
    while rank >= histogram[top]:
        rank -= histogram[top]
        top += 1
    alike = np.empty(histogram[top] + 1, np.uint32)
    count = 0
    for i in range(bits.shape[0]):
        size = bits[i] & sign
        # The next place takes it also where it does not count.
        alike[count] = size
        count += np.int64(where[i]) & np.int64((size >> first) == top)
    found = np.uint32(top) << first
    for width, shift in ((11, 9), (9, 0)):
        histogram[:] = 0
        mask = np.uint32((1 << width) - 1)
        above = np.uint32(shift + width)
        for i in range(count):
            if (alike[i] >> above) == (found >> above):
                histogram[(alike[i] >> np.uint32(shift)) & mask] += 1
        at = 0
        while rank >= histogram[at]:
            rank -= histogram[at]
            at += 1
        found |= np.uint32(at) << np.uint32(shift)
    out = np.empty(1, np.uint32)
    out[0] = found
    return out.view(np.float32)[0]


@kernel(stage=Stage.FLOW)
def products(first_block, last_block, weight, one, other, sums):
    """Per block of slots: sums[block, 0] = sum of weight x one x other."""
    for block in range(first_block, last_block):
        total = 0.0
        for s in range(block * BLOCK, min((block + 1) * BLOCK, weight.shape[0])):
            if weight[s] != 0.0:
                total += weight[s] * np.float64(one[s]) * np.float64(other[s])
        sums[block, 0] = total


@kernel
def sums_by_cube(cells, values, scale, row_cubes, column_cubes, reached, sums):
    """Add ``values`` x ``scale`` (float32) of ``cells`` (n,), in raster order, to ``sums`` (m,) float64 by their cubes.

    ``row_cubes`` (nz ny,) has the number of the cube in which a row along x begins, ``column_cubes`` (nx,) what is to
    be added to it along the row, both int64. ``reached`` (m,) bool is set at the cubes that have a cell. Serial: the
    sums depend on the order.
    """
    nx = column_cubes.shape[0]
    row, first = 0, 0
    for s in range(cells.shape[0]):
        if cells[s] >= first + nx:
            row = cells[s] // nx
            first = row * nx
        cube = row_cubes[row] + column_cubes[cells[s] - first]
        reached[cube] = True
        sums[cube] += np.float64(values[s] * scale)
