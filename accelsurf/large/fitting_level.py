"""The level of an image that is stored as a pyramid whose run fits into the memory; asked before a run is loaded."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from accelsurf.grid.geometry import Geometry
from accelsurf.io import open_channels, options_of
from accelsurf.run import run_bytes
from accelsurf.settings.run_config import RunConfig


@dataclass(frozen=True)
class FittingLevel:
    """A level that fits.

    Attributes
    ----------
    level : int
    levels : int
        How many there are.
    grid : Geometry
        Of the level.
    """

    level: int
    levels: int
    grid: Geometry

    @property
    def text(self) -> str:
        """A line about the level for the user."""
        size = " x ".join(map(str, self.grid.size))
        place = f"level {self.level} of 0 to {self.levels - 1}"
        return f"{place} is read, the finest that fits into the memory: {size} voxels"


def fitting_level(source: Path, config: RunConfig, allowed_bytes: int) -> FittingLevel | None:
    """Return the finest level whose run fits into the memory, else the coarsest; None for a file without levels.

    Parameters
    ----------
    source : Path
    config : RunConfig
        Of the run.
    allowed_bytes : int
        Memory that the run may take.

    Raises
    ------
    InputError
        When the image cannot be opened.
    """
    if "level" not in options_of(source):
        return None
    finest = open_channels(source, replace(config.reading, level=0))
    grids, channels = finest[0].layout.levels, len(finest) + len(config.channel)
    uses_model = config.energy.uses_model
    voxels = [channels * math.prod(grid.shape) for grid in grids]
    needed = [run_bytes(count, uses_model, config.flow.name) for count in voxels]
    level = next((n for n, size in enumerate(needed) if size <= allowed_bytes), len(grids) - 1)
    return FittingLevel(level, len(grids), grids[level])
