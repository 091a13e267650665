"""The protocol that every energy follows, and the region sums that most of them need."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.front_samples import check_shape, sample_at_front
from accelsurf.kernels import motion, region
from accelsurf.kernels.grid import BLOCK
from accelsurf.levelset import Change, LevelSet, dot


class Energy(Protocol):
    """What the loop asks of an energy.

    The loop calls `start` once; then, in each step, `value`, `force` and, with the surface moved, `follow`. What
    `value` found out about the surface may be kept for the `force` that comes after it.

    An energy that carries something from step to step may have two more methods, as `ImageEnergy` has: ``state()``
    returns it (and must not change it later), ``restore(surface, state)`` takes it back. Where they are missing, a run
    that goes back to a state calls `start` there.

    Attributes
    ----------
    alpha : float
        The largest factor of the curvature H in the force (0 when there is none): the weight of the surface's area.
        The time step is bounded by it.
    """

    @property
    def alpha(self) -> float:
        """Largest factor of the curvature in the force; a plain attribute will do."""
        ...

    def start(self, surface: LevelSet) -> None:
        """Take up a surface: full sums, once."""
        ...

    def follow(self, surface: LevelSet, change: Change) -> None:
        """Take up what the last redistancing changed, in O(band)."""
        ...

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U for the present surface; ``fraction`` and ``area`` (n,) are `LevelSet.fraction_and_area`'s."""
        ...

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front: dU = -int f (dS.N) dA with N inward, so f > 0 shrinks."""
        ...


class RegionMoments(NamedTuple):
    """Sums over voxels, each by the share of it that counts: of 1, of the image, of its square."""

    voxels: float
    total: float
    squares: float


class RegionSums:
    """Sums of an image over the inside of the surface, kept up to date in O(band).

    The inside voxels that are not in the band are summed once; after that only cells that enter or leave
    the band change that part. The band itself is summed afresh, each voxel by its share inside.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
        Not modified.

    Attributes
    ----------
    image : ndarray (nz * ny * nx,), float32
        The image, raveled.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._shape = np.shape(image)
        self.image = np.ascontiguousarray(image, dtype=np.float32).ravel()
        self._beyond_band = np.zeros(3)

    def start(self, surface: LevelSet) -> None:
        """Sum the inside voxels that are not in the band.

        Raises
        ------
        InputError
            When the image is not on the surface's grid.
        """
        check_shape(self._shape, surface)
        self._beyond_band = surface.workers.sums(
            region.inside_sums, self.image.size, 3, surface.dense, self.image
        )

    def follow(self, change: Change) -> None:
        """Move the cells that entered or left the band to the right side of the account."""
        self._beyond_band = (
            self._beyond_band + self._plain_sums(change.left_inside) - self._plain_sums(change.entered_inside)
        )

    def state(self) -> np.ndarray:
        """The sums beyond the band, which depend on the way here in their last digits."""
        return self._beyond_band

    def restore(self, kept: np.ndarray) -> None:
        """Take them back."""
        self._beyond_band = kept

    def inside(self, surface: LevelSet, fraction: np.ndarray) -> RegionMoments:
        """Sums over the inside of the surface, voxels cut by it counted in part."""
        band = surface.workers.sums(
            region.weighted_sums, surface.size, 3, surface.band.cells, fraction, self.image
        )
        return RegionMoments(*(float(v) for v in self._beyond_band + band))

    def whole_image(self) -> RegionMoments:
        """Sums over the whole volume."""
        sums = [self._plain_sums(slice(i, i + 1024 * BLOCK)) for i in range(0, self.image.size, 1024 * BLOCK)]
        return RegionMoments(*(float(v) for v in np.sum(sums, axis=0)))

    def _plain_sums(self, cells: NDArray[np.int64] | slice) -> np.ndarray:
        values = self.image[cells].astype(np.float64)
        return np.array([values.size, values.sum(), dot(values, values)])


class ImageEnergy(ABC):
    """Base of energies of an image: has its sums over the inside, follows the band, carries the area weight.

    A subclass gives `value` and `force`, as `Energy` says them.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        On the grid of the volume that is segmented; not modified.
    alpha : float
        Weight of the area, in units of the energy per mm2.

    Attributes
    ----------
    sums : RegionSums
        ``sums.inside(surface, fraction)`` are the sums over the inside, in voxels: times ``surface.voxel_volume`` they
        are integrals. ``sums.image`` is the image, raveled, ready for `sample_at_front`.
    alpha : float
        As given. A subclass whose force has more than alpha times the curvature raises it, see `Energy`.
    """

    def __init__(self, image: np.ndarray, alpha: float = 0.0) -> None:
        self.sums = RegionSums(image)
        self.alpha = float(alpha)

    def start(self, surface: LevelSet) -> None:
        """Sum the image over the first inside."""
        self.sums.start(surface)

    def follow(self, surface: LevelSet, change: Change) -> None:
        """Take up the cells that entered or left the band."""
        self.sums.follow(change)

    def state(self) -> Any:
        """What is carried from step to step; a subclass that carries more than the sums extends both methods."""
        return self.sums.state()

    def restore(self, surface: LevelSet, kept: Any) -> None:
        """Go on, on this surface, from what was ``state`` on it."""
        self.sums.restore(kept)

    @abstractmethod
    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U for the present surface."""

    @abstractmethod
    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front."""


class Interface(NamedTuple):
    """How the energy sees the surface: sharp (``epsilon`` 0), or smeared over +-``epsilon`` voxels.

    Sharp: voxels are cut by the surface and the image is read at it. Smeared: the regions overlap by the
    smeared Heaviside function, and the force is, as its derivative, the mean across the surface with the
    matching delta function; it follows single noisy voxels less.
    """

    epsilon: float = 0.0

    def fraction(self, surface: LevelSet, cut: np.ndarray) -> np.ndarray:
        """Share (n,) of each band voxel that counts as inside; ``fraction_and_area`` are the sharp ones."""
        if self.epsilon == 0:
            return cut
        fraction = np.empty(surface.size)
        surface.workers.run(region.smear_band, surface.size, surface.grid, surface.band, self.epsilon, fraction)
        return fraction

    def force(
        self,
        image: np.ndarray,
        surface: LevelSet,
        front: np.ndarray,
        curvature: np.ndarray,
        polynomial: tuple[float, float, float],
    ) -> np.ndarray:
        """Values (n,) of a I^2 + b I + c at the surface for every front cell, 0 elsewhere; I raveled float32."""
        if self.epsilon == 0:
            value = sample_at_front(image, surface, front)
            a, b, c = (np.float32(v) for v in polynomial)
            return np.where(front, (a * value + b) * value + c, np.float32(0.0))
        out = np.empty(surface.size, np.float32)
        surface.workers.run(
            motion.mean_across,
            surface.size,
            surface.dense.psi,
            image,
            surface.band,
            front,
            (surface.grid, self.epsilon, polynomial, curvature),
            out,
        )
        return out


class ConstrainedEnergy:
    """Base of an energy whose force is held back in places; all else is the energy's own.

    A subclass gives `force`, as `Energy` says it.

    Parameters
    ----------
    energy : Energy
        What pulls the surface where nothing holds it.
    """

    def __init__(self, energy: Energy) -> None:
        self._energy = energy

    @property
    def alpha(self) -> float:
        """The energy's own."""
        return self._energy.alpha

    def start(self, surface: LevelSet) -> None:
        """Take up a surface."""
        self._energy.start(surface)

    def follow(self, surface: LevelSet, change: Change) -> None:
        """Take up what changed."""
        self._energy.follow(surface, change)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self._energy.value(surface, fraction, area)
