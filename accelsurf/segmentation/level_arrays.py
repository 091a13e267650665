"""Arrays of a run on every level of its pyramid, made when they are first needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.pyramid import Level, restrict


class LevelArrays:
    """One array on all levels, restricted from the finest.

    Parameters
    ----------
    finest : ndarray (nz, ny, nx), float32
    grids : sequence of Level
        Finest first.
    """

    def __init__(self, finest: NDArray[np.float32], grids: Sequence[Level]) -> None:
        self._arrays, self._grids = [finest], grids

    def on(self, level: int, box: Box) -> NDArray[np.float32]:
        """The array on a box of a level."""
        while len(self._arrays) <= level:
            n = len(self._arrays)
            self._arrays.append(restrict(self._arrays[-1], self._grids[n - 1], self._grids[n]))
        return np.ascontiguousarray(self._arrays[level][box])

    def release_coarser(self, level: int) -> None:
        """Release the arrays of coarser levels."""
        del self._arrays[level + 1 :]


class LevelInputs:
    """Image, further channels and mask on the levels of a run.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        Channels on the finest level.
    mask_distance : ndarray or None
        Signed distance of the mask there, mm, negative within.
    grids : sequence of Level
        Finest first.
    """

    def __init__(
        self, images: Sequence[NDArray[np.float32]], mask_distance: NDArray[np.float32] | None, grids: Sequence[Level]
    ) -> None:
        self.grids = tuple(grids)
        self._images = [LevelArrays(image, self.grids) for image in images]
        self._mask_distance = None if mask_distance is None else LevelArrays(mask_distance, self.grids)

    def images(self, level: int, box: Box) -> list[NDArray[np.float32]]:
        """The channels on a box of a level."""
        return [image.on(level, box) for image in self._images]

    def mask_distance(self, level: int, box: Box) -> NDArray[np.float32] | None:
        """The mask's distance on a box of a level; None without a mask."""
        return None if self._mask_distance is None else self._mask_distance.on(level, box)

    def release_coarser(self, level: int) -> None:
        """Release the arrays of levels coarser than ``level``."""
        for one in (*self._images, *([self._mask_distance] if self._mask_distance is not None else [])):
            one.release_coarser(level)
