"""Checks that a level set is valid: numbered from cheap to expensive, no output when it is."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels import differences, motion
from accelsurf.kernels.grid import voxels_along
from accelsurf.levelset.level_set import LevelSet

#: How far the slope of psi beside the front may be from 1 on average: a distance has slope 1, but the centred
#: differences of a rough surface fall short of it.
SLOPE_TOLERANCE = 0.25
#: Smallest share of cells beside the front whose closest point lies on the zero level of psi to a tenth of a voxel.
MIN_ON_SURFACE = 0.9


def check_level_set(surface: LevelSet, last: int = 8) -> list[str]:
    """Check a surface after redistancing.

    Parameters
    ----------
    surface : LevelSet
        Not modified.
    last : int, optional
        Stop after this check; 1 to 3 cost O(band), the others O(volume).

    Returns
    -------
    list of str
        One line per finding, the number of the check first; empty when valid. The first check that finds something
        ends the list, since later ones build on it.

    Examples
    --------
    >>> z, y, x = np.indices((16, 16, 16)) - 7.5
    >>> surface = LevelSet(np.sqrt(x**2 + y**2 + z**2) - 5, (1, 1, 1))
    >>> check_level_set(surface)
    []
    >>> surface.dense.psi[surface.band.cells[0]] = np.nan
    >>> check_level_set(surface)
    ['1 finite: psi is not finite at 1 band cell']
    """
    checks = (_finite, _ordered, _distances, _slots, _outside, _closed, _slope, _residuals)
    for number, check in enumerate(checks[:last], start=1):
        finding = check(surface)
        if finding:
            return [f"{number} {check.__name__.strip('_')}: {finding}"]
    return []


def _cells(count: int) -> str:
    return f"{count} band cell{'' if count == 1 else 's'}"


def _finite(surface: LevelSet) -> str:
    bad = ~np.isfinite(surface.dense.psi[surface.band.cells]) | ~np.isfinite(
        surface.band.to_closest
    ).all(axis=1)
    return f"psi is not finite at {_cells(int(bad.sum()))}" if bad.any() else ""


def _ordered(surface: LevelSet) -> str:
    bad = np.diff(surface.band.cells) <= 0
    return f"the cells are not in raster order at {_cells(int(bad.sum()))}" if bad.any() else ""


def _distances(surface: LevelSet) -> str:
    """Psi is the distance to the closest point, with its sign, and within the half width."""
    band, g = surface.band, surface.grid
    rounding = 2e-6 * min(g.hz, g.hy, g.hx)
    length = np.sqrt((band.to_closest.astype(np.float64) ** 2).sum(axis=1))
    bad = np.abs(np.abs(band.psi) - length) > 1e-5 * surface.gamma + rounding
    if bad.any():
        return f"psi is not the distance to the closest point at {_cells(int(bad.sum()))}"
    far = voxels_along(*band.to_closest.astype(np.float64).T, g) > surface.half_width * (1 + 1e-6)
    if far.any():
        return (
            f"{_cells(int(far.sum()))} further than {surface.half_width:g} voxels from the surface"
        )
    bad = surface.dense.psi[band.cells] != band.psi
    return f"the volume's psi is not the band's at {_cells(int(bad.sum()))}" if bad.any() else ""


def _slots(surface: LevelSet) -> str:
    mapped = int((surface.dense.slot >= 0).sum())
    if mapped != surface.size:
        return f"{mapped} voxels point into a band of {_cells(surface.size)}"
    bad = surface.dense.slot[surface.band.cells] != np.arange(surface.size)
    return f"the slot map is wrong at {_cells(int(bad.sum()))}" if bad.any() else ""


def _outside(surface: LevelSet) -> str:
    beyond = surface.dense.psi[surface.dense.slot < 0]
    bad = int((np.abs(beyond) != surface.gamma).sum())
    return f"psi is not +-{surface.gamma:g} at {bad} voxels outside the band" if bad else ""


def _closed(surface: LevelSet) -> str:
    """No two neighbours on different sides of the surface are outside the band."""
    inside = surface.psi < 0
    beyond = surface.dense.slot.reshape(surface.shape) < 0
    bad = 0
    for axis in range(3):
        a, b = [slice(None)] * 3, [slice(None)] * 3
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        crossing = inside[tuple(a)] != inside[tuple(b)]
        bad += int((crossing & (beyond[tuple(a)] | beyond[tuple(b)])).sum())
    return f"the surface leaves the band between {bad} pairs of voxels" if bad else ""


def _slope(surface: LevelSet) -> str:
    slopes = upwind_slopes(surface)
    error = abs(float(np.mean(slopes)) - 1.0) if slopes.size else 0.0
    return (
        f"|grad psi| is off 1 by {error:.2f} on average beside the front"
        if error > SLOPE_TOLERANCE
        else ""
    )


def _residuals(surface: LevelSet) -> str:
    residuals = closest_point_residuals(surface)
    share = float(np.mean(residuals < 0.1)) if residuals.size else 1.0
    if share >= MIN_ON_SURFACE:
        return ""
    return f"only {share:.0%} of the closest points beside the front lie on the surface"


def upwind_slopes(surface: LevelSet) -> np.ndarray:
    """Godunov's |grad psi| (m,), upwind from the front, at the cells within a voxel of the surface."""
    front, norm = surface.front(1.0), np.empty(surface.size, np.float32)
    # Upwind from the front: as if every cell moved away from it.
    away = -surface.band.psi
    surface.workers.parallel(
        differences.upwind_norms,
        surface.size,
        surface.dense.psi,
        surface.grid,
        surface.band,
        away,
        front,
        norm,
    )
    return norm[front]


def closest_point_residuals(surface: LevelSet) -> np.ndarray:
    """Distance of psi from 0 (m,), in voxels of the smallest spacing, at the closest points within a voxel."""
    front, value = surface.front(1.0), np.empty(surface.size, np.float32)
    surface.workers.parallel(
        motion.sample_image,
        surface.size,
        surface.dense.psi,
        surface.grid,
        surface.band,
        front,
        value,
    )
    return np.asarray(np.abs(value[front]) / min(surface.grid.hz, surface.grid.hy, surface.grid.hx))
