"""Random walks between clicks: for each voxel the difference of the probabilities to reach either side first.

The weighted Laplace equation with fixed values at the seeds (Grady 2006), by conjugate gradients.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel

#: Least weight of a link between two voxels: none is cut off.
MIN_WEIGHT = 1e-6


@kernel
def walk(out, fixed, values, spacing, sharpness, tolerance, most):
    """Solve sum over the neighbours of w (out - out_neighbour) = 0 where nothing is fixed.

    Parameters
    ----------
    out : ndarray (nz, ny, nx) float64
        The given values where fixed; elsewhere a first guess, on return the solution.
    fixed : ndarray (nz, ny, nx) bool
    values : ndarray (channels, nz, ny, nx) float32
    spacing : ndarray (3,) float64
        Along z, y, x.
    sharpness : float
        Links weigh exp(-sharpness (difference of values / spacing)^2).
    tolerance : float
        The residual's norm at the end, as a part of that of the right-hand side.
    most : int
        No more iterations than these.

    Returns
    -------
    int
        Iterations.
    """
    links = link_weights(values, spacing, sharpness)
    total = weight_sums(links)
    size = out.size
    flat = out.ravel()
    held = fixed.ravel()
    rest, product = np.empty(size), np.empty(size)
    # Of the right-hand side: the residual of the fixed values alone.
    direction = np.where(held, flat, 0.0)
    apply_links(product, direction, held, links, total)
    target = 0.0
    for i in range(size):
        target += product[i] * product[i]
    apply_links(product, flat, held, links, total)
    change, worth = 0.0, 0.0
    for i in range(size):
        rest[i] = -product[i]
        direction[i] = 0.0 if held[i] else rest[i] / total.flat[i]
        change += rest[i] * rest[i]
        worth += rest[i] * direction[i]
    done = 0
    while done < most and change > tolerance * tolerance * target:
        apply_links(product, direction, held, links, total)
        curvature = 0.0
        for i in range(size):
            curvature += direction[i] * product[i]
        step = worth / curvature
        next_worth = 0.0
        change = 0.0
        for i in range(size):
            flat[i] += step * direction[i]
            rest[i] -= step * product[i]
            change += rest[i] * rest[i]
            if not held[i]:
                next_worth += rest[i] * rest[i] / total.flat[i]
        for i in range(size):
            if not held[i]:
                direction[i] = rest[i] / total.flat[i] + next_worth / worth * direction[i]
        worth = next_worth
        done += 1
    return done


@kernel
def link_weights(values, spacing, sharpness):
    """Weights (3, nz, ny, nx) of the links of each voxel to the next one along z, y, x; 0 at the far border."""
    _, nz, ny, nx = values.shape
    links = np.zeros((3, nz, ny, nx))
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if z + 1 < nz:
                    links[0, z, y, x] = link(
                        values[:, z, y, x], values[:, z + 1, y, x], spacing[0], sharpness
                    )
                if y + 1 < ny:
                    links[1, z, y, x] = link(
                        values[:, z, y, x], values[:, z, y + 1, x], spacing[1], sharpness
                    )
                if x + 1 < nx:
                    links[2, z, y, x] = link(
                        values[:, z, y, x], values[:, z, y, x + 1], spacing[2], sharpness
                    )
    return links


@kernel
def link(here, there, length, sharpness):
    """Weight of a link of some length between two voxels with these values."""
    total = 0.0
    for channel in range(len(here)):
        slope = np.float64(there[channel] - here[channel]) / length
        total += slope * slope
    return np.exp(-sharpness * total) + MIN_WEIGHT


@kernel
def weight_sums(links):
    """Sum of the weights of each voxel's links (nz, ny, nx)."""
    _, nz, ny, nx = links.shape
    total = np.zeros((nz, ny, nx))
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                a = links[0, z, y, x]
                b = links[1, z, y, x]
                c = links[2, z, y, x]
                total[z, y, x] += a + b + c
                if z + 1 < nz:
                    total[z + 1, y, x] += a
                if y + 1 < ny:
                    total[z, y + 1, x] += b
                if x + 1 < nx:
                    total[z, y, x + 1] += c
    return total


@kernel
def apply_links(product, flat, held, links, total):
    """Sum over the neighbours of w (flat - flat_neighbour), 0 where fixed."""
    _, nz, ny, nx = links.shape
    i = 0
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if held[i]:
                    product[i] = 0.0
                else:
                    out = total[z, y, x] * flat[i]
                    if z > 0:
                        out -= links[0, z - 1, y, x] * flat[i - ny * nx]
                    if z + 1 < nz:
                        out -= links[0, z, y, x] * flat[i + ny * nx]
                    if y > 0:
                        out -= links[1, z, y - 1, x] * flat[i - nx]
                    if y + 1 < ny:
                        out -= links[1, z, y, x] * flat[i + nx]
                    if x > 0:
                        out -= links[2, z, y, x - 1] * flat[i - 1]
                    if x + 1 < nx:
                        out -= links[2, z, y, x] * flat[i + 1]
                    product[i] = out
                i += 1
