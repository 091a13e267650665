"""From coarse grids to the image's own: when a coarse level ends, and how a surface is prolonged to the next."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution.convergence import StopRule
from accelsurf.evolution.records import StopReason
from accelsurf.flows import Flow
from accelsurf.grid.pyramid import Level
from accelsurf.levelset import LevelSet
from accelsurf.levelset.transfer import transfer_fields

#: Stop rule of a coarse level, looser because the next level continues from it, and without a forecast: window, motion
#: as a multiple of the finest level's, kinetic energy, and share of the surface that may still move further.
COARSE_WINDOW, COARSE_MOTION, COARSE_KINETIC, COARSE_FAR = 10, 2.0, 0.05, 0.01
#: Reasons to stop that leave no surface for the next level.
FAILED = ("vanished", "filled", "diverged")


class LevelSummary(NamedTuple):
    """Summary of a level: the grid, the ``steps`` made there, and why they ended (None: not yet)."""

    level: Level
    steps: int
    reason: StopReason | None


def rule_on_level(rule: StopRule | None, number: int) -> StopRule | None:
    """The stop rule on a level, ``rule`` being that of the finest one; None there runs to the last step."""
    if number == 0:
        return rule
    motion = StopRule().motion if rule is None else rule.motion
    return StopRule(COARSE_WINDOW, COARSE_MOTION * motion, COARSE_KINETIC, COARSE_FAR, math.inf)


def prolong_surface(
    psi: NDArray[np.float32], old: LevelSet, flow: Flow, coarse: Level, fine: Level, half_width: float
) -> tuple[LevelSet, list[NDArray[np.float32]]]:
    """A surface and its flow's fields on the next finer grid.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx), float32
        That of ``old``, prolonged to ``fine``; its memory is used.
    old : LevelSet
        On the grid ``coarse``.
    flow : Flow
        With its fields on the band of ``old``; what it has beyond them goes to ``fine``.
    coarse, fine : Level
        Those grids: whole levels, or the same box of both.
    half_width : float
        Of the new band, voxels.

    Returns
    -------
    surface : LevelSet
    fields : list of ndarray (n,)
    """
    surface = LevelSet(psi, fine.spacing, half_width, old.workers, overwrite=True, extension=old.extension)
    fields = transfer_fields(flow.fields, flow.fill_values, old.dense.slot, coarse, surface, fine)
    flow.change_grid(surface, fine.places_in(coarse))
    return surface, fields
