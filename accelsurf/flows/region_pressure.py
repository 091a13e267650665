"""Momentum of a gas inside the surface: its pressure takes the surface's force to all of the mass."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from accelsurf.flows.clock import NOW
from accelsurf.flows.fluid import regrid_fluid, spacing_of, transport_fluid
from accelsurf.flows.protocol import EnergyRates, Flow, StepInput, StepLimits, StepPlan, wave_bound
from accelsurf.flows.region_mass import Layer, RegionMass
from accelsurf.kernels import fluid as kernels
from accelsurf.levelset import LevelSet

#: Depths below the surface, voxels, by which the gas is continued beyond it, and how far.
DEPTHS = (1.0, 2.0)
BEYOND = 3.0
#: Friction that leaves less than this of V acts at once.
MIN_FACTOR = 0.1
#: Least density beyond the surface, as a part of that at the surface.
MIN_BEYOND = 0.05


class Inside(NamedTuple):
    """The region: ``share`` (nz, ny, nx) of each voxel inside, ``volume`` |Omega| (mm3), ``squares`` P."""

    share: np.ndarray
    volume: float
    squares: float


class RegionPressure(RegionMass):
    """rho_t + div(rho V) = 0, V_t + (V . grad) V = -w g |Omega| grad rho - gamma V in the surface, S_t = (V . N) N.

    The mass lies inside, uniform at first, with the mass potential U_mass = g |Omega| P, P = int 1/2 rho^2: a gas of
    sound c^2 = w g |Omega| rho. At the surface its pressure balances the force, f + g (P - 1/2 |Omega| rho^2) = 0.
    Uniform rho without a force is at rest: no minimum moves. Where g < -f/P no pressure balances f, the gas meets a
    void; that share of the surface is reported as clamped.

    The fluid is half a step behind the surface. Between two half steps it moves within the surface that is halfway;
    beyond, it is continued along the normals, rho through the value of the balance, V evenly. Mass in the cells that
    the surface cuts errs by that; it is scaled to its value before, less the outflow through the border of the volume,
    and the sum of this is reported as correction.

    Parameters
    ----------
    gravity : float
        g, above 0.
    **common
        As `RegionMass`.
    """

    state_names = (*RegionMass.state_names, "_correction", "_potential", "_before")
    #: Of the trace; |Omega| of now, mm3; and the mass of the fluid within the surface before the last motion.
    _correction = 0.0
    _potential = 0.0
    _volume = 0.0
    _before = 0.0

    def __init__(self, gravity: float, **common: Any) -> None:
        super().__init__(**common)
        self.gravity = float(gravity)

    # -- state ---------------------------------------------------------------------------------------------

    def start(self, surface: LevelSet) -> None:
        """At rest with uniform density, as far as needed."""
        super().start(surface)
        self.fluid[0].reshape(-1)[self._far_outside(surface)] = 0.0
        self._correction = 0.0
        self._potential = 0.0
        self._before = 0.0

    def set_fluid(self, density: np.ndarray, velocity: np.ndarray) -> None:
        """Set the fluid as `RegionMass.set_fluid`; values are needed inside and three voxels beyond."""
        super().set_fluid(density, velocity)
        self.mass = 0.0

    def change_grid(self, surface: LevelSet, place: np.ndarray) -> None:
        """Take the fluid to the grid of ``surface``, ``place`` as for `regrid_fluid`; the mass is that there."""
        self.fluid, self._cell = (
            regrid_fluid(self.fluid, place, surface.shape, 0.0),
            surface.voxel_volume,
        )
        self.mass = 0.0

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Continue with other settings."""
        super().continue_from(surface, before, forces_changed)
        self.mass = 0.0

    def energy(self, area: np.ndarray) -> float:
        """T/w now, and the mass potential of the last step."""
        return super().energy(area) + self._potential

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Change V along N, in all of the band."""
        self.fluid = self._accelerated(
            surface, self.fluid, speed[:, None] * surface.normals(), math.inf
        )

    # -- one step ------------------------------------------------------------------------------------------

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Move the fluid over the step around the present time, under the pressure of now, then the surface."""
        surface, front = now.surface, now.front
        inside, normal = self._balanced(surface), surface.normals()
        density, clamped = self._at_surface(now, inside)
        layer = Layer(normal, now.area, density)
        dt, cfl_dt = self.stable_dt(now, layer, limits)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        before = self.fluid
        self.fluid = self._pressed(surface, inside, layer, dt)
        self._before = float((inside.share * self.fluid[0]).sum(dtype=np.float64)) * self._cell
        self.mass -= self._outflow(surface, inside.share) * dt
        self._potential = self.gravity * inside.volume * inside.squares
        velocity = self._velocity(surface, self.fluid, front, normal)
        fast = self._voxel_rates(surface, velocity) * dt / limits.cfl
        velocity = velocity / np.maximum(fast, 1.0)[:, None]
        kinetic = self._kinetic_between(before, inside.share)
        rates = EnergyRates(
            kinetic=kinetic,
            weight=self.clock.weight(),
            mass_potential=self._potential,
            friction=self.clock.loss * kinetic / self.clock.weight(),
            mass=self.mass,
            mass_correction=self._correction,
            clamped=clamped,
        )
        return self._plan(now, limits, velocity, normal, dt, rates)._replace(cfl_dt=cfl_dt)

    def synchronize(self, now: StepInput) -> None:
        """Move the fluid over the half step that it is behind."""
        inside = self._balanced(now.surface)
        layer = Layer(now.surface.normals(), now.area, self._at_surface(now, inside)[0])
        self.fluid = self._pressed(now.surface, inside, layer, 0.0)
        self.clock.start_moving()

    def _peak_and_stiffness(
        self, now: StepInput, layer: Layer, limits: StepLimits
    ) -> tuple[float, float]:
        """Peak acceleration at the surface, voxels, and the larger of alpha per mass per area and of c^2/w."""
        mean = np.full(now.surface.size, self.mass / max(self._volume, 1e-300))
        peak, stiffness = super()._peak_and_stiffness(now, layer._replace(density=mean), limits)
        return peak, max(stiffness, self._sound(now.surface))

    def stable_dt(self, now: StepInput, layer: Layer, limits: StepLimits) -> tuple[float, float]:
        """Stable step, see `RegionMass.stable_dt`; the fastest wave goes at most h/sqrt(3): the surface follows."""
        dt, cfl_dt = super().stable_dt(now, layer, limits)
        speed = math.sqrt(self.clock.next_weight() * self._sound(now.surface))
        if not self.clock.at_rest:
            speed += self._fastest(
                self.fluid.reshape(4, -1)[:, now.surface.dense.psi < 0].astype(np.float64)
            )
        return min(dt, wave_bound(now.surface, speed)) if speed > 0 else dt, cfl_dt

    def _fastest(self, gas: np.ndarray) -> float:
        """Largest |V| in cells (4, n)."""
        moves = gas[0] > self._dry
        return float(np.linalg.norm(gas[1:, moves] / gas[0, moves], axis=0).max(initial=0.0))

    def _sound(self, surface: LevelSet) -> float:
        """Largest c^2/w."""
        inside = (surface.dense.psi < 0).reshape(surface.shape)
        return self.gravity * self._volume * float(self.fluid[0].max(initial=0.0, where=inside))

    def _pressed(self, surface: LevelSet, inside: Inside, layer: Layer, dt: float) -> np.ndarray:
        """The fluid after the kick around now and the motion of as long."""
        factor, gain = self.clock.kick(dt)
        lasting = 0.5 * (self.clock.last_dt + dt)
        # Friction is half before and half after the pressure; all of it before, if it takes all.
        first = math.sqrt(factor) if factor > MIN_FACTOR else factor
        second = factor / first if factor > 0.0 else 1.0
        stiffness = self.gravity * inside.volume * gain / (second * lasting)
        # Into a void a gas flows at V + 2 c.
        gas = self.fluid.reshape(4, -1)[:, surface.dense.psi < 0].astype(np.float64)
        speed = self._fastest(gas) + 2.0 * math.sqrt(stiffness * float(gas[0].max(initial=0.0)))
        beyond = partial(self._continue, surface, layer, max(speed, 1e-30))
        moved = transport_fluid(
            surface, self._slowed(self.fluid, first), lasting, stiffness, self._dry, beyond
        ).fluid
        beyond(moved)
        return self._slowed(moved, second)

    @staticmethod
    def _slowed(fluid: np.ndarray, factor: float) -> np.ndarray:
        out = fluid * np.float32(factor)
        out[0] = fluid[0]
        return out

    def _kinetic_between(self, before: np.ndarray, share: np.ndarray) -> float:
        """T between the last half step and the next: that of the mean of both fluids."""
        # A velocity that is that of now needs no mean.
        between = before if self.clock.last_dt <= NOW else 0.5 * (before + self.fluid)
        self.detect_oscillation(self._sums(before * share, self.fluid * share).between)
        return self._sums(between * share, between * share).after

    # -- surface and fluid ---------------------------------------------------------------------------------

    def _balanced(self, surface: LevelSet) -> Inside:
        """Scale the fluid to the mass that it had before the surface moved; returns the region."""
        share = (surface.dense.psi < 0).astype(np.float32)
        share[surface.band.cells] = surface.fraction_and_area()[0]
        share = share.reshape(surface.shape)
        there = float((share * self.fluid[0]).sum(dtype=np.float64)) * self._cell
        if self.mass == 0.0:
            self.mass = there
        # The fluid is halfway between two surfaces.
        halfway = 0.5 * (self._before + there) if self._before > 0.0 else there
        if halfway > 0.0 and self.mass > 0.0:
            self._correction += self.mass / halfway - 1.0
            self.fluid = self.fluid * np.float32(self.mass / halfway)
            # A part that was removed leaves its gas.
            self.fluid.reshape(4, -1)[:, self._far_outside(surface)] = 0.0
        self._volume = volume = float(share.sum(dtype=np.float64)) * self._cell
        squares = 0.5 * float((share * self.fluid[0].astype(np.float64) ** 2).sum()) * self._cell
        # Of now, that is of the mass within this surface: of half a step before it would brake the surface.
        squares *= (halfway / there) ** 2 if there > 0.0 else 1.0
        return Inside(share, volume, squares)

    @staticmethod
    def _far_outside(surface: LevelSet) -> np.ndarray:
        """Mask (voxels,) of the outside beyond the band."""
        return (surface.dense.psi > 0) & (surface.dense.slot < 0)

    def _at_surface(self, now: StepInput, inside: Inside) -> tuple[np.ndarray, float]:
        """Density (n,) that balances the force, and the share of the surface where none does."""
        stiffness = self.gravity * inside.volume
        pressure = np.asarray(now.force, np.float64) + self.gravity * inside.squares
        area = max(float(now.area.sum()), 1e-300)
        density = np.sqrt(2.0 * np.maximum(pressure, 0.0) / max(stiffness, 1e-300))
        return density, float((now.area * (pressure < 0.0)).sum()) / area

    def _continued(
        self, surface: LevelSet, fluid: np.ndarray, normal: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Density below the surface (n,), and velocity (n, 3) ``depth`` (n,) voxels beyond it, continued evenly."""
        out = np.empty((surface.size, 2, 4))
        surface.workers.parallel(
            kernels.probe_inside,
            surface.size,
            fluid,
            surface.grid,
            surface.band,
            normal,
            np.array(DEPTHS),
            out,
        )
        near, far = out[:, 0], out[:, 1]
        along = (depth + DEPTHS[0]) / (DEPTHS[1] - DEPTHS[0])
        # The little fluid at a void says nothing about the velocity further on.
        along[near[:, 0] < MIN_BEYOND * self.mass / max(self._volume, 1e-300)] = 0.0
        return near[:, 0], near[:, 1:] + (near[:, 1:] - far[:, 1:]) * along[:, None]

    def _velocity(
        self, surface: LevelSet, fluid: np.ndarray, where: np.ndarray, normal: np.ndarray
    ) -> np.ndarray:
        """V (n, 3) of the surface at the cells ``where`` (n,): that of the gas below, continued evenly."""
        return np.where(
            where[:, None], self._continued(surface, fluid, normal, np.zeros(surface.size))[1], 0.0
        )

    def _continue(self, surface: LevelSet, layer: Layer, fastest: float, fluid: np.ndarray) -> None:
        """Set, in place, the fluid up to `BEYOND` voxels outside, with V at most ``fastest``; further out is none."""
        d = self._voxel_rates(surface, surface.band.to_closest)
        below, velocity = self._continued(surface, fluid, layer.normal, d)
        rho = layer.density + (layer.density - below) * (d / DEPTHS[0])
        rho = np.maximum(rho, MIN_BEYOND * layer.density)
        rho[d > BEYOND] = 0.0
        velocity /= np.maximum(np.linalg.norm(velocity, axis=1) / fastest, 1.0)[:, None]
        flat, outside = fluid.reshape(4, -1), surface.band.psi >= 0
        cells = surface.band.cells[outside]
        flat[0, cells] = rho[outside]
        flat[1:, cells] = (rho[:, None] * velocity)[outside].T

    def _outflow(self, surface: LevelSet, share: np.ndarray) -> float:
        """Mass that flows through the border of the volume per unit time."""
        total = 0.0
        for axis, h in enumerate(spacing_of(surface)):
            if surface.shape[axis] > 1:
                flux = self.fluid[1 + axis] * share
                total += (
                    float(flux.take(-1, axis).sum() - flux.take(0, axis).sum()) * self._cell / h
                )
        return total
