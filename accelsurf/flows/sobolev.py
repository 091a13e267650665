"""Sobolev descent: the force smoothed along the surface by a solve at each step. The expensive baseline."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.descent import Descent, descent_plan
from accelsurf.flows.protocol import StepInput, StepLimits, StepPlan, voxel_rates
from accelsurf.kernels import tube
from accelsurf.levelset import LevelSet, dot

#: Length of the H1 gradient unless one is given, in voxels of the smallest spacing.
LENGTH = 5.0
#: Half width of the tube in which the equation is solved, voxels along the normal.
TUBE = 2.0
#: The solve ends when the residual is this part of the right hand side.
TOLERANCE = 1e-3
MAX_ITERATIONS = 200


class Sobolev(Descent):
    """psi_t = g |grad psi| with (1 - ell^2 Lap_S) g = f: descent in the H1 metric of the surface.

    On a sphere of radius r a spherical harmonic of degree l comes out divided by 1 + ell^2 l (l + 1)/r^2. The step
    is bounded by the CFL number of g alone, also with an area weight.

    Parameters
    ----------
    length : float or None
        ell, mm; None is `LENGTH` voxels.
    """

    name = "sobolev"

    def __init__(self, length: float | None = None) -> None:
        super().__init__()
        self.length = length

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with beta = g, dt <= cfl/|g|, and `resting_dt`."""
        surface = now.surface
        length = LENGTH * surface.smallest_spacing if self.length is None else self.length
        speed = h1_gradient(surface, now.force, length, self._last)
        inner = surface.front(1.0)
        surface.extend_outwards(speed, inner)
        cfl_dt = self.cfl_dt(voxel_rates(surface, inner, speed)[inner], surface, limits)
        dt = self.resting_dt(now, speed, min(cfl_dt, limits.dt_max))
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        return self.remember(descent_plan(now, speed, dt, limits, cfl_dt))


def h1_gradient(surface: LevelSet, force: np.ndarray, length: float, guess: np.ndarray) -> np.ndarray:
    """Solution g (n,) of (1 - length^2 Lap_S) g = force near the surface, by conjugate gradients from ``guess``.

    Solved as the minimum of sum eta ((g - f)^2 + length^2 |grad g|^2) over a tube around the surface whose weight
    eta fades to its edge; in a tube thin against the radius of curvature g is constant along the normal. Diagonal
    preconditioner.
    """
    parallel, n = surface.workers.parallel, surface.size
    slot, cells = surface.dense.slot, surface.band.cells
    eta, diagonal = np.empty(n), np.empty(n)
    parallel(tube.tube_weight, n, surface.grid, surface.band, TUBE, eta)
    parallel(tube.tube_diagonal, n, slot, surface.grid, cells, (eta, length), diagonal)

    def product(field: np.ndarray) -> np.ndarray:
        out = np.empty(n)
        parallel(tube.tube_product, n, slot, surface.grid, cells, (eta, length), field, out)
        return out

    right = eta * force
    g = guess.astype(np.float64)
    residual = right - product(g)
    tolerance = TOLERANCE**2 * dot(right, right / diagonal)
    direction = np.zeros(n)
    last = 1.0
    for _ in range(MAX_ITERATIONS):
        scaled = residual / diagonal
        size = dot(residual, scaled)
        if size <= tolerance:
            break
        direction = scaled + (size / last) * direction
        last = size
        image = product(direction)
        step = size / dot(direction, image)
        g += step * direction
        residual -= step * image
    return g.astype(np.float32)


