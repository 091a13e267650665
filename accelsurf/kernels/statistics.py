"""Statistics of many values without copies: values at a rank by their bits, histograms, sums by blocks and by cubes."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import BLOCK, voxels_along


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
def products(first_block, last_block, weight, first, second, sums):
    """Per block of slots: sums[block, 0] = sum of weight x first x second."""
    for block in range(first_block, last_block):
        total = 0.0
        for s in range(block * BLOCK, min((block + 1) * BLOCK, weight.shape[0])):
            if weight[s] != 0.0:
                total += weight[s] * np.float64(first[s]) * np.float64(second[s])
        sums[block, 0] = total


@kernel(stage=Stage.FLOW)
def displacement_sums(first_block, last_block, grid, band, area, before, limits, sums):
    """Per block of slots: the area, its sum with how far it has moved (voxels along the normal), and what moved far.

    ``before`` = (cells, psi) of the earlier band, in raster order; a cell that was not in it has moved by ``beyond``,
    and more than ``far`` voxels are far: ``limits`` = (far, beyond). ``area`` (n,) of the present ``band``, mm2.
    """
    cells, old = before
    far, beyond = limits
    for block in range(first_block, last_block):
        whole = 0.0
        moved = 0.0
        apart = 0.0
        first, last = block * BLOCK, min((block + 1) * BLOCK, area.shape[0])
        at = rank_of(cells, band.cells[first])
        for s in range(first, last):
            if area[s] == 0.0:
                continue
            while at < cells.shape[0] and cells[at] < band.cells[s]:
                at += 1
            way = beyond
            if at < cells.shape[0] and cells[at] == band.cells[s]:
                z = band.to_closest[s, 0]
                y = band.to_closest[s, 1]
                x = band.to_closest[s, 2]
                length2 = max(np.float64(z) * z + np.float64(y) * y + np.float64(x) * x, 1e-300)
                way = (
                    abs(np.float64(band.psi[s]) - old[at])
                    * voxels_along(z, y, x, grid)
                    / np.sqrt(length2)
                )
            whole += area[s]
            moved += area[s] * way
            apart += area[s] if way > far else 0.0
        sums[block, 0] = whole
        sums[block, 1] = moved
        sums[block, 2] = apart


@kernel
def rank_of(cells, cell):
    """Number of ``cells``, in rising order, that lie before ``cell``."""
    low, high = 0, cells.shape[0]
    while low < high:
        middle = (low + high) // 2
        if cells[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low


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


@kernel
def bin_of(value, low, per_value, bins):
    """Bin below a value, and the share of the bin above it; values beyond the ends belong to the end bins."""
    place = (np.float64(value) - low) * per_value
    place = min(max(place, 0.0), bins - 1.0)
    below = min(int(place), bins - 2)
    return below, place - below


@kernel(stage=Stage.ENERGY)
def weighted_histogram(first_block, last_block, cells, weight, image, scale, sums):
    """Per block of slots: sums[block] = histogram of the image at ``cells``, each times ``weight``.

    ``scale`` = (value of the first bin, bins per value); the bins are the columns of ``sums``.
    """
    low, per_value = scale
    bins = sums.shape[1]
    for block in range(first_block, last_block):
        for s in range(block * BLOCK, min((block + 1) * BLOCK, cells.shape[0])):
            if weight[s] != 0.0:
                below, share = bin_of(image[cells[s]], low, per_value, bins)
                sums[block, below] += weight[s] * (1.0 - share)
                sums[block, below + 1] += weight[s] * share


@kernel(stage=Stage.ENERGY)
def inside_histogram(first_plane, last_plane, dense, image, grid, scale, sums):
    """Per plane of the volume: histogram of the image over the inside voxels not in the band."""
    low, per_value = scale
    bins = sums.shape[1]
    size = grid.ny * grid.nx
    for plane in range(first_plane, last_plane):
        for cell in range(plane * size, (plane + 1) * size):
            if dense.slot[cell] < 0 and dense.psi[cell] < 0.0:
                below, share = bin_of(image[cell], low, per_value, bins)
                sums[plane, below] += 1.0 - share
                sums[plane, below + 1] += share


@kernel(stage=Stage.ENERGY)
def look_up(start, stop, values, scale, table, out):
    """Write the ``table`` at each of the values of the range, linear between bins, to ``out``."""
    low, per_value = scale
    for s in range(start, stop):
        below, share = bin_of(values[s], low, per_value, table.shape[0])
        out[s] = table[below] + share * (table[below + 1] - table[below])
