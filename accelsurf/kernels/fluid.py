"""Mass and momentum on the whole grid: conservative transport (MUSCL, HLL), and exchange with the surface.

A fluid is an array (4, nz, ny, nx) float32: mass per volume rho, and momentum rho V along z, y, x. Its pressure is
G rho^2/2, sound c^2 = G rho, G the ``stiffness``; G = 0 is a fluid without pressure.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import unravel, voxels_along
from accelsurf.kernels.waves import bump

#: Points of a mean across the surface. The cosine's integral is exact from three on.
SAMPLES = 6


@kernel
def limited_slope(before, here, after):
    """Monotonised central slope of three values: a face between two cells has a value between theirs."""
    low, high = here - before, after - here
    if low * high <= 0.0:
        return 0.0
    middle = 0.5 * (low + high)
    size = min(abs(middle), 2.0 * min(abs(low), abs(high)))
    return size if middle > 0.0 else -size


@kernel
def hll_flux(left, right, stiffness, out):
    """Flux of (rho, rho V_n, rho V_t, rho V_s) through a face between the states (rho, V_n, V_t, V_s) on its sides.

    Harten, Lax and van Leer with the slowest and the fastest wave of both sides; into a void a wave runs at V + 2 c.
    Without pressure these are the two velocities themselves: apart they leave a void, together they merge.
    """
    rl = left[0]
    vl = left[1]
    rr = right[0]
    vr = right[1]
    cl, cr = np.sqrt(stiffness * rl), np.sqrt(stiffness * rr)
    if rr <= 0.0:
        slow, fast = vl - cl, vl + 2.0 * cl
    elif rl <= 0.0:
        slow, fast = vr - 2.0 * cr, vr + cr
    else:
        slow, fast = min(vl - cl, vr - cr), max(vl + cl, vr + cr)
    pl, pr = 0.5 * stiffness * rl * rl, 0.5 * stiffness * rr * rr
    for i in range(4):
        ul = rl if i == 0 else rl * left[i]
        ur = rr if i == 0 else rr * right[i]
        fl = ul * vl + (pl if i == 1 else 0.0)
        fr = ur * vr + (pr if i == 1 else 0.0)
        if slow >= 0.0:
            out[i] = fl
        elif fast <= 0.0:
            out[i] = fr
        else:
            out[i] = (fast * fl - slow * fr + slow * fast * (ur - ul)) / (fast - slow)


@kernel
def load_line(flat, where, axis, limits, line):
    """Copy a line of the raveled fluid (4, cells) as (rho, V_n, V_t, V_s) into ``line`` (4, count + 4).

    ``where``: first cell, stride, count; ``limits``: stiffness, dry. Two cells beyond either end repeat the last one:
    mass that reaches the border flows out. Where rho is at most ``dry`` there is no velocity. Returns the first and one
    past the last cell where something may flow, as indices of the line.
    """
    base, stride, count = where
    stiffness, dry = limits
    first, last = count, 0
    for i in range(count):
        cell = base + i * stride
        rho = np.float64(flat[0, cell])
        line[0, i + 2] = rho
        moves = stiffness > 0.0 and rho > 0.0
        for part in range(3):
            speed = flat[1 + (axis + part) % 3, cell] / rho if rho > dry else 0.0
            line[1 + part, i + 2] = speed
            moves = moves or speed != 0.0
        if moves:
            first, last = min(first, i), i + 1
    for q in range(4):
        line[q, 0] = line[q, 1] = line[q, 2]
        line[q, count + 2] = line[q, count + 3] = line[q, count + 1]
    return first, last


@kernel
def evolved_faces(line, i, ratio, stiffness, low, high):
    """States at the lower and the upper face of cell ``i`` of the line, half a step later (Hancock).

    Where one of them would have no mass, both are the cell's mean.
    """
    for q in range(4):
        half = 0.5 * limited_slope(line[q, i - 1], line[q, i], line[q, i + 1])
        low[q], high[q] = line[q, i] - half, line[q, i] + half
    # Primitive form: rho_t = -(rho V)_x, V_t = -V V_x - G rho_x.
    v, rho = line[1, i], line[0, i]
    drho, dv = high[0] - low[0], high[1] - low[1]
    change = 0.5 * ratio
    gain = -change * (v * drho + rho * dv)
    if low[0] + gain <= 0.0 or high[0] + gain <= 0.0:
        for q in range(4):
            low[q] = high[q] = line[q, i]
        return
    impulse = -change * (v * dv + stiffness * drho)
    turn, bend = -change * v * (high[2] - low[2]), -change * v * (high[3] - low[3])
    low[0], high[0] = low[0] + gain, high[0] + gain
    low[1], high[1] = low[1] + impulse, high[1] + impulse
    low[2], high[2] = low[2] + turn, high[2] + turn
    low[3], high[3] = low[3] + bend, high[3] + bend


@kernel
def line_fluxes(line, span, ratio, stiffness, memory, flux):
    """Fluxes (4, count + 1) through the faces of the cells ``span`` = (first, last) of a line; the others are not set.

    Those out of a cell that together exceed its mass become smaller by the same factor.
    """
    first, last = span
    faces, following, passing = memory
    evolved_faces(line, first + 1, ratio, stiffness, faces[0], faces[1])
    for i in range(first, last + 1):
        evolved_faces(line, i + 2, ratio, stiffness, following[0], following[1])
        hll_flux(faces[1], following[0], stiffness, passing)
        for q in range(4):
            flux[q, i] = passing[q]
            faces[0, q], faces[1, q] = following[0, q], following[1, q]
    # A flux leaves one cell only: no factor is applied twice.
    for i in range(first - 1, last + 1):
        up = max(flux[0, i + 1], 0.0) if i < last else 0.0
        down = max(-flux[0, i], 0.0) if i >= first else 0.0
        leaves, has = ratio * (up + down), line[0, i + 2]
        if leaves > has:
            for q in range(4):
                if up > 0.0:
                    flux[q, i + 1] *= has / leaves
                if down > 0.0:
                    flux[q, i] *= has / leaves


@kernel(stage=Stage.FLOW)
def sweep_planes(start, stop, fluid, axis, ratio, limits, rows):
    """Transport along ``axis``, in place, over the lines in the planes of the range.

    Parameters
    ----------
    start, stop : int
        Planes across z; for ``axis`` 0 across y.
    fluid : ndarray (4, nz, ny, nx), float32
    axis : int
        0, 1, 2 for z, y, x.
    ratio : float
        dt/h; (|V_n| + c) dt/h is at most 0.4.
    limits : (float, float)
        Stiffness G, and the mass per volume up to which there is no velocity.
    rows : ndarray (planes, 1)
        Mass per volume that has left the grid, added.
    """
    shape = fluid.shape
    count, plane = shape[1 + axis], shape[2] * shape[3]
    stride = (plane, shape[3], 1)[axis]
    flat = fluid.reshape(4, -1)
    line, flux = np.empty((4, count + 4)), np.empty((4, count + 1))
    memory = np.empty((2, 4)), np.empty((2, 4)), np.empty(4)
    for number in range(start, stop):
        for other in range(shape[2] if axis == 2 else shape[3]):
            base = number * plane + (other * shape[3] if axis == 2 else other)
            if axis == 0:
                base = number * shape[3] + other
            first, last = load_line(flat, (base, stride, count), axis, limits, line)
            if first >= last:
                continue
            first, last = max(first - 1, 0), min(last + 1, count)
            line_fluxes(line, (first, last), ratio, limits[0], memory, flux)
            if last == count:
                rows[number, 0] += ratio * flux[0, count]
            if first == 0:
                rows[number, 0] -= ratio * flux[0, 0]
            for i in range(first, last):
                cell = base + i * stride
                for q in range(4):
                    to = 0 if q == 0 else 1 + (axis + q - 1) % 3
                    flat[to, cell] = np.float32(
                        flat[to, cell] + ratio * (flux[q, i] - flux[q, i + 1])
                    )
                # Rounding alone.
                flat[0, cell] = max(flat[0, cell], np.float32(0.0))


@kernel(stage=Stage.FLOW)
def fluid_sums(first, last, first_fluid, second_fluid, dry, rows):
    """For every plane: sums of rho, of rho V.V/2, rho V.V'/2 and rho V'.V'/2, and of rho^2/2.

    ``first_fluid`` and ``second_fluid`` have the same rho.
    """
    cells = first_fluid.shape[2] * first_fluid.shape[3]
    a, b = first_fluid.reshape(4, -1), second_fluid.reshape(4, -1)
    for plane in range(first, last):
        for cell in range(plane * cells, (plane + 1) * cells):
            rho = np.float64(a[0, cell])
            rows[plane, 0] += rho
            rows[plane, 4] += 0.5 * rho * rho
            if rho <= dry:
                continue
            for axis in range(1, 4):
                m, n = np.float64(a[axis, cell]), np.float64(b[axis, cell])
                rows[plane, 1] += 0.5 * m * m / rho
                rows[plane, 2] += 0.5 * m * n / rho
                rows[plane, 3] += 0.5 * n * n / rho


@kernel(stage=Stage.FLOW)
def fastest_waves(first, last, fluid, limits, out):
    """Largest |V| + c along z, y, x in every plane, into ``out`` (nz, 3); ``limits`` = (stiffness, dry)."""
    stiffness, dry = limits
    cells = fluid.shape[2] * fluid.shape[3]
    flat = fluid.reshape(4, -1)
    for plane in range(first, last):
        for cell in range(plane * cells, (plane + 1) * cells):
            rho = np.float64(flat[0, cell])
            if rho > dry:
                sound = np.sqrt(stiffness * rho)
                for axis in range(3):
                    out[plane, axis] = max(
                        out[plane, axis], abs(flat[1 + axis, cell]) / rho + sound
                    )


@kernel
def corners_around(grid, pz, py, px, cells, shares):
    """Cells (8,) around a point, in voxels, and their ``shares`` (8,) in linear interpolation."""
    pz = min(max(pz, 0.0), grid.nz - 1.0)
    py = min(max(py, 0.0), grid.ny - 1.0)
    px = min(max(px, 0.0), grid.nx - 1.0)
    z = min(int(pz), max(grid.nz - 2, 0))
    y = min(int(py), max(grid.ny - 2, 0))
    x = min(int(px), max(grid.nx - 2, 0))
    for corner in range(8):
        i = corner >> 2
        j = (corner >> 1) & 1
        k = corner & 1
        share = (pz - z if i == 1 else 1.0 - (pz - z)) * (py - y if j == 1 else 1.0 - (py - y))
        share *= px - x if k == 1 else 1.0 - (px - x)
        shares[corner] = share
        # An axis of one cell has no second one; its share is 0.
        cells[corner] = ((z + i) * grid.ny + y + j) * grid.nx + x + k if share != 0.0 else 0


@kernel
def point_across(s, sample, grid, band, layer):
    """Weight and place (z, y, x), in voxels, of a ``sample`` of the mean across the surface at cell ``s``."""
    _, normal, width, shift = layer
    iz, iy, ix = unravel(band.cells[s], grid)
    closest_point, n = band.to_closest[s], normal[s]
    along = (2.0 * sample + 1.0) / SAMPLES - 1.0
    away = along * width / max(voxels_along(n[0], n[1], n[2], grid), 1e-30)
    pz = iz + (closest_point[0] + shift[s, 0] + away * n[0]) / grid.hz
    py = iy + (closest_point[1] + shift[s, 1] + away * n[1]) / grid.hy
    px = ix + (closest_point[2] + shift[s, 2] + away * n[2]) / grid.hx
    return bump(abs(along)) / SAMPLES, pz, py, px


@kernel(stage=Stage.FLOW)
def means_across(start, stop, fluid, grid, band, layer, out):
    """Mean of rho, and of V by mass, across the surface at every cell's closest point, into ``out`` (n, 4).

    The mean is that of a delta function (1 + cos(pi s/epsilon))/(2 epsilon), epsilon = ``width`` voxels, along the
    normal.

    Parameters
    ----------
    layer : (ndarray (n,), ndarray (n, 3), float, ndarray (n, 3))
        Cells that are measured, the others get 0; normal; width, voxels; shift of the points, mm.
    """
    flat = fluid.reshape(4, -1)
    total = np.empty(4)
    cells = np.empty(8, np.int64)
    shares = np.empty(8)
    for s in range(start, stop):
        out[s, :] = 0.0
        if not layer[0][s]:
            continue
        total[:] = 0.0
        for sample in range(SAMPLES):
            weight, pz, py, px = point_across(s, sample, grid, band, layer)
            corners_around(grid, pz, py, px, cells, shares)
            for corner in range(8):
                for q in range(4):
                    total[q] += weight * shares[corner] * flat[q, cells[corner]]
        out[s, 0] = total[0]
        if total[0] > 0.0:
            for part in range(1, 4):
                out[s, part] = total[part] / total[0]


@kernel(stage=Stage.FLOW)
def extend_across(start, stop, slot, grid, band, layer, values, out):
    """Add ``values`` (n, 3) of the cells to the band cells across the surface, into ``out`` (n, 3): by one thread.

    The adjoint of `means_across`: where values are area x force/(rho x voxel), the accelerations that come out work on
    the fluid what the force works on a surface that moves with its means.
    """
    cells, shares = np.empty(8, np.int64), np.empty(8)
    for s in range(start, stop):
        if not layer[0][s]:
            continue
        for sample in range(SAMPLES):
            weight, pz, py, px = point_across(s, sample, grid, band, layer)
            corners_around(grid, pz, py, px, cells, shares)
            for corner in range(8):
                to = slot[cells[corner]]
                if to >= 0:
                    for c in range(3):
                        out[to, c] += weight * shares[corner] * values[s, c]


@kernel(stage=Stage.FLOW)
def probe_inside(start, stop, fluid, grid, band, normal, depths, out):
    """Rho, and V by mass, at ``depths`` (2,), voxels, below every cell's closest point, into ``out`` (n, 2, 4)."""
    flat = fluid.reshape(4, -1)
    cells, shares = np.empty(8, np.int64), np.empty(8)
    for s in range(start, stop):
        iz, iy, ix = unravel(band.cells[s], grid)
        closest_point, n = band.to_closest[s], normal[s]
        mm = 1.0 / max(voxels_along(n[0], n[1], n[2], grid), 1e-30)
        for d in range(2):
            away = depths[d] * mm
            pz, py = (
                iz + (closest_point[0] + away * n[0]) / grid.hz,
                iy + (closest_point[1] + away * n[1]) / grid.hy,
            )
            corners_around(
                grid, pz, py, ix + (closest_point[2] + away * n[2]) / grid.hx, cells, shares
            )
            for q in range(4):
                value = 0.0
                for corner in range(8):
                    value += shares[corner] * flat[q, cells[corner]]
                out[s, d, q] = value
            for q in range(1, 4):
                out[s, d, q] = out[s, d, q] / out[s, d, 0] if out[s, d, 0] > 0.0 else 0.0


@kernel(stage=Stage.FLOW)
def accelerate_layer(start, stop, fluid, grid, cells, impulse, limit):
    """Accelerate the fluid in place: V += ``impulse`` (n, 3), mm per unit time, in the band's ``cells`` (n,).

    Where |V| is then above ``limit``, voxels per unit time, it becomes that; cells without a push stay as they are.
    """
    flat = fluid.reshape(4, -1)
    for s in range(start, stop):
        z, y, x = impulse[s]
        if z == 0.0 and y == 0.0 and x == 0.0:
            continue
        cell = cells[s]
        rho = np.float64(flat[0, cell])
        z = flat[1, cell] + rho * z
        y = flat[2, cell] + rho * y
        x = flat[3, cell] + rho * x
        rate = voxels_along(z, y, x, grid)
        factor = limit * rho / rate if rate > limit * rho else 1.0
        flat[1, cell] = factor * z
        flat[2, cell] = factor * y
        flat[3, cell] = factor * x
