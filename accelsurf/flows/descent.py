"""Flows without inertia, the baselines: plain L2 gradient descent, descent with the momentum of the literature, and
Sobolev descent, whose force is smoothed along the surface by a solve at each step.
"""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.diffusion import diffuse, free_diffusion, largest_diffusion
from accelsurf.flows.protocol import (
    EnergyRates,
    Flow,
    StepInput,
    StepLimits,
    StepPlan,
    clip_speed,
    curvature_bound,
    percentile,
    voxel_rates,
)
from accelsurf.kernels import statistics, tube
from accelsurf.levelset import LevelSet, dot

#: A step that undoes more than this part of the one before is too long for the stiffest part of the surface; after the
#: shortest step that was too long the next ones undo this part at most.
UNDONE = 0.5
#: Steps of a smaller root mean square, voxels, say nothing of the stiffness: details finer than the grid never rest.
STILL = 0.01
#: Length of Sobolev descent, of the H1 gradient, unless one is given, in voxels of the smallest spacing.
LENGTH = 5.0
#: Half width of the tube in which its equation is solved, voxels along the normal.
TUBE = 2.0
#: The solve ends when the residual is this part of the right hand side.
TOLERANCE = 1e-3
MAX_ITERATIONS = 200


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
        fastest = self.peak_force_so_far(percentile(rates, limits.percentile), surface)
        return limits.cfl / fastest if fastest > 0 else math.inf

    def stiffness_dt(self, now: StepInput, speed: np.ndarray, dt: float) -> float:
        """``dt``, shorter if this ``speed`` (n,) would undo more than `UNDONE` of the last step, of speeds `_last`.

        The force of a small displacement d is -K d. The Rayleigh quotient of K for the last step d = dt v,
        (1 - <v+, v>/<v, v>)/dt, is at most its largest eigenvalue, and is near it where the stiffest waves swing: these
        fall to `UNDONE` of themselves in steps of (1 + UNDONE)/K. A reversal in only one step is no oscillation.
        """
        surface, area = now.surface, now.area

        def product(speed: np.ndarray) -> float:
            return float(
                surface.workers.block_sums(
                    statistics.products, area.size, 1, area, self._last, speed
                )[0]
            )

        squares = product(self._last)
        moved = (
            self._last_dt
            * math.sqrt(squares / max(float(area.sum()), 1e-300))
            / surface.smallest_spacing
        )
        undone = -product(speed) / squares if moved > STILL else 0.0
        before, self._reversal = (
            self._reversal,
            (1.0 + min(undone, 1.0)) / self._last_dt if undone > UNDONE else 0.0,
        )
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
    now: StepInput,
    last: np.ndarray,
    speed: np.ndarray,
    dt: float,
    limits: StepLimits,
    cfl_dt: float,
    diffusion: float = 0.0,
) -> StepPlan:
    """Return the step of a descent: ``speed`` (n,) at the front, clipped and extended (in place).

    All that the force works is lost: ``last`` (n,) are the speeds of the step before.
    """
    clipped = clip_speed(speed, voxel_rates(now.surface, now.front, speed), dt, limits.cfl)
    front_speed = percentile(speed, limits.percentile, now.front)
    now.surface.extend_outwards(speed, now.front)
    share = clipped / max(1, int(now.front.sum()))
    rates = EnergyRates(friction=_work(now, speed), friction_before=_work(now, last))
    return StepPlan(
        dt, speed, None, front_speed, share, diffusion, rates, min(cfl_dt, limits.dt_max)
    )


def _work(now: StepInput, speed: np.ndarray) -> float:
    """Work of the force per unit of time on a surface with a ``speed`` (n,): int f beta dA."""
    force = np.where(now.front, now.force, 0.0).astype(np.float32)
    sums = now.surface.workers.block_sums(
        statistics.products, force.size, 1, now.area, force, speed
    )
    return float(sums[0])


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
        """Step with beta = f, within the bounds of `stable_dt` and `stiffness_dt` and of D dt in a step."""
        surface, front = now.surface, now.front
        speed = np.array(now.force, np.float32)
        cfl_dt = self.cfl_dt(voxel_rates(surface, front, speed)[front], surface, limits)
        dt = self.stiffness_dt(now, speed, min(stable_dt(now, cfl_dt), limits.dt_max))
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
        return self.remember(descent_plan(now, self._last, speed, dt, limits, cfl_dt, diffusion))


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
        cfl_dt = self.cfl_dt(
            voxel_rates(now.surface, now.front, force)[now.front], now.surface, limits
        )
        dt = min(stable_dt(now, cfl_dt), limits.dt_max)
        if not math.isfinite(dt):
            return StepPlan.none(now.surface)
        speed = np.float32(1.0 - self.blend) * force + np.float32(self.blend / dt) * self._last
        last = self._last / np.float32(self._last_dt or dt)
        move = descent_plan(now, last, speed, dt, limits, cfl_dt)
        self._last, self._last_dt = move.speed * np.float32(dt), dt
        return move


class Sobolev(Descent):
    """psi_t = g |grad psi| with (1 - ell^2 Lap_S) g = f: descent in the H1 metric of the surface.

    On a sphere of radius r a spherical harmonic of degree l comes out divided by 1 + ell^2 l (l + 1)/r^2. The step
    is bounded by the CFL number of g alone, also with an area weight.

    Parameters
    ----------
    length : float or None
        ell, mm; None is `LENGTH` voxels.
    """

    name = "sobolev"

    def __init__(self, length: float | None = None) -> None:
        super().__init__()
        self.length = length

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with beta = g, dt <= cfl/|g|, and `stiffness_dt`."""
        surface = now.surface
        length = LENGTH * surface.smallest_spacing if self.length is None else self.length
        speed = h1_gradient(surface, now.force, length, self._last)
        inner = surface.front(1.0)
        surface.extend_outwards(speed, inner)
        cfl_dt = self.cfl_dt(voxel_rates(surface, inner, speed)[inner], surface, limits)
        dt = self.stiffness_dt(now, speed, min(cfl_dt, limits.dt_max))
        if not math.isfinite(dt):
            return StepPlan.none(surface)
        return self.remember(descent_plan(now, self._last, speed, dt, limits, cfl_dt))


def h1_gradient(
    surface: LevelSet, force: np.ndarray, length: float, guess: np.ndarray
) -> np.ndarray:
    """Solution g (n,) of (1 - length^2 Lap_S) g = force near the surface, by conjugate gradients from ``guess``.

    Solved as the minimum of sum eta ((g - f)^2 + length^2 |grad g|^2) over a tube around the surface whose weight
    eta fades to its edge; in a tube thin against the radius of curvature g is constant along the normal. Diagonal
    preconditioner.
    """
    parallel, n = surface.workers.parallel, surface.size
    slot, cells = surface.dense.slot, surface.band.cells
    eta, diagonal = np.empty(n), np.empty(n)
    parallel(tube.tube_weight, n, surface.grid, surface.band, TUBE, eta)
    parallel(tube.tube_diagonal, n, slot, surface.grid, cells, (eta, length), diagonal)

    def product(field: np.ndarray) -> np.ndarray:
        out = np.empty(n)
        parallel(tube.tube_product, n, slot, surface.grid, cells, (eta, length), field, out)
        return out

    right = eta * force
    g = guess.astype(np.float64)
    residual = right - product(g)
    tolerance = TOLERANCE**2 * dot(right, right / diagonal)
    direction = np.zeros(n)
    last = 1.0
    for _ in range(MAX_ITERATIONS):
        scaled = residual / diagonal
        size = dot(residual, scaled)
        if size <= tolerance:
            break
        direction = scaled + (size / last) * direction
        last = size
        image = product(direction)
        step = size / dot(direction, image)
        g += step * direction
        residual -= step * image
    return g.astype(np.float32)
