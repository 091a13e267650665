"""A given force field over space: U = int_inside f dx."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.area import AreaTerm
from accelsurf.energies.front_samples import sample_at_front
from accelsurf.energies.image_energy import ImageEnergy
from accelsurf.grid.boxes import Box
from accelsurf.levelset import LevelSet


class RegionField(ImageEnergy):
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
        super().__init__(field, alpha)
        self._area = AreaTerm(alpha)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self.sums.inside(surface, fraction).total * surface.voxel_volume + self._area.value(area)

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The field."""
        return np.array(self.sums.image.reshape(surface.shape)[box])

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """The field at each front cell's closest surface point, plus alpha H."""
        force = sample_at_front(self.sums.image, surface, front)
        self._area.add_force(force, curvature)
        return force
