"""What is in a large phantom: capsules of a tree of vessels, and ellipsoids that are cells. No voxel is made here.

Positions are (z, y, x) in voxels, the first voxel's centre at 0. All follows from size, number of cells and seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Radii of vessels, voxels: the root's for the largest volumes, and the thinnest.
MAX_RADIUS, MIN_RADIUS = 25.0, 3.0
#: Voxels along an axis per voxel of the root's radius, and of a cell's mean radius, for smaller volumes.
PER_ROOT_RADIUS, PER_CELL_RADIUS = 40.0, 48.0
#: Mean radius of cells, voxels; a semi-axis is between `SEMI_AXES` times the mean of its volume's cells.
MIN_CELL, MAX_CELL, SEMI_AXES = 3.0, 24.0, (0.75, 1.25)
#: Least distance of the bounding ball of a cell to vessels and to other cells, voxels.
GAP = 5.0
#: Of so many cells one is put beside the one before, and so deep into it along the line of their centres, voxels.
EVERY_TOUCHING, OVERLAP = 5, 1.0
#: Tries to find room for a cell.
MAX_TRIES = 2000


@dataclass(frozen=True)
class Scene:
    """The objects of a phantom.

    Attributes
    ----------
    size : int
        Voxels along each axis.
    seed : int
    capsules : ndarray of float64, (m, 7)
        Both ends of each piece of the tree, and its radius; the root's first.
    centres : ndarray of float64, (n, 3)
        Of the cells; cell i has the label i + 1.
    axes : ndarray of float64, (n, 3)
        Semi-axes of the cells.
    rotations : ndarray of float64, (n, 3, 3)
        Rows are the directions of the semi-axes.
    touching : ndarray of int, (t, 2)
        Pairs of labels of cells that touch.
    """

    size: int
    seed: int
    capsules: Floats
    centres: Floats
    axes: Floats
    rotations: Floats
    touching: NDArray[np.int64]

    @classmethod
    def of(cls, size: int, seed: int = 0, cells: int = 1000) -> Scene:
        """Make the scene of a volume.

        Raises
        ------
        ValueError
            If the volume has no room for the cells.
        """
        capsules = tree(size, np.random.Generator(np.random.PCG64(seed)))
        chance = np.random.Generator(np.random.PCG64([seed, 1]))
        return cls(size, seed, capsules, *_cells(size, cells, capsules, chance))


def tree(size: int, chance: np.random.Generator) -> Floats:
    """Capsules (m, 7) of a tree that reaches every part of a cube of ``size`` voxels.

    A vessel supplies a box. It is cut across its longest axis, and a branch goes to the middle of each part, with a
    radius by Murray's law for a flow in proportion to the volume supplied: r^3 = r_1^3 + r_2^3. No two branches cross.
    """
    radius = float(np.clip(size / PER_ROOT_RADIUS, MIN_RADIUS, MAX_RADIUS))
    low, high = np.zeros(3), np.full(3, size - 1.0)
    entry, first = high * (0.0, 0.5, 0.5), high * (0.3, 0.5, 0.5)
    pieces = _bent(entry, first, radius, chance)
    waiting = [(low, high, first, radius)]
    while waiting:
        low, high, point, radius = waiting.pop()
        axis = int(np.argmax(high - low))
        share = 0.4 + 0.2 * chance.random()
        middle = low[axis] + share * (high[axis] - low[axis])
        for part, fraction in ((0, share), (1, 1.0 - share)):
            box = low.copy(), high.copy()
            box[1 - part][axis] = middle
            narrow = radius * fraction ** (1.0 / 3.0)
            to = box[0] + (box[1] - box[0]) * (0.4 + 0.2 * chance.random(3))
            pieces += _bent(point, to, max(narrow, MIN_RADIUS), chance)
            if narrow > MIN_RADIUS:
                waiting.append((*box, to, narrow))
    return np.array(pieces)


def _bent(start: Floats, end: Floats, radius: float, chance: np.random.Generator) -> list[Floats]:
    """Two capsules from one point to another, with a bend between."""
    length = float(np.linalg.norm(end - start))
    middle = (start + end) / 2 + 0.1 * length * (2.0 * chance.random(3) - 1.0)
    return [np.array([*a, *b, radius]) for a, b in ((start, middle), (middle, end))]


def _cells(
    size: int, count: int, capsules: Floats, chance: np.random.Generator
) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
    """Centres, semi-axes, rotations and touching pairs of cells."""
    mean = float(np.clip(size / PER_CELL_RADIUS, MIN_CELL, MAX_CELL))
    centres = np.empty((count, 3))
    axes = np.empty((count, 3))
    rotations = np.empty((count, 3, 3))
    pairs = []
    for number in range(count):
        axes[number] = mean * (SEMI_AXES[0] + (SEMI_AXES[1] - SEMI_AXES[0]) * chance.random(3))
        rotations[number] = rotation(chance)
        beside = number % EVERY_TOUCHING == EVERY_TOUCHING - 1
        reach = axes[number].max()
        for _ in range(MAX_TRIES):
            if beside:
                way = direction(chance)
                width = sum(_radius(axes[i], rotations[i], way) for i in (number - 1, number))
                at = centres[number - 1] + (width - OVERLAP) * way
            else:
                at = reach + GAP + (size - 1.0 - 2.0 * (reach + GAP)) * chance.random(3)
            if _has_room(
                at, reach, size, capsules, centres[: number - beside], axes[: number - beside]
            ):
                break
        else:
            raise ValueError(
                f"no room for cell {number + 1} of {count} in {size}^3 voxels: fewer cells"
            )
        centres[number] = at
        if beside:
            pairs.append((number, number + 1))
    return centres, axes, rotations, np.array(pairs, np.int64).reshape(-1, 2)


def _has_room(
    at: Floats, reach: float, size: int, capsules: Floats, centres: Floats, axes: Floats
) -> bool:
    """Whether a ball keeps its distance to the volume's faces, to vessels and to the bounding balls of cells."""
    if (at < reach + GAP).any() or (at > size - 1.0 - reach - GAP).any():
        return False
    if (np.linalg.norm(centres - at, axis=1) < reach + axes.max(axis=1, initial=0.0) + GAP).any():
        return False
    start, along = capsules[:, :3], capsules[:, 3:6] - capsules[:, :3]
    share = np.clip(
        ((at - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30), 0.0, 1.0
    )
    distance = np.linalg.norm(start + share[:, None] * along - at, axis=1) - capsules[:, 6]
    return not (distance < reach + GAP).any()


def direction(chance: np.random.Generator) -> Floats:
    """A unit vector, every direction as likely (from the ball within a cube: no function that differs by machine)."""
    while True:
        vector = 2.0 * chance.random(3) - 1.0
        length = np.sqrt((vector**2).sum())
        if 0.1 < length <= 1.0:
            return np.asarray(vector / length)


def rotation(chance: np.random.Generator) -> Floats:
    """Three orthogonal unit rows."""
    first, other = direction(chance), direction(chance)
    second = np.cross(first, other)
    while (second**2).sum() < 0.01:
        second = np.cross(first, direction(chance))
    second = second / np.sqrt((second**2).sum())
    return np.stack([first, second, np.cross(first, second)])


def _radius(axes: Floats, rows: Floats, way: Floats) -> float:
    """Distance from an ellipsoid's centre to its surface along a unit vector."""
    return float(1.0 / np.sqrt((((rows @ way) / axes) ** 2).sum()))


def table(scene: Scene, spacing_mm: float) -> list[dict[str, Any]]:
    """Rows of a table of balls, one well within each cell, as ``accelsurf segment --objects`` reads it: mm, LPS."""
    return [
        {
            "id": number + 1,
            **dict(zip("zyx", (centre * spacing_mm).tolist(), strict=True)),
            "r": 0.7 * float(axes.min()) * spacing_mm,
        }
        for number, (centre, axes) in enumerate(zip(scene.centres, scene.axes, strict=True))
    ]
