"""Interpolation of a distance beside its ridges, where the cubic of four nodes overshoots."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH
from accelsurf.kernels.interpolate import axis_weights, four_weights, place_on_axis

#: Second differences at the two inner nodes of a line may differ by this part of the spacing, and none may be larger
#: than the smaller of the two (minmod) by more. Across a ridge they differ by up to 2.
MAX_CHANGE = 0.25
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
def limited_memory(grid):
    """Memory for `limited_in_vectors` on a grid."""
    memory = np.empty(ROWS * BATCH)
    if min(grid.nz, min(grid.ny, grid.nx)) < 4:
        # Nothing is written to the rows of nodes that a thin volume does not have.
        memory[:] = 0.0
    return memory


@kernel
def limited_in_vectors(count, psi, grid, first, memory):
    """`interpolate.value_and_gradient` of ``count`` points, with the second differences of each line of nodes limited.

    ``first`` (`BATCH`,) int64 are the raveled first nodes of the points; the rows INNER and BEYOND of ``memory``, from
    `limited_memory`, say where among the nodes the points are, and the row LEVELS and those after it get psi and its
    gradient per mm, z, y, x. A point gets the same bits in any column: vectors round nothing of this otherwise.
    """
    nz, ny, nx = min(grid.nz, 4), min(grid.ny, 4), min(grid.nx, 4)
    weights_in_vectors(count, grid.nz, INNER, WEIGHTS, memory)
    weights_in_vectors(count, grid.ny, INNER + ON[1], WEIGHTS + ON[8], memory)
    weights_in_vectors(count, grid.nx, INNER + ON[2], WEIGHTS + ON[8] + ON[8], memory)
    for plane in range(nz):
        for line in range(ny):
            load_nodes(count, nx, psi, first, (plane * grid.ny + line) * grid.nx, memory)
            lines_along_x(count, np.uint64(line) * ON[1], most_of(nx, grid.hx), memory)
        lines_along_y(count, np.uint64(plane) * ON[1], most_of(ny, grid.hy), memory)
    lines_along_z(count, most_of(nz, grid.hz), (grid.hz, grid.hy, grid.hx), memory)


@kernel
def most_of(length, h):
    """Largest change of second differences along lines of ``length`` nodes: no limit where they are not four."""
    return MAX_CHANGE * h if length == 4 else np.inf


@kernel(inlined=True)
def enter_point(i, grid, pz, py, px, memory):
    """Enter a position (voxels) in column ``i`` of the rows INNER and BEYOND of ``memory``; returns its first node."""
    bz, memory[INNER + i], memory[BEYOND + i] = place_on_axis(pz, grid.nz)
    by, memory[INNER + ON[1] + i], memory[BEYOND + ON[1] + i] = place_on_axis(py, grid.ny)
    bx, memory[INNER + ON[2] + i], memory[BEYOND + ON[2] + i] = place_on_axis(px, grid.nx)
    return (bz * grid.ny + by) * grid.nx + bx


@kernel
def weights_in_vectors(count, n, at, to, memory):
    """Write `interpolate.axis_weights` of the places in the row ``at`` of ``memory`` to the rows from ``to`` on."""
    if n < 4:
        w = np.zeros(8)
        for i in range(np.uint64(count)):
            axis_weights(memory[at + i], n, w, 0)
            for k in range(8):
                memory[to + ON[k] + i] = w[k]
        return
    for i in range(np.uint64(count)):
        w0, w1, w2, w3, s0, s1, s2, s3 = four_weights(memory[at + i])
        memory[to + i], memory[to + ON[1] + i], memory[to + ON[2] + i], memory[to + ON[3] + i] = w0, w1, w2, w3
        slopes = to + ON[4] + i
        memory[slopes], memory[slopes + ON[1]], memory[slopes + ON[2]], memory[slopes + ON[3]] = s0, s1, s2, s3


@kernel
def load_nodes(count, length, psi, first, shift, memory):
    """Copy the ``length`` nodes of each point's line, which begins ``shift`` beyond its ``first``, to rows NODES."""
    if length < 4:
        for n in range(count):
            for k in range(length):
                memory[NODES + ON[k] + np.uint64(n)] = psi[first[n] + shift + k]
        return
    for n in range(count):
        i = NODES + np.uint64(n)
        at = first[n] + shift
        memory[i], memory[i + ON[1]] = psi[at], psi[at + 1]
        memory[i + ON[2]], memory[i + ON[3]] = psi[at + 2], psi[at + 3]


@kernel(inlined=True)
def bends(a, b, c, d, most):
    """Replacement of the outer nodes of a line a, b, c, d: whether a is, d is, both by parabolas, what each gets added.

    The second differences at b and c are limited to ``most`` more or less than the smaller of them, 0 where their
    signs differ: an outer node is replaced by the parabola through the other three, or by the line through the inner
    two, plus that.
    """
    left, right = a - 2.0 * b + c, b - 2.0 * c + d
    least = left if abs(left) < abs(right) else right
    least = least if left * right > 0.0 else 0.0
    more_a = most if left > least else -most
    more_d = most if right > least else -most
    return abs(left - least) > most, abs(right - least) > most, least != 0.0, more_a, more_d


@kernel(inlined=True)
def bent(replaced, parabola, more, a, b, c, d):
    """The node a of a line ``a, b, c, d``, or what it is ``replaced`` by, see `bends`."""
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
