"""Residues: the interpolant of psi at points known to lie on the surface, where it ought to be 0.

The cubic of four nodes is off in fourth order on a smooth surface, by up to 0.1 voxel where its nodes lie on both sides
of a ridge of the distance, and always to the same side: a redistancing that looked for the value 0 would swell what is
thin by as much, each time. Looking for the residue instead, it leaves a surface that rests where it is. On one that
moves, the error of a cell is the difference between its residues now and at first, which does not add up.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import BATCH, unravel
from accelsurf.kernels.interpolate import (
    LEVELS,
    enter_point,
    four_nodes,
    limited_in_vectors,
    limited_memory,
    value_and_gradient,
)
from accelsurf.kernels.simd.cubic import cubic_value

#: Smallest residue that counts, voxels; larger ones count by what they exceed it. So closest points that disagree come
#: together by this much in a redistancing.
MIN_RESIDUE = 3e-4
#: Largest residue, voxels. What is more counts less, and nothing from twice as much on: large residues are of noise, or
#: of points that are not on the surface any more.
MAX_RESIDUE = 0.1
#: With unequal spacings a voxel is as large as it is across the surface where the limited interpolant is within this
#: part of it from 0: it errs by less where both sides of a sheet of 1.5 voxels are among its nodes. Elsewhere a voxel
#: is as large as along the finest axis.
MAX_LIMITED = 0.05
#: Distance from the surface, voxels, within which cells have a residue of their own. Others have that of the cell
#: nearest their closest point: their closest points then lie on the same surface as those beside it.
OWN_RESIDUE = 1.0
#: From this ratio of the spacings on most of the surface lies between two slices with no cell so near: cells that find
#: none there keep a residue of their own.
VERY_THICK = 16.0


@kernel
def known_point(s, grid, band, motion):
    """Closest point of slot ``s`` after ``motion`` = (velocity (n, 3), dt): index coordinates z, y, x."""
    velocity, dt = motion
    iz, iy, ix = unravel(band.cells[s], grid)
    return (
        iz + (band.to_closest[s, 0] + dt * velocity[s, 0]) / grid.hz,
        iy + (band.to_closest[s, 1] + dt * velocity[s, 1]) / grid.hy,
        ix + (band.to_closest[s, 2] + dt * velocity[s, 2]) / grid.hx,
    )


@kernel
def has_own_residue(s, grid, band):
    """Test if slot ``s`` is within `OWN_RESIDUE` of the surface."""
    fz = band.to_closest[s, 0] / grid.hz
    fy = band.to_closest[s, 1] / grid.hy
    fx = band.to_closest[s, 2] / grid.hx
    return fz * fz + fy * fy + fx * fx <= OWN_RESIDUE * OWN_RESIDUE


@kernel
def corner(i, grid, pz, py, px):
    """Raveled cell of corner ``i``, 0 .. 7, of the cube of voxel centres around a position, within the volume."""
    iz = min(max(np.int64(np.floor(pz)) + (i >> 2), 0), grid.nz - 1)
    iy = min(max(np.int64(np.floor(py)) + ((i >> 1) & 1), 0), grid.ny - 1)
    ix = min(max(np.int64(np.floor(px)) + (i & 1), 0), grid.nx - 1)
    return (iz * grid.ny + iy) * grid.nx + ix


@kernel
def nearest_slot(slot, grid, pz, py, px):
    """Slot of the voxel of the volume that is nearest to an index position; -1 where it is not in the band."""
    iz = min(max(np.int64(np.floor(pz + 0.5)), 0), grid.nz - 1)
    iy = min(max(np.int64(np.floor(py + 0.5)), 0), grid.ny - 1)
    ix = min(max(np.int64(np.floor(px + 0.5)), 0), grid.nx - 1)
    return slot[np.uint64((iz * grid.ny + iy) * grid.nx + ix)]


@kernel
def is_at_surface(psi, grid, pz, py, px):
    """Test if psi has both signs around an index position: a piece without inside must not be held in place."""
    inside = 0
    iz = np.int64(np.floor(pz))
    iy = np.int64(np.floor(py))
    ix = np.int64(np.floor(px))
    if 0 <= iz < grid.nz - 1 and 0 <= iy < grid.ny - 1 and 0 <= ix < grid.nx - 1:
        a = (iz * grid.ny + iy) * grid.nx + ix
        b = a + grid.ny * grid.nx
        for at in (a, a + grid.nx, b, b + grid.nx):
            inside += (psi[at] < 0.0) + (psi[at + 1] < 0.0)
        return 0 < inside < 8
    for i in range(8):
        inside += 1 if psi[corner(i, grid, pz, py, px)] < 0.0 else 0
    return 0 < inside < 8


@kernel
def largest_residue(psi, grid, point, memory):
    """Largest residue (mm) that counts in full at an index position ``point`` z, y, x, see `MAX_LIMITED`.

    ``memory`` = (first (`BATCH`,) int64, `limited_memory`).
    """
    first, lines = memory
    first[0] = enter_point(np.uint64(0), grid, *point, lines)
    limited_in_vectors(1, psi, grid, first, lines)
    level, gz, gy, gx = four_nodes(lines, LEVELS)
    z = grid.hz * gz
    y = grid.hy * gy
    x = grid.hx * gx
    voxel = np.sqrt((z * z + y * y + x * x) / max(gz * gz + gy * gy + gx * gx, 1e-30))
    return MAX_RESIDUE * (
        voxel if abs(level) <= MAX_LIMITED * voxel else min(grid.hz, min(grid.hy, grid.hx))
    )


@kernel(stage=Stage.CLOSEST_POINTS)
def own_residues(start, stop, psi, grid, band, motion, out):
    """Residue (mm) of every cell within `OWN_RESIDUE`; 0 elsewhere, and beside no surface.

    On slices as thick as `VERY_THICK` every cell has one whose closest point is well inside the volume.
    ``psi`` is a distance and ``band`` its band, or psi has moved since, by ``motion`` = (velocity (n, 3), dt).
    ``out`` = (residue (n,) float32, near (n,) bool): whether the cell is so near.
    """
    residue, near = out
    w = np.empty(24)
    h = min(grid.hz, min(grid.hy, grid.hx))
    least, most = MIN_RESIDUE * h, MAX_RESIDUE * h
    limit = 2.0 * MAX_RESIDUE * max(grid.hz, max(grid.hy, grid.hx))
    equal, thick = (
        grid.hz == grid.hy == grid.hx,
        max(grid.hz, max(grid.hy, grid.hx)) >= VERY_THICK * h,
    )
    lines, first = limited_memory(grid), np.zeros(BATCH, np.int64)
    furthest = 1.01 * OWN_RESIDUE * max(grid.hz, max(grid.hy, grid.hx))
    sy, sz = grid.nx, grid.ny * grid.nx
    for s in range(np.uint64(start), np.uint64(stop)):
        residue[s] = 0.0
        # The length of the closest point, when psi was a distance.
        near[s] = abs(band.psi[s]) <= furthest and has_own_residue(s, grid, band)
        if not near[s] and not thick:
            continue
        pz, py, px = known_point(s, grid, band, motion)
        bz = int(pz) - 1
        by = int(py) - 1
        bx = int(px) - 1
        # Well inside the volume, without the cases and the slopes of value_and_gradient.
        if 0 <= bz <= grid.nz - 4 and 0 <= by <= grid.ny - 4 and 0 <= bx <= grid.nx - 4:
            at = (bz * grid.ny + by) * grid.nx + bx
            value = cubic_value(
                psi, at, sy, sz, np.float32(pz - bz), np.float32(py - by), np.float32(px - bx)
            )
        elif near[s]:
            value, _, _, _ = value_and_gradient(psi, grid, pz, py, px, w)
        else:
            continue
        size = abs(value) - least
        if abs(value) > most:
            # Beyond the largest voxel nothing is left in any direction.
            is_open = not equal and abs(value) < limit and is_at_surface(psi, grid, pz, py, px)
            largest = largest_residue(psi, grid, (pz, py, px), (first, lines)) if is_open else most
            size = min(size, 2.0 * largest - abs(value))
        if size > 0.0 and is_at_surface(psi, grid, pz, py, px):
            residue[s] = size if value > 0.0 else -size


@kernel(stage=Stage.CLOSEST_POINTS)
def distant_residues(start, stop, slot, grid, band, motion, out):
    """Residue of every cell beyond `OWN_RESIDUE`: that of the cell nearest its closest point, where that is within.

    ``out`` as `own_residues` has filled it.
    """
    residue, near = out
    for s in range(np.uint64(start), np.uint64(stop)):
        if near[s]:
            continue
        pz, py, px = known_point(s, grid, band, motion)
        nearest = nearest_slot(slot, grid, pz, py, px)
        if nearest >= 0 and near[np.uint64(nearest)]:
            residue[s] = residue[np.uint64(nearest)]


@kernel(stage=Stage.BAND)
def mark_below(start, stop, slot, grid, cells, flipped, marked):
    """Mark in ``marked`` (n,) bool the slots whose cube of eight voxels upwards has one of the ``flipped`` (n,) slots.

    A cube that begins at no slot has no mark: `drop_residues` looks at its voxels.
    """
    for s in range(start, stop):
        if not flipped[s]:
            continue
        iz, iy, ix = unravel(cells[s], grid)
        for az in range(max(iz - 1, 0), iz + 1):
            for ay in range(max(iy - 1, 0), iy + 1):
                for ax in range(max(ix - 1, 0), ix + 1):
                    other = slot[(az * grid.ny + ay) * grid.nx + ax]
                    if other >= 0:
                        marked[other] = True


@kernel(stage=Stage.BAND)
def drop_residues(start, stop, slot, grid, band, flipped, out):
    """Set to 0 the residues in ``out`` (n,) of the cells whose closest point is beside a flipped slot.

    ``flipped`` = ((n,) bool, `mark_below`'s marks (n,) bool).
    """
    is_flipped, marked = flipped
    for s in range(np.uint64(start), np.uint64(stop)):
        if out[s] == 0.0:
            continue
        pz, py, px = known_point(s, grid, band, (band.to_closest, 0.0))
        first = (
            slot[np.uint64(corner(0, grid, pz, py, px))]
            if pz >= 0.0 and py >= 0.0 and px >= 0.0
            else -1
        )
        if first >= 0:
            if marked[np.uint64(first)]:
                out[s] = 0.0
            continue
        for i in range(8):
            other = slot[np.uint64(corner(i, grid, pz, py, px))]
            if other >= 0 and is_flipped[np.uint64(other)]:
                out[s] = 0.0
                break
