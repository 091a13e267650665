"""Bases of the energies of an image, with the term of the area and with regions; and a given force field."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import sample_at_front
from accelsurf.energies.region_sums import Elsewhere, Interface, MomentTracker, RegionMoments
from accelsurf.levelset import BandChange, LevelSet


class AreaTerm:
    """The area term that energies contain: U = alpha A, f = alpha H (H > 0 on a sphere, which therefore shrinks).

    Parameters
    ----------
    alpha : float
        Weight, in units of the energy per mm2.
    """

    def __init__(self, alpha: float = 0.0) -> None:
        self.alpha = float(alpha)

    def value(self, area: np.ndarray) -> float:
        """Energy of the surface areas (mm2) of the band cells."""
        return self.alpha * float(area.sum()) if self.alpha else 0.0

    def add_force(self, force: np.ndarray, curvature: np.ndarray) -> None:
        """Add alpha H to ``force`` in place."""
        if self.alpha:
            force += np.float32(self.alpha) * curvature


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
        self._area = AreaTerm(alpha)

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


class RegionEnergy(ImageEnergy):
    """Base of energies of the sums over inside and outside, whose force is a polynomial of the image.

    A subclass gives `value` and `polynomial`. Parameters as of `ChanVese`.
    """

    def __init__(
        self,
        image: np.ndarray,
        alpha: float,
        epsilon: float,
        elsewhere: Elsewhere | None,
        whole: RegionMoments | None,
    ) -> None:
        super().__init__(image, alpha)
        self._interface, self._elsewhere = Interface(float(epsilon)), elsewhere
        self._all = whole or self.sums.whole_image()
        if elsewhere is not None:
            self._all = self._all.plus(elsewhere.all)

    def regions(
        self, surface: LevelSet, fraction: np.ndarray
    ) -> tuple[RegionMoments, RegionMoments]:
        """Sums over the inside and over the outside."""
        inside = self.sums.inside(surface, self._interface.fraction(surface, fraction))
        if self._elsewhere is not None:
            inside = inside.plus(self._elsewhere.inside)
        return inside, RegionMoments(*(a - b for a, b in zip(self._all, inside, strict=True)))

    @abstractmethod
    def polynomial(self) -> tuple[float, float, float]:
        """Factors a, b, c of the force a I^2 + b I + c without the area, after the last `value`."""

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front with the image at each cell's closest surface point, or across it."""
        force = self._interface.force(self.sums.image, surface, front, curvature, self.polynomial())
        self._area.add_force(force, curvature)
        return force


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

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self.sums.inside(surface, fraction).total * surface.voxel_volume + self._area.value(
            area
        )

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """The field at each front cell's closest surface point, plus alpha H."""
        force = sample_at_front(self.sums.image, surface, front)
        self._area.add_force(force, curvature)
        return force
