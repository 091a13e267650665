"""Mass and momentum on the whole grid: transport, sums, means across a surface, and transfer to another grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.kernels import fluid as kernels
from accelsurf.levelset import LevelSet, Workers

#: Most voxels that the fastest wave goes in a sweep.
MAX_COURANT = 0.4
#: Where the mass per volume is below this part of its first value there is no velocity.
DRY = 1e-6


class FluidSums(NamedTuple):
    """Integrals over the grid: mass; 1/2 int rho V.V, V.V', V'.V' of two fluids of the same rho; 1/2 int rho^2."""

    mass: float
    before: float
    between: float
    after: float
    squares: float


class Transported(NamedTuple):
    """A ``fluid`` after its transport, the mass per voxel that has ``left`` the grid, and the ``steps`` made."""

    fluid: np.ndarray
    left: float
    steps: int


def make_fluid(density: np.ndarray, velocity: np.ndarray | None = None) -> np.ndarray:
    """Mass and momentum (4, nz, ny, nx) of a density (nz, ny, nx) and a velocity (3, nz, ny, nx), z y x; None: 0."""
    out = np.zeros((4, *density.shape), np.float32)
    out[0] = density
    if velocity is not None:
        out[1:] = density * velocity
    return out


def spacing_of(surface: LevelSet) -> np.ndarray:
    """Spacing (3,) along z, y, x, mm, as the kernels have it."""
    return np.array([surface.grid.hz, surface.grid.hy, surface.grid.hx])


def fluid_sums(
    workers: Workers, first: np.ndarray, second: np.ndarray, voxel: float, dry: float
) -> FluidSums:
    """Sums of two fluids, that before and that after a change of the momentum, in voxels of ``voxel`` mm3."""
    shape = (first.shape[1], first.shape[2], first.shape[3])
    sums = workers.plane_sums(kernels.fluid_sums, shape, 5, first, second, dry) * voxel
    return FluidSums(*(float(value) for value in sums))


def fastest_rate(surface: LevelSet, fluid: np.ndarray, stiffness: float, dry: float) -> float:
    """Largest (|V| + c)/h along an axis of more than one voxel, voxels per unit time."""
    fastest = np.zeros((surface.shape[0], 3))
    surface.workers.parallel(
        kernels.fastest_waves, surface.shape[0], fluid, (stiffness, dry), fastest
    )
    rates = fastest.max(axis=0) / spacing_of(surface)
    return max((float(rates[a]) for a in range(3) if surface.shape[a] > 1), default=0.0)


def transport_fluid(
    surface: LevelSet,
    fluid: np.ndarray,
    dt: float,
    stiffness: float,
    dry: float,
    boundary: Callable[[np.ndarray], None] | None = None,
) -> Transported:
    """The fluid after ``dt`` of rho_t + div(rho V) = 0, (rho V)_t + div(rho V V) = -grad(G rho^2/2), G = ``stiffness``.

    Sweeps along the axes there and back, half a step each (Strang), in as many steps as `MAX_COURANT` asks for. Fluid
    at the border of the grid flows out. ``boundary`` sets in place, before a sweep, the fluid beyond a surface.
    """
    out = fluid.copy()
    left = 0.0
    steps = 0
    done = 0.0
    axes = [a for a in range(3) if surface.shape[a] > 1]
    spacing = spacing_of(surface)
    sweeps = [*((a, 0.5) for a in axes[:-1]), (axes[-1], 1.0), *((a, 0.5) for a in axes[-2::-1])]
    while done < dt:
        rate = fastest_rate(surface, out, stiffness, dry)
        more = max(math.ceil((dt - done) * rate / MAX_COURANT * (1.0 - 1e-9)), 1)
        step = (dt - done) / more
        for a, part in sweeps:
            if boundary is not None:
                boundary(out)
            planes = (surface.shape[1], 1, 1) if a == 0 else surface.shape
            ratio = part * step / spacing[a]
            left += float(
                surface.workers.plane_sums(
                    kernels.sweep_planes, planes, 1, out, a, ratio, (stiffness, dry)
                )[0]
            )
        done, steps = (dt if more == 1 else done + step), steps + 1
    return Transported(out, left, steps)


def regrid_fluid(
    fluid: np.ndarray, place: np.ndarray, shape: tuple[int, ...], outside: float
) -> np.ndarray:
    """The fluid on another grid of ``shape``, by linear interpolation of density and velocity.

    ``place`` (2, 3): factor and addition that take an index of the new grid to one of the old. Beyond the old grid
    there is a fluid at rest of the density ``outside``.
    """
    if (place[0] == 1.0).all() and (place[1] == np.round(place[1])).all():
        return _shifted(fluid, place[1].astype(int), shape, outside)
    indices = [np.arange(n) * place[0, a] + place[1, a] for a, n in enumerate(shape)]
    points = np.stack(np.meshgrid(*indices, indexing="ij"))
    beyond = np.zeros(shape, np.bool_)
    for a, n in enumerate(fluid.shape[1:]):
        beyond |= (points[a] < -0.5) | (points[a] > n - 0.5)
    density = fluid[0].astype(np.float64)
    rho = ndimage.map_coordinates(density, points, order=1, mode="nearest")
    out = make_fluid(np.where(beyond, outside, rho))
    for part in range(1, 4):
        speed = np.divide(fluid[part], density, out=np.zeros_like(density), where=density > 0)
        velocity = ndimage.map_coordinates(speed, points, order=1, mode="nearest")
        out[part] = np.where(beyond, 0.0, out[0] * velocity)
    return out


def _shifted(
    fluid: np.ndarray, by: np.ndarray, shape: tuple[int, ...], outside: float
) -> np.ndarray:
    """The same voxels, whose first is ``by`` in the old grid, in another box."""
    out = np.zeros((4, *shape), np.float32)
    out[0] = outside
    old = [
        slice(max(b, 0), min(b + n, m)) for b, n, m in zip(by, shape, fluid.shape[1:], strict=True)
    ]
    new = [slice(s.start - b, s.stop - b) for s, b in zip(old, by, strict=True)]
    out[(slice(None), *new)] = fluid[(slice(None), *old)]
    return out
