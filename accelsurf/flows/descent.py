"""Flows without inertia: their base, and plain L2 gradient descent, the baseline."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.diffusion import diffuse, free_diffusion, largest_diffusion
from accelsurf.flows.protocol import Flow, StepInput, StepLimits, StepPlan
from accelsurf.flows.step_limits import clip_speed, curvature_bound, percentile, voxel_rates
from accelsurf.levelset import LevelSet


class Descent(Flow):
    """Base of flows without inertia: a step that follows the peak speed so far."""

    def cfl_dt(self, rates: np.ndarray, surface: LevelSet, limits: StepLimits) -> float:
        """Step in which the percentile of the speeds ``rates`` (voxels per unit time) moves the surface by cfl."""
        fastest = self._peak_force_so_far(percentile(rates, limits.percentile), surface)
        return min(limits.dt_max, limits.cfl / fastest if fastest > 0 else math.inf)


class DescentWithMemory(Descent):
    """A descent that needs its last step, a field on the surface."""

    state_names = (*Descent.state_names, "_last")

    def __init__(self) -> None:
        self._last = np.zeros(0, np.float32)

    @property
    def fields(self) -> list[np.ndarray]:
        """The last step."""
        return [self._last]

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """The last step on the new band."""
        (self._last,) = fields

    def start(self, surface: LevelSet) -> None:
        """Start with a last step of 0."""
        super().start(surface)
        self._last = np.zeros(surface.size, np.float32)


def descent_plan(
    now: StepInput, speed: np.ndarray, dt: float, limits: StepLimits, cfl_dt: float, diffusion: float = 0.0
) -> StepPlan:
    """Return the step of a descent: ``speed`` (n,) at the front, clipped and extended (in place)."""
    rates = voxel_rates(now.surface, now.front, speed)
    clipped = clip_speed(speed, rates, dt, limits.cfl)
    front_speed = percentile(speed, limits.percentile, now.front)
    now.surface.extend_outwards(speed, now.front)
    share = clipped / max(1, int(now.front.sum()))
    return StepPlan(dt, speed, None, front_speed, share, diffusion, cfl_dt=cfl_dt)


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
        self.diffusion = diffusion

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with beta = f, dt <= cfl/|f|, dt <= h^2/(4 alpha), and D dt within the stability bound of a step."""
        surface, front = now.surface, now.front
        speed = np.array(now.force, np.float32)
        dt = cfl_dt = self.cfl_dt(voxel_rates(surface, front, speed)[front], surface, limits)
        if now.alpha > 0:
            dt = min(dt, curvature_bound(surface) / now.alpha)
        if self.diffusion:
            dt = min(dt, largest_diffusion(surface) / self.diffusion)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        diffusion = self.diffusion
        if diffusion is None:
            diffusion = free_diffusion(surface, dt, percentile(speed, limits.percentile, front))
        if diffusion > 0:
            surface.extend_outwards(speed, front)
            diffuse(surface, front, speed, diffusion * dt)
        return descent_plan(now, speed, dt, limits, cfl_dt, diffusion)
