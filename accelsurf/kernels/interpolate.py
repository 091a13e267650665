"""Cubic interpolation on four nodes per axis (Lagrange), one-sided at the border, lower order on thin volumes.

Compact on purpose: prefiltered B-splines ring when the band is clipped.

Interpolation of a distance beside its ridges, where the cubic of four nodes overshoots.
"""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import BATCH, Grid
from accelsurf.kernels.simd.cubic import cubic


@kernel(inlined=True)
def place_on_axis(p, n):
    """First of the four nodes, or of all ``n``, around position ``p`` (voxels) on an axis, and the place among them.

    ``p`` beyond the axis is clamped to its ends. Returns (base, u, beyond), where ``beyond`` is the distance that was
    clamped.
    """
    clamped = min(max(p, 0.0), n - 1.0)
    base = min(max(int(np.floor(clamped)) - 1, 0), max(n - 4, 0))
    return base, clamped - base, p - clamped


@kernel(inlined=True)
def four_weights(u):
    """Weights of four nodes at the place ``u`` from the first: of the value, then of the derivative per voxel."""
    a = u - 1.0
    b = u - 2.0
    c = u - 3.0
    return (
        -a * b * c / 6.0,
        u * b * c / 2.0,
        -u * a * c / 2.0,
        u * a * b / 6.0,
        -((3.0 * u - 12.0) * u + 11.0) / 6.0,
        ((3.0 * u - 10.0) * u + 6.0) / 2.0,
        -((3.0 * u - 8.0) * u + 3.0) / 2.0,
        ((3.0 * u - 6.0) * u + 2.0) / 6.0,
    )


@kernel
def axis_weights(p, n, w, o):
    """Weights of the nodes ``base .. base + count - 1`` for position ``p`` (voxels) on an axis of ``n`` nodes.

    ``w[o:o+4]`` get the weights of the value, ``w[o+4:o+8]`` those of the derivative per voxel. ``p`` beyond the
    axis is clamped to its ends; the returned ``beyond`` is the distance that was clamped, for a linear continuation.
    Returns (base, count, beyond).
    """
    base, u, beyond = place_on_axis(p, n)
    if n >= 4:
        w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5], w[o + 6], w[o + 7] = four_weights(u)
        return base, 4, beyond
    if n == 3:
        w[o] = (u - 1.0) * (u - 2.0) / 2.0
        w[o + 1] = -u * (u - 2.0)
        w[o + 2] = u * (u - 1.0) / 2.0
        w[o + 4] = u - 1.5
        w[o + 5] = 2.0 - 2.0 * u
        w[o + 6] = u - 0.5
        return 0, 3, beyond
    if n == 2:
        w[o] = 1.0 - u
        w[o + 1] = u
        w[o + 4] = -1.0
        w[o + 5] = 1.0
        return 0, 2, beyond
    w[o] = 1.0
    w[o + 4] = 0.0
    return 0, 1, beyond


@kernel
def has_cubes(grid):
    """Test if every axis has the four nodes that `cubic` reads, or is a single slice (not along x)."""
    return grid.nx >= 4 and (grid.ny >= 4 or grid.ny == 1) and (grid.nz >= 4 or grid.nz == 1)


@kernel
def nodes_of(p, n, stride):
    """First of the four nodes around position ``p`` of an axis, the place among them, what lies beyond, the stride.

    Returns (base, u, beyond, stride); a single slice counts four times, at stride 0.
    """
    if n == 1:
        return 0, np.float32(1.0), 0.0, 0
    base, u, beyond = place_on_axis(p, n)
    return base, np.float32(u), beyond, stride


@kernel
def value_and_gradient(array, grid, pz, py, px, w):
    """Interpolate the raveled dense ``array`` at an index position; ``w`` is (24,) scratch.

    Returns (value, d/dz, d/dy, d/dx) with the gradient per mm. Beyond the border it is continued linearly.
    """
    if has_cubes(grid):
        return cubes_value_and_gradient(array, grid, pz, py, px)
    # A slice across x is one across z to the memory: (nz, ny, 1) lies as (1, nz, ny).
    turned = Grid(1, grid.nz, grid.ny, grid.hx, grid.hz, grid.hy)
    if grid.nx == 1 and has_cubes(turned):
        value, gx, gz, gy = cubes_value_and_gradient(array, turned, px, pz, py)
        return value, gz, gy, gx
    return thin_value_and_gradient(array, grid, pz, py, px, w)


@kernel
def cubes_value_and_gradient(array, grid, pz, py, px):
    """`value_and_gradient` where `has_cubes`."""
    bz, uz, ez, sz = nodes_of(pz, grid.nz, grid.ny * grid.nx)
    by, uy, ey, sy = nodes_of(py, grid.ny, grid.nx)
    bx, ux, ex, _ = nodes_of(px, grid.nx, 1)
    value, gz, gy, gx = cubic(array, (bz * grid.ny + by) * grid.nx + bx, sy, sz, uz, uy, ux)
    if sz == 0:
        gz = np.float32(0.0)
    if sy == 0:
        gy = np.float32(0.0)
    return value + gz * ez + gy * ey + gx * ex, gz / grid.hz, gy / grid.hy, gx / grid.hx


@kernel
def thin_value_and_gradient(array, grid, pz, py, px, w):
    """`value_and_gradient` on a volume that is thinner than four nodes somewhere."""
    bz, mz, ez = axis_weights(pz, grid.nz, w, 0)
    by, my, ey = axis_weights(py, grid.ny, w, 8)
    bx, mx, ex = axis_weights(px, grid.nx, w, 16)
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
    """Interpolate the raveled dense ``array`` at an index position, clamped to the border (no continuation)."""
    pz = min(max(pz, 0.0), grid.nz - 1.0)
    py = min(max(py, 0.0), grid.ny - 1.0)
    px = min(max(px, 0.0), grid.nx - 1.0)
    return value_and_gradient(array, grid, pz, py, px, w)[0]


@kernel
def linear_cell(array, at, dy, dz, tz, ty, tx):
    """Linear interpolation among node ``at`` and the next along z, y (strides ``dz``, ``dy``) and x."""
    # Unsigned: a signed index is tested for being negative at every read.
    at = np.uint64(at)
    dy = np.uint64(dy)
    dz = np.uint64(dz)
    dx = np.uint64(1)
    a, b = (
        array[at] + tx * (array[at + dx] - array[at]),
        array[at + dy] + tx * (array[at + dy + dx] - array[at + dy]),
    )
    near = a + ty * (b - a)
    at += dz
    a, b = (
        array[at] + tx * (array[at + dx] - array[at]),
        array[at + dy] + tx * (array[at + dy + dx] - array[at + dy]),
    )
    return near + tz * (a + ty * (b - a) - near)


@kernel
def linear_at(array, grid, pz, py, px):
    """Linear interpolation of the raveled dense ``array`` at an index position, clamped to the border."""
    pz = min(max(pz, 0.0), grid.nz - 1.0)
    py = min(max(py, 0.0), grid.ny - 1.0)
    px = min(max(px, 0.0), grid.nx - 1.0)
    iz = int(pz)
    iy = int(py)
    ix = int(px)
    tz = pz - iz
    ty = py - iy
    tx = px - ix
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


@kernel(inlined=True)
def band_rows(slot, n_slots, at, sy, sz, rows):
    """Slots where the sixteen rows of four nodes from cell ``at`` on begin, into ``rows`` (16,) int64.

    Rows of cells have consecutive slots. False where a node is not in the band. No branches: nearly all are.
    """
    odd = np.int32(0)
    # Unsigned: a signed index is tested for being negative at every read.
    a = np.uint64(at)
    sy = np.uint64(sy)
    sz = np.uint64(sz)
    three = np.uint64(3)
    for i in range(np.uint64(4)):
        b = a + sy
        c = a + sy + sy
        d = a + three * sy
        first_a = slot[a]
        first_b = slot[b]
        first_c = slot[c]
        first_d = slot[d]
        last_a = slot[a + three]
        last_b = slot[b + three]
        last_c = slot[c + three]
        last_d = slot[d + three]
        a += sz
        # -1 is no slot: a negative first or a last that is not three further leaves bits.
        odd |= (first_a | first_b | first_c | first_d) & np.int32(-0x80000000)
        odd |= (
            ((last_a - first_a) ^ 3)
            | ((last_b - first_b) ^ 3)
            | ((last_c - first_c) ^ 3)
            | ((last_d - first_d) ^ 3)
        )
        odd |= np.int32(max(max(last_a, last_b), max(last_c, last_d)) >= n_slots)
        row = i << np.uint64(2)
        rows[row], rows[row | np.uint64(1)] = first_a, first_b
        rows[row | np.uint64(2)], rows[row | three] = first_c, first_d
    return odd == 0


@kernel
def band_value_at(values, slot, n_slots, grid, position, w):
    """Interpolate a band field (values per slot) at ``position`` (index coordinates z, y, x).

    Cubic where all nodes are in the band; otherwise linear over those of the eight surrounding cells that
    are, by their weights (a front that just met or left another has no full stencil). ``w`` (24,) is scratch.
    Returns (value, found); ``found`` is False when none of the eight is in the band.
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
                if s < 0 or s >= n_slots:
                    return linear_band_value(values, slot, n_slots, grid, position)
                row += w[16 + k] * values[s]
            value += w[i] * w[8 + j] * row
    return value, True


@kernel(inlined=True)
def linear_band_value(values, slot, n_slots, grid, position, first=0):
    """Linear interpolation of a band field over those of the eight surrounding cells that are in the band.

    The field begins at ``first`` in ``values``.
    """
    if n_slots == 0:
        return 0.0, False
    pz = min(max(position[0], 0.0), grid.nz - 1.0)
    py = min(max(position[1], 0.0), grid.ny - 1.0)
    px = min(max(position[2], 0.0), grid.nx - 1.0)
    iz = int(pz)
    iy = int(py)
    ix = int(px)
    at = (iz * grid.ny + iy) * grid.nx + ix
    dz = grid.ny * grid.nx if iz < grid.nz - 1 else 0
    dy, dx = grid.nx if iy < grid.ny - 1 else 0, 1 if ix < grid.nx - 1 else 0
    total = 0.0
    weight = 0.0
    # Without branches, which nobody could predict: a cell that does not count counts with weight 0.
    for i in range(2):
        wz = pz - iz if i == 1 else 1.0 - (pz - iz)
        for j in range(2):
            wy = py - iy if j == 1 else 1.0 - (py - iy)
            for k in range(2):
                wx = px - ix if k == 1 else 1.0 - (px - ix)
                share = wz * wy * wx
                s = slot[at + i * dz + j * dy + k * dx]
                known = (share > 1e-6) & (s >= 0) & (s < n_slots)
                share = share if known else 0.0
                total += share * values[first + (s if known else 0)]
                weight += share
    if weight <= 0.0:
        return 0.0, False
    return total / weight, True


#: Second differences at the two inner nodes of a line may differ by this part of the spacing, and none may be larger
#: than the smaller of the two (minmod) by more. Across a ridge they differ by up to 2.
MAX_CHANGE = 0.25
# Rows of the memory of `limited_in_vectors`, `BATCH` long each, one array for the compiler to see that they are apart.
#: Place of a point among the four nodes of each axis, z, y, x.
INNER = np.uint64(0 * BATCH)
#: Distance beyond the border, z, y, x.
BEYOND = np.uint64(3 * BATCH)
#: Weights of a value and of a slope along these axes.
WEIGHTS = np.uint64(6 * BATCH)
#: Four nodes of a line.
NODES = np.uint64(30 * BATCH)
#: Values and slopes along x of the four lines of a plane.
LINES = np.uint64(34 * BATCH)
#: Values and slopes along x and y of the four planes.
PLANES = np.uint64(42 * BATCH)
#: Psi and its gradient per mm, z, y, x.
LEVELS = np.uint64(54 * BATCH)
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
    nz = min(grid.nz, 4)
    ny = min(grid.ny, 4)
    nx = min(grid.nx, 4)
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
        memory[to + i] = w0
        memory[to + ON[1] + i] = w1
        memory[to + ON[2] + i] = w2
        memory[to + ON[3] + i] = w3
        slopes = to + ON[4] + i
        memory[slopes] = s0
        memory[slopes + ON[1]] = s1
        memory[slopes + ON[2]] = s2
        memory[slopes + ON[3]] = s3


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
    """Replacement of the outer nodes of a line a, b, c, d: whether a is, d is, both by parabolas, the addition to each.

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
    """The node a of a line ``a, b, c, d``, or its replacement where ``replaced``, see `bends`."""
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
        memory[weights] * a
        + memory[weights + ON[1]] * b
        + memory[weights + ON[2]] * c
        + memory[weights + ON[3]] * d
    )


@kernel(inlined=True)
def limited_line(memory, at, weights, most):
    """Value and slope of the line at ``at``, see `four_nodes` and `weighted`, and how it is limited, see `bends`."""
    a, b, c, d = four_nodes(memory, at)
    new_a, new_d, parabola, more_a, more_d = bends(a, b, c, d, most)
    nodes = (
        bent(new_a, parabola, more_a, a, b, c, d),
        b,
        c,
        bent(new_d, parabola, more_d, d, c, b, a),
    )
    return (
        weighted(memory, weights, nodes),
        weighted(memory, weights + ON[4], nodes),
        (new_a, new_d, parabola),
    )


@kernel(inlined=True)
def slope_along(memory, at, weights, limited):
    """A slope across a line from those at its nodes, ``limited`` as `limited_line` has limited the values there.

    The slopes of the additions are 0.
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
        memory[at] = value
        memory[at + ON[4]] = gx
        memory[at + ON[8]] = gy


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
