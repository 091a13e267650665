"""Contact of several surfaces: where two meet, neither enters the other or displaces it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.constraints.mask import ConstrainedEnergy
from accelsurf.energies.energy import Energy
from accelsurf.flows import Flow
from accelsurf.grid.boxes import Corner
from accelsurf.kernels.components import shared_cells, touching
from accelsurf.levelset import FRONT_WIDTH, LevelSet

#: Contact sets in at this distance, voxels of the smallest spacing, and grows until the surfaces touch.
_CONTACT_RANGE = 1.0


class Neighbour(NamedTuple):
    """Another object: its ``surface``, where its grid begins in the common one, its energy and its flow."""

    surface: LevelSet
    corner: Corner
    energy: NonOverlap
    flow: Flow


class Contact(NamedTuple):
    """Contact with a neighbour: ``near`` (m,) indices of the points; the neighbour's ``cells`` and ``slots``
    there; ``share`` (m,), 1 where the two touch and 0 from `_CONTACT_RANGE` on.
    """

    other: Neighbour
    near: NDArray[np.intp]
    cells: NDArray[np.int64]
    slots: NDArray[np.int32]
    share: NDArray[np.float32]


class NonOverlap(ConstrainedEnergy):
    """An energy of one object among others, under the condition that no two overlap.

    Where surfaces i and j touch, i's force becomes max(f_i, -max(f_j, 0)): the contact reaction stops it where both
    would grow, and lets it follow where j shrinks. Then neither can lower its own energy alone. (The mean of both
    forces would minimise U_i + U_j, and reach no equilibrium between similar objects: the smallest difference
    of their models lets one take the other's volume.) Normal velocities meet in the same way, as in an inelastic
    collision. Contact sets in over the last voxel between the two; surfaces that separate do not act on each other.
    After each motion psi_i is at least (psi_i - psi_j)/2: a voxel in both goes to the one in which it is deeper.

    Parameters
    ----------
    energy : Energy
        The object's own.
    corner : (z, y, x)
        First voxel of the object's grid in the grid that all objects share.

    Attributes
    ----------
    neighbours : sequence of Neighbour
        Set by the run of the objects; they do not move while this one does.
    """

    def __init__(self, energy: Energy, corner: Corner) -> None:
        super().__init__(energy)
        self._corner = corner
        self.neighbours: Sequence[Neighbour] = ()
        # Raster order in the object's grid; only of the front.
        self._cells, self._forces = np.empty(0, np.int64), np.empty(0, np.float32)

    def set_neighbours(self, neighbours: Sequence[Neighbour]) -> None:
        """Have other neighbours from now on."""
        self.neighbours = neighbours

    @property
    def is_disturbed(self) -> bool:
        """Test if there are neighbours, which may push the surface, or lie where it was before."""
        return len(self.neighbours) > 0 or super().is_disturbed

    def state(self) -> Any:
        """The energy's own state, and the forces of the last step, which neighbours read."""
        return self._energy.state(), self._cells, self._forces

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        inner, self._cells, self._forces = state
        self._energy.restore(surface, inner)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front, with the reaction of neighbours that do not shrink."""
        force = np.asarray(self._energy.force(surface, front, curvature), np.float32)
        self._cells, self._forces = surface.band.cells[front], force[front]
        front_slots = np.flatnonzero(front)
        reaction = np.zeros(front_slots.size, np.float32)
        for touch in self._contacts(surface, front_slots):
            theirs = touch.other.energy.force_in(touch.cells)
            stopped = _contact_reaction(force[front_slots[touch.near]], theirs, touch.share)
            reaction[touch.near] = np.maximum(reaction[touch.near], stopped)
        force[front_slots] += reaction
        return force

    def _contacts(self, surface: LevelSet, front_slots: NDArray[np.intp]) -> Iterator[Contact]:
        """Find the contacts of the surface, at ``front_slots`` of its band, with each neighbour."""
        if not self.neighbours:
            return
        steps = np.array([surface.grid.hz, surface.grid.hy, surface.grid.hx])
        cells = surface.band.cells[front_slots]
        index = np.stack(np.unravel_index(cells, surface.shape), axis=1) + np.array(self._corner)
        points = index + np.where(
            np.array(surface.shape) > 1, surface.band.to_closest[front_slots] / steps, 0.0
        )
        width = _CONTACT_RANGE * float(steps.min())
        for other in self.neighbours:
            theirs = other.surface
            # Closest points of cells at the volume's border may lie beyond it: then the border's own voxels are read.
            found = touching(
                points, theirs.dense, theirs.grid, np.array(other.corner, float), FRONT_WIDTH, width
            )
            near, slots, share = found
            if near.size:
                yield Contact(other, near, theirs.band.cells[slots], slots, share)

    def force_in(self, cells: NDArray[np.int64]) -> NDArray[np.float32]:
        """The object's own force at some cells of its grid in its last step, 0 away from its front."""
        if self._cells.size == 0:
            return np.zeros(cells.size, np.float32)
        at = np.minimum(np.searchsorted(self._cells, cells), self._cells.size - 1)
        return np.where(self._cells[at] == cells, self._forces[at], np.float32(0.0))

    def react_to_contact(self, surface: LevelSet, flow: Flow) -> None:
        """Change the surface's velocity by the reaction of its neighbours; after its motion."""
        if not self.neighbours or surface.size == 0:
            return
        speed, front = np.asarray(flow.normal_velocity(surface), np.float32), surface.front()
        front_slots = np.flatnonzero(front)
        mine, grows = speed[front_slots], self.force_in(surface.band.cells[front_slots]) < 0
        stopped, slowed = (
            np.zeros(front_slots.size, np.float32),
            np.zeros(front_slots.size, np.float32),
        )
        for other, near, cells, slots, share in self._contacts(surface, front_slots):
            theirs = other.flow.normal_velocity(other.surface)[slots]
            stopped[near] = np.maximum(stopped[near], _contact_reaction(mine[near], theirs, share))
            both = grows[near] & (other.energy.force_in(cells) < 0)
            slowed[near] = np.minimum(
                slowed[near], np.where(both, -share * np.maximum(mine[near], 0.0), 0.0)
            )
        reaction = np.zeros(surface.size, np.float32)
        reaction[front_slots] = stopped + slowed
        if reaction.any():
            surface.extend_outwards(reaction, front)
            flow.add_velocity(surface, reaction)

    def project(self, surface: LevelSet) -> None:
        """Cut the surface where it overlaps neighbours; between its motion and its redistancing."""
        super().project(surface)
        for other in self.neighbours:
            on, theirs = self._shared(surface, other)
            cells = surface.band.cells[on]
            mine = surface.dense.psi[cells]
            surface.dense.psi[cells] = np.maximum(mine, np.float32(0.5) * (mine - theirs))

    def _shared(
        self, surface: LevelSet, other: Neighbour
    ) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """Slots of the band cells that lie on a neighbour's grid too, and the neighbour's psi there, mm."""
        shift = np.array(self._corner, np.int64) - np.array(other.corner, np.int64)
        theirs = other.surface
        return shared_cells(surface.band.cells, surface.grid, theirs.dense.psi, theirs.grid, shift)

    def overlap(self, surface: LevelSet) -> float:
        """Largest depth, mm, of neighbours inside the surface, measured within a voxel of it; 0 if none is inside."""
        deepest, on_surface = 0.0, surface.front(1.0)
        for other in self.neighbours:
            on, theirs = self._shared(surface, other)
            near = on_surface[on]
            if near.any():
                deepest = max(deepest, -float((surface.band.psi[on] + theirs)[near].min()))
        return deepest


def _contact_reaction(
    mine: NDArray[np.float32], theirs: NDArray[np.float32], share: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The change of a quantity along the inward normal to max(mine, -max(theirs, 0)), weighted by ``share``."""
    return np.asarray(-share * np.minimum(mine + np.maximum(theirs, 0.0), 0.0))
