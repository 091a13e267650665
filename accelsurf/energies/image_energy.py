"""Base of the energies of an image."""

from __future__ import annotations

from typing import Any

import numpy as np

from accelsurf.energies.energy import Energy
from accelsurf.energies.region_sums import MomentTracker
from accelsurf.levelset import BandChange, LevelSet


class ImageEnergy(Energy):
    """Base of energies of an image: has its sums over the inside, follows the band, has an area weight.

    A subclass gives `value` and `force`, see `Energy`.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        On the grid of the volume that is segmented; not modified.
    alpha : float
        Weight of the area, in units of the energy per mm2.

    Attributes
    ----------
    sums : MomentTracker
        ``sums.inside(surface, fraction)`` are the sums over the inside, in voxels: times ``surface.voxel_volume`` they
        are integrals. ``sums.image`` is the image, raveled, ready for `sample_at_front`.
    alpha : float
        As given. A subclass whose force has more than alpha times the curvature raises it, see `Energy`.
    """

    def __init__(self, image: np.ndarray, alpha: float = 0.0) -> None:
        self.sums = MomentTracker(image)
        self.alpha = float(alpha)

    def start(self, surface: LevelSet) -> None:
        """Sum the image over the first inside."""
        self.sums.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the sums by the cells that entered or left the band."""
        self.sums.follow(change)

    def state(self) -> Any:
        """Return the sums; a subclass with more state extends both methods."""
        return self.sums.state()

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        self.sums.restore(state)
