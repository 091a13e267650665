"""Bounds on the time step, and the speeds that they depend on."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.flows.protocol import StepInput
from accelsurf.kernels import motion, statistics
from accelsurf.levelset import LevelSet


def voxel_rates(surface: LevelSet, front: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """|speed| (n,) in voxels along the normal per unit time at the front, 0 elsewhere."""
    out = np.empty(surface.size, np.float32)
    surface.workers.parallel(
        motion.voxel_rates, surface.size, surface.grid, surface.band, front, np.asarray(speed, np.float32), out
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
    return float(statistics.magnitude_at_rank(np.ascontiguousarray(values, np.float32), where, rank))


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
