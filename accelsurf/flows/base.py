"""What all flows share: the protocol, the speed limiter, the bounds on the time step."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from accelsurf.kernels import motion
from accelsurf.levelset import LevelSet

#: Most stages of a diffusion step. The free bound is what these reach explicitly: (s^2 + s)/2 times one stage.
STAGES = 8


class Limits(NamedTuple):
    """Step control, the same for every flow.

    ``cfl``: voxels that the surface may move in a step. ``percentile``: the time step follows this percentile
    of the speeds on the front; faster cells are held to ``cfl`` voxels in that step (100: nothing is held).
    ``dt_max``: upper bound of the time step.
    """

    cfl: float = 0.5
    percentile: float = 95.0
    dt_max: float = math.inf


class Move(NamedTuple):
    """One step as the flow wants it.

    ``dt``; ``speed`` (n,) beta on the whole band; ``kinetic`` energy at the beginning of the step; ``rate``
    the percentile of the front's speeds (mm per unit time); ``limited`` share of front cells held back;
    ``diffusion`` used (mm2 per unit time).
    """

    dt: float
    speed: np.ndarray
    kinetic: float
    rate: float
    limited: float
    diffusion: float


class Flow(Protocol):
    """What the loop asks of a flow.

    Attributes
    ----------
    name : str
    weight : float
        Factor w of the potential in T + w U (1 for descent), at the present time.
    """

    name: str

    @property
    def weight(self) -> float:
        """Factor of the potential in the energy that the flow dissipates."""
        ...

    def start(self, surface: LevelSet) -> None:
        """Begin at rest on a surface."""
        ...

    def rest(self) -> None:
        """Put the surface at rest, as at the start (adaptive restart)."""
        ...

    def move(
        self, surface: LevelSet, front: np.ndarray, force: np.ndarray, curvature: np.ndarray, area: np.ndarray,
        alpha: float, limits: Limits,
    ) -> Move:
        """Choose the time step and the speeds of one step."""
        ...

    @property
    def fields(self) -> list[np.ndarray]:
        """Fields (n,) that redistancing must extend."""
        ...

    def take(self, fields: list[np.ndarray]) -> None:
        """Take the extended fields back, on the new band."""
        ...


def voxel_rates(surface: LevelSet, front: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """|speed| (n,) in voxels along the normal per unit time at the front, 0 elsewhere."""
    out = np.empty(surface.size, np.float32)
    surface.workers.run(
        motion.voxel_rates, surface.size, surface.grid, surface.band, front, np.asarray(speed, np.float32), out
    )
    return out


def percentile(values: np.ndarray, percent: float) -> float:
    """The ``percent`` percentile of ``values`` (the value at its rank, no interpolation); 0 for none."""
    if values.size == 0:
        return 0.0
    rank = min(values.size - 1, int(values.size * percent / 100.0))
    return float(np.partition(values, rank)[rank])


def hold_back(speed: np.ndarray, rates: np.ndarray, dt: float, cfl: float) -> int:
    """Hold ``speed`` (in place) to ``cfl`` voxels in ``dt``; returns how many cells were held."""
    most = cfl / dt
    fast = rates > most * (1.0 + 1e-6)
    speed[fast] *= np.float32(most) / rates[fast]
    return int(fast.sum())


def laplacian(surface: LevelSet, front: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Surface Laplacian (n,) of an extended field at the front."""
    out = np.empty(surface.size, np.float32)
    surface.workers.run(
        motion.surface_laplacian, surface.size, surface.dense.slot, surface.grid, surface.band.cells, field, front, out
    )
    return out


def diffusion_bound(surface: LevelSet) -> float:
    """Largest D dt (mm2) for which the explicit 7-point diffusion is an average: 1 / (2 sum 1/h^2)."""
    g = surface.grid
    axes = [(g.nz, g.hz), (g.ny, g.hy), (g.nx, g.hx)]
    return 0.5 / sum(1.0 / h**2 for n, h in axes if n > 1)


def free_diffusion(surface: LevelSet, dt: float) -> float:
    """The free bound: the largest D (mm2 per unit time) that `diffuse` reaches in a step of ``dt``."""
    return 0.5 * STAGES * (STAGES + 1) * diffusion_bound(surface) / dt


def diffuse(surface: LevelSet, front: np.ndarray, field: np.ndarray, amount: float) -> None:
    """Diffuse an extended field (n,) along the surface in place, by ``amount`` = D dt (mm2).

    Runge-Kutta-Legendre of first order (Meyer, Balsara, Aslam 2012): s explicit stages reach (s^2 + s)/2
    times the amount of one, each a Laplacian and an extension; as few as ``amount`` asks for, at most `STAGES`.
    """
    bound = diffusion_bound(surface)
    s = 1
    while s < STAGES and 0.5 * (s * s + s) * bound < amount:
        s += 1
    share = 2.0 / (s * s + s)
    older, old = field.copy(), field.copy()
    old += np.float32(share * amount) * laplacian(surface, front, field)
    surface.extend_outwards(old, front)
    for j in range(2, s + 1):
        mu, nu = (2.0 * j - 1.0) / j, (1.0 - j) / j
        new = np.float32(mu) * (old + np.float32(share * amount) * laplacian(surface, front, old))
        new += np.float32(nu) * older
        surface.extend_outwards(new, front)
        older, old = old, new
    field[:] = old


def smallest_spacing(surface: LevelSet) -> float:
    """Smallest spacing (mm) among the axes with more than one slice."""
    g = surface.grid
    return min(h for n, h in ((g.nz, g.hz), (g.ny, g.hy), (g.nx, g.hx)) if n > 1)
