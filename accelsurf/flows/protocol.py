"""What all flows share: the protocol, the speed limiter, diffusion along the surface, the bounds on the time step."""

from __future__ import annotations

import copy
import math
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from accelsurf.kernels import motion, statistics
from accelsurf.levelset import FRONT_WIDTH, LevelSet

#: Most stages of a diffusion step. The free bound is what these reach explicitly: (s^2 + s)/2 times one stage.
STAGES = 8
#: Free diffusion is a mixing length: D = at most MIXING x h x front speed. The surface then averages its speed over
#: the same patch for each voxel travelled, whatever the step: a step cut short by another bound is not overdamped.
MIXING = 16.0


class StepLimits(NamedTuple):
    """Step control, the same for every flow.

    ``cfl``: voxels that the surface may move in a step. ``percentile``: the time step follows this percentile
    of the speeds on the front; faster cells are held to ``cfl`` voxels in that step (100: nothing is held).
    ``dt_max``: upper bound of the time step.
    """

    cfl: float = 0.5
    percentile: float = 95.0
    dt_max: float = math.inf


class StepInput(NamedTuple):
    """The surface at the beginning of a step, and what acts on it; arrays are per band cell.

    ``front`` (n,) mask of the cells that count; ``force`` f (n,), ``curvature`` H (n,), 1/mm, at the front;
    ``area`` (n,) mm2 of surface in each voxel; ``alpha`` weight of the area in the energy.
    """

    surface: LevelSet
    front: np.ndarray
    force: np.ndarray
    curvature: np.ndarray
    area: np.ndarray
    alpha: float


class EnergyRates(NamedTuple):
    """Energy and mass at the beginning of a step, and what the step takes; see `evolution.StepRecord`.

    ``kinetic`` is the paper's T, ``weight`` the factor w of the potential in T + w U; the others are in the units
    of U: ``friction`` is lost per unit of flow time, ``smoothing`` (diffusion, limiter) taken and ``noise`` put in
    by this step.
    """

    kinetic: float = 0.0
    weight: float = 1.0
    mass_potential: float = 0.0
    friction: float = 0.0
    smoothing: float = 0.0
    noise: float = 0.0
    mass: float = 0.0
    mass_correction: float = 0.0
    clamped: float = 0.0


class StepPlan(NamedTuple):
    """One step as the flow wants it.

    ``dt``; ``speed`` (n,) beta on the whole band; ``velocity`` (n, 3) V, where the surface is carried along by it;
    ``rate`` the percentile of the front's speeds (mm per unit time); ``limited`` share of front cells held back;
    ``diffusion`` used (mm2 per unit time); ``travel``, the step that the surface's way alone would allow.
    """

    dt: float
    speed: np.ndarray
    velocity: np.ndarray | None = None
    rate: float = 0.0
    limited: float = 0.0
    diffusion: float = 0.0
    account: EnergyRates = EnergyRates()
    travel: float = 0.0

    @classmethod
    def none(cls, surface: LevelSet) -> StepPlan:
        """No move: nothing acts on the surface."""
        return cls(0.0, np.zeros(surface.size, np.float32))


class Flow(Protocol):
    """What the loop asks of a flow.

    Attributes
    ----------
    name : str
    """

    name: str

    @property
    def weight(self) -> float:
        """Factor w of the potential in the energy T + w U that the flow dissipates; 1 for descent."""
        ...

    def stencil_width(self, surface: LevelSet) -> float:
        """Distance from the surface, in voxels, up to which the flow needs forces."""
        ...

    def start(self, surface: LevelSet) -> None:
        """Begin at rest on a surface."""
        ...

    def zero_momentum(self, area: np.ndarray) -> float:
        """Put the surface at rest, as at the start (adaptive restart); returns T/w, which is lost."""
        ...

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Choose the time step and the speeds of one step."""
        ...

    @property
    def fields(self) -> list[np.ndarray]:
        """Fields (n,) that redistancing must extend."""
        ...

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """Take the extended fields back, on the new band."""
        ...

    @property
    def fill_values(self) -> list[float]:
        """Values of the fields on surface that was not there before."""
        ...

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """Speed (n,) along the inward normal that the surface would keep without forces."""
        ...

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Add to it (n,)."""
        ...


    def energy(self, area: np.ndarray) -> float:
        """U_mass + T/w now, in the units of U."""
        ...

    def state(self) -> dict[str, Any]:
        """All that the flow remembers from step to step, but not its settings; not changed by later steps."""
        ...

    def restore(self, surface: LevelSet, kept: dict[str, Any]) -> None:
        """Be as a flow of the same settings was when its state was ``state``, on this surface."""
        ...

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Go on from a flow of the same class with other settings; ``forces_changed``: under another energy."""
        ...


class StatefulFlow:
    """What a flow remembers: the attributes named in ``remembered``; arrays are copied."""

    remembered: ClassVar[tuple[str, ...]] = ()
    #: What is remembered of the wells: the strongest force yet, in voxels of ``_voxel`` mm.
    wells: ClassVar[tuple[str, ...]] = ("_peak_force", "_voxel")
    _peak_force, _voxel = 0.0, 1.0

    @property
    def fill_values(self) -> list[float]:
        """0: surface that was not there before is at rest."""
        return [0.0 for _ in self.fields]

    @property
    def fields(self) -> list[np.ndarray]:
        """None, unless a flow says so."""
        return []

    def state(self) -> dict[str, Any]:
        """All that the flow remembers from step to step, but not its settings."""
        return {name: copy.copy(getattr(self, name)) for name in self.remembered}

    def restore(self, surface: LevelSet, kept: dict[str, Any]) -> None:
        """Be as a flow of the same settings was when its state was ``state``."""
        for name in self.remembered:
            setattr(self, name, copy.copy(kept[name]))

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Go on from a flow of the same class with other settings; under another energy its forces do not count."""
        self.restore(surface, before.state())
        if forces_changed:
            self._forget()

    def _forget(self) -> None:
        """Know nothing of the wells."""
        self._peak_force = 0.0

    def _peak_force_so_far(self, pull: float, surface: LevelSet) -> float:
        """Strongest ``pull`` (voxels) so far: near the minimum forces fade, but the wells keep their steepness."""
        # On another level voxels are others.
        voxel = smallest_spacing(surface)
        self._peak_force, self._voxel = max(self._peak_force * self._voxel / voxel, pull), voxel
        return self._peak_force


class Descent(StatefulFlow):
    """What flows without inertia share: no kinetic energy, and a step that follows the strongest speed so far."""

    weight = 1.0
    remembered = StatefulFlow.wells

    def __init__(self) -> None:
        self._forget()

    def energy(self, area: np.ndarray) -> float:
        """None but the potential."""
        return 0.0

    def stencil_width(self, surface: LevelSet) -> float:
        """The front."""
        return FRONT_WIDTH

    def start(self, surface: LevelSet) -> None:
        """Forget the forces of another run."""
        self._forget()

    def zero_momentum(self, area: np.ndarray) -> float:
        """Always at rest."""
        return 0.0

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """Nothing to take."""

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """None."""
        return np.zeros(surface.size, np.float32)

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:
        """Nothing that could be pushed."""

    def cfl_dt(self, rates: np.ndarray, surface: LevelSet, limits: StepLimits) -> float:
        """Step in which the percentile of the speeds ``rates`` (voxels per unit time) moves the surface by cfl."""
        fastest = self._peak_force_so_far(percentile(rates, limits.percentile), surface)
        return min(limits.dt_max, limits.cfl / fastest if fastest > 0 else math.inf)


class DescentWithMemory(Descent):
    """A descent that carries one field from step to step on the surface."""

    remembered = (*Descent.remembered, "_last")

    def __init__(self) -> None:
        super().__init__()
        self._last = np.zeros(0, np.float32)

    @property
    def fields(self) -> list[np.ndarray]:
        """What the last step left."""
        return [self._last]

    def set_fields(self, fields: list[np.ndarray]) -> None:
        """The same on the new band."""
        (self._last,) = fields

    def start(self, surface: LevelSet) -> None:
        """Nothing to remember yet."""
        super().start(surface)
        self._last = np.zeros(surface.size, np.float32)


def finish(
    now: StepInput, speed: np.ndarray, dt: float, limits: StepLimits, travel: float, diffusion: float = 0.0
) -> StepPlan:
    """The move of a descent: ``speed`` (n,) at the front, held to the limit and extended (in place)."""
    rates = voxel_rates(now.surface, now.front, speed)
    held = clip_speed(speed, rates, dt, limits.cfl)
    rate = percentile(speed, limits.percentile, now.front)
    now.surface.extend_outwards(speed, now.front)
    return StepPlan(dt, speed, None, rate, held / max(1, int(now.front.sum())), diffusion, travel=travel)


def voxel_rates(surface: LevelSet, front: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """|speed| (n,) in voxels along the normal per unit time at the front, 0 elsewhere."""
    out = np.empty(surface.size, np.float32)
    surface.workers.run(
        motion.voxel_rates, surface.size, surface.grid, surface.band, front, np.asarray(speed, np.float32), out
    )
    return out


def front_percentiles(now: StepInput, field: np.ndarray, percent: float) -> tuple[float, float]:
    """Percentile of |field| at the front, per mm and in voxels along the normal."""
    per_mm = percentile(field, percent, now.front)
    spacings = {h for n, h in axes_of(now.surface) if n > 1}
    if len(spacings) == 1:
        return per_mm, per_mm / spacings.pop()
    return per_mm, percentile(voxel_rates(now.surface, now.front, field), percent, now.front)


def percentile(values: np.ndarray, percent: float, where: np.ndarray | None = None) -> float:
    """The ``percent`` percentile of |values| (the value at its rank, no interpolation); 0 for none.

    Of all of them, or ``where`` a mask is set.
    """
    where = np.ones(values.size, np.bool_) if where is None else where
    count = int(np.count_nonzero(where))
    if count == 0:
        return 0.0
    rank = min(count - 1, int(count * percent / 100.0))
    return float(statistics.size_at_rank(np.ascontiguousarray(values, np.float32), where, rank))


def clip_speed(speed: np.ndarray, rates: np.ndarray, dt: float, cfl: float) -> int:
    """Hold ``speed`` (n,) or (n, 3) (in place) to ``cfl`` voxels in ``dt``; returns how many cells were held."""
    most = cfl / dt
    fast = rates > most * (1.0 + 1e-6)
    share = np.float32(most) / rates[fast]
    speed[fast] *= share if speed.ndim == 1 else share[:, None]
    return int(fast.sum())


def diffusion_bound(surface: LevelSet) -> float:
    """Largest D dt (mm2) for which the explicit 7-point diffusion is an average: 1 / (2 sum 1/h^2)."""
    g = surface.grid
    axes = [(g.nz, g.hz), (g.ny, g.hy), (g.nx, g.hx)]
    return 0.5 / sum(1.0 / h**2 for n, h in axes if n > 1)


def diffusion_reach(surface: LevelSet) -> float:
    """The largest amount D dt (mm2) that `diffuse` reaches in one step."""
    return 0.5 * STAGES * (STAGES + 1) * diffusion_bound(surface)


def free_diffusion(surface: LevelSet, dt: float, speed: float) -> float:
    """The paper's free gain: the largest D (mm2 per unit time) that does not shorten the step, within a mixing length.

    The first bound is what `diffuse` reaches in ``dt``; the second, MIXING x h x ``speed``, keeps a step that
    another bound has made short from being overdamped.
    """
    return min(diffusion_reach(surface) / dt, MIXING * smallest_spacing(surface) * speed)


def diffuse(surface: LevelSet, front: np.ndarray, field: np.ndarray, amount: float) -> None:
    """Diffuse an extended field (n,) along the surface in place, by ``amount`` = D dt (mm2).

    Runge-Kutta-Legendre of first order (Meyer, Balsara, Aslam 2012): s explicit stages reach (s^2 + s)/2
    times the amount of one, each a Laplacian and an extension; as few as ``amount`` asks for, at most `STAGES`.
    """
    bound = diffusion_bound(surface)
    s = 1
    while s < STAGES and 0.5 * (s * s + s) * bound < amount:
        s += 1
    share = 2.0 / (s * s + s) * amount
    older, old = field, field
    on = np.flatnonzero(front).astype(np.int32)
    table = np.empty((on.size, 6), np.int32)
    run = surface.workers.run
    run(motion.neighbour_slots, on.size, surface.dense.slot, surface.grid, surface.band.cells, on, table)
    for j in range(1, s + 1):
        mu, nu = (2.0 * j - 1.0) / j, (1.0 - j) / j
        new = np.empty_like(field)
        weights = np.float32(mu), np.float32(mu * share), np.float32(nu)
        run(motion.diffusion_stage, on.size, on, table, surface.grid, old, older, weights, new)
        surface.extend_outwards(new, front)
        older, old = old, new
    field[:] = old


def smallest_spacing(surface: LevelSet) -> float:
    """Smallest spacing (mm) among the axes with more than one slice."""
    return min(h for n, h in axes_of(surface) if n > 1)


def axes_of(surface: LevelSet) -> tuple[tuple[int, float], ...]:
    """(voxels, spacing) of the axes z, y, x."""
    g = surface.grid
    return (g.nz, g.hz), (g.ny, g.hy), (g.nx, g.hx)
