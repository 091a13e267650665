"""Triangles sampled into a depth buffer, for `accelsurf.output.pictures.rasterizer`."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def area_vectors(points, triangles, out):
    """Add the area vector, twice the area along the normal, of each of the ``triangles`` (m, 3) to its vertices.

    ``points`` (n, 3) float64; ``out`` (n, 3) float64 is 0 before.
    """
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        uz, uy, ux = (
            points[b, 2] - points[a, 2],
            points[b, 1] - points[a, 1],
            points[b, 0] - points[a, 0],
        )
        vz, vy, vx = (
            points[c, 2] - points[a, 2],
            points[c, 1] - points[a, 1],
            points[c, 0] - points[a, 0],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for i in range(3):
            vertex = triangles[t, i]
            out[vertex, 0] += nx
            out[vertex, 1] += ny
            out[vertex, 2] += nz


@kernel
def sample_levels(projected, triangles, levels):
    """Into how many parts, ``levels`` (m,) int64, each edge is divided for points less than a pixel apart.

    0 for triangles that face away. ``projected`` (n, 3) float64: pixels to the right and up, depth towards the viewer.
    """
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = projected[a, 0], projected[a, 1]
        bx, by = projected[b, 0] - ax, projected[b, 1] - ay
        cx, cy = projected[c, 0] - ax, projected[c, 1] - ay
        levels[t] = 0
        if bx * cy - by * cx > 0.0:
            longest = max(
                max(max(abs(bx), abs(by)), max(abs(cx), abs(cy))), max(abs(cx - bx), abs(cy - by))
            )
            levels[t] = max(np.int64(np.ceil(1.1 * longest)), 1)


@kernel
def fill_depths(projected, triangles, order, levels, depths, nearest, shown):
    """Enter the points of the triangles ``order`` (k,), numbered in this order, into a depth buffer.

    Parameters
    ----------
    projected, triangles, levels
        See `sample_levels`.
    order : ndarray (k,) int64
    depths : (low, step, most)
        A depth counts as the whole number (depth - low)/step, 0 to ``most``.
    nearest : ndarray (n, n) int64
        -1 before; then of each pixel the largest depth, and in the lower 32 bits the last of the points that have it.
    shown : (triangle (n, n) int64, weights (n, n, 3) float64)
        Receives the triangle of that point, and the parts that its corners have in it.
    """
    low, step, most = depths
    triangle, weights = shown
    size = nearest.shape[0]
    number = 0
    for t in order:
        level = levels[t]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        whole = 3.0 * level
        for i in range(level):
            for j in range(level - i):
                # The centres of the triangle that points as the whole does, and of the one beside it that does not.
                for up in range(1, 3 if i + j + 2 <= level else 2):
                    wa, wb = (3 * i + up) / whole, (3 * j + up) / whole
                    wc = (3 * level - (3 * i + up) - (3 * j + up)) / whole
                    x = wa * projected[a, 0] + wb * projected[b, 0] + wc * projected[c, 0]
                    y = wa * projected[a, 1] + wb * projected[b, 1] + wc * projected[c, 1]
                    if 0.0 <= x < size and 0.0 <= y < size:
                        depth = wa * projected[a, 2] + wb * projected[b, 2] + wc * projected[c, 2]
                        key = (np.int64(min(max((depth - low) / step, 0.0), most)) << 32) + number
                        row, column = np.int64(y), np.int64(x)
                        if key > nearest[row, column]:
                            nearest[row, column], triangle[row, column] = key, t
                            at = weights[row, column]
                            at[0], at[1], at[2] = wa, wb, wc
                    number += 1


@kernel
def paint(covered, shown, triangles, vertices, rims, lights, pixels):
    """Colour the ``covered`` (k,) pixels: soft light from above left, a small highlight, darker where ``rims`` says so.

    Parameters
    ----------
    covered : ndarray (k,) int64
        Flat.
    shown, triangles
        See `fill_depths`.
    vertices : (normals (n, 3), colours (n, 3))
        Right, up and towards the viewer, of any length; red, green, blue in 0..1.
    rims : ndarray (k,) float64
        Factors.
    lights : (key, fill, half)
        Directions to the two lights, and halfway from the first to the viewer.
    pixels : ndarray (n * n, 4) float64
        Receives red, green, blue, 1.
    """
    triangle, weights = shown[0].ravel(), shown[1].reshape(-1, 3)
    normals, colours = vertices
    key, fill, half = lights
    n, colour = np.empty(3), np.empty(3)
    for row in range(covered.shape[0]):
        pixel = covered[row]
        t = triangle[pixel]
        for axis in range(3):
            n[axis], colour[axis] = 0.0, 0.0
            for corner in range(3):
                n[axis] += weights[pixel, corner] * normals[triangles[t, corner], axis]
                colour[axis] += weights[pixel, corner] * colours[triangles[t, corner], axis]
        length = max(np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-30)
        # Interpolated normals may point away at the rim.
        length = -length if n[2] < 0.0 else length
        x, y, z = n[0] / length, n[1] / length, n[2] / length
        light = 0.36 + 0.60 * max(x * key[0] + y * key[1] + z * key[2], 0.0)
        light += 0.16 * max(x * fill[0] + y * fill[1] + z * fill[2], 0.0)
        shine = 0.18 * max(x * half[0] + y * half[1] + z * half[2], 0.0) ** 30
        for i in range(3):
            pixels[pixel, i] = min(max(light * rims[row] * colour[i] + shine, 0.0), 1.0)
        pixels[pixel, 3] = 1.0
