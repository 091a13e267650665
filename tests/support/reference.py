"""Slow, plain references of the kernels, by another formula wherever there is one.

Arrays are (z, y, x), spacings (hz, hy, hx) in mm, positions in voxels unless mm is said.
"""

import heapq
import itertools

import numpy as np
from scipy import integrate, ndimage, spatial

from accelsurf.kernels import closest, march
from accelsurf.kernels.grid import Band, DenseArrays, Grid

# ------------------------------------------------------------------------------------------------- data for kernels


def grid_of(shape, spacing) -> Grid:
    """Spacings as numpy's float64: with the compiler off, float32 times a float of Python would stay float32."""
    return Grid(*(int(n) for n in shape), *(np.float64(h) for h in spacing))


def coordinates(shape, spacing, centre):
    """(z, y, x) in mm from ``centre`` (mm), three arrays."""
    return np.meshgrid(
        *(np.arange(n) * h - c for n, h, c in zip(shape, spacing, centre, strict=True)),
        indexing="ij",
    )


def whole_band(psi, closest_point=None) -> tuple[DenseArrays, Band]:
    """Every voxel in the band, the slot of a voxel being its raveled index."""
    flat = np.ascontiguousarray(psi, np.float32).ravel()
    cells = np.arange(flat.size)
    closest_points = np.zeros((flat.size, 3), np.float32)
    if closest_point is not None:
        closest_points[:] = np.reshape(closest_point, (-1, 3))
    return DenseArrays(flat.copy(), cells.astype(np.int32)), Band(
        cells, flat.copy(), closest_points
    )


def smooth_noise(shape, seed, sigma=1.5) -> np.ndarray:
    """Smooth random function of standard deviation 1, float32."""
    field = ndimage.gaussian_filter(
        np.random.default_rng(seed).standard_normal(shape), sigma, mode="nearest"
    )
    return np.asarray(field / field.std(), np.float32)


# --------------------------------------------------------------------------------------------------- interpolation


def axis_weights(p, n):
    """(first node, weights, weights of the derivative, part beyond the axis) for positions ``p`` (m,).

    From the monomials: the inverse of the Vandermonde matrix of the nodes.
    """
    count = min(n, 4)
    clamped = np.clip(p, 0, n - 1)
    base = np.clip(np.floor(clamped).astype(int) - 1, 0, n - count)
    k = np.arange(count)
    coefficients = np.linalg.inv(np.vander(k, increasing=True).astype(float))
    u = (clamped - base)[:, None]
    slopes = k * u ** np.maximum(k - 1, 0)
    return base, u**k @ coefficients, slopes @ coefficients, p - clamped


def interpolate(array, positions):
    """Value (m,) and gradient (m, 3) per voxel at index ``positions`` (m, 3), continued linearly beyond the border."""
    array, positions = np.asarray(array, float), np.atleast_2d(np.asarray(positions, float))
    axes = [axis_weights(positions[:, a], array.shape[a]) for a in range(3)]
    nodes = [base[:, None] + np.arange(w.shape[1]) for base, w, _, _ in axes]
    block = array[
        nodes[0][:, :, None, None], nodes[1][:, None, :, None], nodes[2][:, None, None, :]
    ]
    gradient = np.empty_like(positions)
    for along in (None, 0, 1, 2):
        z, y, x = (axes[b][2] if b == along else axes[b][1] for b in range(3))
        line = np.einsum("mij,mj->mi", np.einsum("mijk,mk->mij", block, x), y)
        if along is None:
            value = np.einsum("mi,mi->m", line, z)
        else:
            gradient[:, along] = np.einsum("mi,mi->m", line, z)
    beyond = np.stack([axis[3] for axis in axes], axis=1)
    return value + (gradient * beyond).sum(axis=1), gradient


def limited_nodes(nodes, most):
    """(matrix, vector) of the nodes of a line (n,) with limited second differences: matrix @ nodes + vector."""
    matrix, more = np.eye(len(nodes)), np.zeros(len(nodes))
    if len(nodes) < 4:
        return matrix, more
    bends = np.diff(nodes, 2)
    least = 0.0 if bends[0] * bends[1] <= 0.0 else min(bends, key=abs)
    for bend, (a, b, c, d) in zip(bends, ((0, 1, 2, 3), (3, 2, 1, 0)), strict=True):
        if abs(bend - least) > most:
            # On with the slope between b and c; with the bend at c besides, where the two bends agree in sign.
            matrix[a], more[a] = 0.0, np.copysign(most, bend - least)
            matrix[a, [b, c]] = 2.0, -1.0
            if least != 0.0:
                matrix[a, [b, c, d]] += 1.0, -2.0, 1.0
    return matrix, more


def limited_interpolant(array, position, spacing, most):
    """Value and gradient (3,) per mm of the limited interpolant at one ``position``; ``most`` in parts of a spacing."""
    axes = [axis_weights(np.array([p]), n) for p, n in zip(position, array.shape, strict=True)]
    box = tuple(slice(base[0], base[0] + weights.shape[1]) for base, weights, _, _ in axes)
    values, slopes = np.asarray(array[box], float), {}
    for axis in (2, 1, 0):
        (weights,), (derivative,) = axes[axis][1:3]
        reduced = {key: np.empty(values.shape[:-1]) for key in ("value", axis, *slopes)}
        for at in np.ndindex(values.shape[:-1]):
            matrix, more = limited_nodes(values[at], most * spacing[axis])
            line = matrix @ values[at] + more
            reduced["value"][at], reduced[axis][at] = weights @ line, derivative @ line
            for other, given in slopes.items():
                reduced[other][at] = weights @ (matrix @ given[at])
        values, slopes = reduced.pop("value"), reduced
    value = values + sum(slopes[axis] * axes[axis][3][0] for axis in range(3))
    return float(value), np.array([slopes[axis] / spacing[axis] for axis in range(3)])


def linear(array, positions):
    """Linear interpolation clamped to the border."""
    return ndimage.map_coordinates(
        np.asarray(array, float), np.atleast_2d(positions).T, order=1, mode="nearest"
    )


def known_linear(values, known, position):
    """(value, found): linear interpolation of (z, y, x) ``values`` over those surrounding voxels that are ``known``."""
    p = np.clip(position, 0, np.array(values.shape) - 1)
    first = np.minimum(np.floor(p).astype(int), np.maximum(np.array(values.shape) - 2, 0))
    total = weight = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        cell = tuple(np.minimum(first + corner, np.array(values.shape) - 1))
        share = np.prod(np.where(corner, p - first, 1 - (p - first)))
        if known[cell] and share > 1e-6:
            total += share * float(values[cell])
            weight += share
    return (total / weight, True) if weight > 0 else (0.0, False)


def has_stencil(present, position):
    """Whether all nodes of the cubic interpolation at ``position`` are among the ``present`` voxels."""
    axes = [
        axis_weights(np.array([p], float), n) for p, n in zip(position, present.shape, strict=True)
    ]
    return bool(present[tuple(slice(b[0], b[0] + w.shape[1]) for b, w, _, _ in axes)].all())


def band_vector(values, present, position):
    """(vector, found): (z, y, x, m) ``values`` at ``position``, cubic where the stencil is ``present``, else linear.

    The cubic one goes straight on beyond the border up to its faces.
    """
    parts = np.moveaxis(np.asarray(values, float), -1, 0)
    if has_stencil(present, position):
        out = np.asarray(values, float)
        for p, n in zip(position, present.shape, strict=True):
            base, weights, _, beyond = axis_weights(np.array([p], float), n)
            line = out[base[0] : base[0] + weights.shape[1]]
            out = np.tensordot(weights[0], line, 1)
            # Straight on to the face, half a voxel off the last voxel centre.
            if n > 1:
                end, next_ = (line[0], line[1]) if beyond[0] < 0 else (line[-1], line[-2])
                out = out + min(abs(beyond[0]), 0.5) * (end - next_)
        return out, True
    found = [known_linear(part, present, position) for part in parts]
    return np.array([value for value, _ in found]), found[0][1]


def limited(field, present, position, value, part):
    """``value`` within the ``field`` (z, y, x) at the nodes around ``position`` that are ``present``, +- a ``part``."""
    clamped = np.clip(position, 0, np.array(present.shape) - 1.0)
    around = tuple(slice(int(p), int(p) + 2) for p in clamped)
    known = field[around][present[around]]
    low, high = known.min(), known.max()
    return np.clip(value, low - part * abs(low), high + part * abs(high))


# ------------------------------------------------------------------------------------------- closest points, distance


def pull_to_zero(psi, spacing, points, steps=4):
    """Points (mm) moved down the gradient of the interpolant of psi onto its zero level."""
    h = np.asarray(spacing, float)
    for _ in range(steps):
        value, gradient = interpolate(psi, points / h)
        gradient = gradient / h
        points = points - (value / np.maximum((gradient**2).sum(axis=1), 1e-12))[:, None] * gradient
    return points


def zero_level(psi, spacing, parts=4):
    """Points (mm) on the zero level of the cubic interpolant, about h/parts apart: sign changes on a finer lattice."""
    h = np.asarray(spacing, float)
    axes = [np.linspace(0, n - 1, (n - 1) * parts + 1) for n in psi.shape]
    fine = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = interpolate(psi, fine.reshape(-1, 3))[0].reshape(fine.shape[:3])
    points = []
    for a in range(3):
        low, high = np.moveaxis(fine, a, 0)[:-1], np.moveaxis(fine, a, 0)[1:]
        v0, v1 = np.moveaxis(values, a, 0)[:-1], np.moveaxis(values, a, 0)[1:]
        cut = (v0 < 0) != (v1 < 0)
        t = (v0[cut] / (v0[cut] - v1[cut]))[:, None]
        points.append(low[cut] + t * (high[cut] - low[cut]))
    return pull_to_zero(psi, spacing, np.concatenate(points) * h)


def closest_points(psi, spacing, cells, parts=4):
    """Closest points (mm) of the zero level of the interpolant for index ``cells`` (m, 3), by brute force.

    The nearest of many points on the level, then a pattern search around it that shrinks by half each round.
    """
    h = np.asarray(spacing, float)
    at = np.asarray(cells, float) * h
    closest_point = (points := zero_level(psi, spacing, parts))[
        spatial.cKDTree(points).query(at)[1]
    ]
    ways = np.array([w for w in itertools.product((-1, 0, 1), repeat=3) if any(w)], float)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    radius = h.max() / parts
    for _ in range(12):
        tried = (closest_point[:, None] + radius * ways).reshape(-1, 3)
        tried = pull_to_zero(psi, spacing, tried, 2).reshape(len(closest_point), len(ways), 3)
        tried = np.concatenate([closest_point[:, None], tried], axis=1)
        nearest = np.argmin(((tried - at[:, None]) ** 2).sum(axis=2), axis=1)
        closest_point = tried[np.arange(len(closest_point)), nearest]
        radius /= 2
    return closest_point


def distance(psi, spacing, cells, parts=4):
    """Signed distance (mm) of ``cells`` (m, 3) from the zero level of the interpolant of psi, by brute force."""
    gap = np.linalg.norm(
        closest_points(psi, spacing, cells, parts) - np.asarray(cells) * np.asarray(spacing), axis=1
    )
    return np.where(np.asarray(psi)[tuple(np.asarray(cells).T)] < 0, -gap, gap)


def corrected(iteration, closest_point, level, past, spacing):
    """One of Chopp's two corrections at once, the part along the level relaxed by the secant of two residues.

    ``level`` is (psi, gradient per mm) at the closest point (mm from the cell); ``past`` (last residue, its square, the
    last relaxation, the square of the first residue). Returns (closest point, its status, past, by how much of a limit
    each of the decisions was made).
    """
    last, square, relax, first = past
    value, g = level[0], np.asarray(level[1:], float)
    slope2 = g @ g
    margins = [abs(slope2 / closest.MIN_SLOPE2 - 1)]
    if not slope2 > closest.MIN_SLOPE2:
        return closest_point, closest.LOST, past, margins
    residue = (closest_point @ g) / slope2 * g - closest_point
    if iteration == 0:
        relax, first = 1.0, residue @ residue
    elif square > 0:
        relax = np.clip(relax / max(1 - residue @ last / square, 0.25), 0.1, 4.0)
    step = relax * residue - value / slope2 * g
    move = np.linalg.norm(step / spacing)
    if iteration >= 2:
        margins.append(abs(residue @ residue / max(0.25 * first, 1e-12) - 1))
        if residue @ residue > 0.25 * first:
            return closest_point, closest.LOST, past, margins
    limit = closest.TOLERANCE
    if iteration == 0:
        limit = closest.FIRST_TOLERANCE * max(1, np.linalg.norm(closest_point / spacing))
    margins += [abs(move / limit - 1), abs(move / closest.MAX_MOVE - 1)]
    past = residue, 0.0 if move > closest.MAX_MOVE else residue @ residue, relax, first
    closest_point = closest_point + min(1, closest.MAX_MOVE / max(move, 1e-30)) * step
    return closest_point, closest.FOUND if move < limit else closest.ACTIVE, past, margins


def iterated(psi, spacing, cell, closest_point):
    """Closest point of one cell by `corrected`, one correction after the other: (closest point, its status, least
    margin).
    """
    h = np.asarray(spacing, float)
    closest_point, past, least = (
        np.asarray(closest_point, float),
        (np.zeros(3), 0.0, 1.0, 0.0),
        np.inf,
    )
    for iteration in range(closest.MAX_ITERATIONS):
        value, gradient = interpolate(psi, cell + closest_point / h)
        closest_point, status, past, margins = corrected(
            iteration, closest_point, (value[0], *(gradient[0] / h)), past, h
        )
        least = min(least, *margins)
        if status != closest.ACTIVE:
            break
    return closest_point, status, least


def cells_beside(cell, grid):
    """(raveled neighbour, vector (mm) to it) on the six sides, in the order of the kernels."""
    shape, h = (grid.nz, grid.ny, grid.nx), np.array(grid[3:])
    at = np.array(np.unravel_index(cell, shape))
    for axis, sign in itertools.product(range(3), (-1, 1)):
        step = sign * np.eye(3, dtype=int)[axis]
        if ((at + step >= 0) & (at + step < shape)).all():
            yield int(np.ravel_multi_index(at + step, shape)), step * h


def enters(f, step, grid, half_width):
    """Whether a cell not in the band, a ``step`` from one with the closest point ``f``, is met.

    It is where the tangent plane at the closest point comes close enough; then it is offered the closest points of all
    its neighbours.
    """
    h, through = np.array(grid[3:]), f - step
    flat = (through @ f) / (f @ f) * f if f @ f > 0.1 * h.min() ** 2 else through
    return np.linalg.norm(flat / h) <= half_width + march.SLACK


def march_in_order(grid, cells, closest_point, state, half_width):
    """Closest points {cell: closest point} passed on as they are in order of distance, nearest first, by those within
    ``half_width``.

    From the closest points of the slots that are not OPEN in ``state``, which stay. A closest point may come closer on
    its way (to a third cell, past one that has a closer one): a cell that is passed then takes it over and hands it on
    once more.
    """
    known = {
        int(c): np.float32(f)
        for c, f, s in zip(cells, closest_point, state, strict=True)
        if s != march.OPEN
    }
    fixed, waiting = (
        set(known),
        {int(c) for c, s in zip(cells, state, strict=True) if s == march.OPEN},
    )
    h, best, queue = np.array(grid[3:]), {}, []

    def hand_on(cell):
        f = known[cell].astype(float)
        if np.linalg.norm(f / h) > half_width:
            return
        for target, step in cells_beside(cell, grid):
            if target in fixed:
                continue
            if enters(f, step, grid, half_width):
                waiting.add(target)
            d = np.linalg.norm(f - step)
            better = d < best.get(target, (np.inf,))[0] - 1e-6
            if better:
                best[target] = d, np.float32(f - step)
            if target in waiting and (better or target not in known):
                heapq.heappush(queue, (best[target][0], target))

    for cell in sorted(known):
        hand_on(cell)
    while queue:
        d, cell = heapq.heappop(queue)
        if d == best[cell][0] and known.get(cell) is not best[cell][1]:
            known[cell] = best[cell][1]
            hand_on(cell)
    return known


def march_by_rounds(psi, grid, cells, closest_point, state, half_width):
    """Closest points {cell: closest point} passed on round by round, as those of the last one stood, from the slots
    that are not OPEN.

    Those stay. A cell looks where a neighbour within ``half_width`` has changed, takes the closest over when it is so
    by `CLOSER`, and hands it on. Its first closest point is polished at once, others at last. Returns the number of
    those too.
    """
    known = {
        int(c): np.float32(f)
        for c, f, s in zip(cells, closest_point, state, strict=True)
        if s != march.OPEN
    }
    asked = {int(c) for c, s in zip(cells, state, strict=True) if s == march.OPEN}
    changed = [int(c) for c, s in zip(cells, state, strict=True) if s == march.EDGE]
    fixed, band, later, h = set(known), set(known) | asked, set(), np.array(grid[3:])

    def polished(cell, f):
        closest_points = np.array([f], np.float32)
        march.refine_closest_points(
            0,
            1,
            psi,
            grid,
            np.array([cell]),
            np.array([0]),
            closest_points,
            (np.zeros(1, np.float32), False),
        )
        return closest_points[0]

    while True:
        for cell in changed:
            f = known[cell].astype(float)
            for target, step in cells_beside(cell, grid):
                if np.linalg.norm(f / h) <= half_width and (
                    target in band or enters(f, step, grid, half_width)
                ):
                    asked.add(target)
        asked -= fixed
        band |= asked
        if not asked:
            break
        taken = {}
        for cell in asked:
            offers = [
                known[other] + step for other, step in cells_beside(cell, grid) if other in known
            ]
            lengths = [np.sqrt((offer**2).sum()) for offer in offers]
            own = known.get(cell, np.full(3, np.inf)).astype(float)
            least = np.sqrt((own**2).sum()) - march.MIN_GAIN * h.min()
            if min(lengths, default=np.inf) < least:
                taken[cell] = np.float32(offers[int(np.argmin(lengths))])
        later |= set(taken) & set(known)
        known |= {c: f if c in known else polished(c, f) for c, f in taken.items()}
        changed, asked = list(taken), set()
    return {c: polished(c, f) if c in later else f for c, f in known.items()}, len(later)


def front_cells(psi):
    """Mask of the voxels with a 6-neighbour on the other side."""
    inside = np.asarray(psi) < 0
    front = np.zeros(inside.shape, bool)
    for a in range(3):
        crossing = np.diff(inside, axis=a)
        front |= np.insert(crossing, 0, False, axis=a) | np.insert(
            crossing, crossing.shape[a], False, axis=a
        )
    return front


# ------------------------------------------------------------------------------------------------------ differences


def padded(psi, border):
    """One voxel more on each side: continued ``straight``, as a ``parabola`` or ``mirrored`` at the border's faces."""
    out = np.asarray(psi, float)
    for a in range(3):
        ends = []
        for order in (1, -1):
            one, two, three = (
                np.take(out, [order * i - (order < 0)], axis=a, mode="wrap") for i in range(3)
            )
            if border == "mirrored" or out.shape[a] == 1:
                ends.append(one)
            elif border == "straight" or out.shape[a] == 2:
                ends.append(2 * one - two)
            else:
                ends.append(3 * one - 3 * two + three)
        out = np.concatenate([ends[0], out, ends[1]], axis=a)
    return out


def derivatives(psi, spacing, mirrored=False):
    """Gradient (..., 3) and matrix of second derivatives (..., 3, 3), centred; ``mirrored`` at the border or continued.

    Continued as a parabola, but for the mixed derivatives straight.
    """
    wide = padded(psi, "mirrored" if mirrored else "parabola")
    across = wide if mirrored else padded(psi, "straight")

    def shifted(*steps, wide=wide):
        return wide[tuple(slice(1 + s, n - 1 + s) for s, n in zip(steps, wide.shape, strict=True))]

    unit = np.eye(3, dtype=int)
    first = [(shifted(*e) - shifted(*-e)) / (2 * h) for e, h in zip(unit, spacing, strict=True)]
    second = np.empty((*np.shape(psi), 3, 3))
    for a, b in itertools.product(range(3), repeat=2):
        ea, eb = unit[a], unit[b]
        if a == b:
            second[..., a, a] = (shifted(*ea) - 2 * shifted(0, 0, 0) + shifted(*-ea)) / spacing[
                a
            ] ** 2
        else:
            sum_ = shifted(*ea + eb, wide=across) + shifted(*-ea - eb, wide=across)
            sum_ = sum_ - shifted(*ea - eb, wide=across) - shifted(*eb - ea, wide=across)
            second[..., a, b] = sum_ / (4 * spacing[a] * spacing[b])
    return np.stack(first, axis=-1), second


def principal_curvatures(psi, spacing, mirrored=False):
    """Principal curvatures (..., 2) of the levels: eigenvalues of the second derivatives in the tangent plane."""
    gradient, second = derivatives(psi, spacing, mirrored)
    norm = np.linalg.norm(gradient, axis=-1)
    # A Householder matrix whose columns are the normal and two tangents.
    normal = gradient / np.maximum(norm, 1e-12)[..., None]
    v = normal + np.where(normal[..., :1] >= 0, 1.0, -1.0) * np.array([1.0, 0, 0])
    house = np.eye(3) - 2 * v[..., :, None] * v[..., None, :] / (v**2).sum(axis=-1)[..., None, None]
    tangents = house[..., :, 1:]
    shape_operator = np.einsum("...ai,...ab,...bj->...ij", tangents, second, tangents)
    return np.linalg.eigvalsh(shape_operator) / np.maximum(norm, 1e-12)[..., None]


def surface_curvature(psi, spacing, mirrored=False):
    """Sum of the principal curvatures of the surface that lies psi off each voxel: each is k/(1 - psi k)."""
    k = principal_curvatures(psi, spacing, mirrored)
    bend = 1 - np.asarray(psi, float)[..., None] * k
    most = 2 / min(spacing)
    moved = np.where(
        bend.prod(axis=-1) > 0.2, (k / np.where(bend == 0, 1, bend)).sum(axis=-1), k.sum(axis=-1)
    )
    return np.clip(moved, -most, most)


def one_sided(line, h):
    """Second-order ENO differences (D-, D+) of a 1D array, first order beside its ends."""
    n = len(line)
    if n == 1:
        return np.zeros(1), np.zeros(1)
    slope = np.diff(line) / h
    down, up = np.concatenate([slope[:1], slope]), np.concatenate([slope, slope[-1:]])
    bend = np.full(n, np.nan)
    bend[1:-1] = np.diff(slope) / h
    for i in range(1, n - 1):
        for side, array, sign in ((i - 1, down, 1), (i + 1, up, -1)):
            pair = bend[i], bend[side]
            if not np.isnan(pair).any() and np.sign(pair[0]) == np.sign(pair[1]):
                array[i] += sign * h / 2 * min(pair, key=abs)
    return down, up


def godunov_norm(psi, spacing, shrinking):
    """|grad psi| of psi_t = beta |grad psi| by Godunov's theorem, axis by axis; ``shrinking`` (mask) says beta > 0.

    The extremum of p^2 over the slopes between D- and D+: beta > 0 takes the largest where D- <= D+ and the
    smallest where D- > D+; beta < 0 the other way round.
    """
    psi = np.asarray(psi, float)
    total = np.zeros(psi.shape)
    for a, h in enumerate(spacing):
        down, up = np.empty(psi.shape), np.empty(psi.shape)
        for index in np.ndindex(*np.delete(psi.shape, a)):
            line = (*index[:a], slice(None), *index[a:])
            down[line], up[line] = one_sided(psi[line], h)
        low, high = np.minimum(down, up), np.maximum(down, up)
        most = np.maximum(low**2, high**2)
        least = np.where((low < 0) & (high > 0), 0.0, np.minimum(low**2, high**2))
        total += np.where((down <= up) == np.asarray(shrinking), most, least)
    return np.sqrt(total)


def known_slopes(values, present, spacing):
    """Derivatives (z, y, x, 3) of ``values`` by their ``present`` voxels: the mean of what the two sides say."""
    out = np.zeros((*present.shape, 3))
    for cell in np.argwhere(present):
        for a, h in enumerate(spacing):
            sides = []
            for step in (-1, 1):
                other = cell + step * np.eye(3, dtype=int)[a]
                if 0 <= other[a] < present.shape[a] and present[tuple(other)]:
                    sides.append(
                        (float(values[tuple(other)]) - float(values[tuple(cell)])) / (step * h)
                    )
            out[(*cell, a)] = np.mean(sides) if sides else 0.0
    return out


# ----------------------------------------------------------------------------------------------- regions and motion


def cut_voxel(psi, gradient, spacing):
    """(share inside, area) of a voxel cut by psi + n.x = 0: convex hull and polygon of the cut's corners."""
    h = np.asarray(spacing, float)
    normal = np.asarray(gradient, float) / np.linalg.norm(gradient)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * h
    value = psi + corners @ normal
    cut = []
    for i, j in itertools.combinations(range(8), 2):
        if np.count_nonzero(corners[i] != corners[j]) == 1 and (value[i] < 0) != (value[j] < 0):
            t = value[i] / (value[i] - value[j])
            cut.append(corners[i] + t * (corners[j] - corners[i]))
    if not cut:
        return float(psi < 0), 0.0
    ring = np.array(cut)
    solid = spatial.ConvexHull(np.concatenate([corners[value < 0], ring]), qhull_options="QJ Pp")
    middle = ring.mean(axis=0)
    u = np.linalg.svd(normal[None])[2][1:]
    angle = np.arctan2(*((ring - middle) @ u.T).T)
    ring = ring[np.argsort(angle)] - middle
    area = 0.5 * abs(
        sum(
            np.dot(normal, np.cross(p, q))
            for p, q in zip(ring, np.roll(ring, -1, axis=0), strict=True)
        )
    )
    return solid.volume / h.prod(), area


def smeared_share(s, epsilon):
    """Share inside at signed distance ``s`` (voxels): the integral of the delta function from s to epsilon."""
    if abs(s) >= epsilon:
        return float(s < 0)
    return integrate.quad(lambda t: (1 + np.cos(np.pi * t / epsilon)) / (2 * epsilon), s, epsilon)[
        0
    ]


def laplacian(values, present, spacing):
    """7-point Laplacian of (z, y, x) ``values``; no flux to voxels not ``present`` or beyond the border."""
    out = np.zeros(values.shape)
    for cell in np.ndindex(*values.shape):
        for a, side in itertools.product(range(3), (-1, 1)):
            other = list(cell)
            other[a] += side
            if 0 <= other[a] < values.shape[a] and present[tuple(other)]:
                out[cell] += (float(values[tuple(other)]) - float(values[cell])) / spacing[a] ** 2
    return out


def kick(beta, gain, curvature, damping, dm):
    """beta+ solves beta+ - beta = gain - damping (beta + beta+)/2 + dm beta beta+ H/2."""
    return (beta - damping * beta / 2 + gain) / np.maximum(
        1 + damping / 2 - dm * beta * curvature / 2, 0.2
    )


def departure(velocity, present, spacing, target, dt, rounds=3, farthest=2.0):
    """Index position after ``rounds`` of at = target - dt V(at), (z, y, x, 3) velocity, at most ``farthest`` voxels.

    In the first round V is interpolated linearly.
    """
    at = np.array(target, float)
    for turn in range(rounds):
        if turn == 0:
            parts = [known_linear(velocity[..., c], present, at) for c in range(3)]
            v, found = np.array([value for value, _ in parts]), parts[0][1]
        else:
            v, found = band_vector(velocity, present, at)
        if not found:
            break
        at = target - np.clip(dt * v / np.asarray(spacing), -farthest, farthest)
    return at


def area_stretch(f, normal):
    """Area of the image under the matrix ``f`` of a unit square normal to ``normal``: of two tangents' images."""
    one, other = np.linalg.svd(np.asarray(normal, float)[None])[2][1:]
    return np.linalg.norm(np.cross(f @ one, f @ other))


def tube_matrix(eta, present, spacing, length):
    """Matrix of eta - length^2 div(eta grad) on the ``present`` (z, y, x) voxels, edge by edge."""
    eta = np.asarray(eta, float)
    index = np.arange(eta.size).reshape(eta.shape)
    out = np.diag(eta.ravel())
    for a, h in enumerate(spacing):
        low, high = np.moveaxis(index, a, 0)[:-1].ravel(), np.moveaxis(index, a, 0)[1:].ravel()
        for i, j in zip(low, high, strict=True):
            if present.flat[i] and present.flat[j]:
                edge = np.zeros(eta.size)
                edge[i], edge[j] = 1 / h, -1 / h
                out += length**2 * (eta.flat[i] + eta.flat[j]) / 2 * np.outer(edge, edge)
    return out


def small_components(psi, most):
    """(psi with the sign flipped on 6-connected components of at most ``most`` voxels, removed inside, outside)."""
    out, removed = np.array(psi), []
    for side in (psi < 0, psi >= 0):
        labels, _ = ndimage.label(side)
        sizes = np.bincount(labels.ravel())
        small = np.flatnonzero((sizes <= most) & (np.arange(sizes.size) > 0))
        out[np.isin(labels, small)] *= -1
        removed.append(small.size)
    return out, *removed


# ---------------------------------------------------------------------------------------------------------- windows


def node_weights(n, distance, before, half_width, count) -> np.ndarray:
    """Tent (nodes, voxels) of half width ``half_width`` nodes at each node of an axis, by its formula."""
    if count == 1:
        return np.ones((1, n))
    place = np.arange(n) / distance + before
    away = np.abs(np.arange(count)[:, None] - place[None, :])
    return np.maximum(1.0 - away / half_width, 0.0) / half_width


def window_sums(values, weights) -> np.ndarray:
    """Sums of ``values`` (nz, ny, nx) over the window of every node; ``weights`` per axis as `node_weights`."""
    return np.einsum("az,by,cx,zyx->abc", *weights, values)


def local_energy(image, share, weights) -> float:
    """Squares about the mean inside and the mean outside of every window, ``share`` (nz, ny, nx) being inside."""
    total = 0.0
    for part in (share, 1.0 - share):
        n, one, two = (window_sums(part * image**power, weights) for power in range(3))
        on = n > 1e-9
        total += float((two[on] - one[on] ** 2 / n[on]).sum())
    return total


def histogram(values, weights, low, per_value, bins) -> np.ndarray:
    """Each value shared by the two bins next to it, one value at a time."""
    out = np.zeros(bins)
    for value, weight in zip(np.ravel(values), np.ravel(weights), strict=True):
        place = min(max((float(value) - low) * per_value, 0.0), bins - 1.0)
        for b in range(bins):
            out[b] += weight * max(0.0, 1.0 - abs(place - b))
    return out
