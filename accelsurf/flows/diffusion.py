"""Diffusion of fields along the surface."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels import motion
from accelsurf.levelset import LevelSet

#: Largest number of stages s of a diffusion step. The free bound is that of s explicit stages: (s^2 + s)/2 times one.
MAX_STAGES = 8
#: Free diffusion is a mixing length: D = at most MIXING x h x front speed. The surface then averages its speed over
#: the same patch for each voxel travelled, whatever the step: a step cut short by another bound is not overdamped.
MIXING = 16.0


def one_stage_diffusion(surface: LevelSet) -> float:
    """Largest D dt (mm2) for which the explicit 7-point diffusion is an average: 1 / (2 sum 1/h^2)."""
    return 0.5 / sum(1.0 / h**2 for h in surface.spacings)


def largest_diffusion(surface: LevelSet) -> float:
    """The largest amount D dt (mm2) for which one step of `diffuse` is stable."""
    return 0.5 * MAX_STAGES * (MAX_STAGES + 1) * one_stage_diffusion(surface)


def free_diffusion(surface: LevelSet, dt: float, speed: float) -> float:
    """The paper's free gain: the largest D (mm2 per unit time) that does not shorten the step, within a mixing length.

    The first bound is that of `diffuse` in ``dt``; the second, MIXING x h x ``speed``, avoids that a step
    which another bound has made short is overdamped.
    """
    return min(largest_diffusion(surface) / dt, MIXING * surface.smallest_spacing * speed)


def diffuse(surface: LevelSet, front: np.ndarray, field: np.ndarray, amount: float, component: int = -1) -> None:
    """Diffuse an extended field (n,) along the surface in place, by ``amount`` = D dt (mm2).

    No flux passes the volume's border: the field is mirrored there. A vector's ``component`` along an axis (0, 1, 2)
    changes its sign in the mirror of the two borders across that axis.

    Runge-Kutta-Legendre of first order (Meyer, Balsara, Aslam 2012): s explicit stages make (s^2 + s)/2
    times the amount of one, each a Laplacian and an extension; as few as ``amount`` needs, at most `MAX_STAGES`.
    """
    bound = one_stage_diffusion(surface)
    s = 1
    while s < MAX_STAGES and 0.5 * (s * s + s) * bound < amount:
        s += 1
    share = 2.0 / (s * s + s) * amount
    older, old = field, field
    on = np.flatnonzero(front).astype(np.int32)
    table, at_wall = np.empty((on.size, 6), np.int32), np.empty(on.size, np.bool_)
    parallel = surface.workers.parallel
    where = surface.dense.slot, surface.grid, surface.band.cells
    parallel(motion.neighbour_slots, on.size, *where, on, component, (table, at_wall))
    walls = on[at_wall]
    # A value of the other sign beyond the wall, instead of the same: 2 less of it.
    to_wall = 2.0 / surface.grid[3 + component] ** 2 if walls.size else 0.0
    for j in range(1, s + 1):
        mu, nu = (2.0 * j - 1.0) / j, (1.0 - j) / j
        new = np.empty_like(field)
        weights = np.float32(mu), np.float32(mu * share), np.float32(nu)
        parallel(motion.diffusion_stage, on.size, on, table, surface.grid, (old, older), weights, new)
        new[walls] -= np.float32(mu * share * to_wall) * old[walls]
        surface.extend_outwards(new, front)
        older, old = old, new
    field[:] = old
