"""An energy that is infinite where a clicked voxel is not on its side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.constraints.mask import ConstrainedEnergy
from accelsurf.energies.energy import Energy
from accelsurf.flows import Flow
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.levelset import LevelSet

#: The surface touches a click when psi is this close to its bound, voxels of the smallest spacing.
CONTACT_DISTANCE = 0.25


class ClickConstraint(ConstrainedEnergy):
    """An energy that is infinite beyond the bounds of clicks.

    Psi lies between -d_outside and d_inside, the signed distances to the clicked voxels: `project` puts it there. Where
    the surface touches a click, no force and no momentum acts into it: f and beta along N become min(., 0) at an inside
    click and max(., 0) at an outside one, as in an inelastic collision.

    Parameters
    ----------
    energy : Energy
        The energy without clicks.
    bounds : ClickBounds
        On the energy's grid.
    """

    def __init__(self, energy: Energy, bounds: ClickBounds) -> None:
        super().__init__(energy)
        self.bounds, self._held_cells = bounds, bounds.held

    @property
    def held_cells(self) -> NDArray[np.int64]:
        """The clicked cells."""
        return self._held_cells

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front; 0 where the surface touches a click and would move into it."""
        force = np.array(self._energy.force(surface, front, curvature), np.float32)
        slots, keeps_in, keeps_out = self.touched_slots(surface)
        force[slots] = _held(force[slots], keeps_in, keeps_out)
        return force

    def reaction(self, surface: LevelSet, flow: Flow) -> np.ndarray | None:
        """The change (n,) of the normal velocity that stops it where the surface touches a click."""
        inner = self._energy.reaction(surface, flow)
        slots, keeps_in, keeps_out = self.touched_slots(surface)
        front = surface.front()
        on = front[slots]
        if not on.any():
            return inner
        slots = slots[on]
        keeps_in = keeps_in[on]
        keeps_out = keeps_out[on]
        speed = np.asarray(flow.normal_velocity(surface), np.float32)
        change = np.zeros(surface.size, np.float32) if inner is None else inner
        now = (speed + change)[slots]
        added = np.zeros(surface.size, np.float32)
        added[slots] = _held(now, keeps_in, keeps_out) - now
        if not added.any():
            return inner
        surface.extend_outwards(added, front)
        return change + added

    def touched_slots(self, surface: LevelSet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slots where the surface touches a click, and whether it may not shrink there, and not grow."""
        bounds, near = self.bounds, np.float32(CONTACT_DISTANCE * surface.smallest_spacing)
        slots = surface.dense.slot[bounds.cells]
        known = slots >= 0
        psi = surface.dense.psi[bounds.cells]
        keeps_in, keeps_out = known & (psi > bounds.high - near), known & (psi < bounds.low + near)
        touched = keeps_in | keeps_out
        return slots[touched], keeps_in[touched], keeps_out[touched]

    def project(self, surface: LevelSet) -> None:
        """Bring psi within the bounds; between the surface's motion and its redistancing."""
        super().project(surface)
        bounds, psi = self.bounds, surface.dense.psi
        known = surface.dense.slot[bounds.cells] >= 0
        cells = bounds.cells[known]
        psi[cells] = np.minimum(np.maximum(psi[cells], bounds.low[known]), bounds.high[known])


def without_clicks(energy: Energy) -> Energy:
    """The energy that clicks constrain, without other constraints around both; without clicks the energy itself.

    Parameters
    ----------
    energy : Energy
    """
    inner = energy
    while isinstance(inner, ConstrainedEnergy):
        inner, clicked = inner.unconstrained, isinstance(inner, ClickConstraint)
        if clicked:
            return inner
    return energy


def _held(along: np.ndarray, keeps_in: np.ndarray, keeps_out: np.ndarray) -> np.ndarray:
    """A quantity along the inward normal without its part into the clicks."""
    along = np.where(keeps_in, np.minimum(along, np.float32(0.0)), along)
    return np.where(keeps_out, np.maximum(along, np.float32(0.0)), along)
