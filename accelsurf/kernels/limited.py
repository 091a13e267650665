"""Interpolation of a distance beside its ridges, where the cubic of four nodes overshoots."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH
from accelsurf.kernels.interpolate import axis_weights

#: Second differences at the two inner nodes of a line may differ by this part of the spacing, and none may be larger
#: than the smaller of the two (minmod) by more. Across a ridge they differ by up to 2.
MAX_CHANGE = 0.25
#: How an outer node of a line is replaced: not at all, by the parabola through the other three, by the line through
#: the inner two.
UNCHANGED, PARABOLA, STRAIGHT = 0, 1, 2
#: Rows of the memory of `limited_in_vectors`, `BATCH` long each, one array for the compiler to see that they are apart:
#: the place of a point among the four nodes of each axis, z, y, x, and what lies beyond the border; the weights of a
#: value and of a slope along these axes; four nodes of a line; of the four lines of a plane the values and slopes along
#: x; of the four planes the values and slopes along x and y; psi and its gradient per mm, z, y, x.
INNER, BEYOND, WEIGHTS, NODES, LINES, PLANES, LEVELS = (
    np.uint64(row * BATCH) for row in (0, 3, 6, 30, 34, 42, 54)
)
ROWS = 58
#: Entry k: from a row of that memory to the k-th after it.
ON = tuple(np.uint64(row * BATCH) for row in range(9))


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
    """Memory for `limited_in_vectors`, and that for `limited_value_and_gradient`.

    Rows of the latter: the values of four nodes, and then the slopes along x, y, z that are known by then.
    """
    one = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    return np.empty(ROWS * BATCH), one


@kernel
def limited_value_and_gradient(psi, grid, pz, py, px, w, memory):
    """`interpolate.value_and_gradient`, with the second differences of every line of four nodes limited.

    Runs use it on volumes that are thinner than four nodes; others have `limited_in_vectors`. ``memory`` is the second
    of `limited_memory`.
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


@kernel
def limited_in_vectors(count, psi, grid, first, memory):
    """`limited_value_and_gradient` of ``count`` points at once, on a volume of four nodes or more along each axis.

    ``first`` (`BATCH`,) int64 are the raveled first nodes of the points; the rows INNER and BEYOND of ``memory``
    (`ROWS` x `BATCH`,) say where among the nodes the points are, and the row LEVELS and those after it get psi and its
    gradient per mm, z, y, x. A point gets the same bits in any column: vectors round nothing of this otherwise.
    """
    for axis in range(3):
        weights_in_vectors(count, INNER + ON[axis], WEIGHTS + np.uint64(axis) * ON[8], memory)
    for plane in range(4):
        for line in range(4):
            load_nodes(count, psi, first, (plane * grid.ny + line) * grid.nx, memory)
            lines_along_x(count, np.uint64(line) * ON[1], MAX_CHANGE * grid.hx, memory)
        lines_along_y(count, np.uint64(plane) * ON[1], MAX_CHANGE * grid.hy, memory)
    lines_along_z(count, MAX_CHANGE * grid.hz, (grid.hz, grid.hy, grid.hx), memory)


@kernel(inlined=True)
def enter_point(i, grid, pz, py, px, memory):
    """Enter a position (voxels) in column ``i`` of the rows INNER and BEYOND of ``memory``; returns its first node."""
    bz, memory[INNER + i], memory[BEYOND + i] = inner_place(pz, grid.nz)
    by, memory[INNER + ON[1] + i], memory[BEYOND + ON[1] + i] = inner_place(py, grid.ny)
    bx, memory[INNER + ON[2] + i], memory[BEYOND + ON[2] + i] = inner_place(px, grid.nx)
    return (bz * grid.ny + by) * grid.nx + bx


@kernel(inlined=True)
def inner_place(p, n):
    """First of the four nodes around a position on an axis, its place among them, and what lies beyond the border."""
    clamped = min(max(p, 0.0), n - 1.0)
    base = min(max(int(np.floor(clamped)) - 1, 0), n - 4)
    return base, clamped - base, p - clamped


@kernel
def weights_in_vectors(count, at, to, memory):
    """Write `interpolate.axis_weights` of the places in the row ``at`` of ``memory`` to the rows from ``to`` on."""
    for i in range(np.uint64(count)):
        u = memory[at + i]
        a, b, c = u - 1.0, u - 2.0, u - 3.0
        memory[to + i] = -a * b * c / 6.0
        memory[to + ON[1] + i] = u * b * c / 2.0
        memory[to + ON[2] + i] = -u * a * c / 2.0
        memory[to + ON[3] + i] = u * a * b / 6.0
        memory[to + ON[4] + i] = -((3.0 * u - 12.0) * u + 11.0) / 6.0
        memory[to + ON[5] + i] = ((3.0 * u - 10.0) * u + 6.0) / 2.0
        memory[to + ON[6] + i] = -((3.0 * u - 8.0) * u + 3.0) / 2.0
        memory[to + ON[7] + i] = ((3.0 * u - 6.0) * u + 2.0) / 6.0


@kernel
def load_nodes(count, psi, first, shift, memory):
    """Copy four nodes of each point's line, which begins ``shift`` beyond its ``first``, to the rows NODES."""
    for n in range(count):
        i = NODES + np.uint64(n)
        at = first[n] + shift
        memory[i], memory[i + ON[1]] = psi[at], psi[at + 1]
        memory[i + ON[2]], memory[i + ON[3]] = psi[at + 2], psi[at + 3]


@kernel(inlined=True)
def bends(a, b, c, d, most):
    """`limits` without branches: whether a is replaced, d is, both by parabolas, and what is added to a and to d."""
    left, right = a - 2.0 * b + c, b - 2.0 * c + d
    least = left if abs(left) < abs(right) else right
    least = least if left * right > 0.0 else 0.0
    more_a = most if left > least else -most
    more_d = most if right > least else -most
    return abs(left - least) > most, abs(right - least) > most, least != 0.0, more_a, more_d


@kernel(inlined=True)
def bent(replaced, parabola, more, a, b, c, d):
    """The node a of a line ``a, b, c, d``, where it is replaced as `outer_node` has it."""
    node = 2.0 * b - c + more
    node = node + (b - 2.0 * c + d) if parabola else node
    return node if replaced else a


@kernel(inlined=True)
def four_nodes(memory, at):
    """The nodes of a line: entry ``at`` of ``memory`` and those of the next three rows."""
    return memory[at], memory[at + ON[1]], memory[at + ON[2]], memory[at + ON[3]]


@kernel(inlined=True)
def weighted(memory, weights, nodes):
    """Sum of four nodes by the weights in entry ``weights`` of ``memory`` and in those of the next three rows."""
    a, b, c, d = nodes
    return (
        memory[weights] * a + memory[weights + ON[1]] * b + memory[weights + ON[2]] * c + memory[weights + ON[3]] * d
    )


@kernel(inlined=True)
def limited_line(memory, at, weights, most):
    """Value and slope of the line at ``at``, see `four_nodes` and `weighted`, and how it is limited, see `bends`."""
    a, b, c, d = four_nodes(memory, at)
    new_a, new_d, parabola, more_a, more_d = bends(a, b, c, d, most)
    nodes = bent(new_a, parabola, more_a, a, b, c, d), b, c, bent(new_d, parabola, more_d, d, c, b, a)
    return weighted(memory, weights, nodes), weighted(memory, weights + ON[4], nodes), (new_a, new_d, parabola)


@kernel(inlined=True)
def slope_along(memory, at, weights, limited):
    """A slope across a line from those at its nodes, ``limited`` as `limited_line` has limited the values there.

    The slopes of what was added to the values are 0.
    """
    new_a, new_d, parabola = limited
    a, b, c, d = four_nodes(memory, at)
    nodes = bent(new_a, parabola, 0.0, a, b, c, d), b, c, bent(new_d, parabola, 0.0, d, c, b, a)
    return weighted(memory, weights, nodes)


@kernel
def lines_along_x(count, line, most, memory):
    """Values and slopes of the lines in the rows NODES, to ``line`` beyond the first of the rows LINES."""
    weights = WEIGHTS + ON[8] + ON[8]
    for i in range(np.uint64(count)):
        value, gx, _ = limited_line(memory, NODES + i, weights + i, most)
        memory[LINES + line + i], memory[LINES + ON[4] + line + i] = value, gx


@kernel
def lines_along_y(count, plane, most, memory):
    """Values and slopes of the planes in the rows LINES, to ``plane`` beyond the first of the rows PLANES."""
    weights = WEIGHTS + ON[8]
    for i in range(np.uint64(count)):
        value, gy, limited = limited_line(memory, LINES + i, weights + i, most)
        gx = slope_along(memory, LINES + ON[4] + i, weights + i, limited)
        at = PLANES + plane + i
        memory[at], memory[at + ON[4]], memory[at + ON[8]] = value, gx, gy


@kernel
def lines_along_z(count, most, spacing, memory):
    """Psi and its gradient from the rows PLANES, to the rows LEVELS."""
    hz, hy, hx = spacing
    for i in range(np.uint64(count)):
        value, gz, limited = limited_line(memory, PLANES + i, WEIGHTS + i, most)
        gx = slope_along(memory, PLANES + ON[4] + i, WEIGHTS + i, limited)
        gy = slope_along(memory, PLANES + ON[8] + i, WEIGHTS + i, limited)
        beyond = BEYOND + i
        value += gz * memory[beyond] + gy * memory[beyond + ON[1]] + gx * memory[beyond + ON[2]]
        levels = LEVELS + i
        memory[levels], memory[levels + ON[1]] = value, gz / hz
        memory[levels + ON[2]], memory[levels + ON[3]] = gy / hy, gx / hx
