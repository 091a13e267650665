"""Bookkeeping of the band: which cells stay, which enter, and the dense arrays that follow."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import unravel, voxels_along
from accelsurf.kernels.interpolate import band_rows, band_value_at, linear_band_value
from accelsurf.kernels.march import OPEN, is_within_stencil, length
from accelsurf.kernels.simd.cubic import cubic_rows

#: The smallest distance that a cell may be given, as a part of the smallest spacing, so that psi has a sign.
MIN_DISTANCE = 1e-6


@kernel(stage=Stage.BAND)
def extent(cells, grid, out):
    """First voxel of some cells, and the one after the last, into ``out`` (2, 3) int64. Serial."""
    low_y = grid.ny
    low_x = grid.nx
    high_y = -1
    high_x = -1
    for s in range(cells.shape[0]):
        _, iy, ix = unravel(cells[s], grid)
        low_y, high_y = min(low_y, iy), max(high_y, iy)
        low_x, high_x = min(low_x, ix), max(high_x, ix)
    first, _, _ = unravel(cells[0], grid)
    last, _, _ = unravel(cells[-1], grid)
    out[0, 0] = first
    out[0, 1] = low_y
    out[0, 2] = low_x
    out[1, 0] = last + 1
    out[1, 1] = high_y + 1
    out[1, 2] = high_x + 1


@kernel(stage=Stage.BAND)
def keep_mask(start, stop, psi, grid, known, half_width, keep):
    """Mark in ``keep`` (n,) bool the slots whose closest point is known and near enough.

    Near enough is within ``half_width`` voxels, and `is_within_stencil`. ``known`` = (cells, closest point, state), a
    row for each slot, as in `march`.
    """
    cells, closest_point, state = known
    for s in range(start, stop):
        voxels = voxels_along(closest_point[s, 0], closest_point[s, 1], closest_point[s, 2], grid)
        keep[s] = (
            state[s] != OPEN
            and voxels <= half_width
            and is_within_stencil(psi, grid, cells[s], voxels)
        )


@kernel(stage=Stage.BAND)
def merged_order(cells, n_old, keep, entered):
    """Slots (k,) int64 of the new band in raster order: the old ones that stay merged with those that enter.

    ``cells`` (m,) of the ``n_old`` old slots, in raster order, and then of new ones; ``keep`` (m,) bool; ``entered``
    the new slots that stay, sorted by cell. Serial.
    """
    count = entered.shape[0]
    for s in range(n_old):
        if keep[s]:
            count += 1
    order = np.empty(count, np.int64)
    at = 0
    e = 0
    for s in range(n_old):
        if not keep[s]:
            continue
        while e < entered.shape[0] and cells[entered[e]] < cells[s]:
            order[at] = entered[e]
            at += 1
            e += 1
        order[at] = s
        at += 1
    while e < entered.shape[0]:
        order[at] = entered[e]
        at += 1
        e += 1
    return order


@kernel(stage=Stage.BAND)
def gather_band(start, stop, dense_psi, grid, order, old, new):
    """Fill the range of the ``new`` band from the ``old`` slots in ``order``.

    ``old`` = (cells, closest point); psi = sign x |closest_point|.
    """
    shortest = MIN_DISTANCE * min(grid.hz, min(grid.hy, grid.hx))
    for s in range(np.uint64(start), np.uint64(stop)):
        source = np.uint64(order[s])
        cell = np.uint64(old.cells[source])
        new.cells[s] = cell
        for axis in range(3):
            new.to_closest[s, axis] = old.to_closest[source, axis]
        d = max(length(old.to_closest, source), shortest)
        new.psi[s] = -d if dense_psi[cell] < 0.0 else d


@kernel(stage=Stage.EXTENSION)
def sample_at_closest_points(start, stop, slot, grid, band, front, values, out):
    """Fields on the ``front`` of the new ``band``: their values at each closest point, interpolated from the old slots.

    ``values`` (m, n_old) float32 belong to the old band and ``slot`` still maps to it; ``out`` is (m, n). A cell with
    nothing known around its closest point has its own old values, or 0 when it was not in the band.
    """
    m, n_old = values.shape
    flat = values.reshape(m * n_old)
    w = np.empty(24)
    rows = np.empty(16, np.int64)
    position = np.empty(3)
    hz = 1.0 / grid.hz
    hy = 1.0 / grid.hy
    hx = 1.0 / grid.hx
    cells, closest_point = band.cells, band.to_closest
    for s in range(np.uint64(start), np.uint64(stop)):
        if not front[s]:
            continue
        cell = cells[s]
        iz, iy, ix = unravel(cell, grid)
        pz = iz + closest_point[s, 0] * hz
        py = iy + closest_point[s, 1] * hy
        px = ix + closest_point[s, 2] * hx
        bz = int(pz) - 1
        by = int(py) - 1
        bx = int(px) - 1
        inside = 0 <= bz <= grid.nz - 4 and 0 <= by <= grid.ny - 4 and 0 <= bx <= grid.nx - 4
        if inside:
            at = (bz * grid.ny + by) * grid.nx + bx
            if band_rows(slot, n_old, at, grid.nx, grid.ny * grid.nx, rows):
                uz = np.float32(pz - bz)
                uy = np.float32(py - by)
                ux = np.float32(px - bx)
                for field in range(m):
                    out[field, s] = cubic_rows(flat, rows, uz, uy, ux)
                    for k in range(16):
                        rows[k] += n_old
                continue
        position[0] = pz
        position[1] = py
        position[2] = px
        slot_before = slot[np.uint64(cell)]
        for field in range(m):
            if inside:
                value, found = linear_band_value(flat, slot, n_old, grid, position, field * n_old)
            else:
                value, found = band_value_at(values[field], slot, n_old, grid, position, w)
            if not found:
                value = (
                    values[field, slot_before] if slot_before >= 0 and slot_before < n_old else 0.0
                )
            out[field, s] = value


@kernel(stage=Stage.EXTENSION)
def outward_table(start, stop, slot, grid, band, front, off, table):
    """Find where the cells ``off`` the front (slots, int32) read the front's values, for `extend_outwards`.

    Row i of ``table`` = (slots (m, 8) int32, shares (m, 8) float32) gets the slots of the cells around the closest
    point of cell ``off[i]`` that are on the front, and their weights in the linear interpolation there, with sum 1 (all
    0 where none is). A cell that does not count is the cell itself, with weight 0.
    """
    slots, shares = table
    for row in range(np.uint64(start), np.uint64(stop)):
        s = np.uint64(off[row])
        iz, iy, ix = unravel(band.cells[s], grid)
        pz = min(max(iz + band.to_closest[s, 0] / grid.hz, 0.0), grid.nz - 1.0)
        py = min(max(iy + band.to_closest[s, 1] / grid.hy, 0.0), grid.ny - 1.0)
        px = min(max(ix + band.to_closest[s, 2] / grid.hx, 0.0), grid.nx - 1.0)
        iz = int(pz)
        iy = int(py)
        ix = int(px)
        tz = pz - iz
        ty = py - iy
        tx = px - ix
        total = 0.0
        for corner in range(8):
            i = corner >> 2
            j = (corner >> 1) & 1
            k = corner & 1
            share = (
                (tz if i == 1 else 1.0 - tz)
                * (ty if j == 1 else 1.0 - ty)
                * (tx if k == 1 else 1.0 - tx)
            )
            at = -1
            if share > 1e-6:
                at = slot[np.uint64(((iz + i) * grid.ny + iy + j) * grid.nx + ix + k)]
            if at >= 0 and front[np.uint64(at)]:
                slots[row, corner] = at
                shares[row, corner] = share
                total += share
            else:
                slots[row, corner] = s
                shares[row, corner] = 0.0
        scale = 1.0 / total if total > 0.0 else 0.0
        for corner in range(8):
            shares[row, corner] *= scale


@kernel(stage=Stage.EXTENSION)
def extend_outwards(start, stop, off, slots, shares, values):
    """Overwrite ``values`` at the cells ``off`` the front by the front's, as `outward_table` weighs them."""
    for row in range(np.uint64(start), np.uint64(stop)):
        value = np.float32(0.0)
        for corner in range(8):
            share = shares[row, corner]
            if share > 0.0:
                value += share * values[slots[row, corner]]
        values[off[row]] = value


@kernel(stage=Stage.EXTENSION)
def quadratic_table(start, stop, slot, grid, band, row_of, off, across, table):
    """Make an `outward_table` with the quadratic interpolation around the node that is nearest to each closest point.

    Of values in rows: ``row_of`` (n,) int32 has the row of a slot on the front, -1 for others.
    Row i of ``table`` = (rows (m, 10) uint32, shares (m, 10) float32, mirrored (m,) int8) gets that node, its six
    neighbours and, for each pair of axes, the node diagonally towards the closest point: all within 1.7 voxels of the
    surface. With distances u >= 0 of the closest point, F + sum [u (u + 1)/2 (F_+ - F) + u (u - 1)/2 (F_- - F)] +
    sum u_i u_j (F_ij - F_i - F_j + F). Beyond the border the values are those of the mirror image, with the other sign
    beyond the borders across axis ``across`` (-1: none); bit a of ``mirrored`` is set where one beyond a border across
    axis a counts. Where one of the ten is not on the front, the mean of those that are, by their weights in the linear
    interpolation there; all 0 where none is.
    """
    rows, shares, mirrored = table
    for row in range(np.uint64(start), np.uint64(stop)):
        s = np.uint64(off[row])
        iz, iy, ix = unravel(band.cells[s], grid)
        cz, uz, tz, az = nearest_node(
            iz + band.to_closest[s, 0] / grid.hz, grid.nz, grid.ny * grid.nx
        )
        cy, uy, ty, ay = nearest_node(iy + band.to_closest[s, 1] / grid.hy, grid.ny, grid.nx)
        cx, ux, tx, ax = nearest_node(ix + band.to_closest[s, 2] / grid.hx, grid.nx, 1)
        mirrored[row] = (tz * az == 0) + 2 * (ty * ay == 0) + 4 * (tx * ax == 0)
        # Signs of the values towards the closest point and away from it.
        sz, oz = mirror_sign(tz, 0, across, grid.nz), mirror_sign(az, 0, across, grid.nz)
        sy, oy = mirror_sign(ty, 1, across, grid.ny), mirror_sign(ay, 1, across, grid.ny)
        sx, ox = mirror_sign(tx, 2, across, grid.nx), mirror_sign(ax, 2, across, grid.nx)
        c = cz + cy + cx
        rest = 1.0 - uz * uz - uy * uy - ux * ux + uz * uy + uz * ux + uy * ux
        known = put(slot, row_of, c, rest, rows, shares, row, 0)
        known &= put(
            slot, row_of, c + tz, sz * uz * (0.5 * (uz + 1.0) - uy - ux), rows, shares, row, 1
        )
        known &= put(
            slot, row_of, c + ty, sy * uy * (0.5 * (uy + 1.0) - uz - ux), rows, shares, row, 2
        )
        known &= put(
            slot, row_of, c + tx, sx * ux * (0.5 * (ux + 1.0) - uz - uy), rows, shares, row, 3
        )
        known &= put(slot, row_of, c + az, oz * 0.5 * uz * (uz - 1.0), rows, shares, row, 4)
        known &= put(slot, row_of, c + ay, oy * 0.5 * uy * (uy - 1.0), rows, shares, row, 5)
        known &= put(slot, row_of, c + ax, ox * 0.5 * ux * (ux - 1.0), rows, shares, row, 6)
        known &= put(slot, row_of, c + tz + ty, sz * sy * uz * uy, rows, shares, row, 7)
        known &= put(slot, row_of, c + ty + tx, sy * sx * uy * ux, rows, shares, row, 8)
        known &= put(slot, row_of, c + tx + tz, sx * sz * ux * uz, rows, shares, row, 9)
        if not known:
            put_linear(
                slot, row_of, c, ((uz, tz, sz), (uy, ty, sy), (ux, tx, sx)), rows, shares, row
            )


@kernel
def put_linear(slot, row_of, c, axes, rows, shares, row):
    """Write the weights of the linear interpolation among the corners of a cube that are on the front into a row.

    ``axes`` = for z, y, x: distance from the node at ``c``, step in memory to the next, sign of its value.
    """
    (uz, tz, sz), (uy, ty, sy), (ux, tx, sx) = axes
    total = 0.0
    for k in range(10):
        shares[row, k] = 0.0
    for corner in range(8):
        i = corner >> 2
        j = (corner >> 1) & 1
        k = corner & 1
        share = (
            (uz if i == 1 else 1.0 - uz)
            * (uy if j == 1 else 1.0 - uy)
            * (ux if k == 1 else 1.0 - ux)
        )
        sign = (sz if i == 1 else 1.0) * (sy if j == 1 else 1.0) * (sx if k == 1 else 1.0)
        if put(slot, row_of, c + i * tz + j * ty + k * tx, sign * share, rows, shares, row, corner):
            total += share
        else:
            shares[row, corner] = 0.0
    scale = 1.0 / total if total > 0.0 else 0.0
    for k in range(8):
        shares[row, k] *= scale


@kernel
def mirror_sign(step, axis, across, n):
    """-1 where there is no ``step`` as the border across ``axis`` is there and turns the values, else 1."""
    return -1.0 if step == 0 and axis == across and n > 1 else 1.0


@kernel
def nearest_node(p, n, stride):
    """Nearest node to position ``p`` of an axis, as an offset in memory; the distance; the steps towards it and away.

    At the border a step beyond it is none: the mirror image of the node is the node. The border is half a voxel beyond
    the last node; a closest point further out is there.
    """
    p = min(max(p, -0.5), n - 0.5) if n > 1 else 0.0
    node = min(int(p + 0.5), n - 1)
    back, ahead = (-stride if node > 0 else 0), (stride if node < n - 1 else 0)
    if p < node:
        return node * stride, node - p, back, ahead
    return node * stride, p - node, ahead, back


@kernel
def put(slot, row_of, cell, share, rows, shares, row, k):
    """Write the row of ``cell`` and its share into a row of a table; 0 and False where it is not on the front."""
    s = slot[np.uint64(cell)]
    r = row_of[np.uint64(s)] if s >= 0 else -1
    known = r >= 0
    rows[row, k] = r if known else 0
    shares[row, k] = share
    return known


@kernel(stage=Stage.EXTENSION)
def extend_quadratically(start, stop, off, slots, shares, values):
    """Overwrite ``values`` at the cells ``off`` the front by the front's, as `quadratic_table` weighs them."""
    for row in range(np.uint64(start), np.uint64(stop)):
        value = np.float32(0.0)
        for k in range(10):
            value += shares[row, k] * values[slots[row, k]]
        values[off[row]] = value


@kernel(stage=Stage.BAND)
def drop_cells(start, stop, dense, cells, keep, gamma):
    """Remove the slots that ``keep`` (m,) bool does not mark from the dense arrays: psi = +-gamma (mm), slot = -1."""
    for s in range(start, stop):
        if not keep[s]:
            cell = cells[s]
            dense.slot[cell] = -1
            dense.psi[cell] = -gamma if dense.psi[cell] < 0.0 else gamma


@kernel(stage=Stage.BAND)
def flatten_beyond(start, stop, dense, gamma):
    """Set psi to +-gamma (mm) at the voxels of the range, here of the whole volume, that are not in the band."""
    for cell in range(np.uint64(start), np.uint64(stop)):
        if dense.slot[cell] < 0:
            dense.psi[cell] = -gamma if dense.psi[cell] < 0.0 else gamma


@kernel(stage=Stage.BAND)
def store_band(start, stop, dense, band):
    """Write the range of the band's psi and slots to the dense arrays."""
    for s in range(start, stop):
        cell = band.cells[s]
        dense.slot[cell] = s
        dense.psi[cell] = band.psi[s]


@kernel(stage=Stage.BAND)
def front_mask(start, stop, grid, band, width, front):
    """Mark the slots within ``width`` voxels of the surface."""
    for s in range(start, stop):
        front[s] = (
            voxels_along(band.to_closest[s, 0], band.to_closest[s, 1], band.to_closest[s, 2], grid)
            <= width
        )


@kernel(stage=Stage.BAND)
def count_inside(start, stop, psi, grid, inside):
    """Voxels inside, of each of the range's rows along x of the volume: ``inside`` (nz ny,) int32."""
    for row in range(start, stop):
        first = np.uint64(row * grid.nx)
        count = 0
        for ix in range(np.uint64(grid.nx)):
            count += psi[first + ix] < 0.0
        inside[row] = count


@kernel(stage=Stage.BAND)
def count_front(start, stop, psi, grid, inside, counts):
    """Front cells of each of the range's rows: ``counts`` (nz ny,) int64. ``inside`` is that of `count_inside`."""
    marks = np.empty(grid.nx, np.uint8)
    for row in range(start, stop):
        counts[row] = 0
        if not is_even(inside, row, grid):
            mark_front(psi, grid, row, marks)
            for ix in range(grid.nx):
                counts[row] += marks[ix]


@kernel(stage=Stage.BAND)
def front_cells(start, stop, psi, grid, inside, ends, cells):
    """Raveled front cells of the range's rows into ``cells``, those of row r before ``ends[r]``, in raster order.

    A front cell has a 6-neighbour on the other side of the surface. ``ends`` (nz ny,) is the running sum of
    `count_front`.
    """
    marks = np.empty(grid.nx, np.uint8)
    for row in range(start, stop):
        if is_even(inside, row, grid):
            continue
        mark_front(psi, grid, row, marks)
        at = ends[row - 1] if row > 0 else 0
        for ix in range(grid.nx):
            if marks[ix]:
                cells[at] = row * grid.nx + ix
                at += 1


@kernel
def mark_front(psi, grid, row, marks):
    """Set ``marks`` (nx,) uint8 to 1 at the front cells of a row, to 0 at the others; in vectors."""
    iz, iy = row // grid.ny, row % grid.ny
    # Unsigned: an index that may be negative keeps the loops from running in vectors.
    nx = np.uint64(grid.nx)
    start = np.uint64(row * grid.nx)
    unit = np.uint64(1)
    plane = np.uint64(grid.ny) * nx
    # Beyond the border a row is its own neighbour.
    above = start - nx if iy > 0 else start
    below = start + nx if iy < grid.ny - 1 else start
    before = start - plane if iz > 0 else start
    behind = start + plane if iz < grid.nz - 1 else start
    for ix in range(nx):
        inside = psi[start + ix] < 0.0
        along_y = ((psi[above + ix] < 0.0) != inside) | ((psi[below + ix] < 0.0) != inside)
        along_z = ((psi[before + ix] < 0.0) != inside) | ((psi[behind + ix] < 0.0) != inside)
        marks[ix] = along_y | along_z
    for ix in range(unit, nx):
        marks[ix] |= (psi[start + ix - unit] < 0.0) != (psi[start + ix] < 0.0)
    for ix in range(nx - unit):
        marks[ix] |= (psi[start + ix + unit] < 0.0) != (psi[start + ix] < 0.0)


@kernel
def is_even(inside, row, grid):
    """Test if a row and those beside it are all on one side."""
    count = inside[row]
    even = count == 0 or count == grid.nx
    iz, iy = row // grid.ny, row % grid.ny
    if iz > 0:
        even = even and inside[row - grid.ny] == count
    if iz < grid.nz - 1:
        even = even and inside[row + grid.ny] == count
    if iy > 0:
        even = even and inside[row - 1] == count
    if iy < grid.ny - 1:
        even = even and inside[row + 1] == count
    return even
