"""The paper's constant-density surfaces: momentum on a surface of constant mass per area."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.accelerated import Accelerated
from accelsurf.flows.diffusion import diffuse
from accelsurf.flows.protocol import (
    StepInput,
    StepLimits,
    StepPlan,
    cfl_bound,
    clip_speed,
    front_percentiles,
    percentile,
    voxel_rates,
    wave_bound,
)
from accelsurf.kernels import motion, statistics
from accelsurf.levelset import LevelSet


class ConstantDensity(Accelerated):
    """beta_t = w f/rho + 1/2 beta^2 H - gamma beta + D Lap beta + tau xi on the surface, psi_t = beta |grad psi|.

    The paper's system for surfaces with the corrected signs: w = lambda k^2 t^(k-2), gamma = (k+1)/t; with a
    constant friction a, w = lambda and gamma = a. Parameters as `Accelerated`.
    """

    name = "constant-density"
    state_names = (*Accelerated.state_names, "beta")
    beta = np.zeros(0, np.float32)

    @property
    def fields(self) -> list[np.ndarray]:
        """The speed beta."""
        return [self.beta]

    def start(self, surface: LevelSet) -> None:
        """At rest on ``surface``."""
        self.beta = np.zeros(surface.size, np.float32)
        self._initialize(surface)

    def zero_momentum(self, area: np.ndarray) -> float:
        """Set the speed to zero, and the clock of the friction to the start."""
        lost = self.energy(area)
        self.beta[:] = 0.0
        self._reset_clock()
        return lost

    def energy(self, area: np.ndarray) -> float:
        """T/w now."""
        return self._kinetic(area, self.beta, self.beta) / self.weight

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """The speeds on the new band."""
        (self.beta,) = fields

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """The speed beta."""
        return self.beta

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Change beta."""
        self.beta = self.beta + speed

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Kick the speeds by the force over the step around the present time; the centred leap-frog."""
        surface = now.surface
        front = now.front
        clock = self.clock
        force = front_percentiles(now, now.force, limits.percentile)
        speed = (
            (0.0, 0.0) if clock.at_rest else front_percentiles(now, self.beta, limits.percentile)
        )
        dt, cfl_dt = self.stable_dt(now, limits, force, speed)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        before = self.beta
        self.beta = before.copy()
        diffusion = 0.0
        smoothed = before
        damping = 0.0
        impulse = clock.first_kick(dt)
        dm = 0.5 * (dt + clock.last_dt)
        if not clock.at_rest:
            damping, impulse = clock.gamma * dm, clock.weight() * dm
            diffusion = self._diffusion_now(
                surface, dm, speed[0] + dt * impulse / (self.rho * dm) * force[0]
            )
            if diffusion > 0:
                diffuse(surface, front, self.beta, diffusion * dm)
                smoothed = self.beta.copy()
        kick = np.float32(impulse / self.rho) * np.asarray(now.force, np.float32)
        rates = damping, 0.0 if clock.at_rest else dm
        surface.workers.parallel(
            motion.kick, surface.size, self.beta, kick, now.curvature, front, rates
        )
        # Copies: the speeds are clipped in place.
        kicked = noisy = self.beta.copy()
        noise = self._noise_now(now, dm, 1)
        if noise is not None:
            self.beta += noise[:, 0]
            noisy = self.beta.copy()
        clipped = clip_speed(self.beta, voxel_rates(surface, front, self.beta), dt, limits.cfl)
        energy_rates = self._energy_rates(now.area, (before, smoothed, kicked, noisy, self.beta))
        if diffusion > 0:
            # The surface came here by the speed before diffusion, the transport term has the one after: its work is
            # less than the change of the area took, and diffusion has taken less by that.
            bend = np.float32(0.5 * dm) * np.where(front, now.curvature, np.float32(0.0))
            missing = bend * kicked * (before - smoothed)
            share = self._kinetic(now.area, missing, before) + self._kinetic(
                now.area, missing, self.beta
            )
            energy_rates = energy_rates._replace(
                smoothing=energy_rates.smoothing + share / clock.weight()
            )
        energy_rates = energy_rates._replace(mass=self.rho * float(now.area.sum()))
        front_speed = percentile(self.beta, limits.percentile, front)
        surface.extend_outwards(self.beta, front)
        clock.tick(dt)
        share = clipped / max(1, int(front.sum()))
        return StepPlan(dt, self.beta, None, front_speed, share, diffusion, energy_rates, cfl_dt)

    def synchronize(self, now: StepInput) -> None:
        """Kick the speeds over the half step that they are behind."""
        surface, dm = now.surface, 0.5 * self.clock.last_dt
        damping, impulse = self.clock.gamma * dm, self.clock.weight() * dm
        kick = np.float32(impulse / self.rho) * np.asarray(now.force, np.float32)
        self.beta = self.beta.copy()
        surface.workers.parallel(
            motion.kick, surface.size, self.beta, kick, now.curvature, now.front, (damping, dm)
        )
        surface.extend_outwards(self.beta, now.front)
        self.clock.start_moving()

    def _kinetic(self, area: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
        """1/2 rho int beta beta' dA."""
        products = self._workers.block_sums(statistics.products, area.size, 1, area, first, second)
        return 0.5 * self.rho * float(products[0])

    def stable_dt(
        self,
        now: StepInput,
        limits: StepLimits,
        force: tuple[float, float],
        speed: tuple[float, float],
    ) -> tuple[float, float]:
        """Largest stable time step, and that of the CFL number alone.

        ``force`` and ``speed`` are percentiles, each per mm and in voxels. CFL, b dt + A dt^2/2 <= cfl with b and A
        the percentiles of speed and acceleration in voxels; transverse waves, dt <= h/(sqrt(3) c_T) with
        c_T = sqrt(beta^2/2 + w alpha/rho); diffusion and noise.
        """
        surface = now.surface
        peak = self.force_stiffness(force[1], surface) / self.rho
        stiffness = now.alpha / self.rho
        if self.clock.at_rest:
            dt = cfl_dt = self.clock.first_dt(peak, stiffness, surface.smallest_spacing, limits.cfl)
        else:
            w = self.clock.next_weight()
            cfl_dt = cfl_bound(speed[1], w * peak, limits.cfl)
            dt = min(cfl_dt, wave_bound(surface, math.sqrt(0.5 * speed[0] ** 2 + w * stiffness)))
        return self._bounded(dt, surface, limits), cfl_dt
