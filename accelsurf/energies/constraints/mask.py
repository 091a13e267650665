"""An energy that is infinite outside of a mask: its surface never leaves it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.constraints.constrained import ConstrainedEnergy
from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import sample_at_front
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import axis_steps
from accelsurf.levelset import LevelSet

#: The surface touches the boundary of the mask when it is this close, voxels of the smallest spacing.
CONTACT_DISTANCE = 0.25


class MaskConstraint(ConstrainedEnergy):
    """An energy that is infinite beyond a mask: `project` cuts the surface there, and no force acts across it.

    Parameters
    ----------
    energy : Energy
        The energy within the mask.
    distance : ndarray (nz, ny, nx), float32
        Signed distance to the boundary of the mask, mm, negative within; from `mask_distance`, on the energy's grid.
    """

    def __init__(self, energy: Energy, distance: NDArray[np.float32]) -> None:
        super().__init__(energy)
        self._distance = np.ascontiguousarray(distance, np.float32).reshape(-1)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front; 0 where the surface touches the boundary and would grow."""
        force = self._energy.force(surface, front, curvature)
        near = -CONTACT_DISTANCE * min(surface.grid.hz, surface.grid.hy, surface.grid.hx)
        stopped = front & (sample_at_front(self._distance, surface, front) > near) & (force < 0)
        return np.where(stopped, np.float32(0.0), force)

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The energy's own within the mask; NaN beyond it, where the surface never is."""
        force = super().image_force(surface, box)
        beyond = self._distance.reshape(surface.shape)[box] > 0
        return None if force is None else np.where(beyond, np.float32(np.nan), force)

    def project(self, surface: LevelSet) -> None:
        """Cut off what has crossed the boundary; between the surface's motion and its redistancing."""
        super().project(surface)
        cells = surface.band.cells
        surface.dense.psi[cells] = np.maximum(surface.dense.psi[cells], self._distance[cells])


def mask_distance(mask: NDArray[np.bool_], spacing: tuple[float, float, float]) -> NDArray[np.float32]:
    """Signed distance (mm) to the boundary of a mask, negative within it, half a voxel from the centres next to it.

    Examples
    --------
    >>> mask_distance(np.array([[[False, True, True, False]]]), (1.0, 1.0, 2.0))
    array([[[ 1., -1., -1.,  1.]]], dtype=float32)
    """
    half = np.float32(0.5 * min(axis_steps(mask.shape, spacing)))
    distance = np.where(
        mask,
        half - ndimage.distance_transform_edt(mask, spacing) if not mask.all() else -1e6,
        ndimage.distance_transform_edt(~mask, spacing) - half,
    )
    return np.asarray(distance, np.float32)
