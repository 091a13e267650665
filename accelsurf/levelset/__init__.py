"""The surface on the grid: a narrow band of signed distance around the zero level of psi. Knows no image."""

from accelsurf.levelset.levelset import Change, LevelSet, Snapshot
from accelsurf.levelset.parallel import Workers

__all__ = ["Change", "LevelSet", "Snapshot", "Workers"]
