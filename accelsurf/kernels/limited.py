"""Interpolation of a distance beside its ridges, where the cubic of four nodes overshoots."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.interpolate import axis_weights

#: Second differences at the two inner nodes of a line may differ by this part of the spacing, and none may be larger
#: than the smaller of the two (minmod) by more. Across a ridge they differ by up to 2.
MAX_CHANGE = 0.25
#: How an outer node of a line is replaced: not at all, by the parabola through the other three, by the line through
#: the inner two.
UNCHANGED, PARABOLA, STRAIGHT = 0, 1, 2


@kernel
def limits(a, b, c, d, most):
    """How to replace the outer nodes of the line ``a, b, c, d``: (way of a, what is added, way of d, what is added).

    The second differences at b and c are limited to ``most`` more or less than the smaller of them, 0 where their
    signs differ.
    """
    left, right = a - 2.0 * b + c, b - 2.0 * c + d
    least = 0.0
    if left * right > 0.0:
        least = left if abs(left) < abs(right) else right
    other = STRAIGHT if least == 0.0 else PARABOLA
    way_a, more_a, way_d, more_d = UNCHANGED, 0.0, UNCHANGED, 0.0
    if abs(left - least) > most:
        way_a, more_a = other, most if left > least else -most
    if abs(right - least) > most:
        way_d, more_d = other, most if right > least else -most
    return way_a, more_a, way_d, more_d


@kernel
def outer_node(way, more, b, c, d):
    """The node before ``b`` on a line ``b, c, d``, replaced as `limits` has it."""
    node = 2.0 * b - c + more
    return node + (b - 2.0 * c + d) if way == PARABOLA else node


@kernel
def limited_memory():
    """Memory for `limited_value_and_gradient`.

    Rows: the values of four nodes, and then the slopes along x, y, z that are known by then.
    """
    return np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))


@kernel
def limited_value_and_gradient(psi, grid, pz, py, px, w, memory):
    """`interpolate.value_and_gradient`, with the second differences of every line of four nodes limited.

    ``memory`` = `limited_memory`.
    """
    bz, mz, ez = axis_weights(pz, grid.nz, w, 0)
    by, my, ey = axis_weights(py, grid.ny, w, 8)
    bx, mx, ex = axis_weights(px, grid.nx, w, 16)
    nodes, lines, planes, out = memory
    for i in range(mz):
        for j in range(my):
            at = ((bz + i) * grid.ny + by + j) * grid.nx + bx
            for k in range(mx):
                nodes[0, k] = psi[at + k]
            combine(nodes, 1, mx, (w, 16), MAX_CHANGE * grid.hx, lines, j)
        combine(lines, 2, my, (w, 8), MAX_CHANGE * grid.hy, planes, i)
    combine(planes, 3, mz, (w, 0), MAX_CHANGE * grid.hz, out, 0)
    value, gx, gy, gz = out[0, 0], out[1, 0], out[2, 0], out[3, 0]
    value += gz * ez + gy * ey + gx * ex
    return value, gz / grid.hz, gy / grid.hy, gx / grid.hx


@kernel(inlined=True)
def combine(nodes, rows, count, weights, most, out, to):
    """Interpolate the first ``rows`` of ``nodes`` (4, 4), and the slope of row 0, into column ``to`` of ``out``.

    ``count`` nodes; ``weights`` = (w, where in w those of this axis begin), as `interpolate.axis_weights` sets them.
    """
    w, o = weights
    way_a, more_a, way_d, more_d = UNCHANGED, 0.0, UNCHANGED, 0.0
    if count == 4:
        way_a, more_a, way_d, more_d = limits(nodes[0, 0], nodes[0, 1], nodes[0, 2], nodes[0, 3], most)
    slope = 0.0
    for row in range(rows):
        total = 0.0
        for k in range(count):
            node = nodes[row, k]
            # The slopes of what is added to the values are 0.
            if k == 0 and way_a != UNCHANGED:
                node = outer_node(way_a, more_a if row == 0 else 0.0, nodes[row, 1], nodes[row, 2], nodes[row, 3])
            elif k == 3 and way_d != UNCHANGED:
                node = outer_node(way_d, more_d if row == 0 else 0.0, nodes[row, 2], nodes[row, 1], nodes[row, 0])
            total += w[o + k] * node
            if row == 0:
                slope += w[o + 4 + k] * node
        out[row, to] = total
    out[rows, to] = slope
