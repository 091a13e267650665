"""The paper's constant-density surfaces: momentum on a surface of constant mass per area."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.base import (
    Limits,
    Move,
    diffuse,
    free_diffusion,
    hold_back,
    percentile,
    smallest_spacing,
    voxel_rates,
)
from accelsurf.kernels import motion
from accelsurf.levelset import LevelSet

#: Automatic velocity diffusion: D = MIXING x h x front speed, a mixing length in voxels. The surface then
#: averages its speed over the same patch for each voxel travelled, whatever the step.
MIXING = 16.0


class ConstantDensity:
    """beta_t = w f/rho + 1/2 beta^2 H - gamma beta + D Lap beta at the moving surface, psi_t = beta |grad psi|.

    The paper's system for surfaces with the corrected signs: w = lambda k^2 t^(k-2), gamma = (k+1)/t; with a
    constant friction a, w = lambda and gamma = a. From rest at t = 0 by the exact start-up series
    beta = (lambda k/2) t^(k-1) f/rho.

    Parameters
    ----------
    k, lambda_, rho : float
        Order, strength of the potential, mass per area.
    friction : float, optional
        A constant friction instead of (k+1)/t.
    diffusion : float, optional
        D in mm2 per unit time, capped at each step by the free bound; None chooses MIXING x h x speed.
    """

    name = "constant-density"

    def __init__(
        self,
        k: float = 2.0,
        lambda_: float = 1.0,
        rho: float = 1.0,
        friction: float | None = None,
        diffusion: float | None = None,
    ) -> None:
        self.k, self.lambda_, self.rho = float(k), float(lambda_), float(rho)
        self.friction = friction
        self.diffusion = diffusion
        self.beta = np.zeros(0, np.float32)
        #: Time since the last rest, and the last time step (0 right after a rest).
        self.clock = 0.0
        self._last_dt = 0.0
        self._strongest = 0.0

    @property
    def weight(self) -> float:
        """The factor w of the potential, lambda k^2 t^(k-2) (lambda with a constant friction)."""
        return self._weight_at(self.clock if self.clock > 0 else 1.0)

    def _weight_at(self, t: float) -> float:
        if self.friction is not None:
            return self.lambda_
        return self.lambda_ * self.k**2 * t ** (self.k - 2.0)

    @property
    def fields(self) -> list[np.ndarray]:
        """The speed beta."""
        return [self.beta]

    def start(self, surface: LevelSet) -> None:
        """At rest on ``surface``."""
        self.beta = np.zeros(surface.size, np.float32)
        self.clock = self._last_dt = self._strongest = 0.0

    def rest(self) -> None:
        """At rest where the surface is, with the clock of the friction at 0."""
        self.beta[:] = 0.0
        self.clock = self._last_dt = 0.0

    def take(self, fields: list[np.ndarray]) -> None:
        """The speeds on the new band."""
        (self.beta,) = fields

    def move(
        self,
        surface: LevelSet,
        front: np.ndarray,
        force: np.ndarray,
        curvature: np.ndarray,
        area: np.ndarray,
        alpha: float,
        limits: Limits,
    ) -> Move:
        """Kick the speeds by the force over the step around the present time; the centred leap-frog."""
        before = self.beta.copy()
        dt = self.stable_dt(surface, front, force, alpha, limits)
        if not math.isfinite(dt):
            return Move(0.0, np.zeros_like(before), 0.0, 0.0, 0.0, 0.0)
        diffusion = 0.0
        if self.clock == 0.0:
            self._start_up(force, front, dt)
        else:
            dm = 0.5 * (dt + self._last_dt)
            gamma = (self.k + 1.0) / self.clock if self.friction is None else self.friction
            pull = np.float32(self._weight_at(self.clock) / self.rho) * np.asarray(force, np.float32)
            diffusion = self._diffusion_now(surface, front, pull, dt, dm, limits)
            if diffusion > 0:
                diffuse(surface, front, self.beta, diffusion * dm)
            surface.workers.run(
                motion.kick, surface.size, self.beta, pull, curvature, front, (gamma * dm, dm)
            )
        held = hold_back(self.beta, voxel_rates(surface, front, self.beta), dt, limits.cfl)
        rate = percentile(np.abs(self.beta[front]), limits.percentile)
        kinetic = 0.5 * self.rho * float(np.dot(area, before.astype(np.float64) * self.beta))
        surface.extend_outwards(self.beta, front)
        self.clock += dt
        self._last_dt = dt
        return Move(dt, self.beta, kinetic, rate, held / max(1, int(front.sum())), diffusion)

    def _start_up(self, force: np.ndarray, front: np.ndarray, dt: float) -> None:
        if self.friction is None:
            factor = self.lambda_ * 0.5 * self.k * (0.5 * dt) ** (self.k - 1.0)
        else:
            factor = 0.5 * dt * self.lambda_ / (1.0 + 0.25 * self.friction * dt)
        self.beta = np.where(front, np.float32(factor / self.rho) * force, np.float32(0.0)).astype(np.float32)

    def stable_dt(
        self, surface: LevelSet, front: np.ndarray, force: np.ndarray, alpha: float, limits: Limits
    ) -> float:
        """Largest stable time step.

        Travel, b dt + A dt^2/2 <= cfl with b and A the percentiles of speed and acceleration in voxels, and
        transverse waves, dt <= h/(sqrt(3) c_T) with c_T = sqrt(beta^2/2 + w alpha/rho).
        """
        pull = percentile(voxel_rates(surface, front, force)[front], limits.percentile)
        # The strongest force so far: near the minimum forces fade, but the wells keep their steepness.
        pull = self._strongest = max(self._strongest, pull)
        h = smallest_spacing(surface)
        if self.clock == 0.0:
            return min(limits.dt_max, self._first_dt(pull, alpha, h, limits.cfl))
        w = self._weight_at(self.clock + (self._last_dt if self.k > 2 else 0.0))
        b = percentile(voxel_rates(surface, front, self.beta)[front], limits.percentile)
        a = w * pull / self.rho
        root = b + math.sqrt(b * b + 2.0 * a * limits.cfl)
        travel = 2.0 * limits.cfl / root if root > 0 else math.inf
        fastest = percentile(np.abs(self.beta[front]), limits.percentile)
        wave = math.sqrt(0.5 * fastest**2 + w * alpha / self.rho)
        return min(limits.dt_max, travel, h / (math.sqrt(3.0) * wave) if wave > 0 else math.inf)

    def _first_dt(self, pull: float, alpha: float, h: float, cfl: float) -> float:
        """From rest, beta(dt/2) dt <= cfl and, for k = 2, the wave bound; the same with w(dt) for other k."""
        if pull <= 0:
            return math.inf
        if self.friction is not None:
            travel = math.sqrt(2.0 * cfl * self.rho / (self.lambda_ * pull))
            wave = h / math.sqrt(3.0 * self.lambda_ * alpha / self.rho) if alpha > 0 else math.inf
            return min(travel, wave)
        k = self.k
        travel = (cfl * self.rho * 2.0 ** (k - 1.0) / (0.5 * k * self.lambda_ * pull)) ** (1.0 / k)
        if alpha <= 0:
            return travel
        return min(travel, (h / (k * math.sqrt(3.0 * self.lambda_ * alpha / self.rho))) ** (2.0 / k))

    def _diffusion_now(
        self, surface: LevelSet, front: np.ndarray, pull: np.ndarray, dt: float, dm: float, limits: Limits
    ) -> float:
        if self.diffusion is not None:
            wanted = self.diffusion
        else:
            speed = percentile(np.abs(self.beta[front]), limits.percentile)
            speed += dt * percentile(np.abs(pull[front]), limits.percentile)
            wanted = MIXING * smallest_spacing(surface) * speed
        return min(wanted, free_diffusion(surface, dm))
