"""L2 gradient descent: beta = f. The baseline, with the same step control and limiter as the others."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.protocol import (
    Descent,
    StepInput,
    StepLimits,
    StepPlan,
    axes_of,
    diffuse,
    diffusion_reach,
    finish,
    free_diffusion,
    percentile,
    voxel_rates,
)
from accelsurf.levelset import LevelSet


class Gradient(Descent):
    """psi_t = f |grad psi|: descent of the potential, without memory.

    Parameters
    ----------
    diffusion : float or None
        D (mm2 per unit time): each step's force is smoothed along the surface by D dt, with the operator and
        the bounds that the accelerated flows use for their speeds. 0 is the plain gradient, None the free bound.
    """

    name = "gradient"

    def __init__(self, diffusion: float | None = 0.0) -> None:
        super().__init__()
        self.diffusion = diffusion

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with beta = f, dt <= cfl/|f|, dt <= h^2/(4 alpha), and D dt within the reach of diffusion."""
        surface, front = now.surface, now.front
        speed = np.array(now.force, np.float32)
        dt = travel = self.cfl_dt(voxel_rates(surface, front, speed)[front], surface, limits)
        if now.alpha > 0:
            dt = min(dt, curvature_bound(surface) / now.alpha)
        if self.diffusion:
            dt = min(dt, diffusion_reach(surface) / self.diffusion)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        diffusion = self.diffusion
        if diffusion is None:
            diffusion = free_diffusion(surface, dt, percentile(speed, limits.percentile, front))
        if diffusion > 0:
            surface.extend_outwards(speed, front)
            diffuse(surface, front, speed, diffusion * dt)
        return finish(now, speed, dt, limits, travel, diffusion)


def curvature_bound(surface: LevelSet) -> float:
    """Largest alpha dt (mm2) of explicit curvature flow: 1 / (2 (1/h1^2 + 1/h2^2)), h1, h2 the finest spacings."""
    finest = sorted(h for n, h in axes_of(surface) if n > 1)[:2]
    return 0.5 / sum(1.0 / h**2 for h in finest)
