"""Diffusion of fields along the surface."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.kernels import motion
from accelsurf.levelset import LevelSet

#: Number k of the stage that is blended with the last, s, for s = 2 to 14 stages. Of the k that leave a step as long as
#: it can be, those with which it damps the finest waves best (to 0.73 and less): benchmarks/notes/flows.md.
BLENDED = (0, 0, 1, 0, 1, 2, 1, 2, 1, 2, 3, 4, 5)
MAX_STAGES = 1 + len(BLENDED)
#: Part of the stable step that is used. It also bounds the error in time: at 12 voxels of radius a wave of degree 4
#: decays within 5 % of its rate in the longest step.
SAFETY = 0.9
#: Free diffusion is a mixing length: D = at most MIXING x h x front speed. The surface then averages its speed over
#: the same patch for each voxel travelled, whatever the step: a step cut short by another bound is not overdamped.
#: From a noisy cube, benchmarks/notes/flows.md, "as a mixing length".
MIXING = 16.0


def one_stage_diffusion(surface: LevelSet) -> float:
    """Largest D dt (mm2) for which the explicit 7-point diffusion is an average: 1 / (2 sum 1/h^2)."""
    return 0.5 / sum(1.0 / h**2 for h in surface.spacings)


def largest_diffusion(surface: LevelSet) -> float:
    """The largest amount D dt (mm2) for which one step of `diffuse` is stable."""
    return SAFETY * STAGES[-1].amount * one_stage_diffusion(surface)


class Polynomial(NamedTuple):
    """Polynomial of a step: (1 - ``blend``) P_k(1 + z/``amount``) + ``blend`` P_s(1 + z/``amount``) for z = D dt Lap.

    P_k and P_s are Legendre's. ``amount`` is the largest stable one, in units of one explicit stage's; ``stages`` is s,
    ``blended`` k.
    """

    stages: int
    blended: int
    blend: float
    amount: float


def stages_of(count: int) -> Polynomial:
    """The polynomial of ``count`` stages that agrees with exp(z) to second order (one stage: 1 + z).

    With S = s(s + 1), K = k(k + 1) and m = 2 x amount its slope is 1 if the mean of S and K is m, and its second
    derivative if that of their squares is 2 m^2 + 2 m.
    """
    if count == 1:
        return Polynomial(1, 0, 1.0, 1.0)
    k = BLENDED[count - 2]
    high, low = count * (count + 1.0), k * (k + 1.0)
    m = 0.25 * (high + low - 2.0 + math.sqrt((high + low - 2.0) ** 2 - 8.0 * high * low))
    return Polynomial(count, k, (m - low) / (high - low), 0.5 * m)


STAGES = tuple(stages_of(count) for count in range(1, MAX_STAGES + 1))


def free_diffusion(surface: LevelSet, dt: float, speed: float) -> float:
    """The paper's free gain: the largest D (mm2 per unit time) that does not shorten the step, within a mixing length.

    The first bound is that of `diffuse` in ``dt``; the second, MIXING x h x ``speed``, avoids that a step
    which another bound has made short is overdamped.
    """
    return min(largest_diffusion(surface) / dt, MIXING * surface.smallest_spacing * speed)


def diffuse(
    surface: LevelSet, front: np.ndarray, field: np.ndarray, amount: float, component: int = -1
) -> None:
    """Diffuse a field (n,), given on the ``front``, along the surface in place, by ``amount`` = D dt (mm2).

    Off the front the field is as before, or extended. No flux passes the volume's border: the field is mirrored there.
    A vector's ``component`` along an axis (0, 1, 2) changes its sign in the mirror of the two borders across that axis.

    Runge-Kutta-Legendre (Meyer, Balsara, Aslam 2012): stage j is the Legendre polynomial P_j of the Laplacian, each a
    Laplacian and an extension. Two of them combined are of second order, see `stages_of`; as few as ``amount`` needs.
    """
    bound = SAFETY * one_stage_diffusion(surface)
    step = next(
        (polynomial for polynomial in STAGES if polynomial.amount * bound >= amount), STAGES[-1]
    )
    share = amount / step.amount
    parallel, grid = surface.workers.parallel, surface.grid
    rows = surface.front_rows(front, component)
    on, off = rows.on, rows.off
    walls = np.flatnonzero(rows.walls & (1 << component)) if component >= 0 else on[:0]
    # A value of the other sign beyond the wall, instead of the same: 2 less of it.
    to_wall = 2.0 / grid[3 + component] ** 2 if walls.size else 0.0
    first = np.empty(rows.order.size, np.float32)
    # "clip" only says that all slots exist: then nothing is buffered.
    field.take(on, out=first[: on.size], mode="clip")
    rows.extend(surface.workers, first)
    field[off] = first[on.size :]
    # Stage 1 reads an older one, with weight 0.
    turn, blended = (
        [first.copy() if step.blended == 0 else first, np.empty_like(first), np.zeros_like(first)],
        first,
    )
    for j in range(1, step.stages + 1):
        mu, nu = (2.0 * j - 1.0) / j, (1.0 - j) / j
        new = turn[j % 3]
        old = turn[(j - 1) % 3]
        older = turn[(j - 2) % 3]
        weights = np.float32(mu), np.float32(mu * share), np.float32(nu)
        parallel(
            motion.diffusion_stage,
            on.size,
            rows.order,
            rows.neighbours,
            grid,
            (old, older),
            weights,
            new,
        )
        if walls.size:
            new[walls] -= np.float32(mu * share * to_wall) * old[walls]
        if j < step.stages:
            rows.extend(surface.workers, new)
        if j == step.blended:
            blended = new.copy()
    last, blended = turn[step.stages % 3][: on.size], blended[: on.size]
    last -= blended
    last *= np.float32(step.blend)
    last += blended
    field[on] = last
