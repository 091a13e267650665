"""Phantoms of twelve kinds, each by a seeded function: image and truth on about 64^3 voxels.

Values are 0 outside and 1 inside before they are blurred by .7 voxels and noise is added, unless a kind says otherwise.
The same name and seed give the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.image.volume import Volume

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
SIDE = 64
#: Standard deviation of the blur (voxels), and of the noise unless a kind says otherwise, of a contrast of 1.
BLUR, NOISE = 0.7, 0.2
CELLS = 40


class Drawn(NamedTuple):
    """A phantom before it is degraded: values, truth, spacing (z, y, x), and the noise's standard deviation."""

    values: Floats
    truth: Mask
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    noise: float = NOISE


class Kind(NamedTuple):
    """A kind of phantom: what draws it, and the family that it counts for."""

    draw: Callable[[np.random.Generator], Drawn]
    family: str


def made(name: str, seed: int = 0) -> tuple[Volume, Mask]:
    """Image (float32) and truth of a phantom.

    Parameters
    ----------
    name : str
        One of `KINDS`.
    seed : int
        Another phantom of the same kind.
    """
    random = np.random.default_rng([list(KINDS).index(name), seed])
    drawn = KINDS[name].draw(random)
    values = ndimage.gaussian_filter(drawn.values, [BLUR / h for h in drawn.spacing])
    values += random.normal(0.0, drawn.noise, values.shape)
    return Volume.from_array((100.0 * values).astype(np.float32), drawn.spacing), drawn.truth


def grid(side: int = SIDE) -> Sequence[Floats]:
    """Coordinates z, y, x from the middle, broadcastable."""
    return np.ogrid[tuple(slice(-0.5 * (side - 1), 0.5 * side, 1.0) for _ in range(3))]


def rough(random: np.random.Generator, width: float, side: int = SIDE) -> Floats:
    """Smooth random field with mean 0 and deviation 1; bumps are about ``width`` voxels wide."""
    field = ndimage.gaussian_filter(random.normal(size=(side, side, side)), width, mode="reflect")
    return np.asarray((field - field.mean()) / field.std())


def ball(at: Sequence[float], radius: float) -> Floats:
    """Signed distance to a ball, negative inside."""
    z, y, x = grid()
    return np.asarray(np.sqrt((z - at[0]) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2) - radius)


def line(points: Floats, radius: float) -> Mask:
    """Voxels within ``radius`` of a line through points (z, y, x from the middle)."""
    fine = [
        start + (stop - start) * t
        for start, stop in zip(points, points[1:], strict=False)
        for t in np.linspace(0.0, 1.0, 24)
    ]
    open_ = np.ones((SIDE,) * 3, bool)
    index = np.round(np.array(fine) + 0.5 * (SIDE - 1)).astype(int)
    index = index[((index >= 0) & (index < SIDE)).all(axis=1)]
    open_[tuple(index.T)] = False
    return np.asarray(ndimage.distance_transform_edt(open_) <= radius)


def walk(
    random: np.random.Generator, start: Floats, heading: Floats, steps: int, length: float
) -> Floats:
    """Points of a line that wanders about its heading."""
    points = [start]
    for _ in range(steps):
        heading = heading + random.normal(0.0, 0.35, 3)
        heading = heading / np.linalg.norm(heading)
        points.append(points[-1] + length * heading)
    return np.array(points)


def plain(truth: Mask, noise: float = NOISE) -> Drawn:
    """A phantom whose values are its truth."""
    return Drawn(truth.astype(np.float64), truth, noise=noise)


def blob(random: np.random.Generator) -> Drawn:
    """An irregular lump beside another one that does not touch it."""
    field = rough(random, 5.0)
    truth = ball((-8.0, -6.0, -6.0), 15.0) + 2.5 * field < 0
    other = (ball((17.0, 16.0, 17.0), 8.0) + 1.5 * field < 0) & ~ndimage.binary_dilation(
        truth, iterations=3
    )
    return Drawn((truth | other).astype(np.float64), truth)


def large(random: np.random.Generator) -> Drawn:
    """An object of about 85 % of the image."""
    field = sum(np.abs(axis) ** 4.0 for axis in grid()) ** 0.25 - 31.5 + 1.5 * rough(random, 6.0)
    return plain(field < np.quantile(field, 0.85))


def half(random: np.random.Generator) -> Drawn:
    """Half of the image, beyond a wavy wall."""
    return plain(grid()[2] + 4.0 * rough(random, 9.0) < 0)


def tube(random: np.random.Generator) -> Drawn:
    """A winding tube from face to face."""
    start = np.array([random.uniform(-10, 10), random.uniform(-10, 10), -34.0])
    return plain(line(walk(random, start, np.array([0.0, 0.0, 1.0]), 30, 4.0), 3.2))


def tree(random: np.random.Generator) -> Drawn:
    """A tube that branches twice."""
    trunk = walk(random, np.array([0.0, 0.0, -32.0]), np.array([0.0, 0.0, 1.0]), 6, 4.0)
    truth = line(trunk, 4.0)
    for turn in (-0.8, 0.8):
        branch = walk(random, trunk[-1], np.array([0.3, turn, 0.7]), 5, 4.0)
        truth |= line(branch, 2.6)
        for further in (-0.8, 0.8):
            truth |= line(
                walk(random, branch[-1], np.array([further, 0.5 * turn, 0.7]), 5, 4.0), 1.7
            )
    return plain(truth)


def sheet(random: np.random.Generator) -> Drawn:
    """A folded sheet of about four voxels."""
    height = (
        14.0 * ndimage.gaussian_filter(random.normal(size=(SIDE, SIDE)), 8.0, mode="reflect") * 8.0
    )
    z, y, x = grid()
    return plain((np.abs(z - height[None]) < 2.2) & (np.maximum(np.abs(y), np.abs(x)) < 26))


def shell(random: np.random.Generator) -> Drawn:
    """A shell around a cavity; the object is the shell."""
    field = 2.0 * rough(random, 6.0)
    return plain((ball((0, 0, 0), 22.0) + field < 0) & (ball((2, -2, 1), 15.0) + field > 0))


def _tiles(random: np.random.Generator) -> tuple[NDArray[np.int64], Floats]:
    """Number of the nearest of `CELLS` random centres, and the distance (voxels) to the wall between two."""
    centres = random.uniform(-0.5 * SIDE, 0.5 * SIDE, (CELLS, 3))
    z, y, x = grid()
    squares = np.stack([(z - c[0]) ** 2 + (y - c[1]) ** 2 + (x - c[2]) ** 2 for c in centres])
    order = np.argsort(squares, axis=0)[:2]
    first, second = (np.sqrt(np.take_along_axis(squares, order[k : k + 1], 0)[0]) for k in (0, 1))
    return order[0], 0.5 * (second - first)


def _middle(tiles: NDArray[np.int64]) -> int:
    """Number of the tile in the middle of the image."""
    return int(tiles[SIDE // 2, SIDE // 2, SIDE // 2])


def cells(random: np.random.Generator) -> Drawn:
    """A cell among cells of equal brightness, with bright walls; the object reaches to the middle of its walls."""
    tiles, wall = _tiles(random)
    return Drawn(0.2 + 0.8 * (wall < 1.0), tiles == _middle(tiles), noise=0.1)


def touching(random: np.random.Generator) -> Drawn:
    """A ball that touches three equal ones."""
    at = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 21.0], [0.0, 19.0, -7.0], [18.0, -8.0, -6.0]])
    at += random.normal(0.0, 1.0, at.shape)
    distances = np.stack([ball(tuple(where), 11.0) for where in at])
    return Drawn(
        (distances.min(axis=0) < 0).astype(np.float64),
        (distances[0] < 0) & (distances.argmin(axis=0) == 0),
    )


def textured(random: np.random.Generator) -> Drawn:
    """A lump that differs from its surroundings by the size of its grain, and a little in brightness."""
    truth = ball((0, 0, 0), 17.0) + 2.5 * rough(random, 6.0) < 0
    return Drawn(
        np.where(truth, 0.5 + 0.5 * rough(random, 1.0), 0.5 * rough(random, 3.0)), truth, noise=0.1
    )


def thick(random: np.random.Generator) -> Drawn:
    """An irregular lump in slices that are five times as thick as a pixel is wide; values are means over a slice."""
    truth = ball((0, 0, 0), 18.0) + 3.0 * rough(random, 6.0) < 0
    blocks = truth[: SIDE // 5 * 5].reshape(SIDE // 5, 5, SIDE, SIDE)
    return Drawn(blocks.mean(axis=1), blocks.mean(axis=1) >= 0.5, (5.0, 1.0, 1.0))


def noisy(random: np.random.Generator) -> Drawn:
    """An irregular lump in noise of 1.5 contrasts."""
    return plain(ball((3, -4, 2), 17.0) + 2.5 * rough(random, 6.0) < 0, noise=1.5)


KINDS = {
    "phantom-blob": Kind(blob, "other"),
    "phantom-large": Kind(large, "other"),
    "phantom-half": Kind(half, "other"),
    "phantom-tube": Kind(tube, "vessels"),
    "phantom-tree": Kind(tree, "vessels"),
    "phantom-sheet": Kind(sheet, "other"),
    "phantom-shell": Kind(shell, "other"),
    "phantom-cells": Kind(cells, "cells"),
    "phantom-touching": Kind(touching, "nuclei"),
    "phantom-textured": Kind(textured, "other"),
    "phantom-thick": Kind(thick, "other"),
    "phantom-noisy": Kind(noisy, "other"),
}
