"""The surface on the grid: a narrow band of signed distance around the zero level of psi, without images."""

from accelsurf.levelset.checkpoint import SurfaceState, checkpoint_surface, restore_surface
from accelsurf.levelset.displacement import FAR, Snapshot
from accelsurf.levelset.extent import extent_of, inside_extent_of
from accelsurf.levelset.level_set import FRONT_WIDTH, NO_CELLS, LevelSet
from accelsurf.levelset.measures import BandChange
from accelsurf.levelset.threads import Workers, dot

__all__ = [
    "FAR",
    "FRONT_WIDTH",
    "NO_CELLS",
    "BandChange",
    "LevelSet",
    "Snapshot",
    "SurfaceState",
    "Workers",
    "checkpoint_surface",
    "dot",
    "extent_of",
    "inside_extent_of",
    "restore_surface",
]
