"""What the paper's systems share: the clock, its weight and friction, the start from rest, the bounds on the step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from accelsurf.flows.noise import Noise
from accelsurf.flows.protocol import (
    EnergyRates,
    Flow,
    StepInput,
    StepLimits,
    diffusion_reach,
    free_diffusion,
    smallest_spacing,
)
from accelsurf.levelset import LevelSet

#: Where the surface turns around in two steps running, its wells are taken to be steeper by this factor, at most so
#: many times steeper than the strongest force says: the square of what the step becomes shorter by.
STEEPER, STEEPEST = 1.5, 16.0


class Clock:
    """The time t of the weight w = lambda k^2 t^(k-2) and the friction gamma = (k+1)/t.

    With a constant friction a, w = lambda and gamma = a. From rest at t = 0 the first half step follows the exact
    series beta = (lambda k/2) t^(k-1) f/rho; that needs k > 1. Otherwise the clock starts at t0 > 0, from rest.

    Parameters
    ----------
    k, lambda_ : float
        Order and strength of the potential.
    friction : float, optional
        A constant friction instead of (k+1)/t.
    t0 : float, optional
        Time on the clock at rest. None: 0 for k > 1; otherwise the time in which the first step is made.
    """

    def __init__(
        self, k: float = 2.0, lambda_: float = 1.0, friction: float | None = None, t0: float | None = None
    ) -> None:
        self.k, self.lambda_, self.friction = float(k), float(lambda_), friction
        self._given = 0.0 if t0 is None and (k > 1 or friction is not None) else t0
        self.t0 = self._given
        self.time = self.t0 or 0.0
        #: The last time step, 0 right after a rest.
        self.last_dt = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether no step was made since the last rest."""
        return self.last_dt == 0.0

    def start(self) -> None:
        """Begin another run."""
        self.t0 = self._given
        self.zero_momentum()

    def zero_momentum(self) -> None:
        """Back to the time of a start from rest."""
        self.time, self.last_dt = self.t0 or 0.0, 0.0

    def state(self) -> tuple[float | None, float, float]:
        """What it remembers: t0 as it was found, time and last step."""
        return self.t0, self.time, self.last_dt

    def restore(self, kept: tuple[float | None, float, float]) -> None:
        """Be as it was."""
        self.t0, self.time, self.last_dt = kept

    def continue_from(self, before: Clock) -> None:
        """Go on from a clock with other settings: its time, unless it is at rest, where each has its own."""
        same = (self.k, self.lambda_, self.friction, self._given) == (
            before.k, before.lambda_, before.friction, before._given
        )
        if same:
            self.restore(before.state())
        elif not before.at_rest:
            self.time, self.last_dt = before.time, before.last_dt

    def tick(self, dt: float) -> None:
        """Go on by ``dt``."""
        self.time += dt
        self.last_dt = dt

    def weight(self, t: float | None = None) -> float:
        """Weight w at time ``t``, now unless given; at 0, where it may be infinite, that of time 1."""
        t = self.time if t is None else t
        if self.friction is not None:
            return self.lambda_
        return self.lambda_ * self.k**2 * (t if t > 0 else 1.0) ** (self.k - 2.0)

    @property
    def gamma(self) -> float:
        """Friction now (time > 0)."""
        return (self.k + 1.0) / self.time if self.friction is None else self.friction

    @property
    def loss(self) -> float:
        """Part of T/w that is lost per unit of time, now: 2 gamma + w'/w = 3 k/t, or 2 a."""
        if self.friction is not None:
            return 2.0 * self.friction
        return 3.0 * self.k / self.time if self.time > 0 else 0.0

    def first_kick(self, dt: float) -> float:
        """Speed per f/rho half a step after rest."""
        half = 0.5 * dt
        if self.friction is not None:
            return half * self.lambda_ / (1.0 + 0.5 * half * self.friction)
        if self.time == 0.0:
            return self.lambda_ * 0.5 * self.k * half ** (self.k - 1.0)
        return half * self.weight() / (1.0 + 0.5 * half * self.gamma)

    def first_dt(self, pull: float, stiffness: float, h: float, cfl: float) -> float:
        """Largest first step: travel beta(dt/2) dt <= cfl with f/rho = ``pull`` (voxels), and the wave bound.

        ``stiffness`` is the sum of the tensions over rho: waves run at sqrt(w stiffness).
        """
        if pull <= 0:
            return math.inf
        if self.t0 is None:
            # The step that a weight of that very time allows: lambda k^2 t^(k-2) f/rho t^2/2 = cfl.
            self.t0 = self.time = (2.0 * cfl / (self.lambda_ * self.k**2 * pull)) ** (1.0 / self.k)
        if self.friction is None and self.time == 0.0:
            k = self.k
            travel = (cfl * 2.0 ** (k - 1.0) / (0.5 * k * self.lambda_ * pull)) ** (1.0 / k)
            if stiffness <= 0:
                return travel
            return min(travel, (h / (k * math.sqrt(3.0 * self.lambda_ * stiffness))) ** (2.0 / k))
        w = self.weight()
        wave = h / math.sqrt(3.0 * w * stiffness) if stiffness > 0 else math.inf
        return min(math.sqrt(2.0 * cfl / (w * pull)), wave)

    def next_weight(self) -> float:
        """Weight w at the end of a step like the last: where it grows, the step must be stable up to there."""
        return self.weight(self.time + (self.last_dt if self.k > 2 else 0.0))


class Accelerated(Flow):
    """What the two mass models share. See `Clock` for k, lambda_, friction and t0.

    Parameters
    ----------
    rho : float
        Mass per area at the start.
    diffusion : float, optional
        D of the velocity along the surface, mm2 per unit time; the step is as short as it needs. None is the
        free gain of each step (`base.free_diffusion`).
    noise : Noise, optional
        Random acceleration.
    """

    def __init__(
        self,
        k: float = 2.0,
        lambda_: float = 1.0,
        rho: float = 1.0,
        friction: float | None = None,
        diffusion: float | None = None,
        t0: float | None = None,
        noise: Noise | None = None,
    ) -> None:
        self.clock = Clock(k, lambda_, friction, t0)
        self.rho = float(rho)
        self.diffusion = diffusion
        self.noise = noise
        self._forget_forces()

    @property
    def weight(self) -> float:
        """The factor w of the potential, lambda k^2 t^(k-2) (lambda with a constant friction)."""
        return self.clock.weight()

    def _begin(self, surface: LevelSet) -> None:
        self._workers = surface.workers
        self.clock.start()
        self._forget_forces()
        if self.noise is not None:
            self.noise.start()

    def state(self) -> dict[str, Any]:
        """All that the flow remembers from step to step, but not its settings."""
        noise = None if self.noise is None else self.noise.state()
        return {**super().state(), "clock": self.clock.state(), "noise": noise}

    def restore(self, surface: LevelSet, state: dict[str, Any]) -> None:
        """Be as a flow of the same settings was when its state was ``state``."""
        super().restore(surface, state)
        self._workers = surface.workers
        self.clock.restore(state["clock"])
        if self.noise is not None:
            self.noise.restore(state["noise"])

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Go on with other settings: speeds and time on the clock stay; noise that was not there begins."""
        assert isinstance(before, Accelerated)
        Flow.restore(self, surface, before.state())
        self._workers = surface.workers
        self.clock.continue_from(before.clock)
        if self.noise is not None and before.noise is not None:
            self.noise.restore(before.noise.state())
        if forces_changed:
            self._forget_forces()

    #: Also how many times steeper than the strongest force says they have shown to be, and whether the surface turned
    #: around in the last step.
    state_names = (*Flow.state_names, "_steeper", "_turned")

    def _forget_forces(self) -> None:
        super()._forget_forces()
        self._steeper, self._turned = 1.0, False

    def _put_to_rest(self) -> None:
        self.clock.zero_momentum()
        if self.noise is not None:
            self.noise.zero_momentum()

    def _kinetic(self, area: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
        """The paper's T of two velocities half a step before and after."""
        raise NotImplementedError

    def _account(self, area: np.ndarray, stages: tuple[np.ndarray, ...]) -> EnergyRates:
        """Energies from the velocities before, after diffusion, kick, noise and limiter."""
        before, smoothed, kicked, noisy, after = stages
        w = self.clock.weight()
        # Where nothing happened two stages are one array.
        energies = {id(stage): self._kinetic(area, stage, stage) / w for stage in stages}

        def energy(velocity: np.ndarray) -> float:
            return energies[id(velocity)]

        kinetic = self._kinetic(area, before, after)
        self._detect_oscillation(kinetic)
        return EnergyRates(
            kinetic=kinetic,
            weight=w,
            friction=self.clock.loss * kinetic / w,
            smoothing=energy(before) - energy(smoothed) + energy(noisy) - energy(after),
            noise=energy(noisy) - energy(kicked),
        )

    def _force_stiffness(self, pull: float, surface: LevelSet) -> float:
        """Strongest force per mass (voxels) so far, and what turning around has shown beyond it."""
        return self._peak_force_so_far(pull, surface) * self._steeper

    def _detect_oscillation(self, kinetic: float) -> None:
        """Take the wells for steeper when the speeds before and after a kick are opposed on the whole, twice running.

        Leap-frog is stable up to omega dt = 2. A surface that swings by itself in more than four steps turns around in
        one of them at most; in two running, something swings by omega dt > pi/2, and soon grows.
        """
        turned = kinetic < 0.0
        if turned and self._turned:
            self._steeper = min(self._steeper * STEEPER, STEEPEST)
        self._turned = turned

    def _bounded(self, dt: float, surface: LevelSet, limits: StepLimits) -> float:
        """The step ``dt`` within the bounds of diffusion and noise, and the user's."""
        if self.diffusion:
            dt = min(dt, diffusion_reach(surface) / self.diffusion)
        if self.noise is not None and self.noise.acts:
            dt = min(dt, self.noise.longest_dt(surface, limits.cfl))
        return min(dt, limits.dt_max)

    def _diffusion_now(self, surface: LevelSet, dt: float, speed: float) -> float:
        return free_diffusion(surface, dt, speed) if self.diffusion is None else self.diffusion

    def _noise_now(self, now: StepInput, dt: float, components: int) -> np.ndarray | None:
        if self.noise is None or not self.noise.acts:
            return None
        return self.noise.kicks(now.surface, now.front, dt, components)


def cfl_dt(speed: float, acceleration: float, cfl: float) -> float:
    """Step in which b dt + A dt^2/2 = cfl."""
    root = speed + math.sqrt(speed * speed + 2.0 * acceleration * cfl)
    return 2.0 * cfl / root if root > 0 else math.inf


def wave_dt(surface: LevelSet, speed: float) -> float:
    """Step in which a transverse wave of ``speed`` goes h/sqrt(3): stable in any direction."""
    return smallest_spacing(surface) / (math.sqrt(3.0) * speed) if speed > 0 else math.inf
