"""Region sums and surface integrals: volume fractions by the plane that the mean of psi and its gradient define."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.differences import (
    CURVATURES,
    ROW,
    block_curvatures,
    block_memory,
    curvature_at_closest_point,
    curvatures,
    gather_block,
    gradient,
    is_at_border,
    mean_above_centre,
    mirrored_curvatures,
)
from accelsurf.kernels.grid import BATCH, BLOCK, unravel, voxels_along
from accelsurf.kernels.waves import bump, sine_of_pi

#: Half width of the layer that the area is measured in, voxels along the normal: with 3/2 the samples of a plane
#: along an axis add up to 1 exactly.
AREA_WIDTH = 1.5
#: Below this distance, voxels, the vector to the closest point does not tell the direction of the normal.
MIN_DIRECTION = 0.01


@kernel
def cube(x):
    """max(x, 0)^3."""
    return x * x * x if x > 0.0 else 0.0


@kernel
def fraction_below_plane(psi, gz, gy, gx, grid):
    """Part of a voxel inside the plane psi + n.x = 0, n = grad/|grad|.

    Volume of the unit cube below the plane m.u = s (m_a = |n_a| h_a) by inclusion and exclusion of the
    corners. Exact for a plane of any direction and spacing.
    """
    norm = np.sqrt(gz * gz + gy * gy + gx * gx)
    if norm < 1e-6:
        return 1.0 if psi < 0.0 else 0.0
    a = abs(gz) / norm * grid.hz
    b = abs(gy) / norm * grid.hy
    c = abs(gx) / norm * grid.hx
    # A direction along a face has m = 0, where the formula is 0/0: this much tilt has no visible effect, and
    # shares a face that lies exactly between two voxels among them.
    least = 1e-4 * (a + b + c)
    a = max(a, least)
    b = max(b, least)
    c = max(c, least)
    total = a + b + c
    s = 0.5 * total - psi
    if s <= 0.0:
        return 0.0
    if s >= total:
        return 1.0
    volume = cube(s) - cube(s - a) - cube(s - b) - cube(s - c)
    volume += cube(s - a - b) + cube(s - a - c) + cube(s - b - c)
    return min(max(volume / (6.0 * a * b * c), 0.0), 1.0)


@kernel
def smeared_area(d, voxels, gz, gy, gx, gauss, grid, width):
    """Area (mm2) that a voxel at distance ``d`` mm, ``voxels`` in voxels along the normal, has of the surface.

    The delta function (1 + cos(pi s/epsilon))/(2 epsilon) of the distance, epsilon = ``width`` voxels: smooth as the
    surface moves through the grid, where the areas of planes that cut voxels jump by a percent. The levels within
    epsilon have on average 1 + d^2 K times the area of the surface, which is taken out.
    """
    if voxels >= width:
        return 0.0
    if voxels > MIN_DIRECTION:
        mm = abs(d) / voxels
    else:
        along = voxels_along(gz, gy, gx, grid)
        # On a sheet through the voxel's centre the centred differences are 0: no direction is known.
        mm = (
            np.sqrt(gz * gz + gy * gy + gx * gx) / along
            if along > 1e-6
            else min(grid.hz, min(grid.hy, grid.hx))
        )
    delta = bump(voxels / width) / (2.0 * width * mm)
    return delta * (1.0 - min(max(d * d * gauss, -0.25), 0.25)) * grid.hz * grid.hy * grid.hx


@kernel(stage=Stage.ENERGY)
def measure_band(start, stop, psi, grid, band, within, out):
    """Volume fraction, surface area and curvature at every slot of the range.

    Parameters
    ----------
    psi : ndarray (nz * ny * nx,), float32
        mm.
    within : float
        Distance from the surface, voxels, up to which curvature is measured.
    out : (ndarray (n,), ndarray (n,), ndarray (n,), ndarray (n,))
        Written, fraction, area, curvature and variation: share of the voxel inside; surface in it, mm2; H of the
        surface at its closest point, 1/mm, limited to what the grid resolves, 2/min(h), and 0 further than ``within``
        off; the same with psi mirrored at the border, the first variation of the area in the volume.
    """
    fraction, area, curvature, variation = out
    diagonal = 0.51 * np.sqrt(grid.hz**2 + grid.hy**2 + grid.hx**2)
    most = 2.0 / min(grid.hz, min(grid.hy, grid.hx))
    memory = block_memory()
    slope, shape = (
        memory[19 * BATCH : 22 * BATCH].reshape(3, BATCH),
        memory[22 * BATCH :].reshape(3, BATCH),
    )
    which, distance = np.empty(BATCH, np.int64), np.zeros(BATCH, np.float32)
    # Rows: distance in voxels, width of the layer; area, curvature.
    measured = np.full(4 * BATCH, AREA_WIDTH)
    at = start
    while at < stop:
        count = 0
        while at < stop and count < BATCH:
            s = at
            at += 1
            d = band.psi[s]
            voxels = voxels_along(
                band.to_closest[s, 0], band.to_closest[s, 1], band.to_closest[s, 2], grid
            )
            if abs(d) > diagonal and voxels > max(within, AREA_WIDTH):
                fraction[s] = 1.0 if d < 0.0 else 0.0
                area[s] = 0.0
                curvature[s] = 0.0
                variation[s] = 0.0
                continue
            iz, iy, ix = unravel(band.cells[s], grid)
            if gather_block(band.cells[s], iz, iy, ix, psi, grid, memory, count):
                which[count] = s
                distance[count] = d
                measured[count] = voxels
                count += 1
            else:
                gz, gy, gx = gradient(psi, band.cells[s], iz, iy, ix, grid)
                mean, gauss = curvatures(psi, band.cells[s], iz, iy, ix, grid)
                level = (
                    gz,
                    gy,
                    gx,
                    mean,
                    gauss,
                    mean_above_centre(psi, band.cells[s], iz, iy, ix, grid),
                )
                fraction[s], area[s], curvature[s] = measures(
                    grid, d, voxels, level, within, diagonal, most
                )
                variation[s] = curvature[s]
                if is_at_border(iz, iy, ix, grid) and voxels <= within:
                    mirrored, _ = mirrored_curvatures(psi, band.cells[s], iz, iy, ix, grid)
                    variation[s] = min(max(curvature[s] + mirrored - mean, -most), most)
        block_curvatures(grid, memory)
        measures_alike(grid, distance, memory, (within, most), measured)
        for i in range(count):
            s, d = which[i], distance[i]
            gz = slope[0, i]
            gy = slope[1, i]
            gx = slope[2, i]
            fraction[s] = share_inside(grid, d, shape[2, i], gz, gy, gx, diagonal)
            area[s], curvature[s] = measured[2 * BATCH + i], measured[3 * BATCH + i]
            if measured[i] <= MIN_DIRECTION:
                area[s] = smeared_area(d, measured[i], gz, gy, gx, shape[1, i], grid, AREA_WIDTH)
            variation[s] = curvature[s]


@kernel(inlined=True)
def measures(grid, d, voxels, level, within, diagonal, most):
    """Share, area and curvature, see `measure_band`, of a cell.

    Its ``level`` is the gradient (z, y, x), H, K and what the mean of psi over the voxel is above psi at its centre.
    With the mean the plane has the share of a curved surface: with the centre's value a ball's volume would be
    0.25 (h/R)^2 too large.
    """
    gz, gy, gx, mean, gauss, above = level
    fraction = share_inside(grid, d, above, gz, gy, gx, diagonal)
    curvature = curvature_at_closest_point(mean, gauss, d, most) if voxels <= within else 0.0
    return fraction, smeared_area(d, voxels, gz, gy, gx, gauss, grid, AREA_WIDTH), curvature


@kernel(inlined=True)
def share_inside(grid, d, above, gz, gy, gx, diagonal):
    """Share of a voxel inside, see `measures`."""
    if abs(d) <= diagonal:
        return fraction_below_plane(d + above, gz, gy, gx, grid)
    return 1.0 if d < 0.0 else 0.0


@kernel
def measures_alike(grid, distance, memory, limits, measured):
    """Area and curvature as `measures` has them, of `BATCH` cells alike, so that it runs in vectors.

    Not the area of those at `MIN_DIRECTION`. ``distance`` (`BATCH`,) as d there; ``memory`` of `block_curvatures`;
    ``limits`` = (within, most). ``measured`` (4 x `BATCH`,) float64 holds the rows voxels, width of the layer; area and
    curvature, which are written.
    """
    within, most = limits
    for i in range(np.uint64(BATCH)):
        # The width by a row: divided by what does not change it would be rounded otherwise than in `smeared_area`.
        d = distance[i]
        voxels = measured[i]
        width = measured[ROW[1] + i]
        mean, gauss = memory[CURVATURES + i], memory[CURVATURES + ROW[1] + i]
        # Nothing is divided by 0, also where the result is not used.
        mm = max(abs(d) / max(voxels, MIN_DIRECTION), 1e-30)
        delta = bump(voxels / width) / (2.0 * width * mm)
        area = delta * (1.0 - min(max(d * d * gauss, -0.25), 0.25)) * grid.hz * grid.hy * grid.hx
        measured[ROW[2] + i] = area if voxels < width else 0.0
        denominator = 1.0 - d * mean + d * d * gauss
        bend = (mean - 2.0 * d * gauss) / denominator
        bend = min(max(bend if denominator > 0.2 else mean, -most), most)
        measured[ROW[3] + i] = bend if voxels <= within else 0.0


@kernel
def room_to_border(p, n, step):
    """Distance of index ``p`` from the outermost voxels' centres of an axis of ``n``, in steps of ``step`` voxels."""
    if n == 1 or abs(step) < 1e-6:
        return np.inf
    return max(min(p, n - 1.0 - p), 0.0) / abs(step)


@kernel(stage=Stage.FLOW)
def wide_areas(start, stop, psi, grid, band, width, out):
    """Area (mm2) of the surface at every slot, smeared over ``width`` voxels to either side, into ``out`` (n,).

    Parts of the surface, a few voxels long, are measured the better the wider the layer. Where it would reach
    the outermost voxels it is narrower, down to `AREA_WIDTH`: the same for all cells of a closest point.
    """
    for s in range(start, stop):
        closest_point = band.to_closest[s]
        voxels = voxels_along(closest_point[0], closest_point[1], closest_point[2], grid)
        out[s] = 0.0
        if voxels < width:
            iz, iy, ix = unravel(band.cells[s], grid)
            gz, gy, gx = gradient(psi, band.cells[s], iz, iy, ix, grid)
            _, gauss = curvatures(psi, band.cells[s], iz, iy, ix, grid)
            along = max(voxels_along(gz, gy, gx, grid), 1e-6)
            fz = closest_point[0] / grid.hz
            fy = closest_point[1] / grid.hy
            fx = closest_point[2] / grid.hx
            room = room_to_border(
                iz + fz, grid.nz, fz / voxels if voxels > 0.01 else gz / (grid.hz * along)
            )
            room = min(
                room,
                room_to_border(
                    iy + fy, grid.ny, fy / voxels if voxels > 0.01 else gy / (grid.hy * along)
                ),
            )
            room = min(
                room,
                room_to_border(
                    ix + fx, grid.nx, fx / voxels if voxels > 0.01 else gx / (grid.hx * along)
                ),
            )
            here = min(width, max(room, AREA_WIDTH))
            out[s] = smeared_area(band.psi[s], voxels, gz, gy, gx, gauss, grid, here)


@kernel(stage=Stage.ENERGY)
def smear_band(start, stop, grid, band, epsilon, fraction):
    """Share of each voxel inside by the smeared Heaviside function of the distance in voxels, s.

    (1 - s/epsilon - sin(pi s/epsilon)/pi)/2 within epsilon of the surface; its derivative is the delta
    function that `motion.mean_across` averages the image with.
    """
    for s in range(start, stop):
        x = (
            voxels_along(band.to_closest[s, 0], band.to_closest[s, 1], band.to_closest[s, 2], grid)
            / epsilon
        )
        if band.psi[s] < 0.0:
            x = -x
        if x <= -1.0:
            fraction[s] = 1.0
        elif x >= 1.0:
            fraction[s] = 0.0
        else:
            folded = x if abs(x) <= 0.5 else (1.0 - x if x > 0.0 else -1.0 - x)
            fraction[s] = 0.5 * (1.0 - x - sine_of_pi(folded) / np.pi)


@kernel(stage=Stage.ENERGY)
def weighted_sums(first_block, last_block, cells, weight, image, sums):
    """Per block of slots: sums[block] (3,) = sum over its slots of weight x (1, I, I^2); ``weight`` (n,) float64."""
    for block in range(first_block, last_block):
        count = 0.0
        total = 0.0
        squares = 0.0
        for s in range(block * BLOCK, min((block + 1) * BLOCK, cells.shape[0])):
            if weight[s] == 0.0:
                continue
            value = np.float64(image[cells[s]])
            count += weight[s]
            total += weight[s] * value
            squares += weight[s] * value * value
        sums[block, 0] = count
        sums[block, 1] = total
        sums[block, 2] = squares


@kernel(stage=Stage.ENERGY)
def inside_sums(first_plane, last_plane, dense, image, grid, sums):
    """Per plane of the volume: sums over the inside voxels not in the band of (1, I, I^2), one after the other."""
    size = grid.ny * grid.nx
    for plane in range(first_plane, last_plane):
        count = 0.0
        total = 0.0
        squares = 0.0
        for cell in range(plane * size, (plane + 1) * size):
            if dense.slot[cell] < 0 and dense.psi[cell] < 0.0:
                value = np.float64(image[cell])  # float() would stay float32
                count += 1.0
                total += value
                squares += value * value
        sums[plane, 0] = count
        sums[plane, 1] = total
        sums[plane, 2] = squares
