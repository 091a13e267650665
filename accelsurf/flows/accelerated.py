"""Base of the paper's accelerated systems: clock, noise, energies, and the stiffness that bounds the step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from accelsurf.flows.clock import Clock
from accelsurf.flows.diffusion import free_diffusion, largest_diffusion
from accelsurf.flows.noise import Noise
from accelsurf.flows.protocol import EnergyRates, Flow, StepInput, StepLimits
from accelsurf.levelset import LevelSet

#: Where the speeds reverse in two steps in a row, the estimate of the force stiffness grows by the first factor, up to
#: this multiple of the estimate by the peak force: the step becomes shorter by the square root.
STIFFNESS_GROWTH = 1.5
MAX_STIFFNESS_FACTOR = 16.0


class Accelerated(Flow):
    """Base of the two mass models. See `Clock` for k, lambda_, friction and t0.

    Parameters
    ----------
    rho : float
        Mass per area at the start.
    diffusion : float, optional
        D of the velocity along the surface, mm2 per unit time; it may shorten the step. None is the
        free gain of each step (`diffusion.free_diffusion`).
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

    def _initialize(self, surface: LevelSet) -> None:
        self._workers = surface.workers
        self.clock.start()
        self._forget_forces()
        if self.noise is not None:
            self.noise.start()

    def start_moving(self, surface: LevelSet, fields: list[np.ndarray]) -> None:
        """Start on ``surface`` in motion, with `fields` of this moment. Without t0 it needs a constant friction."""
        self.start(surface)
        self.set_fields(fields)
        self.clock.start_moving()

    @abstractmethod
    def synchronize(self, now: StepInput) -> None:
        """Kick the speeds, which are half a step behind the surface, up to its time, by the forces there."""

    def state(self) -> dict[str, Any]:
        """Copy the state that goes from step to step, without the settings."""
        noise = None if self.noise is None else self.noise.state()
        return {**super().state(), "clock": self.clock.state(), "noise": noise}

    def restore(self, surface: LevelSet, state: dict[str, Any]) -> None:
        """Set the state that a flow of the same settings returned on this surface."""
        super().restore(surface, state)
        self._workers = surface.workers
        self.clock.restore(*state["clock"])
        if self.noise is not None:
            self.noise.restore(*state["noise"])

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Continue with other settings: speeds and time on the clock stay; noise begins if there was none."""
        assert isinstance(before, Accelerated)
        Flow.restore(self, surface, before.state())
        self._workers = surface.workers
        self.clock.continue_from(before.clock)
        if self.noise is not None and before.noise is not None:
            self.noise.restore(*before.noise.state())
        if forces_changed:
            self._forget_forces()

    #: Also the factor by which oscillations have raised the stiffness estimate, and whether the speeds reversed in the
    #: last step.
    state_names = (*Flow.state_names, "_stiffness_factor", "_reversed")

    def _forget_forces(self) -> None:
        super()._forget_forces()
        self._stiffness_factor, self._reversed = 1.0, False

    def _reset_clock(self) -> None:
        self.clock.zero_momentum()
        if self.noise is not None:
            self.noise.zero_momentum()

    @abstractmethod
    def _kinetic(self, area: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
        """1/2 int rho V . V' dA of two velocities; the paper's T of one."""

    def _energy_rates(self, area: np.ndarray, stages: tuple[np.ndarray, ...]) -> EnergyRates:
        """Energies from the velocities before, after diffusion, kick, noise and clipping.

        Each stage changes the momentum; the work of a change is its product with the mean of the velocities before and
        after all of them. Only so does the work of the force equal the decrease of U: the surface moves by the velocity
        before in the step that ends here, and by the one after in the step that begins.
        """
        before, smoothed, kicked, noisy, after = stages
        w = self.clock.weight()
        mean = 0.5 * (before + after)

        def work(earlier: np.ndarray, later: np.ndarray) -> float:
            # Where a stage changed nothing, it is the same array as the one before.
            return 0.0 if later is earlier else 2.0 * self._kinetic(area, later - earlier, mean) / w

        self.detect_oscillation(self._kinetic(area, before, after))
        # T at the time of the record, which is half a step from both velocities: that of their mean. Their product is
        # below 0 where the velocity reverses. At rest ``before`` is the velocity at that time itself.
        between = before if self.clock.at_rest else mean
        kinetic, friction = self._kinetic(area, between, between), 0.0
        if not self.clock.at_rest:
            # The kick damps the speeds that diffusion left, which may be far below those before.
            gamma = self.clock.gamma
            friction = (
                gamma * self._kinetic(area, smoothed + kicked, mean)
                + (self.clock.loss - 2.0 * gamma) * kinetic
            )
        return EnergyRates(
            kinetic=kinetic,
            weight=w,
            friction=friction / w,
            smoothing=-work(before, smoothed) - work(noisy, after),
            noise=work(kicked, noisy),
        )

    def force_stiffness(self, peak: float, surface: LevelSet) -> float:
        """Estimate of the force stiffness: the peak force so far (voxels), times the factor raised by oscillations."""
        return self.peak_force_so_far(peak, surface) * self._stiffness_factor

    def detect_oscillation(self, kinetic: float) -> None:
        """Raise the stiffness when the speeds before and after a kick are opposed on average in two steps in a row.

        Leap-frog is stable up to omega dt = 2. An oscillation of more than four steps reverses the speeds in one of
        them at most; two in a row mean an oscillation with omega dt > pi/2, which soon grows.
        """
        reverses = kinetic < 0.0
        if reverses and self._reversed:
            self._stiffness_factor = min(
                self._stiffness_factor * STIFFNESS_GROWTH, MAX_STIFFNESS_FACTOR
            )
        self._reversed = reverses

    def _bounded(self, dt: float, surface: LevelSet, limits: StepLimits) -> float:
        """The step ``dt`` within the bounds of diffusion and noise, and the user's."""
        if self.diffusion:
            dt = min(dt, largest_diffusion(surface) / self.diffusion)
        if self.noise is not None and self.noise.acts:
            dt = min(dt, self.noise.longest_dt(surface, limits.cfl))
        return min(dt, limits.dt_max)

    @staticmethod
    def _extended(surface: LevelSet, velocity: np.ndarray, front: np.ndarray) -> np.ndarray:
        """A velocity (n, 3) of the front, float32, on the whole band."""
        components = [np.ascontiguousarray(velocity[:, c], np.float32) for c in range(3)]
        for component in components:
            surface.extend_outwards(component, front)
        return np.stack(components, axis=1)

    def _diffusion_now(self, surface: LevelSet, dt: float, speed: float) -> float:
        return free_diffusion(surface, dt, speed) if self.diffusion is None else self.diffusion

    def _noise_now(self, now: StepInput, dt: float, components: int) -> np.ndarray | None:
        if self.noise is None or not self.noise.acts:
            return None
        return self.noise.kicks(now.surface, now.front, dt, components)
