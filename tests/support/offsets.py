"""Bodies of revolution that grow or shrink at constant speed, through changes of topology; solved exactly.

Descent of U = c int dx moves the surface by c t along its normal. Its viscosity solution is the set of all points whose
distance from the first body is below the growth (above it, from the outside, for a body that shrinks), whatever merges
or parts on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from tests.support.follow import WIDTH, Lattice, lattice, surface_points
from tests.support.follow_curve import Frame, Run, Setup, nearest
from tests.support.lagrangian import Law, star

#: Signed distance (mm, outside > 0) of points (n, 2), (r, z), from the first surface.
Distance = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Offset:
    """A body given by its ``distance``, which grows by ``growth`` mm (shrinks, if negative) at speed 1."""

    distance: Distance
    growth: float

    def volume(self, count: int = 400) -> float:
        """Volume (mm3) at the end, by a fine sum over the half plane."""
        step = 0.5 * WIDTH / count
        r = (np.arange(count) + 0.5) * step
        z = (np.arange(2 * count) + 0.5) * step - 0.5 * WIDTH
        points = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1)
        inside = np.clip(
            0.5 - (self.distance(points.reshape(-1, 2)) - self.growth) / step, 0.0, 1.0
        )
        return float(2.0 * np.pi * step**2 * (inside.reshape(count, -1) * r[:, None]).sum())


class Found(NamedTuple):
    """Relative error of the volume; mean distance (voxels) of the surface from the exact one; components inside and
    outside; whether the body's centre is inside."""

    volume: float
    mean: float
    inside: int
    outside: int
    holds_centre: bool


def two_balls(points: np.ndarray) -> np.ndarray:
    """Radius 0.35, 1 apart."""
    r, z = points.T
    return np.asarray(np.hypot(r, np.abs(z) - 0.5) - 0.35)


def torus(points: np.ndarray) -> np.ndarray:
    """Radii 0.5 and 0.22."""
    r, z = points.T
    return np.asarray(np.hypot(r - 0.5, z) - 0.22)


def dumbbell(points: np.ndarray) -> np.ndarray:
    """Two smooth lobes with a waist of radius 0.22."""
    return nearest(
        star(lambda angle: 0.22 + 0.93 * np.sin(angle) ** 2, 256, revolved=True), points
    ).distance


MERGE, CLOSE, SPLIT = Offset(two_balls, 0.3), Offset(torus, 0.34), Offset(dumbbell, -0.24)


def grow(problem: Offset, n: int, frame: Frame) -> Found:
    """Solve on ``n`` voxels along an axis by the program, in steps of half a voxel, and compare."""
    on: Lattice = lattice(n)
    own = frame.inwards(on.points.reshape(3, -1).T, True)
    shape = on.points.shape[1:]
    speed = np.full(shape, -1.0 if problem.growth > 0 else 1.0)
    run = Run(Setup(problem.distance(own).reshape(shape), speed, on.spacing), Law("descent"))
    run.until(abs(problem.growth), 0.5 * on.spacing[0])
    surface = run.surface
    off = problem.distance(frame.inwards(surface_points(surface, on), True)) - problem.growth
    labels = surface.labels
    return Found(
        surface.volume(surface.fraction_and_area()[0]) / problem.volume() - 1.0,
        float(np.abs(off).mean()) / on.spacing[0],
        int(ndimage.label(labels)[1]),
        int(ndimage.label(1 - labels)[1]),
        bool(labels.ravel()[np.hypot(*own.T).argmin()]),
    )
