"""Marching of closest points: distance, band membership and extension from the front outwards.

Every cell has the vector to its closest point on the surface. Most get it from the cubic interpolant
at once; the others, and the cells that enter, adopt the closest point of a neighbour that has a closer one and refine
it, as in vector distance transforms, round by round until nothing changes: every round reads the last one only, so it
runs in several threads and gives the same bytes for any number of them. A field is extended by its value at the closest
point, so grad F . grad psi = 0.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.closest import (
    FOUND,
    LIMITED,
    MIN_GAIN,
    NEXT,
    OFFSET,
    PLACE,
    closest_point_memory,
    closest_points,
    crossing_point,
    guess_closest_points,
    guess_memory,
    is_between_signs,
    is_near_volume,
)
from accelsurf.kernels.grid import BATCH, is_thick, neighbours, step_of, unravel, voxels_along

#: State of a slot's closest point: not known yet.
OPEN = 0
#: Known.
FROZEN = 1
#: Known, and a neighbour is not in the band.
EDGE = 2
#: A closest point may lie this many voxels beyond the border; a surface further out has left the volume.
MARGIN = 1.0
#: A cell enters when it is at most this much beyond the band, voxels, by its neighbour's tangent plane.
SLACK = 0.1
#: Along each axis of a grid of thick slices the band extends so many voxels from a change of the sign.
STENCIL_WIDTH = 3


@kernel(stage=Stage.CLOSEST_POINTS)
def find_closest_points(start, stop, dense, grid, band, guide, closest_point, state):
    """Closest point of every cell of the range from psi as it is; ``state`` becomes OPEN where it is not found.

    Cells beside the front always find one: the closest point of the interpolant, or, where that fails or
    lies beyond the nearest edge crossing (voxel-sized features), the linear plane through the crossings.
    ``band`` is the band when psi was last a distance; ``guide`` = (inner, residue (n,), limited): see
    `guess_closest_points`, `residues` and `limited`. ``to_closest`` (n, 3) float32 and ``state`` (n,) int8 are written.
    """
    psi = dense.psi
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    plane = np.empty(3)
    w = np.empty(24)
    scratch = near, guess, guess_memory()
    place = scratch[2][0][PLACE:]
    memory, points, status = closest_point_memory()
    inner, residue, limited = guide
    offset = memory[OFFSET : OFFSET + BATCH]
    memory[LIMITED : LIMITED + BATCH] = limited
    beside, slots = np.empty(BATCH, np.bool_), np.arange(start, start + BATCH)
    within, around = np.empty(BATCH, np.bool_), np.empty(BATCH, np.bool_)
    for first in range(start, stop, BATCH):
        count = min(BATCH, stop - first)
        guess_closest_points(
            slots[:count], dense, grid, band, (inner, residue), scratch, (points, beside, offset)
        )
        slots += BATCH
        closest_points(count, psi, grid, band.cells[first:stop], memory, w)
        check_volume(grid, place, memory, within, around)
        for i in range(count):
            s = first + i
            cell = band.cells[s]
            n = np.uint64(i)
            iz = np.int64(place[n])
            iy = np.int64(place[n + NEXT])
            ix = np.int64(place[n + NEXT + NEXT])
            guess[0] = points[0, i]
            guess[1] = points[1, i]
            guess[2] = points[2, i]
            found = status[i] == FOUND and around[i]
            bound = -1.0
            if beside[i]:
                neighbours(cell, iz, iy, ix, grid, near)
                bound = crossing_point(psi, grid, cell, iz, iy, ix, near, plane)
            # Beyond the border psi is only continued, and so is its jump to +-gamma.
            state[s] = accept_closest_point(
                psi[cell], grid, plane, bound, guess, found, 0.5 if within[i] else 0.9
            )
            if within[i] and not beside[i] and state[s] == FROZEN:
                if not is_between_signs(psi, grid, iz, iy, ix, guess):
                    state[s] = OPEN
            closest_point[s, 0] = guess[0]
            closest_point[s, 1] = guess[1]
            closest_point[s, 2] = guess[2]


@kernel
def check_volume(grid, place, points, within, around):
    """Test if the closest points of a batch lie ``within`` the volume, and within `MARGIN` ``around`` it.

    Both are (`BATCH`,) bool.
    ``place`` and ``points`` hold rows z, y, x of the cells' indices and of the closest points (mm), one after the
    other. Of all columns alike, so that it runs in vectors.
    """
    for i in range(np.uint64(BATCH)):
        iz = place[i]
        iy = place[i + NEXT]
        ix = place[i + NEXT + NEXT]
        closest_point = (
            np.float64(points[i]),
            np.float64(points[i + NEXT]),
            np.float64(points[i + NEXT + NEXT]),
        )
        inside = is_near_volume(grid, iz, iy, ix, closest_point, 0.0)
        within[i] = inside
        around[i] = inside | is_near_volume(grid, iz, iy, ix, closest_point, MARGIN)


@kernel
def accept_closest_point(value, grid, plane, bound, guess, found, least):
    """Decide if a closest point, ``found`` at ``guess``, is accepted for a cell with psi = ``value``: FROZEN or OPEN.

    A closest point at less than ``least`` of the distance by psi is not on the surface. Where an edge crossing,
    ``bound`` mm off (-1: there is none), lies closer, the closest point of its ``plane`` is put there.
    """
    h = min(grid.hz, min(grid.hy, grid.hx))
    distance = np.sqrt(guess[0] * guess[0] + guess[1] * guess[1] + guess[2] * guess[2])
    if bound >= 0.0 and (not found or distance > bound + 0.1 * h):
        for axis in range(3):
            guess[axis] = plane[axis]
        return FROZEN
    if found and (bound >= 0.0 or least * abs(value) <= distance <= abs(value) + 2.0 * h):
        return FROZEN
    return OPEN


@kernel
def length(v, s):
    """Length of row ``s`` of an (n, 3) array."""
    return np.sqrt(v[s, 0] * v[s, 0] + v[s, 1] * v[s, 1] + v[s, 2] * v[s, 2])


@kernel(stage=Stage.CLOSEST_POINTS)
def classify_closest_points(start, stop, dense, grid, cells, closest_point, state, reviewed):
    """Compare each cell's closest point with those of its neighbours.

    Reads ``state`` (n,), writes ``reviewed`` (n,) int8: OPEN when a neighbour's closest point is closer; EDGE when a
    neighbour is not in the band (the march starts here).
    """
    near = np.empty(6, np.int64)
    h = min(grid.hz, min(grid.hy, grid.hx))
    for s in range(np.uint64(start), np.uint64(stop)):
        reviewed[s] = state[s]
        if state[s] == OPEN:
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        bound = length(closest_point, s) - MIN_GAIN * h
        least = bound * bound if bound > 0.0 else -1.0
        for side in range(6):
            if near[side] < 0:
                continue
            slot = dense.slot[np.uint64(near[side])]
            if slot < 0:
                reviewed[s] = EDGE
            elif state[np.uint64(slot)] != OPEN:
                other = np.uint64(slot)
                oz, oy, ox = step_of(side, grid)
                cz = closest_point[other, 0] + oz
                cy = closest_point[other, 1] + oy
                cx = closest_point[other, 2] + ox
                if cz * cz + cy * cy + cx * cx < least:
                    reviewed[s] = OPEN
                    break


@kernel
def grown(array):
    """``array`` with room for half as many entries again."""
    larger = np.empty(array.shape[0] + array.shape[0] // 2 + 1024, array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def grown_rows(array):
    """Same as ``grown``, for rows of three."""
    larger = np.empty((array.shape[0] + array.shape[0] // 2 + 1024, 3), array.dtype)
    larger[: array.shape[0]] = array
    return larger


@kernel
def tangent_closest_point(closest_point, via, grid, cz, cy, cx, out):
    """Closest point (into ``out``) of a cell whose neighbour ``via`` has the closest point (cz, cy, cx) from the cell.

    The point where the neighbour's tangent plane is closest: exact on a plane, and as good a guess as psi's slope
    gives. The neighbour's own closest point where that neighbour is too close to the surface to tell its normal.
    Returns its length in voxels.
    """
    fz = closest_point[via, 0]
    fy = closest_point[via, 1]
    fx = closest_point[via, 2]
    length2 = fz * fz + fy * fy + fx * fx
    h = min(grid.hz, min(grid.hy, grid.hx))
    if length2 > 0.1 * h * h:
        along = (cz * fz + cy * fy + cx * fx) / length2
        cz = along * fz
        cy = along * fy
        cx = along * fx
    out[0] = cz
    out[1] = cy
    out[2] = cx
    return voxels_along(cz, cy, cx, grid)


@kernel
def is_within_stencil(psi, grid, cell, voxels):
    """Test if a cell with a closest point ``voxels`` off belongs to the band on thick slices.

    On other grids all do. Where the spacings differ so much a closest point may be long in voxels while the surface is
    near across the slices. So psi must change its sign within `STENCIL_WIDTH` voxels: interpolation at the surface and
    beside it reads no others.
    """
    if voxels <= STENCIL_WIDTH or not is_thick(grid):
        return True
    iz, iy, ix = unravel(cell, grid)
    inside = psi[np.uint64(cell)] < 0.0
    for step in range(2 * STENCIL_WIDTH + 1):
        # The nearest slices first: 0, 1, -1, 2 ...
        az = iz + (step + 1) // 2 * (2 * (step % 2) - 1)
        if az < 0 or az >= grid.nz:
            continue
        for ay in range(max(iy - STENCIL_WIDTH, 0), min(iy + STENCIL_WIDTH + 1, grid.ny)):
            row = (az * grid.ny + ay) * grid.nx
            for ax in range(max(ix - STENCIL_WIDTH, 0), min(ix + STENCIL_WIDTH + 1, grid.nx)):
                if (psi[np.uint64(row + ax)] < 0.0) != inside:
                    return True
    return False


@kernel(stage=Stage.CLOSEST_POINTS)
def wake_neighbours(start, stop, dense, grid, known, sources, half_width, entering):
    """Mark the neighbours in the band of the slots ``sources`` (m,) as active.

    The closest points of the sources are new or at the band's edge. The neighbours may get a closer closest point. A
    neighbour that is not in the band shall enter it when the tangent plane at the source's closest point is within
    ``half_width`` voxels (and `SLACK`) of it: ``entering`` (m,) uint8 gets a bit for its side. ``known`` = (cells,
    closest point, state, active bool), a row for each slot, of which ``active`` is written.
    """
    cells, closest_point, _, active = known
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    for row in range(np.uint64(start), np.uint64(stop)):
        entering[row] = 0
        source = np.uint64(sources[row])
        if (
            voxels_along(
                closest_point[source, 0], closest_point[source, 1], closest_point[source, 2], grid
            )
            > half_width
        ):
            continue
        cell = cells[source]
        iz, iy, ix = unravel(cell, grid)
        neighbours(cell, iz, iy, ix, grid, near)
        sides = 0
        for side in range(6):
            if near[side] < 0:
                continue
            other = dense.slot[np.uint64(near[side])]
            if other >= 0:
                # Several threads may write it here, all the same.
                active[np.uint64(other)] = True
                continue
            oz, oy, ox = step_of(side, grid)
            cz = closest_point[source, 0] - oz
            cy = closest_point[source, 1] - oy
            cx = closest_point[source, 2] - ox
            voxels = tangent_closest_point(closest_point, source, grid, cz, cy, cx, guess)
            if voxels <= half_width + SLACK and is_within_stencil(
                dense.psi, grid, near[side], voxels
            ):
                sides |= 1 << side
        entering[row] = sides


@kernel(stage=Stage.CLOSEST_POINTS)
def enter_neighbours(slot, grid, known, n, sources, entering):
    """Let the neighbours of ``sources`` that `wake_neighbours` has found enter as OPEN and active slots; serial.

    ``slot`` is extended from ``n`` on, ``known`` has room for more than its first ``n`` slots. Returns it, perhaps with
    more room, and the new n.
    """
    done, n = enter_some(slot, grid, known, n, sources, entering, 0)
    while done < sources.shape[0]:
        cells, closest_point, state, active = known
        known = grown(cells), grown_rows(closest_point), grown(state), grown(active)
        done, n = enter_some(slot, grid, known, n, sources, entering, done)
    return known, n


@kernel
def enter_some(slot, grid, known, n, sources, entering, first):
    """`enter_neighbours` of the sources from row ``first`` on, as many as ``known`` has room for.

    Returns the first row that is left over, and the new n. Apart from what grows: a loop in which an array may become
    another counts the references to it each time round.
    """
    cells, _, state, active = known
    # To the next voxel along z, y, x: the sides are those of `neighbours`, -z, +z, -y, +y, -x, +x.
    steps = grid.ny * grid.nx, grid.nx, 1
    for row in range(first, sources.shape[0]):
        if entering[row] == 0:
            continue
        if n + 6 > cells.shape[0]:
            return row, n
        cell = cells[sources[row]]
        for side in range(6):
            if not (entering[row] >> side) & 1:
                continue
            at = cell + steps[side // 2] * (side % 2 * 2 - 1)
            # Another source may have let it in.
            if slot[at] < 0:
                cells[n] = at
                state[n] = OPEN
                active[n] = True
                slot[at] = n
                n += 1
    return sources.shape[0], n


@kernel(stage=Stage.CLOSEST_POINTS)
def take_active(open_slots, n, total, active):
    """The active slots among ``open_slots`` and ``n`` .. ``total``, in this order; none is ``active`` then. Serial."""
    out = np.empty(open_slots.shape[0] + total - n, np.int64)
    count = 0
    # Without branches: that a slot does not count is seen when the next takes its place.
    for s in open_slots:
        out[count] = s
        count += np.int64(active[s])
        active[s] = False
    for s in range(n, total):
        out[count] = s
        count += np.int64(active[s])
        active[s] = False
    return out[:count]


@kernel(stage=Stage.CLOSEST_POINTS)
def sort_changes(on, changed, was_open, refine_later):
    """The slots ``on`` (m,) that have ``changed``, and those of them that were open: their first closest points.

    Serial. The others of them are marked in ``refine_later`` (n,) bool.
    """
    sources, first = np.empty(on.shape[0], np.int64), np.empty(on.shape[0], np.int64)
    count, n_first = 0, 0
    for row in range(on.shape[0]):
        s = on[row]
        sources[count], first[n_first] = s, s
        count += np.int64(changed[row])
        n_first += np.int64(changed[row] & was_open[row])
        refine_later[s] |= changed[row] & ~was_open[row]
    return sources[:count], first[:n_first]


@kernel(inlined=True)
def closer_point_of_neighbour(s, dense, grid, cells, closest_point, state, near, out):
    """The neighbour's closest point that is closest to slot ``s``, into ``out``.

    It is closer than the slot's own by `MIN_GAIN`. Returns the neighbour's slot, -1 where there is none.
    """
    h = min(grid.hz, min(grid.hy, grid.hx))
    # Squares of distances: -1 where nothing can be closer. An open slot has no closest point yet.
    least = 1e30
    if state[s] != OPEN:
        bound = length(closest_point, s) - MIN_GAIN * h
        least = bound * bound if bound > 0.0 else -1.0
    found = -1
    cell = cells[s]
    iz, iy, ix = unravel(cell, grid)
    neighbours(cell, iz, iy, ix, grid, near)
    for side in range(6):
        slot = dense.slot[np.uint64(near[side])] if near[side] >= 0 else -1
        if slot < 0 or state[np.uint64(slot)] == OPEN:
            continue
        other = np.uint64(slot)
        oz, oy, ox = step_of(side, grid)
        cz = closest_point[other, 0] + oz
        cy = closest_point[other, 1] + oy
        cx = closest_point[other, 2] + ox
        d = cz * cz + cy * cy + cx * cx
        if d < least:
            least, found = d, slot
            out[0] = cz
            out[1] = cy
            out[2] = cx
    return found


@kernel(stage=Stage.CLOSEST_POINTS)
def propagate_closest_points(start, stop, dense, grid, known, on, out):
    """One round: each of the slots ``on`` (m,) looks for a closer closest point among its neighbours'.

    Reads ``known`` = (cells, closest point, state, residue) and writes ``out`` = (better (m, 3), changed (m,), offset
    (m,)), for `update_closest_points`. A closest point comes with its residue.
    """
    cells, closest_point, state, residue = known
    better, changed, offset = out
    near = np.empty(6, np.int64)
    guess = np.empty(3)
    for row in range(np.uint64(start), np.uint64(stop)):
        donor = closer_point_of_neighbour(
            np.uint64(on[row]), dense, grid, cells, closest_point, state, near, guess
        )
        changed[row] = donor >= 0
        offset[row] = residue[np.uint64(donor)] if donor >= 0 else 0.0
        better[row, 0] = guess[0]
        better[row, 1] = guess[1]
        better[row, 2] = guess[2]


@kernel(stage=Stage.CLOSEST_POINTS)
def update_closest_points(start, stop, on, found, known):
    """Enter in ``known`` = (closest point, state, residue) the results ``found`` of a round.

    ``found`` is the ``out`` of `propagate_closest_points`.
    """
    better, changed, offset = found
    closest_point, state, residue = known
    for row in range(start, stop):
        if changed[row]:
            s = on[row]
            closest_point[s, 0] = better[row, 0]
            closest_point[s, 1] = better[row, 1]
            closest_point[s, 2] = better[row, 2]
            state[s], residue[s] = FROZEN, offset[row]


@kernel(stage=Stage.CLOSEST_POINTS)
def refine_closest_points(start, stop, psi, grid, cells, on, closest_point, guide):
    """Move the closest points of the slots ``on`` (m,), adopted from neighbours, to their own closest points.

    ``guide`` = (residue, limited), see `find_closest_points`. A closest point that does not get shorter, further off
    than the radius of curvature, stays.
    """
    out = np.empty(3)
    w = np.empty(24)
    memory, points, status = closest_point_memory()
    at = np.empty(BATCH, np.int64)
    residue, limited = guide
    memory[LIMITED : LIMITED + BATCH] = limited
    for first in range(start, stop, BATCH):
        count = min(BATCH, stop - first)
        for i in range(count):
            s = on[first + i]
            at[i] = cells[s]
            memory[OFFSET + np.uint64(i)] = residue[s]
            points[0, i] = closest_point[s, 0]
            points[1, i] = closest_point[s, 1]
            points[2, i] = closest_point[s, 2]
        closest_points(count, psi, grid, at, memory, w)
        for i in range(count):
            s = on[first + i]
            iz, iy, ix = unravel(at[i], grid)
            out[0] = points[0, i]
            out[1] = points[1, i]
            out[2] = points[2, i]
            d = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
            shorter = status[i] == FOUND and d <= length(closest_point, s) * (1.0 + 1e-3)
            if shorter and is_near_volume(grid, iz, iy, ix, out, MARGIN):
                closest_point[s, 0] = out[0]
                closest_point[s, 1] = out[1]
                closest_point[s, 2] = out[2]
