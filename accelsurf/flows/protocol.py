"""The protocol of the flows: input and output of a step, the base class, and bounds on the time step."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np

from accelsurf.kernels import motion, statistics
from accelsurf.levelset import FRONT_WIDTH, LevelSet


class StepLimits(NamedTuple):
    """Step control, the same for every flow.

    ``cfl``: voxels that the surface may move in a step. ``percentile``: the time step follows this percentile
    of the speeds on the front; faster speeds are clipped to ``cfl`` voxels in that step (100: nothing is clipped).
    ``dt_max``: upper bound of the time step.
    """

    cfl: float = 0.5
    percentile: float = 95.0
    dt_max: float = math.inf


class StepInput(NamedTuple):
    """The surface at the beginning of a step, and its force; arrays are per band cell.

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
    """Energy and mass at the beginning of a step, and the energy that it takes; see `evolution.StepRecord`.

    ``kinetic`` is the paper's T, ``weight`` the factor w of the potential in T + w U; the others are in the units
    of U: ``friction`` is lost per unit of flow time; this step takes ``smoothing`` (diffusion, limiter) and adds
    ``noise``. ``friction_before`` is the loss per unit of time of the step before at its end, where that is not
    ``friction``: a descent loses the work of its force, and its speeds change from step to step.
    """

    kinetic: float = 0.0
    weight: float = 1.0
    mass_potential: float = 0.0
    friction: float = 0.0
    friction_before: float | None = None
    smoothing: float = 0.0
    noise: float = 0.0
    mass: float = 0.0
    mass_correction: float = 0.0
    clamped: float = 0.0


class StepPlan(NamedTuple):
    """One step as the flow plans it.

    ``dt``; ``speed`` (n,) beta on the whole band, mm per unit time; ``velocity`` (n, 3) V, where the surface is
    advected by it; ``front_speed``, the percentile of the front's speeds, mm per unit time; ``clipped``, the share of
    front cells whose speed was clipped; ``diffusion`` used, mm2 per unit time; ``energy_rates``; ``cfl_dt``, the step
    that the CFL number alone would allow.
    """

    dt: float
    speed: np.ndarray
    velocity: np.ndarray | None = None
    front_speed: float = 0.0
    clipped: float = 0.0
    diffusion: float = 0.0
    energy_rates: EnergyRates = EnergyRates()
    cfl_dt: float = 0.0

    @classmethod
    def none(cls, surface: LevelSet) -> StepPlan:
        """No move: nothing acts on the surface."""
        return cls(0.0, np.zeros(surface.size, np.float32))


class Flow(ABC):
    """The protocol of flows. A subclass gives `name` and `move`; all other methods have a default.

    The defaults suit a flow without momentum: no fields on the surface, no kinetic energy, and nothing to do
    when momentum is set to zero. All flows know the peak force of the run so far, by which they choose their steps.

    Attributes
    ----------
    name : str
        Its name in settings and reports.
    state_names : tuple of str
        Attributes of the state that goes from step to step, without settings: `state` copies, `restore` sets them.
        A subclass adds its own.
    """

    name: ClassVar[str]
    state_names: ClassVar[tuple[str, ...]] = ("_peak_force", "_voxel")

    #: Peak force so far, in voxels of ``_voxel`` mm.
    _peak_force, _voxel = 0.0, 1.0

    @abstractmethod
    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Choose the time step and the speeds of one step."""

    @property
    def weight(self) -> float:
        """Factor w of the potential in the energy T + w U that the flow dissipates; 1 for descent."""
        return 1.0

    def stencil_width(self, surface: LevelSet) -> float:
        """Distance from the surface, in voxels, up to which the flow needs forces; by default the front."""
        return FRONT_WIDTH

    def start(self, surface: LevelSet) -> None:
        """Begin without momentum on a surface."""
        self._forget_forces()

    def zero_momentum(self, area: np.ndarray) -> float:
        """Set the momentum to zero, as at the start; returns T/w, which is lost. ``area`` (n,), mm2."""
        return 0.0

    @property
    def fields(self) -> list[np.ndarray]:
        """Fields (n,) on the band that redistancing must extend."""
        return []

    def set_fields(self, fields: list[np.ndarray]) -> None:  # noqa: B027
        """Replace the fields by those that were extended to the new band."""

    @property
    def fill_values(self) -> list[float]:
        """Values of the fields on surface that was not there before; 0, without momentum."""
        return [0.0 for _ in self.fields]

    def change_grid(self, surface: LevelSet, place: np.ndarray) -> None:  # noqa: B027
        """Take the flow's data beyond its `fields` to the grid of ``surface``.

        ``place`` (2, 3): factors and additions that take an index (z, y, x) there to one on the grid before.
        """

    def normal_velocity(self, surface: LevelSet) -> np.ndarray:
        """Speed (n,) along the inward normal that the momentum alone gives the surface, mm per unit time."""
        return np.zeros(surface.size, np.float32)

    def add_velocity(self, surface: LevelSet, speed: np.ndarray) -> None:  # noqa: B027
        """Add ``speed`` (n,) to the normal velocity; without momentum there is none to change."""

    def energy(self, area: np.ndarray) -> float:
        """U_mass + T/w now, in the units of U. ``area`` (n,), mm2."""
        return 0.0

    def state(self) -> dict[str, Any]:
        """Copy the state that goes from step to step, without the settings."""
        return {name: copy.copy(getattr(self, name)) for name in self.state_names}

    def restore(self, surface: LevelSet, state: dict[str, Any]) -> None:
        """Set the state that a flow of the same settings returned on this surface."""
        for name in self.state_names:
            setattr(self, name, copy.copy(state[name]))

    def continue_from(self, surface: LevelSet, before: Flow, forces_changed: bool) -> None:
        """Continue from a flow of the same class with other settings; ``forces_changed``: under another energy."""
        self.restore(surface, before.state())
        if forces_changed:
            self._forget_forces()

    def _forget_forces(self) -> None:
        """Reset the peak force."""
        self._peak_force = 0.0

    def peak_force_so_far(self, peak: float, surface: LevelSet) -> float:
        """Largest ``peak`` (voxels) so far: near the minimum forces fade, but the stiffness there stays."""
        # On another level the voxels have another size.
        voxel = surface.smallest_spacing
        self._peak_force, self._voxel = max(self._peak_force * self._voxel / voxel, peak), voxel
        return self._peak_force


def voxel_rates(surface: LevelSet, front: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """|speed| (n,) in voxels along the normal per unit time at the front, 0 elsewhere."""
    out = np.empty(surface.size, np.float32)
    surface.workers.parallel(
        motion.voxel_rates,
        surface.size,
        surface.grid,
        surface.band,
        front,
        np.asarray(speed, np.float32),
        out,
    )
    return out


def front_percentiles(now: StepInput, field: np.ndarray, percent: float) -> tuple[float, float]:
    """Percentile of |field| at the front, per mm and in voxels along the normal."""
    per_mm = percentile(field, percent, now.front)
    spacings = set(now.surface.spacings)
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
    return float(
        statistics.magnitude_at_rank(np.ascontiguousarray(values, np.float32), where, rank)
    )


def clip_speed(speed: np.ndarray, rates: np.ndarray, dt: float, cfl: float) -> int:
    """Clip ``speed`` (n,) or (n, 3), in place, to ``cfl`` voxels in ``dt``; return how many cells were clipped.

    ``rates`` (n,) are the speeds in voxels per unit time, see `voxel_rates`.
    """
    limit = cfl / dt
    fast = rates > limit * (1.0 + 1e-6)
    factor = np.float32(limit) / rates[fast]
    speed[fast] *= factor if speed.ndim == 1 else factor[:, None]
    return int(fast.sum())


def cfl_bound(speed: float, acceleration: float, cfl: float) -> float:
    """Step in which b dt + A dt^2/2 = cfl."""
    root = speed + math.sqrt(speed * speed + 2.0 * acceleration * cfl)
    return 2.0 * cfl / root if root > 0 else math.inf


def wave_bound(surface: LevelSet, speed: float) -> float:
    """Step in which a transverse wave of ``speed`` goes h/sqrt(3): stable in any direction."""
    return surface.smallest_spacing / (math.sqrt(3.0) * speed) if speed > 0 else math.inf


def curvature_bound(surface: LevelSet) -> float:
    """Largest alpha dt (mm2) of explicit curvature flow: 1 / (2 (1/h1^2 + 1/h2^2)), h1, h2 the finest spacings."""
    finest = sorted(surface.spacings)[:2]
    return 0.5 / sum(1.0 / h**2 for h in finest)
