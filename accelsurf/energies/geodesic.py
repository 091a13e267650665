"""Geodesic active surfaces: the area, counted less where the image has edges."""

from __future__ import annotations

import numpy as np

from accelsurf.energies.front_samples import sample_at_front, slope_at_front
from accelsurf.energies.image_energy import AreaTerm, ImageEnergy
from accelsurf.errors import InputError
from accelsurf.levelset import LevelSet, dot

#: Automatic contrast: the gradient that counts as a strong edge (percentile of all voxels), the part of it that
#: counts as half an edge, and how far above the middle of all gradients, noise or texture, half an edge must be. Tried
#: on balls in noise, record 0017 and benchmarks/notes/flows.md.
_STRONG_PERCENTILE = 99.9
_STRONG_SHARE = 0.25
_ABOVE_NOISE = 2.0


class Geodesic(ImageEnergy):
    """U = int phi dA + c int_in phi dx + alpha A, f = phi H + grad phi . n + c phi + alpha H (n outward).

    The exact first variation: phi H acts as the area does, grad phi . n towards lower phi on either side of an edge.

    Parameters
    ----------
    phi : ndarray (nz, ny, nx)
        Weight of area at a voxel, above 0; `edge_indicator` makes it from an image. No unit, so U is in mm2.
    alpha : float
        Weight of area that edges do not lower: it limits the curvature of edges that the surface can follow. No unit.
    balloon : float
        c, per mm: above 0 the surface shrinks where there is no edge, below 0 it grows. It exceeds the area's own
        force on a ball of radius r mm when c < -2/r.

    Attributes
    ----------
    alpha : float
        max(phi) + alpha, the largest factor of H in the force. With the given alpha alone, 0 by default, the flows
        would step as if there were no curvature in the force, and be unstable.
    """

    def __init__(self, phi: np.ndarray, alpha: float = 0.0, balloon: float = 0.0) -> None:
        super().__init__(phi, float(np.max(phi)) + float(alpha))
        self._area = AreaTerm(alpha)
        self.balloon = float(balloon)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface: phi at the closest point of each voxel, times the area in it."""
        phi = sample_at_front(self.sums.image, surface, area > 0)
        energy = dot(phi, area) + self._area.value(area)
        if self.balloon:
            energy += (
                self.balloon * self.sums.inside(surface, fraction).total * surface.voxel_volume
            )
        return energy

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front, phi and its slope at each cell's closest surface point."""
        phi, slope = slope_at_front(self.sums.image, surface, front)
        force: np.ndarray = phi * (curvature + np.float32(self.balloon)) + slope
        self._area.add_force(force, curvature)
        return force


def edge_indicator(gradient: np.ndarray, contrast: float | None = None) -> np.ndarray:
    """Edge indicator phi = 1/(1 + (gradient/K)^2): 1 where an image is flat, near 0 on its edges.

    Parameters
    ----------
    gradient : ndarray (nz, ny, nx), float32
        Magnitude of the gradient of a smoothed image, per mm, as `accelsurf.image.smoothing.gradient_magnitude` has it.
    contrast : float, optional
        K, as the gradient. By default `edge_contrast` of it.

    Returns
    -------
    ndarray (nz, ny, nx), float32

    Raises
    ------
    InputError
        When all gradients are 0, so that there is no edge.

    Examples
    --------
    >>> import numpy as np
    >>> gradient = np.zeros((1, 9, 24), np.float32)
    >>> gradient[..., 11:13] = 0.5
    >>> phi = edge_indicator(gradient)
    >>> bool(phi[0, 4, 12] < 0.1), bool(phi[0, 4, 2] > 0.99)
    (True, True)
    """
    half = np.float32(edge_contrast(gradient) if contrast is None else contrast)
    return np.asarray(1.0 / (1.0 + (gradient / half) ** 2), np.float32)


def edge_contrast(gradient: np.ndarray) -> float:
    """Gradient K that counts as half an edge, from all gradients of an image.

    The larger of a quarter of the strongest edges (99.9th percentile) and twice the median. Most voxels are not on an
    edge, so the median is that of noise and texture: there phi stays at 0.8, and edges differ from it as much as
    possible. In a clean image the median is 0, and a quarter of the strongest edge makes phi 1/17 on it.

    Raises
    ------
    InputError
        When all gradients are 0.

    Examples
    --------
    >>> import numpy as np
    >>> edge_contrast(np.array([0.1] * 90 + [1.0] * 10)), edge_contrast(np.array([0.3] * 90 + [1.0] * 10))
    (0.25, 0.6)
    """
    strong = float(np.percentile(gradient, _STRONG_PERCENTILE)) or float(np.max(gradient))
    contrast = max(_STRONG_SHARE * strong, _ABOVE_NOISE * float(np.median(gradient)))
    if not contrast > 0:
        raise InputError(
            "the image has no edge at this scale: its gradient is 0", "take a smaller edge scale"
        )
    return contrast
