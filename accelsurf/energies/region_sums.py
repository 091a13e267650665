"""Sums of an image over the inside of the surface, and the interface at which inside and outside meet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.front_samples import check_shape, sample_at_front
from accelsurf.grid.boxes import sum_in_order
from accelsurf.kernels import motion, region
from accelsurf.levelset import BandChange, LevelSet

#: Sums (m,) over values that add up: the sums of two disjoint sets of voxels add up to the sums of both together.
Summing = Callable[[NDArray[np.float32]], NDArray[np.float64]]


class RegionMoments(NamedTuple):
    """Sums over voxels, weighted by their volume fraction: of 1, of the image, of its square."""

    voxels: float
    total: float
    squares: float

    def plus(self, other: RegionMoments) -> RegionMoments:
        """The sums over both of two regions that do not overlap."""
        return RegionMoments(*(a + b for a, b in zip(self, other, strict=True)))


def moments_of(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Number, sum and sum of squares of some values, (3,)."""
    exact = values.astype(np.float64)
    return np.array([exact.size, exact.sum(), (exact * exact).sum()])


def sums_by_plane(
    image: NDArray[np.float32], summing: Summing, where: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Sums (m,) of an image (nz, ny, nx), or of its voxels ``where``, plane after plane.

    The sums of some voxels have the same bytes on every box that contains them; of a whole image, also if it is read
    some planes at a time.
    """
    return sum_in_order(
        summing(plane.ravel() if where is None else plane[where[z]])
        for z, plane in enumerate(image)
    )


class Elsewhere(NamedTuple):
    """Sums over the part of the image that is not on the grid at hand: ``inside`` the object, and over ``all`` of it.

    `RegionMoments` for means and variances, histograms (BINS,) for densities. An energy of a box that gets them sees
    the whole object: its box is where the surface moves, and the rest stays as it is.
    """

    inside: Any
    all: Any


class MomentTracker:
    """Sums of an image over the inside of the surface, kept up to date in O(band).

    The inside voxels that are not in the band are summed once; after that only cells that enter or leave
    the band change that part. The band itself is summed in each step, each voxel by its fraction inside.

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
        self._beyond_band = surface.workers.plane_sums(
            region.inside_sums, surface.shape, 3, surface.dense, self.image, surface.grid
        )

    def follow(self, change: BandChange) -> None:
        """Update the sums by the cells that entered or left the band."""
        left, entered = (
            moments_of(self.image[cells]) for cells in (change.left_inside, change.entered_inside)
        )
        self._beyond_band = self._beyond_band + left - entered

    def state(self) -> np.ndarray:
        """The sums beyond the band, whose last digits depend on the steps before."""
        return self._beyond_band

    def restore(self, state: np.ndarray) -> None:
        """Set them."""
        self._beyond_band = state

    def inside(self, surface: LevelSet, fraction: np.ndarray) -> RegionMoments:
        """Sums over the inside of the surface, with the volume fraction of voxels that it cuts."""
        band = surface.workers.block_sums(
            region.weighted_sums, surface.size, 3, surface.band.cells, fraction, self.image
        )
        return RegionMoments(*(float(v) for v in self._beyond_band + band))

    def whole_image(self) -> RegionMoments:
        """Sums over the whole volume."""
        return RegionMoments(
            *(float(v) for v in sums_by_plane(self.image.reshape(self._shape), moments_of))
        )


class Interface(NamedTuple):
    """The interface between inside and outside: sharp (``epsilon`` 0), or smeared over +-``epsilon`` voxels.

    Sharp: voxels are cut by the surface and the image is read at it. Smeared: the regions overlap by the
    smeared Heaviside function, and the force is, as its derivative, the mean across the surface with the
    matching delta function; it follows single noisy voxels less.
    """

    epsilon: float = 0.0

    def fraction(self, surface: LevelSet, sharp: np.ndarray) -> np.ndarray:
        """Share (n,) of each band voxel that counts as inside; ``sharp`` (n,) from `LevelSet.fraction_and_area`."""
        if self.epsilon == 0:
            return sharp
        fraction = np.empty(surface.size)
        surface.workers.parallel(
            region.smear_band, surface.size, surface.grid, surface.band, self.epsilon, fraction
        )
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
            force = polynomial_of(value, polynomial)
            force[~front] = 0.0
            return force
        out = np.empty(surface.size, np.float32)
        surface.workers.parallel(
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


def polynomial_of(
    values: NDArray[np.float32], polynomial: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Return a I^2 + b I + c of values I, in their precision."""
    a, b, c = (np.float32(v) for v in polynomial)
    return np.asarray((a * values + b) * values + c)
