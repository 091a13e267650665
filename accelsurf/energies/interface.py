"""The interface of the two regions: sharp or smeared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.front_samples import sample_at_front
from accelsurf.kernels import motion, region
from accelsurf.levelset import LevelSet


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
        surface.workers.parallel(region.smear_band, surface.size, surface.grid, surface.band, self.epsilon, fraction)
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


def polynomial_of(values: NDArray[np.float32], polynomial: tuple[float, float, float]) -> NDArray[np.float32]:
    """Return a I^2 + b I + c of values I, in their precision."""
    a, b, c = (np.float32(v) for v in polynomial)
    return np.asarray((a * values + b) * values + c)
