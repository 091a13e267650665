"""Balls that are added to an object or removed from it by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Corner
from accelsurf.grid.geometry import ball_distance
from accelsurf.grid.pyramid import Level


class BallEdit(NamedTuple):
    """A ball to be added to an object or removed from it: ``centre`` (z, y, x) as voxel index, ``radius`` in mm."""

    kind: str
    centre: tuple[float, float, float]
    radius: float

    def on_level(self, grid: Level) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Its centre as index of a level's grid, and its radius in voxels of it along each axis."""
        middle = (np.array(self.centre) - grid.first) / grid.factors
        return middle, self.radius / np.array(grid.spacing)

    def extent(self, grid: Level) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel that it may reach on a level's grid, and the one after the last."""
        middle, size = self.on_level(grid)
        low = np.maximum(np.floor(middle - size), 0).astype(np.int64)
        high = np.minimum(np.ceil(middle + size) + 1, grid.shape).astype(np.int64)
        return low, high


def apply_balls(psi: NDArray[np.float32], balls: Sequence[BallEdit], grid: Level, corner: Corner, gamma: float) -> None:
    """Add balls to an object or remove them from it: changes psi near them, in place.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx), float32
        mm, negative inside.
    balls : sequence of Ball
    grid : Level
        Of which psi is a box.
    corner : (z, y, x)
        First voxel of that box.
    gamma : float
        How far beyond a ball psi is changed, mm.
    """
    for ball in balls:
        middle = ball.on_level(grid)[0] - corner
        reach = (ball.radius + gamma) / np.array(grid.spacing)
        low = np.maximum(np.floor(middle - reach), 0).astype(int)
        high = np.minimum(np.ceil(middle + reach) + 1, psi.shape).astype(int)
        z, y, x = (slice(int(a), max(int(a), int(b))) for a, b in zip(low, high, strict=True))
        box = z, y, x
        distance = ball_distance(box, grid.spacing, middle, ball.radius)
        near = psi[box]
        if ball.kind == "add":
            np.minimum(near, distance, out=near)
        else:
            np.maximum(near, -distance, out=near)
