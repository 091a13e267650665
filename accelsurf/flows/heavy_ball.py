"""Gradient descent with the plain momentum of the literature: the second baseline."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.descent import Descent, descent_plan, stable_dt
from accelsurf.flows.protocol import StepInput, StepLimits, StepPlan, voxel_rates
from accelsurf.levelset import LevelSet


class HeavyBall(Descent):
    """Step s_n = (1 - omega) dt f + omega s_(n-1), redistanced after each (Andersson, Läthén, Lenz, Borga 2013).

    The last step is a field on the surface, extended along normals as all fields are. There is no mass, no time
    but the number of steps, and no term for the motion of the surface itself.

    Parameters
    ----------
    blend : float
        omega, the fraction of the last step that is added again: 0 (plain descent) up to, not including, 1.
    """

    name = "momentum"

    def __init__(self, blend: float = 0.8) -> None:
        super().__init__()
        self.blend = float(blend)

    def zero_momentum(self, area: np.ndarray) -> float:
        """Set the last step to zero."""
        self._last[:] = 0.0
        return 0.0

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """The last step, mm."""
        return self._last

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Change the last step."""
        self._last = self._last + speed

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with the bounds of plain descent; a step beyond the limit is clipped before it becomes the last one."""
        force = np.asarray(now.force, np.float32)
        cfl_dt = self.cfl_dt(voxel_rates(now.surface, now.front, force)[now.front], now.surface, limits)
        dt = min(stable_dt(now, cfl_dt), limits.dt_max)
        if not math.isfinite(dt):
            return StepPlan.none(now.surface)
        speed = np.float32(1.0 - self.blend) * force + np.float32(self.blend / dt) * self._last
        move = descent_plan(now, speed, dt, limits, cfl_dt)
        self._last = move.speed * np.float32(dt)
        return move
