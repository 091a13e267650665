"""A given force field over space: U = int_inside f dx."""

from __future__ import annotations

import numpy as np

from accelsurf.energies.area import AreaTerm
from accelsurf.energies.base import RegionSums, sample_at_front
from accelsurf.levelset import Change, LevelSet


class RegionField:
    """U = int_inside f(x) dx + alpha A: the surface shrinks where f > 0 and grows where f < 0.

    The speed image of other programs, with its energy. Its force is the field itself.

    Parameters
    ----------
    field : ndarray (nz, ny, nx)
        f, in any unit.
    alpha : float
        Weight of the area, in the field's unit times mm.
    """

    def __init__(self, field: np.ndarray, alpha: float = 0.0) -> None:
        self._area = AreaTerm(alpha)
        self.alpha = self._area.alpha
        self._sums = RegionSums(field)

    def start(self, surface: LevelSet) -> None:
        """Sum the field over the first inside."""
        self._sums.start(surface)

    def follow(self, surface: LevelSet, change: Change) -> None:
        """Take up the cells that entered or left the band."""
        self._sums.follow(change)

    def value(self, surface: LevelSet, part: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self._sums.inside(surface, part).total * surface.voxel_volume + self._area.value(area)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """The field at each front cell's closest surface point, plus alpha H."""
        force = sample_at_front(self._sums.image, surface, front)
        self._area.add_force(force, curvature)
        return force
