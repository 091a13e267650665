"""The surface on the grid: a narrow band of signed distance around the zero level of psi. Knows no image."""

from accelsurf.levelset.checkpoint import KeptSurface, keep, restore
from accelsurf.levelset.level_set import FRONT_WIDTH, Change, LevelSet, Snapshot
from accelsurf.levelset.threads import Workers, dot

__all__ = ["FRONT_WIDTH", "Change", "KeptSurface", "LevelSet", "Snapshot", "Workers", "dot", "keep", "restore"]
