"""Base of an energy with a constraint on its surface, and the constraint that the surface stays within a mask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import sample_at_front
from accelsurf.flows import Flow
from accelsurf.grid.geometry import axis_steps
from accelsurf.levelset import BandChange, LevelSet

#: The surface touches the boundary of the mask when it is this close, voxels of the smallest spacing.
CONTACT_DISTANCE = 0.25


class ConstrainedEnergy(Energy):
    """Wraps an energy whose force is limited in places; everything else is that of the energy.

    A subclass gives `force`, and `project` if it bounds the surface.

    Parameters
    ----------
    energy : Energy
        The energy without the constraint.
    """

    def __init__(self, energy: Energy) -> None:
        self._energy = energy

    @property
    def unconstrained(self) -> Energy:
        """The energy without the constraint."""
        return self._energy

    @property
    def alpha(self) -> float:  # type: ignore[override]  # read only: it is the inner energy's
        """The energy's own."""
        return self._energy.alpha

    @property
    def held_cells(self) -> NDArray[np.int64]:
        """The energy's own."""
        return self._energy.held_cells

    def reaction(self, surface: LevelSet, flow: Flow) -> np.ndarray | None:
        """The energy's own."""
        return self._energy.reaction(surface, flow)

    @property
    def is_disturbed(self) -> bool:
        """The energy's own."""
        return self._energy.is_disturbed

    def start(self, surface: LevelSet) -> None:
        """Start the energy on a first surface."""
        self._energy.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the energy."""
        self._energy.follow(surface, change)

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Set the energy's time."""
        self._energy.set_time(surface, time)

    def project(self, surface: LevelSet) -> None:
        """Bring psi back to where the energy is finite."""
        self._energy.project(surface)

    def state(self) -> Any:
        """Return the energy's state."""
        return self._energy.state()

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        self._energy.restore(surface, state)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self._energy.value(surface, fraction, area)


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

    def project(self, surface: LevelSet) -> None:
        """Cut off the part that has crossed the boundary; between the surface's motion and its redistancing."""
        super().project(surface)
        cells = surface.band.cells
        surface.dense.psi[cells] = np.maximum(surface.dense.psi[cells], self._distance[cells])


def mask_distance(
    mask: NDArray[np.bool_], spacing: tuple[float, float, float]
) -> NDArray[np.float32]:
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
