"""Blocks of voxels: sums and means over them, and their values on voxels; and how much voxels differ from the next."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def sums_along(values, step):
    """Sums (n, blocks, m) float32 of ``step`` voxels each along the middle axis; the last block may be smaller.

    Parameters
    ----------
    values : ndarray (n, count, m) float32
    step : int
    """
    n, count, m = values.shape
    blocks = (count + step - 1) // step
    out = np.empty((n, blocks, m), np.float32)
    for i in range(n):
        for block in range(blocks):
            first, stop = block * step, min((block + 1) * step, count)
            for k in range(m):
                rest = np.float32(0.0)
                for j in range(first + 1, stop):
                    rest += values[i, j, k]
                out[i, block, k] = values[i, first, k] + rest
    return out


@kernel
def scaled_means(values, middle, spread, window, steps):
    """Means over blocks of (values - middle)/spread, cut at -window and window; the last blocks may be smaller.

    Parameters
    ----------
    values : ndarray (nz, ny, nx) float32
    middle, spread, window : float32
    steps : (int, int, int)
        Voxels of a block along z, y, x.

    Returns
    -------
    ndarray float32
        Of the blocks. Sums are made along z, then along y, then along x.
    """
    nz, ny, nx = values.shape
    (step_z, step_y, step_x), scale = steps, np.float32(1.0) / spread
    out = np.empty(((nz + step_z - 1) // step_z, (ny + step_y - 1) // step_y, (nx + step_x - 1) // step_x), np.float32)
    plane, line = np.empty((ny, nx), np.float32), np.empty(nx, np.float32)
    for block_z in range(out.shape[0]):
        plane[:] = np.float32(0.0)
        for iz in range(block_z * step_z, min((block_z + 1) * step_z, nz)):
            for iy in range(ny):
                row, total = values[iz, iy], plane[iy]
                for ix in range(nx):
                    total[ix] += min(max((row[ix] - middle) * scale, -window), window)
        depth = min((block_z + 1) * step_z, nz) - block_z * step_z
        for block_y in range(out.shape[1]):
            line[:] = np.float32(0.0)
            stop_y = min((block_y + 1) * step_y, ny)
            for iy in range(block_y * step_y, stop_y):
                for ix in range(nx):
                    line[ix] += plane[iy, ix]
            layers = depth * (stop_y - block_y * step_y)
            for block_x in range(out.shape[2]):
                first, stop, total = block_x * step_x, min((block_x + 1) * step_x, nx), np.float32(0.0)
                for ix in range(first, stop):
                    total += line[ix]
                out[block_z, block_y, block_x] = total / np.float32(layers * (stop - first))
    return out


@kernel
def changes_up_to(values, limit):
    """Number of differences of neighbours along all axes (nz, ny, nx) float32 that are at most ``limit``, a float32."""
    nz, ny, nx = values.shape
    total = 0
    for iz in range(nz):
        for iy in range(ny):
            row, count = values[iz, iy], np.int32(0)
            for ix in range(nx - 1):
                count += np.int32(abs(row[ix + 1] - row[ix]) <= limit)
            for axis in range(2):
                if (axis == 0 and iz == nz - 1) or (axis == 1 and iy == ny - 1):
                    continue
                other = values[iz + 1, iy] if axis == 0 else values[iz, iy + 1]
                for ix in range(nx):
                    count += np.int32(abs(other[ix] - row[ix]) <= limit)
            total += count
    return total


@kernel
def add_between(out, share, values, z, y, x):
    """Add ``share`` times values of blocks, linearly between their middles; beyond the voxels named ``share`` alone.

    Parameters
    ----------
    out : ndarray (nz, ny, nx) float32
        Changed.
    share : float32
    values : ndarray float32
        Of the blocks.
    z, y, x : (first, below, part)
        For each axis: ``first``, the first voxel of ``out`` that has a value; for it and those after it the block
        ``below`` it (n,) int64, and the ``part`` (n,) float32 of the way to the next block.
    """
    nz, ny, nx = out.shape
    (first_z, below_z, part_z), (first_y, below_y, part_y), (first_x, below_x, part_x) = z, y, x
    last_z, last_y, last_x = values.shape[0] - 1, values.shape[1] - 1, values.shape[2] - 1
    line = np.empty(last_x + 1, np.float32)
    for iz in range(nz):
        for iy in range(ny):
            row, jz, jy = out[iz, iy], iz - first_z, iy - first_y
            if not (0 <= jz < len(below_z) and 0 <= jy < len(below_y)):
                for ix in range(nx):
                    row[ix] += share
                continue
            az, ay = below_z[jz], below_y[jy]
            bz, by = min(az + 1, last_z), min(ay + 1, last_y)
            for k in range(last_x + 1):
                low = between(values[az, ay, k], values[bz, ay, k], part_z[jz])
                high = between(values[az, by, k], values[bz, by, k], part_z[jz])
                line[k] = between(low, high, part_y[jy])
            for ix in range(first_x):
                row[ix] += share
            for j in range(len(below_x)):
                ax = below_x[j]
                row[first_x + j] += share * between(line[ax], line[min(ax + 1, last_x)], part_x[j])
            for ix in range(first_x + len(below_x), nx):
                row[ix] += share


@kernel(inlined=True)
def between(low, high, part):
    """Value between two others, at a part of the way."""
    return low + part * (high - low)


@kernel
def hold_side(force, before, inside, held, least, gains):
    """Move F towards what it was by the part ``held``; labels may change to one side alone.

    Parameters
    ----------
    force : ndarray (nz, ny, nx) float32
        F, changed.
    before : ndarray (nz, ny, nx) float32
        F before, cut at -1 and 1 here.
    inside : ndarray (nz, ny, nx) of bool
        The object before.
    held, least : float32
        Where a label would change to the other side, F is that before, of its side by ``least`` at least.
    gains : bool
        Whether labels may change to the inside; else to the outside.
    """
    nz, ny, nx = force.shape
    limit = np.float32(1.0)
    for iz in range(nz):
        for iy in range(ny):
            row, was, labels = force[iz, iy], before[iz, iy], inside[iz, iy]
            for ix in range(nx):
                earlier = min(max(was[ix], -limit), limit)
                now = between(row[ix], earlier, held)
                if gains and labels[ix] and now >= 0.0:
                    now = min(earlier, -least)
                elif not gains and not labels[ix] and now < 0.0:
                    now = max(earlier, least)
                row[ix] = now


@kernel
def tally_changes(values, leading):
    """Count how often each half of the bits occurs among the differences of neighbours (nz, ny, nx) float32.

    Parameters
    ----------
    values : ndarray (nz, ny, nx), float32
    leading : int
        -1: the upper 16 bits are counted. Else the lower 16 bits of the differences that have these upper ones. The
        bits of floats that are not negative are in the order of the floats.

    Returns
    -------
    ndarray (65536,) int64
    """
    nz, ny, nx = values.shape
    counts = np.zeros(65536, np.int64)
    change = np.empty(nx, np.float32)
    bits = change.view(np.uint32)
    for iz in range(nz):
        for iy in range(ny):
            row = values[iz, iy]
            for axis in range(3):
                if (axis == 0 and iz == nz - 1) or (axis == 1 and iy == ny - 1):
                    continue
                other = values[iz + 1, iy] if axis == 0 else values[iz, iy + 1] if axis == 1 else row[1:]
                for ix in range(len(other)):
                    change[ix] = abs(other[ix] - row[ix])
                for ix in range(len(other)):
                    upper = np.int64(bits[ix] >> np.uint32(16))
                    if leading < 0:
                        counts[upper] += 1
                    elif upper == leading:
                        counts[np.int64(bits[ix] & np.uint32(0xFFFF))] += 1
    return counts
