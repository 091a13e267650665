"""Flows without inertia: their base, and plain L2 gradient descent, the baseline."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.diffusion import diffuse, free_diffusion, largest_diffusion
from accelsurf.flows.protocol import (
    Flow,
    StepInput,
    StepLimits,
    StepPlan,
    clip_speed,
    curvature_bound,
    percentile,
    voxel_rates,
)
from accelsurf.kernels import statistics
from accelsurf.levelset import LevelSet

#: A step that undoes more than this part of the one before is too long for the stiffest part of the surface; after the
#: shortest step that was too long the next ones undo this part at most.
UNDONE = 0.5
#: Steps of a smaller root mean square, voxels, say nothing of the stiffness: details finer than the grid never rest.
STILL = 0.01


class Descent(Flow):
    """Base of flows without inertia: a step that follows the peak speed so far, and remembers the last one.

    The last step is a field on the surface.
    """

    state_names = (*Flow.state_names, "_last", "_last_dt", "_reversal", "_stiffness")

    def __init__(self) -> None:
        self._last = np.zeros(0, np.float32)
        self._last_dt = 0.0
        self._forget_forces()

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
        self._last, self._last_dt = np.zeros(surface.size, np.float32), 0.0

    def _forget_forces(self) -> None:
        super()._forget_forces()
        # Stiffness, per unit time, that the last step met if it was undone, and that two in a row met at any time.
        self._reversal = self._stiffness = 0.0

    def cfl_dt(self, rates: np.ndarray, surface: LevelSet, limits: StepLimits) -> float:
        """Step in which the percentile of the speeds ``rates`` (voxels per unit time) moves the surface by cfl."""
        fastest = self._peak_force_so_far(percentile(rates, limits.percentile), surface)
        return limits.cfl / fastest if fastest > 0 else math.inf

    def resting_dt(self, now: StepInput, speed: np.ndarray, dt: float) -> float:
        """``dt``, shorter if this ``speed`` (n,) would undo more than `UNDONE` of the last step, of speeds `_last`.

        The force of a small displacement d is -K d. The Rayleigh quotient of K for the last step d = dt v,
        (1 - <v+, v>/<v, v>)/dt, is at most its largest eigenvalue, and is near it where the stiffest waves swing: those
        fall to `UNDONE` of themselves in steps of (1 + UNDONE)/K. What only one step shows is no oscillation.
        """
        surface, area = now.surface, now.area

        def product(speed: np.ndarray) -> float:
            return float(surface.workers.block_sums(statistics.products, area.size, 1, area, self._last, speed)[0])

        squares = product(self._last)
        moved = self._last_dt * math.sqrt(squares / max(float(area.sum()), 1e-300)) / surface.smallest_spacing
        undone = -product(speed) / squares if moved > STILL else 0.0
        before, self._reversal = self._reversal, (1.0 + min(undone, 1.0)) / self._last_dt if undone > UNDONE else 0.0
        self._stiffness = max(self._stiffness, min(before, self._reversal))
        return min(dt, (1.0 + UNDONE) / self._stiffness) if self._stiffness > 0 else dt

    def remember(self, plan: StepPlan) -> StepPlan:
        """Return the plan; its step is the last one from now on."""
        self._last, self._last_dt = plan.speed, plan.dt
        return plan


def stable_dt(now: StepInput, cfl_dt: float) -> float:
    """Largest stable step of a descent: 1/dt = 1/cfl_dt + alpha/`curvature_bound`.

    Across a face a wave of two voxels decays at the rate 4 alpha (1/h1^2 + 1/h2^2) + df/dn, and no step may exceed 2
    over it. The force goes from -F to F within a voxel of a sharp edge: df/dn is at most 2.5 F/h (by the cubic
    interpolant), and half of it less than 1/cfl_dt = F/(cfl h) up to a cfl of .8.
    """
    if now.alpha <= 0.0:
        return cfl_dt
    curvature_dt = curvature_bound(now.surface) / now.alpha
    return curvature_dt / (1.0 + curvature_dt / cfl_dt)


def descent_plan(
    now: StepInput, speed: np.ndarray, dt: float, limits: StepLimits, cfl_dt: float, diffusion: float = 0.0
) -> StepPlan:
    """Return the step of a descent: ``speed`` (n,) at the front, clipped and extended (in place)."""
    rates = voxel_rates(now.surface, now.front, speed)
    clipped = clip_speed(speed, rates, dt, limits.cfl)
    front_speed = percentile(speed, limits.percentile, now.front)
    now.surface.extend_outwards(speed, now.front)
    share = clipped / max(1, int(now.front.sum()))
    return StepPlan(dt, speed, None, front_speed, share, diffusion, cfl_dt=min(cfl_dt, limits.dt_max))


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
        """Step with beta = f, within the bounds of `stable_dt` and `resting_dt` and of D dt in a step."""
        surface, front = now.surface, now.front
        speed = np.array(now.force, np.float32)
        cfl_dt = self.cfl_dt(voxel_rates(surface, front, speed)[front], surface, limits)
        dt = self.resting_dt(now, speed, min(stable_dt(now, cfl_dt), limits.dt_max))
        if self.diffusion:
            dt = min(dt, largest_diffusion(surface) / self.diffusion)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        diffusion = self.diffusion
        if diffusion is None:
            diffusion = free_diffusion(surface, dt, percentile(speed, limits.percentile, front))
        if diffusion > 0:
            surface.extend_outwards(speed, front)
            # The polynomial of one step is below 0 for some fine waves, which a force of that sign would raise.
            for _ in range(2):
                diffuse(surface, front, speed, 0.5 * diffusion * dt)
        return self.remember(descent_plan(now, speed, dt, limits, cfl_dt, diffusion))
