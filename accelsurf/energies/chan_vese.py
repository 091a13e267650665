"""Chan-Vese: the image is one constant inside, another outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.area import AreaTerm
from accelsurf.energies.image_energy import ImageEnergy
from accelsurf.energies.interface import Interface, polynomial_of
from accelsurf.energies.region_sums import Elsewhere, RegionMoments
from accelsurf.grid.boxes import Box
from accelsurf.levelset import LevelSet


class ChanVese(ImageEnergy):
    """U = l1 int_in (I - c1)^2 + l2 int_out (I - c2)^2 + alpha A, f = l1 (I - c1)^2 - l2 (I - c2)^2 + alpha H.

    The first variation of the paper's region energy for an inward normal. c1 and c2 are the means inside and
    outside, at each step those of the present surface (by the envelope theorem they add nothing to f).

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in that unit squared times mm3.
    alpha : float
        Weight of the area, in the image's unit squared times mm.
    means : (float, float), optional
        Fixed (c1, c2) instead of the surface's own.
    epsilon : float
        Half width of the smeared interface in voxels; 0 is sharp. See `Interface`.
    balance : float
        l1/l2, with l1 + l2 = 2: above 1 the inside must fit its mean more closely than the outside its own.
    elsewhere : Elsewhere, optional
        `RegionMoments` of the part of the object and of the image that are not on this grid; they count in the means.
    whole : RegionMoments, optional
        Of the whole image, where this grid is a window of it; by default those of ``image``.
    """

    def __init__(
        self,
        image: np.ndarray,
        alpha: float = 0.0,
        means: tuple[float, float] | None = None,
        epsilon: float = 0.0,
        balance: float = 1.0,
        elsewhere: Elsewhere | None = None,
        whole: RegionMoments | None = None,
    ) -> None:
        super().__init__(image, alpha)
        self._interface = Interface(float(epsilon))
        self._weights = (2.0 * balance / (1.0 + balance), 2.0 / (1.0 + balance))
        self._area = AreaTerm(alpha)
        self._fixed = means
        self._elsewhere = elsewhere
        self._all = whole or self.sums.whole_image()
        if elsewhere is not None:
            self._all = self._all.plus(elsewhere.all)
        self.means = means or (0.0, 0.0)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also sets `means` for the next `force`."""
        inside = self.sums.inside(surface, self._interface.fraction(surface, fraction))
        if self._elsewhere is not None:
            inside = inside.plus(self._elsewhere.inside)
        energy = 0.0
        means = []
        for i, sums in enumerate((inside, self._outside(inside))):
            mean = self._fixed[i] if self._fixed else sums.total / sums.voxels if sums.voxels > 0 else 0.0
            means.append(mean)
            energy += self._weights[i] * (sums.squares - 2.0 * mean * sums.total + mean * mean * sums.voxels)
        self.means = (means[0], means[1])
        return energy * surface.voxel_volume + self._area.value(area)

    def _outside(self, inside: RegionMoments) -> RegionMoments:
        return RegionMoments(*(a - b for a, b in zip(self._all, inside, strict=True)))

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front with the image at each cell's closest surface point, or across it."""
        force = self._interface.force(self.sums.image, surface, front, curvature, self._polynomial())
        self._area.add_force(force, curvature)
        return force

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The force of each voxel's own value, between the means of the last `value`."""
        return polynomial_of(self.sums.image.reshape(surface.shape)[box], self._polynomial())

    def _polynomial(self) -> tuple[float, float, float]:
        (c1, c2), (l1, l2) = self.means, self._weights
        return l1 - l2, 2.0 * (l2 * c2 - l1 * c1), l1 * c1 * c1 - l2 * c2 * c2
