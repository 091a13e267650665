"""Momentum of mass on the whole grid: a fluid that the surface's force moves, and that moves the surface."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from accelsurf.flows.accelerated import Accelerated
from accelsurf.flows.clock import NOW
from accelsurf.flows.fluid import (
    DRY,
    FluidSums,
    fluid_sums,
    make_fluid,
    regrid_fluid,
    spacing_of,
    transport_fluid,
)
from accelsurf.flows.mass_balance import layer_area
from accelsurf.flows.protocol import (
    EnergyRates,
    Flow,
    StepInput,
    StepLimits,
    StepPlan,
    cfl_bound,
    percentile,
    wave_bound,
)
from accelsurf.kernels import fluid as kernels
from accelsurf.levelset import LevelSet

#: Half width, voxels, of the layer in which the force acts on the fluid.
LAYER = 1.5
#: The force accelerates a density that is at most this factor below the mean at the surface.
DENSITY_RANGE = 20.0
#: Integral of the square of the delta function, times its half width.
DELTA_SQUARE = 0.75


class Layer(NamedTuple):
    """The surface as the fluid feels it; arrays are per band cell.

    ``normal`` (n, 3); ``area`` (n,) mm2, smeared over the layer; ``density`` (n,) mass per volume across the surface,
    which the force accelerates.
    """

    normal: np.ndarray
    area: np.ndarray
    density: np.ndarray


class RegionMass(Accelerated):
    """rho_t + div(rho V) = 0, V_t + (V . grad) V = w f N delta/rho - gamma V, psi_t = -V . grad psi.

    Mass and momentum live on the whole grid of the surface's box, uniform at first, and leave through its border. There
    is no pressure: nothing feels the force but a layer of ``width`` voxels to either side of the surface. The force is
    smeared over it by a cosine and by mass; the surface moves with the mean of V by the same weights. So the fluid
    gains the energy that the potential loses, and the surface takes along the mass that it sweeps.

    Kicks by the leap-frog with exact factors of friction and weight (`Clock.kick`); between them fluid and psi move.

    Parameters
    ----------
    width : float
        Half width of the layer, voxels.
    **common
        As `Accelerated`, without diffusion and noise; ``rho`` is mass per volume.
    """

    name = "region-mass"
    state_names = (*Accelerated.state_names, "fluid", "mass", "_cell")
    fluid = np.zeros((4, 0, 0, 0), np.float32)
    #: Mass for the trace, and the volume of a voxel, mm3.
    mass, _cell = 0.0, 1.0

    def __init__(self, width: float = LAYER, **common: Any) -> None:
        super().__init__(diffusion=0.0, noise=None, **common)
        self.width = float(width)

    # -- state ---------------------------------------------------------------------------------------------

    @property
    def _dry(self) -> float:
        return DRY * self.rho

    def state(self) -> dict[str, Any]:
        """Copy the state that goes from step to step, without the settings; no step changes a fluid in place."""
        return {**super().state(), "fluid": self.fluid}

    def stencil_width(self, surface: LevelSet) -> float:
        """All but the outermost cells: the layer in which the force acts is wider than the front."""
        return surface.half_width - 1.0

    def start(self, surface: LevelSet) -> None:
        """At rest with uniform density."""
        self.fluid = make_fluid(np.full(surface.shape, self.rho, np.float32))
        self.mass, self._cell = 0.0, surface.voxel_volume
        self._initialize(surface)

    def set_fluid(self, density: np.ndarray, velocity: np.ndarray) -> None:
        """Replace density (nz, ny, nx) and velocity (3, nz, ny, nx), z y x, mm per unit time, by present values."""
        self.fluid = make_fluid(density, velocity)
        self.clock.start_moving()

    def change_grid(self, surface: LevelSet, place: np.ndarray) -> None:
        """Take the fluid to the grid of ``surface``, ``place`` as for `regrid_fluid`; new fluid is at rest."""
        self.fluid, self._cell = (
            regrid_fluid(self.fluid, place, surface.shape, self.rho),
            surface.voxel_volume,
        )

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Continue with other settings."""
        super().continue_from(surface, before, forces_changed)
        assert isinstance(before, RegionMass)
        self.fluid = self.fluid * np.float32(self.rho / before.rho)

    def zero_momentum(self, area: np.ndarray) -> float:
        """Set the velocity to zero; the density stays."""
        lost = self._sums(self.fluid, self.fluid).after / self.weight
        self.fluid = make_fluid(self.fluid[0])
        self._reset_clock()
        return lost

    def energy(self, area: np.ndarray) -> float:
        """T/w now."""
        return self._sums(self.fluid, self.fluid).after / self.weight

    def _kinetic(self, area: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
        """1/2 int rho V . V' of two fluids of the same density."""
        return self._sums(first, second).between

    def _sums(self, first: np.ndarray, second: np.ndarray) -> FluidSums:
        return fluid_sums(self._workers, first, second, self._cell, self._dry)

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """V . N."""
        normal = surface.normals()
        velocity = self._velocity(surface, self.fluid, np.ones(surface.size, np.bool_), normal)
        return np.asarray((velocity * normal).sum(axis=1), np.float32)

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Change V along N, in the layer."""
        within = layer_area(surface, self.width) > 0.0
        impulse = np.where(within, speed, 0.0)[:, None] * surface.normals()
        self.fluid = self._accelerated(surface, self.fluid, impulse, math.inf)

    # -- one step ------------------------------------------------------------------------------------------

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Kick the fluid by the force over the step around the present time, then move it."""
        surface = now.surface
        front = now.front
        clock = self.clock
        layer = self._layer(now)
        dt, cfl_dt = self.stable_dt(now, layer, limits)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        before = self.fluid
        after, clipped = self._clipped(now, layer, dt, limits.cfl / dt)
        sums = self._sums(before, after)
        moved = transport_fluid(surface, after, dt, 0.0, self._dry)
        # Fluid that the surface meets in the step slows it in the step.
        first = self._velocity(surface, after, front, layer.normal)
        last = self._means(surface, moved.fluid, front, layer.normal, first * dt)[:, 1:]
        self.fluid, self.mass = moved.fluid, sums.mass
        met = sums.after - self._sums(moved.fluid, moved.fluid).after
        self.detect_oscillation(sums.between)
        # A velocity that is that of now needs no mean.
        of_now = clock.last_dt <= NOW
        kinetic = sums.before if of_now else 0.25 * (sums.before + 2.0 * sums.between + sums.after)
        rates = EnergyRates(
            kinetic=kinetic,
            weight=clock.weight(),
            friction=clock.loss * kinetic / clock.weight(),
            smoothing=(clipped + met) / clock.weight(clock.time + 0.5 * dt),
            mass=self.mass,
        )
        return self._plan(now, limits, 0.5 * (first + last), layer.normal, dt, rates)._replace(
            cfl_dt=cfl_dt
        )

    def _plan(
        self,
        now: StepInput,
        limits: StepLimits,
        velocity: np.ndarray,
        normal: np.ndarray,
        dt: float,
        rates: EnergyRates,
    ) -> StepPlan:
        """The step of a surface with ``velocity`` (n, 3) at the front; the clock ticks."""
        surface, front = now.surface, now.front
        velocity = self._extended(surface, velocity, front)
        speed = np.ascontiguousarray((velocity * normal).sum(axis=1), np.float32)
        front_speed = percentile(np.linalg.norm(velocity, axis=1), limits.percentile, front)
        clipped = front & (self._voxel_rates(surface, velocity) > limits.cfl / dt * (1.0 - 1e-6))
        self.clock.tick(dt)
        return StepPlan(
            dt,
            speed,
            velocity,
            front_speed,
            float(clipped.sum()) / max(1, int(front.sum())),
            energy_rates=rates,
        )

    def synchronize(self, now: StepInput) -> None:
        """Kick the velocity over the half step that it is behind."""
        self.fluid = self._kicked(now, self._layer(now), 0.0, math.inf)
        self.clock.start_moving()

    def stable_dt(self, now: StepInput, layer: Layer, limits: StepLimits) -> tuple[float, float]:
        """Largest stable time step, and that of the CFL number alone.

        As for `ConstantDensity`, with the mass per area of the layer, rho epsilon/0.75. The fluid's own waves have
        steps of their own, see `transport_fluid`.
        """
        surface, front = now.surface, now.front
        peak, stiffness = self._peak_and_stiffness(now, layer, limits)
        if self.clock.at_rest:
            dt = cfl_dt = self.clock.first_dt(peak, stiffness, surface.smallest_spacing, limits.cfl)
        else:
            w = self.clock.next_weight()
            velocity = self._velocity(surface, self.fluid, front, layer.normal)
            rate = percentile(self._voxel_rates(surface, velocity), limits.percentile, front)
            cfl_dt = cfl_bound(rate, w * peak, limits.cfl)
            dt = min(cfl_dt, wave_bound(surface, math.sqrt(w * stiffness)))
        return self._bounded(dt, surface, limits), cfl_dt

    def _peak_and_stiffness(
        self, now: StepInput, layer: Layer, limits: StepLimits
    ) -> tuple[float, float]:
        """Peak acceleration of the layer, voxels, and alpha per mass per area."""
        surface, front = now.surface, now.front
        mm = 1.0 / np.maximum(self._voxel_rates(surface, layer.normal), 1e-30)
        per_area = layer.density * (self.width / DELTA_SQUARE) * mm
        rates = np.abs(now.force) / (per_area * mm)
        peak = self.force_stiffness(percentile(rates, limits.percentile, front), surface)
        return peak, now.alpha / float(per_area[front].min(initial=math.inf))

    def _kicked(self, now: StepInput, layer: Layer, dt: float, limit: float) -> np.ndarray:
        """The fluid after the kick around now, V in the layer at most ``limit`` voxels per unit time."""
        surface = now.surface
        factor, gain = self.clock.kick(dt)
        slowed = self.fluid * np.float32(factor)
        slowed[0] = self.fluid[0]
        along = gain * now.force * layer.area / (layer.density * surface.voxel_volume)
        impulse = np.zeros((surface.size, 3))
        across = layer.area > 0.0, layer.normal, self.width, np.zeros((surface.size, 3))
        where = surface.dense.slot, surface.grid, surface.band
        surface.workers.serial(
            kernels.extend_across,
            0,
            surface.size,
            *where,
            across,
            along[:, None] * layer.normal,
            impulse,
        )
        return self._accelerated(surface, slowed, impulse, limit)

    def _clipped(
        self, now: StepInput, layer: Layer, dt: float, limit: float
    ) -> tuple[np.ndarray, float]:
        """The fluid after the kick, and the energy T that the limit of V in the layer takes."""
        surface, kicked = now.surface, self._kicked(now, layer, dt, math.inf)
        there = kicked.reshape(4, -1)[:, surface.band.cells[layer.area > 0]].astype(np.float64)
        rates = np.linalg.norm(there[1:].T / spacing_of(surface), axis=1)
        if not (rates > limit * there[0]).any():
            return kicked, 0.0
        after = self._kicked(now, layer, dt, limit)
        # The work of the change is its product with the mean of the velocities before and after all.
        first, last = self._sums(self.fluid, after), self._sums(kicked, after)
        return after, self._sums(
            self.fluid, kicked
        ).between - first.between + last.between - last.after

    # -- surface and fluid ---------------------------------------------------------------------------------

    def _layer(self, now: StepInput) -> Layer:
        """The surface as the fluid feels it."""
        surface, normal = now.surface, now.surface.normals()
        area = np.where(now.front, layer_area(surface, self.width), 0.0)
        density = self._means(surface, self.fluid, now.front, normal)[:, 0]
        mean = float((area * density).sum()) / max(float(area.sum()), 1e-300)
        return Layer(normal, area, np.maximum(density, max(mean / DENSITY_RANGE, 1e-30)))

    def _velocity(
        self, surface: LevelSet, fluid: np.ndarray, where: np.ndarray, normal: np.ndarray
    ) -> np.ndarray:
        """V (n, 3) of the surface at the cells ``where`` (n,)."""
        return self._means(surface, fluid, where, normal)[:, 1:]

    def _means(
        self,
        surface: LevelSet,
        fluid: np.ndarray,
        where: np.ndarray,
        normal: np.ndarray,
        shift: np.ndarray | None = None,
    ) -> np.ndarray:
        """Density and velocity (n, 4) across the surface, moved by ``shift`` (n, 3) mm."""
        out = np.empty((surface.size, 4))
        shift = np.zeros((surface.size, 3)) if shift is None else shift
        layer = where, normal, self.width, shift
        surface.workers.parallel(
            kernels.means_across, surface.size, fluid, surface.grid, surface.band, layer, out
        )
        return out

    @staticmethod
    def _accelerated(
        surface: LevelSet, fluid: np.ndarray, impulse: np.ndarray, limit: float
    ) -> np.ndarray:
        out = fluid.copy()
        surface.workers.parallel(
            kernels.accelerate_layer,
            surface.size,
            out,
            surface.grid,
            surface.band.cells,
            np.asarray(impulse, np.float64),
            limit,
        )
        return out

    @staticmethod
    def _voxel_rates(surface: LevelSet, velocity: np.ndarray) -> np.ndarray:
        """|V| (n,) in voxels per unit time."""
        return np.asarray(np.linalg.norm(velocity / spacing_of(surface), axis=1))
