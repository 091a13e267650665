"""Cubic interpolation on four nodes per axis (Lagrange), one-sided at the border, lower order on thin volumes.

Compact on purpose: prefiltered B-splines ring when the band is clipped.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def axis_weights(p, n, w, o):
    """Weights of the nodes ``base .. base + count - 1`` for position ``p`` (voxels) on an axis of ``n`` nodes.

    ``w[o:o+4]`` get the weights of the value, ``w[o+4:o+8]`` those of the derivative per voxel. ``p`` beyond the
    axis is held at its end; the returned ``beyond`` is what was cut off, for a linear continuation.
    Returns (base, count, beyond).
    """
    held = min(max(p, 0.0), n - 1.0)
    beyond = p - held
    if n >= 4:
        base = min(max(int(np.floor(held)) - 1, 0), n - 4)
        u = held - base
        a, b, c = u - 1.0, u - 2.0, u - 3.0
        w[o] = -a * b * c / 6.0
        w[o + 1] = u * b * c / 2.0
        w[o + 2] = -u * a * c / 2.0
        w[o + 3] = u * a * b / 6.0
        w[o + 4] = -((3.0 * u - 12.0) * u + 11.0) / 6.0
        w[o + 5] = ((3.0 * u - 10.0) * u + 6.0) / 2.0
        w[o + 6] = -((3.0 * u - 8.0) * u + 3.0) / 2.0
        w[o + 7] = ((3.0 * u - 6.0) * u + 2.0) / 6.0
        return base, 4, beyond
    if n == 3:
        u = held
        w[o] = (u - 1.0) * (u - 2.0) / 2.0
        w[o + 1] = -u * (u - 2.0)
        w[o + 2] = u * (u - 1.0) / 2.0
        w[o + 4] = u - 1.5
        w[o + 5] = 2.0 - 2.0 * u
        w[o + 6] = u - 0.5
        return 0, 3, beyond
    if n == 2:
        w[o] = 1.0 - held
        w[o + 1] = held
        w[o + 4] = -1.0
        w[o + 5] = 1.0
        return 0, 2, beyond
    w[o] = 1.0
    w[o + 4] = 0.0
    return 0, 1, beyond


@kernel
def value_and_gradient(array, grid, pz, py, px, w):
    """Interpolate the raveled dense ``array`` at an index position; ``w`` is (24,) scratch.

    Returns (value, d/dz, d/dy, d/dx) with the gradient per mm.
    """
    bz, mz, ez = axis_weights(pz, grid.nz, w, 0)
    by, my, ey = axis_weights(py, grid.ny, w, 8)
    bx, mx, ex = axis_weights(px, grid.nx, w, 16)
    # Weights along x in registers: the compiler cannot know that writing nothing leaves w as it was.
    a0, a1, a2, a3 = w[16], w[17], w[18], w[19]
    b0, b1, b2, b3 = w[20], w[21], w[22], w[23]
    value = 0.0
    gz = 0.0
    gy = 0.0
    gx = 0.0
    for i in range(mz):
        plane_value = 0.0
        plane_gy = 0.0
        plane_gx = 0.0
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            if mx == 4:
                v0, v1, v2, v3 = array[at], array[at + 1], array[at + 2], array[at + 3]
                row = a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                slope = b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
            else:
                row = 0.0
                slope = 0.0
                for k in range(mx):
                    row += w[16 + k] * array[at + k]
                    slope += w[20 + k] * array[at + k]
            plane_value += w[8 + j] * row
            plane_gy += w[12 + j] * row
            plane_gx += w[8 + j] * slope
        value += w[i] * plane_value
        gz += w[4 + i] * plane_value
        gy += w[i] * plane_gy
        gx += w[i] * plane_gx
    value += gz * ez + gy * ey + gx * ex
    return value, gz / grid.hz, gy / grid.hy, gx / grid.hx


@kernel
def value_at(array, grid, pz, py, px, w):
    """Interpolate the raveled dense ``array`` at an index position, held at the border (no continuation)."""
    bz, mz, _ = axis_weights(pz, grid.nz, w, 0)
    by, my, _ = axis_weights(py, grid.ny, w, 8)
    bx, mx, _ = axis_weights(px, grid.nx, w, 16)
    value = 0.0
    for i in range(mz):
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            row = 0.0
            for k in range(mx):
                row += w[16 + k] * array[at + k]
            value += w[i] * w[8 + j] * row
    return value


@kernel
def linear_at(array, grid, pz, py, px):
    """Linear interpolation of the raveled dense ``array`` at an index position, held at the border."""
    pz = min(max(pz, 0.0), grid.nz - 1.0)
    py = min(max(py, 0.0), grid.ny - 1.0)
    px = min(max(px, 0.0), grid.nx - 1.0)
    iz, iy, ix = int(pz), int(py), int(px)
    tz, ty, tx = pz - iz, py - iy, px - ix
    dz = grid.ny * grid.nx if iz < grid.nz - 1 else 0
    dy = grid.nx if iy < grid.ny - 1 else 0
    dx = 1 if ix < grid.nx - 1 else 0
    at = (iz * grid.ny + iy) * grid.nx + ix
    near = (1.0 - ty) * ((1.0 - tx) * array[at] + tx * array[at + dx])
    near += ty * ((1.0 - tx) * array[at + dy] + tx * array[at + dy + dx])
    at += dz
    far = (1.0 - ty) * ((1.0 - tx) * array[at] + tx * array[at + dx])
    far += ty * ((1.0 - tx) * array[at + dy] + tx * array[at + dy + dx])
    return (1.0 - tz) * near + tz * far


@kernel
def band_value_at(values, slot, n_slots, grid, position, w, known):
    """Interpolate a band field (values per slot) at ``position`` (index coordinates z, y, x).

    Cubic where all nodes are in the band; otherwise linear over those of the eight surrounding cells that
    are, by their weights (a front that just met or left another has no full stencil). ``known`` marks the
    slots that count. Returns (value, found); ``found`` is False when none of the eight is in the band.
    """
    bz, mz, _ = axis_weights(position[0], grid.nz, w, 0)
    by, my, _ = axis_weights(position[1], grid.ny, w, 8)
    bx, mx, _ = axis_weights(position[2], grid.nx, w, 16)
    value = 0.0
    for i in range(mz):
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            row = 0.0
            for k in range(mx):
                s = slot[at + k]
                if s < 0 or s >= n_slots or not known[s]:
                    return linear_band_value(values, slot, n_slots, grid, position, known)
                row += w[16 + k] * values[s]
            value += w[i] * w[8 + j] * row
    return value, True


@kernel
def linear_band_value(values, slot, n_slots, grid, position, known):
    """Linear interpolation of a band field over those of the eight surrounding cells that are known."""
    pz = min(max(position[0], 0.0), grid.nz - 1.0)
    py = min(max(position[1], 0.0), grid.ny - 1.0)
    px = min(max(position[2], 0.0), grid.nx - 1.0)
    iz, iy, ix = int(np.floor(pz)), int(np.floor(py)), int(np.floor(px))
    total = 0.0
    weight = 0.0
    for i in range(2):
        wz = pz - iz if i == 1 else 1.0 - (pz - iz)
        for j in range(2):
            wy = py - iy if j == 1 else 1.0 - (py - iy)
            for k in range(2):
                wx = px - ix if k == 1 else 1.0 - (px - ix)
                share = wz * wy * wx
                if share <= 1e-6:
                    continue
                s = slot[((iz + i) * grid.ny + iy + j) * grid.nx + ix + k]
                if s >= 0 and s < n_slots and known[s]:
                    total += share * values[s]
                    weight += share
    if weight <= 0.0:
        return 0.0, False
    return total / weight, True
