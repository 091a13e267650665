"""Chan-Vese: the image is one constant inside, another outside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.energies.image_energy import RegionEnergy
from accelsurf.energies.region_sums import Elsewhere, RegionMoments
from accelsurf.levelset import LevelSet


class TwoMeans(NamedTuple):
    """Means of the image inside and outside."""

    inside: float
    outside: float


class ChanVese(RegionEnergy):
    """U = l1 int_in (I - c1)^2 + l2 int_out (I - c2)^2 + alpha A, f = l1 (I - c1)^2 - l2 (I - c2)^2 + alpha H.

    The first variation of the paper's region energy for an inward normal. c1 and c2 are the means inside and
    outside, at each step those of the present surface (by the envelope theorem they add nothing to f).

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in that unit squared times mm3.
    alpha : float
        Weight of the area, in the image's unit squared times mm.
    means : TwoMeans, optional
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
        means: TwoMeans | None = None,
        epsilon: float = 0.0,
        balance: float = 1.0,
        elsewhere: Elsewhere | None = None,
        whole: RegionMoments | None = None,
    ) -> None:
        super().__init__(image, alpha, epsilon, elsewhere, whole)
        self._weights = (2.0 * balance / (1.0 + balance), 2.0 / (1.0 + balance))
        self._fixed = means
        self.means = means or TwoMeans(0.0, 0.0)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also sets `means` for the next `force`."""
        energy = 0.0
        means = []
        for i, sums in enumerate(self.regions(surface, fraction)):
            mean = self._fixed[i] if self._fixed else sums.total / sums.voxels if sums.voxels > 0 else 0.0
            means.append(mean)
            energy += self._weights[i] * (sums.squares - 2.0 * mean * sums.total + mean * mean * sums.voxels)
        self.means = TwoMeans(*means)
        return energy * surface.voxel_volume + self._area.value(area)

    def polynomial(self) -> tuple[float, float, float]:
        """Factors of the force, between the means of the last `value`."""
        (c1, c2), (l1, l2) = self.means, self._weights
        return l1 - l2, 2.0 * (l2 * c2 - l1 * c1), l1 * c1 * c1 - l2 * c2 * c2
