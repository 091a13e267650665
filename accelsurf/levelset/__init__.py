"""The surface on the grid: a narrow band of signed distance around the zero level of psi. Knows no image."""

from accelsurf.levelset.kept import KeptSurface, keep, restore
from accelsurf.levelset.levelset import FRONT_WIDTH, Change, LevelSet, Snapshot
from accelsurf.levelset.parallel import Workers, dot

__all__ = ["FRONT_WIDTH", "Change", "KeptSurface", "LevelSet", "Snapshot", "Workers", "dot", "keep", "restore"]
