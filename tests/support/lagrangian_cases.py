"""Smooth problems without closed forms: shapes and forces without symmetry, in the plane and about an axis."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.support.follow import WIDTH, Lattice, Triple, lattice, order
from tests.support.follow_curve import UPRIGHT, Frame, Misfit, about, evolve, in_voxels, turned
from tests.support.lagrangian import Curve, Force, Law, ellipse


def lopsided(points: np.ndarray) -> np.ndarray:
    """A force of the plane without any symmetry; its zero set is an egg."""
    x, y = points.T
    return np.asarray(0.6 * (x**2 + 1.6 * y**2 - 0.3 * x * y + 0.5 * x**3 - 0.35))


def uneven(points: np.ndarray) -> np.ndarray:
    """A force about an axis that is not the same above and below; smooth on the axis, so even in r."""
    r, z = points.T
    return np.asarray(0.6 * (r**2 + 1.6 * z**2 - 0.4 * z * r**2 + 0.5 * z**3 - 0.35))


def soft_region(points: np.ndarray) -> np.ndarray:
    """Chan-Vese's force with means 1 and 0 of a soft, oblique ellipse; it pulls small starts out to its edge."""
    x, y = points.T
    return np.tanh(x**2 + 2.0 * y**2 - 0.2 * x * y - 1.0)


EGG = ellipse(0.9, 0.75, 128, (0.05, -0.05))
BODY = ellipse(0.75, 0.9, 96, (0.0, 0.03), revolved=True)
#: Fills the soft region from one side: its far side is stretched five times as much as the near one.
SEED = ellipse(0.3, 0.3, 192, (-0.5, 0.1))

TILTED = turned(0.4, (0.01, -0.013, 0.0))
OBLIQUE = about((0.5, 0.3, 0.8), (0.01, 0.0, -0.02))
CONSTANT, FLOWABLE = "constant-density", "flowable-mass"


@dataclass(frozen=True)
class Problem:
    """A problem and the grids that it is solved on; ``step`` is the time step in h, the finest spacing."""

    law: Law
    frame: Frame = UPRIGHT
    start: Curve = field(default=EGG, repr=False)
    force: Force = lopsided
    coarser: Triple = (1, 1, 1)
    times: tuple[float, ...] = (0.5, 1.0, 1.5)
    step: float = 0.5

    def grid(self, n: int) -> Lattice:
        """``n`` voxels along an axis; a single slice in the plane."""
        return lattice(n, self.coarser, flat=not self.start.revolved)

    def misfit(self, n: int) -> Misfit:
        """The largest misfit in voxels on a grid."""
        h = WIDTH / (n - 1)
        found = evolve(
            self.start, self.force, self.law, self.grid(n), self.times, self.step * h, self.frame
        )
        return in_voxels(found, h)

    def study(self, sizes: tuple[int, ...]) -> dict[str, Any]:
        """Misfits in voxels on several grids, and the orders."""
        found = [self.misfit(n) for n in sizes]
        errors = {
            key: [getattr(one, key) * WIDTH / (n - 1) for one, n in zip(found, sizes, strict=True)]
            for key in ("mean", "point")
        }
        return {
            "sizes": list(sizes),
            "mean_voxels": [one.mean for one in found],
            "point_voxels": [one.point for one in found],
            "density_relative": [one.density for one in found],
            "order_of_mean": order(errors["mean"], sizes) if len(sizes) > 1 else None,
            "order_of_point": order(errors["point"], sizes) if len(sizes) > 1 else None,
        }


PLANE: dict[str, Problem] = {
    "area weight": Problem(Law(CONSTANT, alpha=0.03), TILTED),
    "no area weight": Problem(Law(CONSTANT), TILTED),
    "along the grid": Problem(Law(CONSTANT, alpha=0.03)),
    "k = 1.5": Problem(Law(CONSTANT, k=1.5), TILTED),
    "k = 3": Problem(Law(CONSTANT, k=3.0, alpha=0.03), TILTED),
    "k = 3, lambda 2, rho 1/2": Problem(
        Law(CONSTANT, 3.0, 2.0, 0.5, alpha=0.03), TILTED, times=(0.3, 0.6, 0.9)
    ),
    "constant friction": Problem(Law(CONSTANT, friction=1.0, alpha=0.03), TILTED),
    "flowable, area weight": Problem(Law(FLOWABLE, alpha=0.03), TILTED),
    "flowable, no area weight": Problem(Law(FLOWABLE), TILTED),
    "flowable, along the grid": Problem(Law(FLOWABLE, alpha=0.03)),
    "flowable, k = 1.5": Problem(Law(FLOWABLE, k=1.5, alpha=0.03), TILTED),
    "flowable, k = 3": Problem(Law(FLOWABLE, k=3.0, alpha=0.03), TILTED),
    "flowable, k = 3, lambda 2, rho 1/2": Problem(
        Law(FLOWABLE, 3.0, 2.0, 0.5, alpha=0.03), TILTED, times=(0.3, 0.6, 0.9)
    ),
    "flowable, constant friction": Problem(Law(FLOWABLE, friction=1.0, alpha=0.03), TILTED),
}
DESCENT = Problem(Law("descent", alpha=0.02), TILTED, step=0.1)
#: Spacing 2 along one axis of the plane.
STRETCHED: dict[str, Problem] = {
    "y twice as coarse": Problem(Law(CONSTANT, alpha=0.03), TILTED, coarser=(1, 2, 1)),
    "x twice as coarse": Problem(Law(CONSTANT, alpha=0.03), TILTED, coarser=(1, 1, 2)),
    "flowable, y twice as coarse": Problem(Law(FLOWABLE, alpha=0.03), TILTED, coarser=(1, 2, 1)),
    "flowable, x twice as coarse": Problem(Law(FLOWABLE, alpha=0.03), TILTED, coarser=(1, 1, 2)),
}
SPACE: dict[str, Problem] = {
    "upright": Problem(Law(CONSTANT, alpha=0.03), start=BODY, force=uneven),
    "oblique": Problem(Law(CONSTANT, alpha=0.03), OBLIQUE, BODY, uneven),
    "oblique, k = 3": Problem(Law(CONSTANT, k=3.0, alpha=0.03), OBLIQUE, BODY, uneven),
    "flowable, oblique": Problem(Law(FLOWABLE, alpha=0.03), OBLIQUE, BODY, uneven),
    "oblique, 2:1:1": Problem(Law(CONSTANT, alpha=0.03), OBLIQUE, BODY, uneven, (2, 1, 1)),
    "flowable, oblique, 2:1:1": Problem(
        Law(FLOWABLE, alpha=0.03), OBLIQUE, BODY, uneven, (2, 1, 1)
    ),
}
#: Mass drawn out to a fifth on one side.
DRAWN_OUT = Problem(Law(FLOWABLE, alpha=0.02), TILTED, SEED, soft_region, times=(0.8, 1.2, 1.4))


def diffusing(diffusion: float) -> Problem:
    """The egg with a diffusion D (mm2 per unit time) of its speed."""
    return Problem(Law(CONSTANT, diffusion=diffusion), TILTED)
