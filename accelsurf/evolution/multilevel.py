"""From coarse grids to the image's own: when a coarse level ends."""

from __future__ import annotations

import math
from typing import NamedTuple

from accelsurf.evolution.convergence import StopRule
from accelsurf.evolution.records import StopReason
from accelsurf.grid.pyramid import Level

#: Stop rule of a coarse level, looser because the next level continues from it, and without a forecast: window, motion
#: as a multiple of the finest level's, kinetic energy, and share of the surface that may still move further.
COARSE_WINDOW = 10
COARSE_MOTION = 2.0
COARSE_KINETIC = 0.05
COARSE_FAR = 0.01
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
