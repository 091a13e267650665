"""A surface that follows noise: no cell changes sides where the surface has not come by, see record 0005.

Psi is flat where it is below the distance from the surface. On a rough surface |grad psi| is steep along another axis
at the same time, and a step then carries psi through 0 too early. Two wrong redistancings show what this test sees.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from accelsurf.energies.front_samples import sample_at_front
from accelsurf.levelset import LevelSet

SIDE, STEPS, DT = 24, 30, 0.6
#: Distance, voxels, within which the wrong redistancings leave psi alone.
NEAR = 1.5
#: A cell further from the surface than this part of the way of a step has changed sides too early.
PART = 1.15


def follow_noise(renew: Callable[[LevelSet], None], seed: int) -> float:
    """Share, of the cells that change sides, of those that do so too early.

    A plane moves by noise that rests in space, and is pulled back to where it began, as an object's edge does.
    """
    z = np.arange(SIDE)[:, None, None]
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (SIDE,) * 3).astype(np.float32)
    force = (noise + 0.5 * (z - 0.5 * SIDE).astype(np.float32)).ravel()
    surface = LevelSet(np.broadcast_to(z - 0.5 * SIDE + 0.1, noise.shape), (1.0, 1.0, 1.0))
    changed = early = 0
    for _ in range(STEPS):
        front = surface.front()
        speed = np.clip(sample_at_front(force, surface, front), -1.0, 1.0).astype(np.float32)
        surface.extend_outwards(speed, front)
        cells, distance = surface.band.cells, np.linalg.norm(surface.band.to_closest, axis=1)
        before = surface.labels.ravel()[cells]
        surface.advance(speed, DT)
        crossed = surface.labels.ravel()[cells] != before
        changed += int(crossed.sum())
        early += int((crossed & (distance > PART * DT * np.abs(speed))).sum())
        surface.remove_small()
        renew(surface)
    return early / changed


def redistance(surface: LevelSet) -> None:
    surface.redistance()


def leave_psi(surface: LevelSet, flattest: float) -> None:
    """Redistance, but leave psi near the surface where it is at least ``flattest`` of the distance."""
    advanced = surface.psi.copy().ravel()
    surface.redistance()
    band = surface.band
    kept = advanced[band.cells]
    near = (np.abs(kept) <= NEAR) & (np.abs(kept) >= flattest * np.abs(band.psi))
    band.psi[near] = kept[near]
    surface.dense.psi[band.cells[near]] = kept[near]


@pytest.mark.parametrize("seed", range(3))
def test_cells_change_sides_where_the_surface_comes_by(seed: int) -> None:
    assert follow_noise(redistance, seed) < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_flat_psi_lets_cells_change_sides_too_early(seed: int) -> None:
    """That only flat psi does it: steep psi left alone beside cells that are redistanced does not."""
    assert follow_noise(lambda surface: leave_psi(surface, 0.0), seed) > 0.06
    assert follow_noise(lambda surface: leave_psi(surface, 0.8), seed) < 0.03
