"""Geodesic arrival times: an ordered march from a set of voxels through a medium with a cost per mm.

|grad T| = c, with T given at the seeds: first-order Godunov differences, voxels accepted in the order of their times
(the fast marching method of Tsitsiklis and of Sethian). Where it is asked from which seed the front came, T = tau r, r
the distance from that seed, and the differences are those of tau: they are exact where c is constant, as first-order
differences of T beside a point are not (the factored equation of Fomel, Luo and Zhao, 2009).

Shortest paths over a grid from a set of voxels: every step costs its length and the change of the values.

L(x) = min over the neighbours y of L(y) + c(x, y), 0 at the seeds: relaxed row by row, back and forth in each plane,
and plane by plane, until nothing becomes shorter. The least solution does not depend on the order, as rounding keeps
the order of numbers; so these are the lengths of an ordered search (Dijkstra), without a queue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel

#: First capacity of the queue and of the list of accepted voxels; both double when full.
FIRST_CAPACITY = 4096
#: A voxel has at most so many open neighbours, each of which enters the queue at most once when it is accepted.
SIDES = 6
#: A front came through one cost if its time is that of the straight way up to this part.
EVEN = 1e-3
#: Where fronts of several owners meet, the order is strict to this part of a bucket.
FINER = 16.0


class Medium(NamedTuple):
    """Medium that the march goes through.

    ``values`` (channels, n) float32; ``open`` (n,) bool, False where nothing passes, or (0,) where all is open.
    """

    values: np.ndarray
    open: np.ndarray


class Appearance(NamedTuple):
    """Values that fronts pass easily: per channel (channels,) float64 median and spread of the values, and the gradient
    (per mm) that counts as 1; and the weights of the cost, see `cost_at`.
    """

    median: np.ndarray
    spread: np.ndarray
    gradient: np.ndarray
    weights: np.ndarray


class Sources(NamedTuple):
    """Whose the front is: ``origin`` (n,) int32 or int64 is to become the seed voxel from which it came to each voxel,
    -1 where it does not come; ``owner`` (n,) int32 is whose a seed is. Both (0,) where nobody asks.
    """

    origin: np.ndarray
    owner: np.ndarray


class Queue(NamedTuple):
    """Voxels by their times: ``heads`` (ring of buckets) the last entry of each, -1 for none; ``entries`` (m, 2), each
    a voxel and the entry before it, or the next free one; ``free`` (1,) the first free entry.
    """

    heads: np.ndarray
    entries: np.ndarray
    free: np.ndarray


@kernel
def march(times, medium, appearance, grid, seeds, cap, sources):
    """Accept voxels in the order of their arrival times, from the seeds outwards.

    Parameters
    ----------
    times : ndarray (n,) float32
        At the seeds their times, at least 0, which are final; inf at all others. On return the times of the accepted
        voxels, inf at all others. While it runs, a time that is not final is stored as its negative.
    medium : Medium
    appearance : Appearance
    grid : Grid
    seeds : ndarray (k,) int64
        Each once. A seed starts also where nothing passes.
    cap : ndarray (n,) or (0,) float32
        A voxel is accepted only if its time is below its cap; without elements there is none.
    sources : Sources
        Of fronts of several owners each voxel takes the one that comes first.

    Returns
    -------
    ndarray (m,) int64
        The accepted voxels, seeds included, in the order of their times up to `bucket_width`; within it in an order
        that depends on the input alone.
    """
    width = bucket_width(appearance.weights, grid)
    if len(sources.origin) > 0:
        width /= FINER
    queue = new_queue(appearance.weights, grid, width)
    costs = np.empty(
        len(times)
    )  # of the voxels that a front has come to; memory that nobody writes to costs nothing
    order = np.empty(max(FIRST_CAPACITY, len(seeds)), np.int64)
    order[: len(seeds)] = seeds
    if len(sources.origin) > 0:
        sources.origin[:] = -1
        for cell in seeds:
            sources.origin[cell] = cell
    done = 0
    count = len(seeds)
    waiting = 0
    bucket = np.int64(0)
    while True:
        while done < count:
            if waiting + SIDES > len(queue.entries):
                queue = larger(queue)
            waiting += offer(
                times, costs, order[done], medium, appearance, grid, (cap, width, sources), queue
            )
            done += 1
        if waiting == 0:
            break
        bucket = first_filled(queue, bucket)
        cell = leave(queue, bucket)
        waiting -= 1
        if times[cell] < 0.0 and np.int64(-times[cell] / width) <= bucket:
            times[cell] = -times[cell]
            if count == len(order):
                order = np.concatenate((order, np.empty(count, np.int64)))
            order[count] = cell
            count += 1
    return order[:count].copy()


@kernel(inlined=True)
def offer(times, costs, cell, medium, appearance, grid, limits, queue):
    """Enter the neighbours that a voxel with a final time brings an earlier one; returns how many.

    ``limits`` are (cap, width of a bucket, sources) of `march`; the queue has space for all.
    """
    cap, width, sources = limits
    iz, iy, ix = unravel(cell, grid)
    time, entered = times[cell], 0
    for side in range(SIDES):
        axis, step = side // 2, 2 * (side % 2) - 1
        index = iz if axis == 0 else iy if axis == 1 else ix
        length = grid.nz if axis == 0 else grid.ny if axis == 1 else grid.nx
        stride = step * (grid.ny * grid.nx if axis == 0 else grid.nx if axis == 1 else 1)
        if not 0 <= index + step < length:
            continue
        other = cell + stride
        before = times[other]
        if 0.0 <= before < np.inf or (len(medium.open) > 0 and not medium.open[other]):
            continue
        if (
            0 <= index + 2 * step < length
            and 0.0 <= times[other + stride] < time
            and is_same_owner(sources, cell, other + stride)
        ):
            continue  # along this axis it has been reached earlier, from beyond it
        at = (
            iz + (step if axis == 0 else 0),
            iy + (step if axis == 1 else 0),
            ix + (step if axis == 2 else 0),
        )
        if before == np.inf:
            costs[other] = cost_at(other, at, medium, appearance, grid)
        if len(sources.origin) == 0:
            found = np.float32(upwind_time(times, other, at, costs[other], grid))
            come_from = cell
        else:
            found, come_from = first_of_all(
                times, sources, other, at, (costs[other], appearance.weights[0]), grid
            )
        if found < abs(before) and (len(cap) == 0 or found < cap[other]):
            times[other] = -found
            if len(sources.origin) > 0:
                sources.origin[other] = sources.origin[come_from]
            enter(queue, np.int64(max(found, time) / width), other)
            entered += 1
    return entered


@kernel
def bucket_width(w, grid):
    """Times of one bucket: half the shortest step between two voxels, within which the order is free."""
    return w[0] * min(grid.hz, grid.hy, grid.hx) / 2.0


@kernel
def new_queue(w, grid, width):
    """An empty queue: buckets in a ring, longer than the longest step."""
    step = (w[0] + w[1] * w[2] + w[3] * w[5]) * max(grid.hz, grid.hy, grid.hx)
    length = 2
    while length * width < step + 2.0 * width:
        length *= 2
    return empty_queue(length)


@kernel
def empty_queue(length):
    """An empty queue with so many buckets, a power of two."""
    entries = np.empty((FIRST_CAPACITY, 2), np.int64)
    entries[:, 1] = np.arange(1, FIRST_CAPACITY + 1)
    return Queue(np.full(length, -1, np.int64), entries, np.zeros(1, np.int64))


@kernel
def larger(queue):
    """The queue with space for twice as many entries; those that were free remain so."""
    size = len(queue.entries)
    entries = np.empty((2 * size, 2), np.int64)
    entries[:size] = queue.entries
    entries[size:, 1] = np.arange(size + 1, 2 * size + 1)
    return Queue(queue.heads, entries, queue.free)


@kernel(inlined=True)
def enter(queue, bucket, cell):
    """Enter a voxel into a bucket; the queue has space."""
    entry = queue.free[0]
    place = bucket & (len(queue.heads) - 1)
    queue.free[0] = queue.entries[entry, 1]
    queue.entries[entry, 0], queue.entries[entry, 1] = cell, queue.heads[place]
    queue.heads[place] = entry


@kernel(inlined=True)
def first_filled(queue, bucket):
    """The first bucket from this one on that is not empty, of a queue that is not empty."""
    while queue.heads[bucket & (len(queue.heads) - 1)] < 0:
        bucket += 1
    return bucket


@kernel(inlined=True)
def leave(queue, bucket):
    """Take the voxel that entered a bucket last, which is not empty."""
    place = bucket & (len(queue.heads) - 1)
    entry = queue.heads[place]
    queue.heads[place] = queue.entries[entry, 1]
    queue.entries[entry, 1] = queue.free[0]
    queue.free[0] = entry
    return queue.entries[entry, 0]


@kernel(inlined=True)
def upwind_time(times, cell, at, cost, grid):
    """Solution T of sum over the axes of (max(T - T_i, 0)/h_i)^2 = c^2, T_i the earlier final time of two neighbours.

    Axis by axis in the order of T_i, as long as the solution is later than the next one.
    """
    a = earlier(times, cell, at[0], grid.nz, grid.ny * grid.nx)
    b = earlier(times, cell, at[1], grid.ny, grid.nx)
    c = earlier(times, cell, at[2], grid.nx, 1)
    ha = grid.hz
    hb = grid.hy
    hc = grid.hx
    if b < a:
        a, b, ha, hb = b, a, hb, ha
    if c < b:
        b, c, hb, hc = c, b, hc, hb
    if b < a:
        a, b, ha, hb = b, a, hb, ha
    time = a + cost * ha
    if time <= b:
        return time
    wa, wb = 1.0 / (ha * ha), 1.0 / (hb * hb)
    time = later_root(cost, wa, wb, 0.0, b - a, 0.0) + a
    if time <= c:
        return time
    return later_root(cost, wa, wb, 1.0 / (hc * hc), b - a, c - a) + a


@kernel(inlined=True)
def is_same_owner(sources, cell, other):
    """Test if two voxels were reached by fronts of one owner; True where no owners are given."""
    origin, owner = sources
    return len(origin) == 0 or owner[origin[cell]] == owner[origin[other]]


@kernel(inlined=True)
def first_of_all(times, sources, cell, at, costs, grid):
    """Earliest time at which a front comes to a voxel from its neighbours, and the neighbour that it comes from."""
    first, come_from = np.float32(np.inf), np.int64(-1)
    for side in range(SIDES):
        axis, step = side // 2, 2 * (side % 2) - 1
        index = at[0] if axis == 0 else at[1] if axis == 1 else at[2]
        length = grid.nz if axis == 0 else grid.ny if axis == 1 else grid.nx
        if not 0 <= index + step < length:
            continue
        beside = cell + step * (grid.ny * grid.nx if axis == 0 else grid.nx if axis == 1 else 1)
        if not 0.0 <= times[beside] < np.inf:
            continue
        if come_from >= 0 and sources.origin[come_from] == sources.origin[beside]:
            continue
        found = np.float32(factored_time(times, sources, (cell, beside), at, costs, grid))
        if found < first:
            first, come_from = found, beside
    return first, come_from


@kernel(inlined=True)
def factored_time(times, sources, cells, at, costs, grid):
    """Time at which the front that came to ``cells[1]`` comes to ``cells[0]``, its neighbour at ``at``.

    T = tau r, r the distance from the front's seed; along each axis the earlier neighbour of the same owner has tau_i,
    and d_i T = a_i tau - b_i, a_i = r/h +- d_i r, b_i = r tau_i/h. The least solution over sets of axes that is upwind
    along each, or straight on from one neighbour. ``costs`` are that of the voxel and the least of all: no way is
    cheaper.
    """
    (cell, come_from), (cost, least_cost) = cells, costs
    source = sources.origin[come_from]
    sz, sy, sx = unravel(source, grid)
    dz = (at[0] - sz) * grid.hz
    dy = (at[1] - sy) * grid.hy
    dx = (at[2] - sx) * grid.hx
    r = np.sqrt(dz * dz + dy * dy + dx * dx)
    layer = grid.ny * grid.nx
    straight = is_straight(times, sources, come_from, cost, grid)
    if (
        straight
        and is_straight_beside(times, sources, cell, dz, layer, cost, grid)
        and is_straight_beside(times, sources, cell, dy, grid.nx, cost, grid)
        and is_straight_beside(times, sources, cell, dx, 1, cost, grid)
    ):
        return cost * r
    front = times, sources, cell, come_from, straight
    a0, b0, t0 = factored_axis(front, (at[0], grid.nz, layer, grid.hz), (dz, r), cost)
    a1, b1, t1 = factored_axis(front, (at[1], grid.ny, grid.nx, grid.hy), (dy, r), cost)
    a2, b2, t2 = factored_axis(front, (at[2], grid.nx, 1, grid.hx), (dx, r), cost)
    least = min(t0 + cost * grid.hz, t1 + cost * grid.hy, t2 + cost * grid.hx)
    for axes in range(3, 8):  # sets of two axes and of all three, as bits
        if axes == 4:
            continue
        u = axes & 1
        v = axes >> 1 & 1
        w = axes >> 2
        if (u and t0 == np.inf) or (v and t1 == np.inf) or (w and t2 == np.inf):
            continue
        square = u * a0 * a0 + v * a1 * a1 + w * a2 * a2
        mixed = u * a0 * b0 + v * a1 * b1 + w * a2 * b2
        rest = u * b0 * b0 + v * b1 * b1 + w * b2 * b2 - cost * cost
        root = mixed * mixed - square * rest
        if root < 0.0 or square == 0.0:
            continue
        tau = (mixed + np.sqrt(root)) / square
        if (
            (u and (a0 * tau < b0 or tau * r < t0))
            or (v and (a1 * tau < b1 or tau * r < t1))
            or (w and (a2 * tau < b2 or tau * r < t2))
        ):
            continue
        least = min(least, tau * r)
    return max(least, least_cost * r)


@kernel(inlined=True)
def is_straight(times, sources, cell, cost, grid):
    """Test if the front came to a voxel straight from its seed, at this cost all the way."""
    sz, sy, sx = unravel(sources.origin[cell], grid)
    iz, iy, ix = unravel(cell, grid)
    dz = (iz - sz) * grid.hz
    dy = (iy - sy) * grid.hy
    dx = (ix - sx) * grid.hx
    least = cost * np.sqrt(dz * dz + dy * dy + dx * dx)
    return abs(times[cell] - least) <= EVEN * least


@kernel(inlined=True)
def is_straight_beside(times, sources, cell, way, stride, cost, grid):
    """Test if the front at the next voxel towards the seed, ``way`` away, came there straight."""
    if way == 0.0:
        return True
    towards = cell - stride if way > 0.0 else cell + stride
    return 0.0 <= times[towards] < np.inf and is_straight(times, sources, towards, cost, grid)


@kernel(inlined=True)
def factored_axis(front, axis, place, cost):
    """(a, b, T) of `factored_time` along an axis: T of the earlier neighbour, inf without one.

    ``axis`` is (index, length, stride, spacing), ``place`` the distance from the seed along it, and in space.
    """
    index, length, stride, h = axis
    d, r = place
    before, after = np.inf, np.inf
    if index > 0:
        before = time_of_front(front, -stride)
    if index < length - 1:
        after = time_of_front(front, stride)
    earlier_time = min(before, after)
    if earlier_time == np.inf:
        return 0.0, 0.0, np.inf
    onwards = d if before <= after else -d
    distance = np.sqrt(max(r * r - 2.0 * onwards * h + h * h, 0.0))
    tau = earlier_time / distance if distance > 1e-6 * h else cost
    return r / h + onwards / r, r * tau / h, earlier_time


@kernel(inlined=True)
def time_of_front(front, stride):
    """Final time of a neighbour if its front is the same, inf otherwise.

    Fronts of one owner are one front; but where they come straight from seeds, each from its own.
    """
    times, sources, cell, come_from, straight = front
    other = cell + stride
    if not 0.0 <= times[other] < np.inf or not is_same_owner(sources, come_from, other):
        return np.inf
    if straight and sources.origin[other] != sources.origin[come_from]:
        return np.inf
    return np.float64(times[other])


@kernel(inlined=True)
def cost_at(cell, at, medium, appearance, grid):
    """Cost per mm: w0 + w1 min(|grad I|/g, w2) + w3 min(max(|I - median|/spread - w4, 0), w5), of the worst channel."""
    w, values = appearance.weights, medium.values
    edge, far = 0.0, 0.0
    for channel in range(len(values)):
        dz = difference(values, channel, cell, at[0], grid.nz, grid.ny * grid.nx) / grid.hz
        dy = difference(values, channel, cell, at[1], grid.ny, grid.nx) / grid.hy
        dx = difference(values, channel, cell, at[2], grid.nx, 1) / grid.hx
        edge = max(edge, np.sqrt(dz * dz + dy * dy + dx * dx) / appearance.gradient[channel])
        far = max(
            far,
            abs(values[channel, cell] - appearance.median[channel]) / appearance.spread[channel],
        )
    return w[0] + w[1] * min(edge, w[2]) + w[3] * min(max(far - w[4], 0.0), w[5])


@kernel(inlined=True)
def difference(values, channel, cell, index, length, stride):
    """Central difference per voxel along an axis; one-sided at the border."""
    before, after = (stride if index > 0 else 0), (stride if index < length - 1 else 0)
    if before + after == 0:
        return 0.0
    return (
        np.float64(values[channel, cell + after] - values[channel, cell - before])
        * stride
        / (before + after)
    )


@kernel(inlined=True)
def later_root(cost, wa, wb, wc, b, c):
    """The larger T of wa T^2 + wb (T - b)^2 + wc (T - c)^2 = cost^2."""
    total, first = wa + wb + wc, wb * b + wc * c
    rest = wb * b * b + wc * c * c - cost * cost
    return (first + np.sqrt(max(first * first - total * rest, 0.0))) / total


@kernel(inlined=True)
def earlier(times, cell, index, length, stride):
    """The earlier of the final times of the two neighbours along an axis; inf where neither is final."""
    before = np.float64(times[cell - stride]) if index > 0 else np.inf
    after = np.float64(times[cell + stride]) if index < length - 1 else np.inf
    before = before if before >= 0.0 else np.inf
    after = after if after >= 0.0 else np.inf
    return min(before, after)


@kernel
def shortest_paths(seeds, values, lengths, weight):
    """Length of the shortest path from the seeds to each voxel, over 6 neighbours.

    Parameters
    ----------
    seeds : ndarray (nz, ny, nx) bool
    values : ndarray (channels, nz, ny, nx) float32
    lengths : ndarray (3,) float64
        Of a step along z, y, x; above 0.
    weight : float
        A step costs sqrt(length^2 + (weight difference)^2), the difference over all channels.

    Returns
    -------
    ndarray (nz, ny, nx) float32
        Inf everywhere without seeds.
    """
    nz, ny, nx = seeds.shape
    far = np.where(seeds, np.float32(0.0), np.float32(np.inf))
    costs = step_costs(values, lengths, weight)
    # A row is looked at again only after a row beside it has changed: when that was, and when it was looked at.
    changed, looked = np.zeros((nz, ny), np.int64), np.full((nz, ny), np.int64(-1))
    now = np.int64(0)
    sweep = 0
    improves = True
    while improves:
        improves = False
        for i in range(nz):
            iz = i if sweep % 2 == 0 else nz - 1 - i
            for j in range(2 * ny):
                iy = j if j < ny else 2 * ny - 1 - j
                before = looked[iz, iy]
                now += 1
                looked[iz, iy] = now
                shorter = relax_from_beside(far, costs, iz, iy, changed, before)
                if shorter or before < 0:
                    relax_along(far[iz, iy], costs[2, iz, iy])
                    changed[iz, iy] = now
                    improves = True
        sweep += 1
    return far


@kernel
def step_costs(values, lengths, weight):
    """Cost (3, nz, ny, nx) float32 of the step to each voxel from the one before it along z, y, x; inf from beyond."""
    channels, nz, ny, nx = values.shape
    out = np.full((3, nz, ny, nx), np.float32(np.inf))
    for axis in range(3):
        dz = int(axis == 0)
        dy = int(axis == 1)
        dx = int(axis == 2)
        square, scale = np.float32(lengths[axis] ** 2), np.float32(weight)
        for iz in range(dz, nz):
            for iy in range(dy, ny):
                row = out[axis, iz, iy, dx:]
                row[:] = square
                for channel in range(channels):
                    here, before = (
                        values[channel, iz, iy, dx:],
                        values[channel, iz - dz, iy - dy, : nx - dx],
                    )
                    for k in range(nx - dx):
                        difference = scale * (here[k] - before[k])
                        row[k] += difference * difference
                for k in range(nx - dx):
                    row[k] = np.sqrt(row[k])
    return out


@kernel(inlined=True)
def relax_from_beside(far, costs, iz, iy, changed, before):
    """Shorten a row's paths by the four rows beside it that changed later than ``before``; whether one became so."""
    nz, ny, _ = far.shape
    row, shorter = far[iz, iy], False
    if iz > 0 and changed[iz - 1, iy] > before:
        shorter |= relax(row, far[iz - 1, iy], costs[0, iz, iy])
    if iz < nz - 1 and changed[iz + 1, iy] > before:
        shorter |= relax(row, far[iz + 1, iy], costs[0, iz + 1, iy])
    if iy > 0 and changed[iz, iy - 1] > before:
        shorter |= relax(row, far[iz, iy - 1], costs[1, iz, iy])
    if iy < ny - 1 and changed[iz, iy + 1] > before:
        shorter |= relax(row, far[iz, iy + 1], costs[1, iz, iy + 1])
    return shorter


@kernel(inlined=True)
def relax(row, other, costs):
    """Shorten the paths of a row by steps from another; whether one became shorter. No branch: it runs in vectors."""
    shorter = 0
    for k in range(len(row)):
        through = other[k] + costs[k]
        shorter |= through < row[k]
        row[k] = min(row[k], through)
    return shorter > 0


@kernel(inlined=True)
def relax_along(row, costs):
    """Shorten the paths of a row by steps within it, there and back."""
    # Branches: where nothing becomes shorter, as in most rows that are looked at again, no voxel waits for another.
    for k in range(1, len(row)):
        through = row[k - 1] + costs[k]
        if through < row[k]:
            row[k] = through
    for k in range(len(row) - 2, -1, -1):
        through = row[k + 1] + costs[k + 1]
        if through < row[k]:
            row[k] = through
