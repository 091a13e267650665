"""The whole pipeline followed on a grid and compared with an exact solution; used by tests and figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.energies import ChanVese, Energy, RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.records import StepRecord
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, Flow, FlowableMass, StepLimits
from accelsurf.levelset import LevelSet
from tests.support import exact
from tests.support.exact import Case

WIDTH = 2.6
SIZES = (32, 48, 64)
Triple = tuple[int, int, int]

#: Case -> time step in h: 0.5, the CFL number, where the surface moves by at most half a voxel in it; the others
#: reverse within 0.3 time units under a force of slope 1/0.1, and need half of it for the same error in time.
STEP = {
    **dict.fromkeys("ABDGJ", 0.5),
    **dict.fromkeys("CEFHLM", 0.25),
    "K": 0.2,
}


class Lattice(NamedTuple):
    """A grid around the origin: spacing (hz, hy, hx) mm and coordinates (3, nz, ny, nx) in the order z, y, x."""

    spacing: tuple[float, float, float]
    points: np.ndarray

    @property
    def radius(self) -> np.ndarray:
        return np.sqrt((self.points**2).sum(axis=0))


def lattice(n: int, coarser: Triple = (1, 1, 1), flat: bool = False) -> Lattice:
    """``n`` voxels of h = WIDTH/(n - 1) along an axis, n/c of c h along one coarser by c; flat: a single slice."""
    h = WIDTH / (n - 1)
    shape = [1 if flat and axis == 0 else n // c for axis, c in enumerate(coarser)]
    axes = [(np.arange(m) - 0.5 * (m - 1)) * c * h for m, c in zip(shape, coarser, strict=True)]
    return Lattice(
        (coarser[0] * h, coarser[1] * h, coarser[2] * h),
        np.stack(np.meshgrid(*axes, indexing="ij")),
    )


def energy_of(case: Case, radius: np.ndarray) -> Energy:
    """An energy of which the force of the case is the gradient: a region field or an image."""
    if case.force is exact.shrinking:
        return RegionField(np.zeros_like(radius), case.alpha)
    if case.force is exact.well:
        return RegionField(0.5 * (radius**2 - 0.36) / np.maximum(radius, 1e-9), case.alpha)
    if case.force is exact.flowable_well or case.force is exact.flowable_circle_well:
        r = np.maximum(radius, 0.05)
        return RegionField((r - 0.6) / r ** (case.dim - 1))
    return ChanVese(0.5 * (1.0 - np.tanh((radius - 0.5) / 0.1)), case.alpha, means=(1.0, 0.0))


def flow_of(case: Case) -> ConstantDensity | FlowableMass:
    made = FlowableMass if case.flowable else ConstantDensity
    return made(
        k=case.k,
        lambda_=case.lambda_,
        rho=case.rho,
        friction=case.friction,
        diffusion=0.0,
        t0=case.t0 or None,
    )


def surface_points(surface: LevelSet, lattice: Lattice) -> np.ndarray:
    """Points (n, 3) of the surface, z y x: the closest ones to the voxels within a voxel of it."""
    near = surface.front(1.0)
    voxels = lattice.points.reshape(3, -1)[:, surface.band.cells[near]].T
    return voxels + surface.band.to_closest[near]


def steps(
    surface: LevelSet, energy: Energy, flow: Flow, dt: float, t_end: float, cfl: float = 0.5
) -> Iterator[tuple[float, StepRecord]]:
    """Evolve with steps of ``dt`` up to ``t_end``: after each, the time now and the row of the step."""
    evolution = Evolution(
        surface, energy, SolverSetup(flow, StepLimits(cfl, percentile=100.0, dt_max=dt)), 10_000
    )
    for step in evolution:
        assert step.record.dt > 0, evolution.stop
        now = step.record.t + step.record.dt
        if now > t_end + 1e-9:
            return
        yield now, step.record


class Misfit(NamedTuple):
    """Largest difference of radii from the exact one, mm: of their mean, and of any point; at all times."""

    mean: float
    point: float


def follow(
    case: Case,
    on: Lattice,
    dt: float,
    flow: Flow | None = None,
    exactly: Case | None = None,
    radii: list[tuple[float, float]] | None = None,
    extension: str = "closest-point",
) -> Misfit:
    """Run a case and compare every step with the exact solution (of ``exactly`` if given).

    ``radii``, if given, gets the time and the mean radius after every step.
    """
    surface = LevelSet(
        on.radius - case.r0, on.spacing, 4.0 if case.flowable else 3.0, extension=extension
    )
    path = exact.path(exactly or case)
    mean = point = 0.0
    for t, _ in steps(surface, energy_of(case, on.radius), flow or flow_of(case), dt, case.t_end):
        found = np.linalg.norm(surface_points(surface, on), axis=1)
        mean = max(mean, abs(float(found.mean()) - path(t)))
        point = max(point, float(np.abs(found - path(t)).max()))
        if radii is not None:
            radii.append((t, float(found.mean())))
    return Misfit(mean, point)


def order(errors: Sequence[float], sizes: Sequence[int] = SIZES) -> float:
    """Slope of log(error) over log(h), for errors on the grids of ``sizes``."""
    return float(np.polyfit(np.log([WIDTH / (n - 1) for n in sizes]), np.log(errors), 1)[0])
