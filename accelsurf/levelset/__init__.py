"""The surface on the grid: a narrow band of signed distance around the zero level of psi, without images."""

from accelsurf.levelset.checkpoint import SurfaceState, checkpoint_surface, restore_surface
from accelsurf.levelset.level_set import FRONT_WIDTH, NO_CELLS, LevelSet
from accelsurf.levelset.measures import FAR, BandChange, Motion, Snapshot
from accelsurf.levelset.threads import Workers, dot

__all__ = [
    "FAR",
    "FRONT_WIDTH",
    "NO_CELLS",
    "BandChange",
    "LevelSet",
    "Motion",
    "Snapshot",
    "SurfaceState",
    "Workers",
    "checkpoint_surface",
    "dot",
    "restore_surface",
]
