"""Values at given points: of dense arrays, of fields of the band, and at the surface with normals and slopes."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.differences import gradient
from accelsurf.kernels.grid import unravel
from accelsurf.kernels.interpolate import value_and_gradient, value_at
from accelsurf.kernels.transport import band_vector_at


@kernel(stage=Stage.EXTENSION)
def fields_at_points(start, stop, slot, grid, values, points, out, known):
    """Band fields ``values`` (n, k) at ``points`` (m, 3), index coordinates, into ``out`` (m, k), see `band_vector_at`.

    ``known`` (m,): False, and 0, where no cell of the band is around the point.
    """
    w = np.empty(24)
    found = np.empty(values.shape[1])
    for p in range(start, stop):
        known[p] = band_vector_at(values, slot, grid, points[p], w, found)
        for c in range(values.shape[1]):
            out[p, c] = found[c] if known[p] else 0.0


@kernel(stage=Stage.ENERGY)
def value_and_gradient_at_points(start, stop, array, grid, points, out):
    """A raveled dense array at ``points`` (m, 3), index coordinates: value and slopes z, y, x per mm, (m, 4)."""
    w = np.empty(24)
    for p in range(start, stop):
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = value_and_gradient(
            array, grid, points[p, 0], points[p, 1], points[p, 2], w
        )


@kernel(stage=Stage.ADVANCE)
def resample_shifted(start, stop, array, grid, first, target, out):
    """A raveled dense array at the places of the voxels of the ``target`` grid, raveled, into ``out``.

    ``first`` (3,), index coordinates of ``grid``: where the first voxel of the target lies; spacings are the same.
    """
    w = np.empty(24)
    for cell in range(start, stop):
        iz, iy, ix = unravel(cell, target)
        out[cell] = value_at(array, grid, first[0] + iz, first[1] + iy, first[2] + ix, w)


@kernel(stage=Stage.ENERGY)
def outward_normals(start, stop, psi, grid, band, front, out):
    """Unit normal grad psi/|grad psi| (z, y, x) of every front cell by centred differences; 0 elsewhere.

    psi is a distance, so the normal at the cell is that at its closest point. 0 too where psi has no slope.
    """
    for s in range(start, stop):
        nz = 0.0
        ny = 0.0
        nx = 0.0
        if front[s]:
            cell = band.cells[s]
            iz, iy, ix = unravel(cell, grid)
            nz, ny, nx = gradient(psi, cell, iz, iy, ix, grid)
        norm = np.sqrt(nz * nz + ny * ny + nx * nx)
        scale = 1.0 / norm if norm > 1e-12 else 0.0
        out[s, 0] = nz * scale
        out[s, 1] = ny * scale
        out[s, 2] = nx * scale


@kernel(stage=Stage.ENERGY)
def value_and_slope(start, stop, image, grid, band, normals, front, out):
    """Value (out[:, 0]) and slope grad I . n per mm (out[:, 1]) of an image at the closest point of every front cell.

    Both from the cubic interpolant of the raveled dense ``image``, at the nearest place within the volume; 0 elsewhere.
    ``normals`` (n, 3) float32 from `outward_normals`.
    """
    w = np.empty(24)
    for s in range(start, stop):
        out[s, 0] = 0.0
        out[s, 1] = 0.0
        if front[s]:
            iz, iy, ix = unravel(band.cells[s], grid)
            pz = min(max(iz + band.to_closest[s, 0] / grid.hz, 0.0), grid.nz - 1.0)
            py = min(max(iy + band.to_closest[s, 1] / grid.hy, 0.0), grid.ny - 1.0)
            px = min(max(ix + band.to_closest[s, 2] / grid.hx, 0.0), grid.nx - 1.0)
            value, gz, gy, gx = value_and_gradient(image, grid, pz, py, px, w)
            out[s, 0] = value
            out[s, 1] = gz * normals[s, 0] + gy * normals[s, 1] + gx * normals[s, 2]
