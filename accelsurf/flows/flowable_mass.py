"""The paper's conserved flowable mass: momentum on a surface whose mass flows along it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.flows.accelerated import Accelerated
from accelsurf.flows.diffusion import diffuse
from accelsurf.flows.mass_balance import Prediction, balance, layer_area, predict
from accelsurf.flows.protocol import (
    Flow,
    StepInput,
    StepLimits,
    StepPlan,
    cfl_bound,
    clip_speed,
    percentile,
    wave_bound,
)
from accelsurf.kernels import transport
from accelsurf.levelset import LevelSet

#: The density that the force accelerates is at most this factor off its mean: the model has no pressure, and light
#: surface overshoots. In noise nearly all mass is in a hundredth of the surface in the end.
DENSITY_RANGE = 3.0
#: Lowest density, as a part of its mean; it only keeps the density above 0.
MIN_DENSITY = 1e-4
#: The area under a piece of surface may change by at most this factor in a step.
STRETCH_RANGE = 2.0


class Gravity(NamedTuple):
    """The mass potential U_mass = g A P, P = int 1/2 rho^2 dA, on the present surface.

    ``potential``; ``tension`` (n,) g (P - 1/2 A rho^2), its tension, as used; ``area`` A; ``clamped`` share of the
    front where the tension was clamped.
    """

    potential: float
    tension: np.ndarray
    area: float
    clamped: float


class FlowableMass(Accelerated):
    """V_t + (V . grad) V = (w/rho) f N - gamma V + ..., rho_t + V . grad rho + rho div_S V = 0, psi_t = -V . grad psi.

    The paper's system for surfaces in extended fields, psi with the corrected sign. Kick by the leap-frog (each
    surface element is accelerated by its own force: no curvature term); then psi, V, rho are advected semi-Lagrangian,
    rho limited and divided by the exact stretch of the area. The lack or excess of the transport then is
    given back where it arose (`mass_balance`). Mass that flows out through the border of the volume is gone, and inflow
    is added: `mass` in the trace changes by that alone. Mass of surface that vanished goes to the surface around, or
    over all the rest where there is none: that alone is the `mass_correction` reported.

    With ``gravity`` g the mass potential U_mass = g A int 1/2 rho^2 dA acts as well,
    V_t -= w g [A grad_S rho + (1/2 A rho - P/rho) H N]. Its tension g (P - 1/2 A rho^2) is negative where
    rho > rms(rho), and the system ill-posed where that outweighs the tension of the energy itself: there it is
    clamped to -``support`` (in its normal part only), and the share of the surface where it is clamped is reported.

    Parameters
    ----------
    gravity : float
        g.
    support : float or None
        Tension that the energy has everywhere on the surface: its area weight. None clamps nothing.
    **common
        As `Accelerated`.
    """

    name = "flowable-mass"
    state_names = (
        *Accelerated.state_names,
        *("velocity", "density", "mass", "_correction", "_expected", "_least", "_most", "_moved"),
    )
    velocity = np.zeros((0, 3), np.float32)
    density = np.zeros(0, np.float32)
    #: Mass that the last motion took to the nodes of the balance, see `Prediction`; a total below 0: not known. And
    #: whether that motion's fields have not come yet.
    _expected = -1.0
    _least = np.zeros(0)
    _most = np.zeros(0)
    _moved = False
    #: Area and density that `_inertia` was asked for last, and its value.
    _inertia_of: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def __init__(self, gravity: float = 0.0, support: float | None = 0.0, **common: object) -> None:
        super().__init__(**common)  # type: ignore[arg-type]
        self.gravity, self.support = float(gravity), support
        self.mass = 0.0
        self._correction = 1.0

    def stencil_width(self, surface: LevelSet) -> float:
        """All but the outermost cells: advected fields are interpolated from cells further away than the front."""
        return surface.half_width - 1.0

    @property
    def fields(self) -> list[np.ndarray]:
        """Velocity z, y, x and the density that the advected surface will have."""
        return [*(np.ascontiguousarray(self.velocity[:, c]) for c in range(3)), self.density]

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """Velocity and density on the new band."""
        self.velocity = np.stack(fields[:3], axis=1)
        self.density = fields[3]
        # Fields that do not come from a motion belong to another grid.
        if not self._moved:
            self._expected = -1.0
        self._moved = False

    def start(self, surface: LevelSet) -> None:
        """At rest on ``surface`` with uniform density."""
        self.velocity = np.zeros((surface.size, 3), np.float32)
        self.density = np.full(surface.size, self.rho, np.float32)
        self.mass = 0.0
        self._correction = 1.0
        self._expected = -1.0
        self._moved = False
        self._initialize(surface)

    def zero_momentum(self, area: np.ndarray) -> float:
        """Set the velocity to zero; the density stays."""
        lost = self._kinetic(area, self.velocity, self.velocity) / self.weight
        self.velocity[:] = 0.0
        self._reset_clock()
        return lost

    def energy(self, area: np.ndarray) -> float:
        """T/w and the mass potential g A P now."""
        kinetic = self._kinetic(area, self.velocity, self.velocity) / self.weight
        squares = 0.5 * float((area * self.density.astype(np.float64) ** 2).sum())
        return kinetic + self.gravity * float(area.sum()) * squares

    @property
    def fill_values(self) -> list[float]:
        """At rest, with the density of the start."""
        return [0.0, 0.0, 0.0, self.rho]

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Continue with other settings; the mass is that of the present surface, after parts were added or removed."""
        super().continue_from(surface, before, forces_changed)
        assert isinstance(before, FlowableMass)
        self.density = self.density * np.float32(self.rho / before.rho)
        self.mass, self._expected = 0.0, -1.0

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """V . N."""
        return np.asarray((self.velocity * surface.normals()).sum(axis=1))

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Change V along N."""
        self.velocity = self.velocity + speed[:, None] * surface.normals()

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Kick the velocity by the forces over the step around the present time."""
        surface = now.surface
        front = now.front
        clock = self.clock
        layer = layer_area(surface)
        self._balance_mass(surface, layer)
        normal = surface.normals()
        gravity = self._gravity_now(now._replace(area=layer))
        acceleration = self._acceleration(now, normal, gravity)
        dt, cfl_dt = self.stable_dt(now, acceleration, gravity, limits)
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        before, dm = self.velocity, 0.5 * (dt + clock.last_dt)
        smoothed, diffusion = self._diffused(now, normal, acceleration, dt, limits)
        damping, impulse = (
            (0.0, clock.first_kick(dt))
            if clock.at_rest
            else (clock.gamma * dm, clock.weight() * dm)
        )
        gain = np.float32(impulse) * acceleration
        kicked = (smoothed * np.float32(1.0 - 0.5 * damping) + gain) / np.float32(
            1.0 + 0.5 * damping
        )
        noise = self._noise_now(now, dm, 3)
        noisy = kicked if noise is None else kicked + noise
        velocity = noisy.copy()
        rates = self._rates(surface, velocity)
        rates[~front] = 0.0
        clipped = clip_speed(velocity, rates, dt, limits.cfl)
        energy_rates = self._energy_rates(
            now.area, (before, smoothed, kicked, noisy, velocity)
        )._replace(
            mass_potential=0.0 if gravity is None else gravity.potential,
            mass=self.mass,
            mass_correction=self._correction - 1.0,
            clamped=0.0 if gravity is None else gravity.clamped,
        )
        self.velocity = self._extended(surface, velocity, front)
        speed = (velocity * normal).sum(axis=1)
        front_speed = percentile(np.linalg.norm(velocity, axis=1), limits.percentile, front)
        surface.extend_outwards(speed, front)
        self._expect_mass(surface, layer * self.density, self.velocity, dt)
        self._stretch(now, normal, dt)
        clock.tick(dt)
        share = clipped / max(1, int(front.sum()))
        return StepPlan(
            dt, speed, self.velocity, front_speed, share, diffusion, energy_rates, cfl_dt
        )

    def synchronize(self, now: StepInput) -> None:
        """Kick the velocity over the half step that it is behind, and balance the mass."""
        surface, layer = now.surface, layer_area(now.surface)
        self._balance_mass(surface, layer)
        self._expected = -1.0
        normal, dm = surface.normals(), 0.5 * self.clock.last_dt
        acceleration = self._acceleration(now, normal, self._gravity_now(now._replace(area=layer)))
        damping, gain = self.clock.gamma * dm, np.float32(self.clock.weight() * dm) * acceleration
        kicked = (self.velocity * np.float32(1.0 - 0.5 * damping) + gain) / np.float32(
            1.0 + 0.5 * damping
        )
        self.velocity = self._extended(surface, kicked, now.front)
        self.clock.start_moving()

    # -- mass ----------------------------------------------------------------------------------------------

    def _balance_mass(self, surface: LevelSet, area: np.ndarray) -> None:
        """Give the advected density the mass that the motion took to each place, and the total that has not left.

        ``area`` (n,) is that of `layer_area`.
        """
        total = float(area.sum())
        if self.mass == 0.0:
            self.mass = float((area * self.density).sum())
        if total == 0.0:
            return
        transported = self._expected >= 0.0
        if transported:
            before = Prediction(self._expected, self._least, self._most)
            found = balance(surface, area * self.density, before)
            self.density = self.density * found.factor
            self.mass += found.mass - before.total
        self.density = np.maximum(self.density, np.float32(MIN_DENSITY * self.mass / total))
        factor = self.mass / float((area * self.density).sum())
        self.density = self.density * np.float32(factor)
        # On another grid a surface has another sum of areas; that is no mass that was lost.
        if transported:
            self._correction *= factor

    def _expect_mass(
        self, surface: LevelSet, mass: np.ndarray, velocity: np.ndarray, dt: float
    ) -> None:
        """Note where the coming motion takes the ``mass`` (n,)."""
        self._expected, self._least, self._most = predict(surface, mass, velocity, dt)
        self._moved = True

    def _inertia(self, area: np.ndarray) -> np.ndarray:
        """The density (n,) that forces accelerate: rho within its range."""
        # Several energies of a step need it.
        if (
            self._inertia_of is None
            or self._inertia_of[0] is not area
            or self._inertia_of[1] is not self.density
        ):
            mean = float((area * self.density).sum()) / max(float(area.sum()), 1e-300)
            clamped = np.clip(
                self.density, np.float32(mean / DENSITY_RANGE), np.float32(mean * DENSITY_RANGE)
            )
            self._inertia_of = area, self.density, clamped
        return self._inertia_of[2]

    def _stretch(self, now: StepInput, normal: np.ndarray, dt: float) -> None:
        """Divide the density by the stretch of the area in the coming motion."""
        surface, front = now.surface, now.front
        stretch = np.empty(surface.size, np.float32)
        surface.workers.parallel(
            transport.area_stretch,
            surface.size,
            surface.dense.slot,
            surface.grid,
            surface.band.cells,
            front,
            (self.velocity, normal, dt),
            stretch,
        )
        self.density = np.asarray(
            self.density / np.clip(stretch, 1.0 / STRETCH_RANGE, STRETCH_RANGE), np.float32
        )
        surface.extend_outwards(self.density, front)

    # -- forces --------------------------------------------------------------------------------------------

    def _gravity_now(self, now: StepInput) -> Gravity | None:
        if self.gravity == 0.0:
            return None
        g, area = self.gravity, float(now.area.sum())
        squares = 0.5 * float((now.area * self.density.astype(np.float64) ** 2).sum())
        tension = g * (squares - 0.5 * area * self.density.astype(np.float64) ** 2)
        clamped = 0.0
        if self.support is not None:
            low = tension < -self.support
            clamped = float((now.area * low).sum()) / area
            tension[low] = -self.support
        return Gravity(g * area * squares, tension.astype(np.float32), area, clamped)

    def _acceleration(
        self, now: StepInput, normal: np.ndarray, gravity: Gravity | None
    ) -> np.ndarray:
        """Acceleration (n, 3) at the front, per weight w: f N/rho and the mass potential's."""
        surface = now.surface
        density = np.maximum(self._inertia(now.area), np.float32(1e-30))
        along = np.asarray(now.force, np.float32) / density
        if gravity is None:
            return np.asarray(along[:, None] * normal)
        along = along + gravity.tension * now.curvature / density
        slope = np.empty((surface.size, 3), np.float32)
        surface.workers.parallel(
            transport.surface_gradient,
            surface.size,
            surface.dense.slot,
            surface.grid,
            surface.band.cells,
            now.front,
            (self.density[:, None], normal),
            slope,
        )
        return np.asarray(along[:, None] * normal - np.float32(self.gravity * gravity.area) * slope)

    def _diffused(
        self,
        now: StepInput,
        normal: np.ndarray,
        acceleration: np.ndarray,
        dt: float,
        limits: StepLimits,
    ) -> tuple[np.ndarray, float]:
        """The velocity after diffusion over the time of the kick, and the coefficient used.

        The speed along the normal and the tangential part diffuse separately. Component by component, a sphere
        that grows or shrinks evenly would be slowed at the rate 2 D/r^2.
        """
        if self.clock.at_rest:
            return self.velocity, 0.0
        front, dm = now.front, 0.5 * (dt + self.clock.last_dt)
        speed = percentile(np.linalg.norm(self.velocity, axis=1), limits.percentile, front)
        speed += (
            dt
            * self.weight
            * percentile(np.linalg.norm(acceleration, axis=1), limits.percentile, front)
        )
        diffusion = self._diffusion_now(now.surface, dm, speed)
        if diffusion <= 0:
            return self.velocity, 0.0
        along = (self.velocity * normal).sum(axis=1)
        tangential = self.velocity - along[:, None] * normal
        diffuse(now.surface, front, along, diffusion * dm)
        for c in range(3):
            component = np.ascontiguousarray(tangential[:, c])
            if component.any():
                diffuse(now.surface, front, component, diffusion * dm, c)
                tangential[:, c] = component
        tangential -= (tangential * normal).sum(axis=1)[:, None] * normal
        return along[:, None] * normal + tangential, diffusion

    # -- step and energy budget ----------------------------------------------------------------------------

    def stable_dt(
        self, now: StepInput, acceleration: np.ndarray, gravity: Gravity | None, limits: StepLimits
    ) -> tuple[float, float]:
        """Largest stable time step under ``acceleration`` (n, 3), and that of the CFL number alone.

        CFL, b dt + A dt^2/2 <= cfl, b and A the percentiles of speed and acceleration in voxels; transverse waves,
        c_T^2 = w (alpha + tension)/rho; with gravity sound, dt <= h/(sqrt(3) (|V| + c_s)), c_s^2 = w g A rho.
        """
        surface, front = now.surface, now.front
        smallest = surface.smallest_spacing
        peak_force = percentile(self._rates(surface, acceleration), limits.percentile, front)
        peak = self.force_stiffness(peak_force, surface)
        stiffness, sound = now.alpha, 0.0
        if gravity is not None:
            stiffness += max(float(gravity.tension[front].max(initial=0.0)), 0.0)
            sound = self.gravity * gravity.area * float(self.density[front].max(initial=0.0))
        stiffness /= float(self._inertia(now.area)[front].min(initial=self.rho))
        if self.clock.at_rest:
            dt = cfl_dt = self.clock.first_dt(peak, max(stiffness, sound), smallest, limits.cfl)
        else:
            w = self.clock.next_weight()
            rate = percentile(self._rates(surface, self.velocity), limits.percentile, front)
            fastest = percentile(np.linalg.norm(self.velocity, axis=1), limits.percentile, front)
            cfl_dt = cfl_bound(rate, w * peak, limits.cfl)
            dt = min(
                cfl_dt,
                wave_bound(surface, math.sqrt(w * stiffness)),
                wave_bound(surface, fastest + math.sqrt(w * sound)) if sound > 0 else math.inf,
            )
        return self._bounded(dt, surface, limits), cfl_dt

    @staticmethod
    def _rates(surface: LevelSet, velocity: np.ndarray) -> np.ndarray:
        """|V| (n,) in voxels per unit time."""
        h = np.array([surface.grid.hz, surface.grid.hy, surface.grid.hx], np.float32)
        return np.asarray(np.linalg.norm(velocity / h, axis=1))

    def _kinetic(self, area: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
        """1/2 int rho V . V' dA."""
        return 0.5 * float(
            (area * self._inertia(area) * (first.astype(np.float64) * second).sum(axis=1)).sum()
        )
