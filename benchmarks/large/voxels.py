"""Voxels of any box of a large phantom, image and truth: each follows from the scene and its own index alone.

The image is what a Gaussian blur of one voxel leaves of plain grey values, by the distance to the surface, with noise
by a hash of the voxel's number. So chunks of any size, made in any order, are those of the whole.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.large.scene import Scene

Box = tuple[slice, slice, slice]
#: Label of the tree; cells have 1, 2, 3 and so on.
TREE = 65535
#: Grey values, and the standard deviation of the noise.
BACKGROUND, VESSEL, CELL, NOISE = 60.0, 170.0, 125.0, 8.0
#: Width of the blurred edge to each side of the surface, voxels: a cubic step that is as wide as a Gaussian of sigma 1.
BLUR = 2.0


def image(scene: Scene, box: Box) -> NDArray[np.uint8]:
    """Grey values of a box, as an array of its shape."""
    tree, cells, _ = _distances(scene, box)
    first = np.array([side.start for side in box], np.int64)
    out = np.empty(tree.shape, np.uint8)
    _grey(out, tree, cells, first, scene.size, np.uint64(scene.seed))
    return out


def truth(scene: Scene, box: Box) -> NDArray[np.uint16]:
    """Labels of a box: 0, the cell's number, or `TREE`."""
    tree, cells, nearest = _distances(scene, box)
    labels = np.where(cells < 0.0, nearest, 0).astype(np.uint16)
    labels[tree < 0.0] = TREE
    return labels


def tree_distance(scene: Scene, step: int, within: float) -> NDArray[np.float32]:
    """Distance to the tree, voxels, at the centres of cubes of ``step`` voxels; at most ``within``."""
    out = np.full((-(-scene.size // step),) * 3, within / step, np.float32)
    scaled = (scene.capsules - (step - 1) / 2) / step  # positions in cubes
    scaled[:, 6] = scene.capsules[:, 6] / step
    for capsule in scaled:
        _capsule(out, np.zeros(3, np.int64), capsule, within / step)
    return out * np.float32(step)


def _distances(
    scene: Scene, box: Box
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Distances to the tree and to the nearest cell, voxels, negative inside and at most `BLUR`; that cell's label."""
    first, last = (
        np.array([getattr(side, end) for side in box], np.int64) for end in ("start", "stop")
    )
    shape = tuple(int(n) for n in last - first)
    tree = np.full(shape, BLUR, np.float32)
    cells, nearest = tree.copy(), np.zeros(shape, np.int32)
    low, high = first - BLUR, last - 1 + BLUR
    ends = np.stack([scene.capsules[:, :3], scene.capsules[:, 3:6]])
    radius = scene.capsules[:, 6:]
    near = ((ends.min(axis=0) - radius <= high) & (ends.max(axis=0) + radius >= low)).all(axis=1)
    for capsule in scene.capsules[near]:
        _capsule(tree, first, capsule, BLUR)
    reach = scene.axes.max(axis=1, keepdims=True)
    near = ((scene.centres - reach <= high) & (scene.centres + reach >= low)).all(axis=1)
    for number in np.flatnonzero(near):
        _ellipsoid(
            cells,
            nearest,
            first,
            scene.centres[number],
            scene.axes[number],
            scene.rotations[number],
            number,
        )
    return tree, cells, nearest


@numba.njit(nogil=True, cache=True)
def _range(low, high, first, count):
    """Voxels of an axis of a box between two positions, the larger one included."""
    begin = int(np.ceil(low)) - first
    end = int(np.floor(high)) - first + 1
    return max(begin, 0), min(end, count)


@numba.njit(nogil=True, cache=True)
def _capsule(out, first, capsule, within):
    """Lower distances to that of one capsule, where it is less than ``within``."""
    az, ay, ax, bz, by, bx, radius = capsule
    dz = bz - az
    dy = by - ay
    dx = bx - ax
    square = max(dz * dz + dy * dy + dx * dx, 1e-30)
    wide = radius + within
    z0, z1 = _range(min(az, bz) - wide, max(az, bz) + wide, first[0], out.shape[0])
    y0, y1 = _range(min(ay, by) - wide, max(ay, by) + wide, first[1], out.shape[1])
    x0, x1 = _range(min(ax, bx) - wide, max(ax, bx) + wide, first[2], out.shape[2])
    for z in range(z0, z1):
        pz = z + first[0] - az
        for y in range(y0, y1):
            py = y + first[1] - ay
            for x in range(x0, x1):
                px = x + first[2] - ax
                share = min(max((pz * dz + py * dy + px * dx) / square, 0.0), 1.0)
                ez = pz - share * dz
                ey = py - share * dy
                ex = px - share * dx
                squared = ez * ez + ey * ey + ex * ex
                if squared < wide * wide:
                    distance = np.float32(np.sqrt(squared) - radius)
                    if distance < out[z, y, x]:
                        out[z, y, x] = distance


@numba.njit(nogil=True, cache=True)
def _ellipsoid(out, nearest, first, centre, axes, rows, number):
    """Lower distances to that of one ellipsoid, to first order, and label where that is so.

    With k = |p / axes| and m = |p / axes^2| the distance is about k (k - 1) / m: exact sign, unit slope at the surface.
    """
    wide = max(axes[0], axes[1], axes[2]) + BLUR
    z0, z1 = _range(centre[0] - wide, centre[0] + wide, first[0], out.shape[0])
    y0, y1 = _range(centre[1] - wide, centre[1] + wide, first[1], out.shape[1])
    x0, x1 = _range(centre[2] - wide, centre[2] + wide, first[2], out.shape[2])
    for z in range(z0, z1):
        pz = z + first[0] - centre[0]
        for y in range(y0, y1):
            py = y + first[1] - centre[1]
            for x in range(x0, x1):
                px = x + first[2] - centre[2]
                k = m = 0.0
                for i in range(3):
                    q = (rows[i, 0] * pz + rows[i, 1] * py + rows[i, 2] * px) / axes[i]
                    k += q * q
                    m += q * q / (axes[i] * axes[i])
                k = np.sqrt(k)
                distance = np.float32(k * (k - 1.0) / np.sqrt(m)) if m > 0.0 else np.float32(-wide)
                if distance < out[z, y, x]:
                    out[z, y, x] = distance
                    nearest[z, y, x] = number + 1


@numba.njit(nogil=True, cache=True)
def _inside(distance):
    """How much of a voxel's blurred surroundings is inside: 1/2 at the surface."""
    t = min(max(0.5 - np.float64(distance) / (2.0 * BLUR), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@numba.njit(nogil=True, cache=True)
def _grey(out, tree, cells, first, size, seed):
    """Grey values from distances, plus noise: the sum of four 16-bit parts of a hash (splitmix64), nearly Gaussian."""
    scale = NOISE / (65536.0 / np.sqrt(3.0))
    key = seed * np.uint64(0x9E3779B97F4A7C15)
    low = np.uint64(0xFFFF)
    for z in range(out.shape[0]):
        for y in range(out.shape[1]):
            row = np.uint64(((z + first[0]) * size + y + first[1]) * size + first[2])
            for x in range(out.shape[2]):
                h = (row + np.uint64(x) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + key
                h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                h = h ^ (h >> np.uint64(31))
                total = (
                    (h & low)
                    + ((h >> np.uint64(16)) & low)
                    + ((h >> np.uint64(32)) & low)
                    + (h >> np.uint64(48))
                )
                grey = BACKGROUND + (np.float64(total) - 131070.0) * scale
                grey += (VESSEL - BACKGROUND) * _inside(tree[z, y, x]) + (
                    CELL - BACKGROUND
                ) * _inside(cells[z, y, x])
                out[z, y, x] = np.uint8(min(max(np.floor(grey + 0.5), 0.0), 255.0))


@numba.njit(nogil=True, cache=True)
def halved(fine):
    """Means of blocks of two voxels along each axis, to the nearest even number where half-way; fewer at the end."""
    shape = ((fine.shape[0] + 1) // 2, (fine.shape[1] + 1) // 2, (fine.shape[2] + 1) // 2)
    out = np.empty(shape, np.uint8)
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                total = count = 0
                for i in range(2 * z, min(2 * z + 2, fine.shape[0])):
                    for j in range(2 * y, min(2 * y + 2, fine.shape[1])):
                        for k in range(2 * x, min(2 * x + 2, fine.shape[2])):
                            total += np.int64(fine[i, j, k])
                            count += 1
                mean, over = total // count, 2 * (total % count)
                if over > count or (over == count and mean % 2 == 1):
                    mean += 1
                out[z, y, x] = mean
    return out
