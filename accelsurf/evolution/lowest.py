"""The state of lowest potential: kept while the surface moves, and gone back to where the run would end above it."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from accelsurf.energies import Energy
from accelsurf.evolution.records import Reason
from accelsurf.flows import Flow
from accelsurf.levelset import LevelSet, Snapshot
from accelsurf.levelset.checkpoint import SurfaceState, band_state, complete_state, restore_surface

#: A run goes back when it has found no lower potential in so many steps and the surface has moved away since.
PATIENCE = 60
#: How often an evolution goes back and continues with shorter steps; once if the surface is gone, which is quick to
#: happen again. Then it ends.
MAX_RETURNS, MAX_RETURNS_IF_GONE = 3, 1
#: By which factor the CFL number of the following steps becomes smaller each time.
SHORTER = 0.5

#: Why a run ends that has gone back as often as it may.
NO_LOWER = "in {} steps no lower energy was found; the surface is that of the lowest"

#: What to do at a step: stay with the present surface, go back and continue, or go back and end.
Decision = Literal["stay", "continue", "end"]


class LowestState(NamedTuple):
    """The state of lowest potential so far, on one grid and under one energy.

    ``potential`` at step number ``step``; the states of ``surface``, ``flow`` and ``energy`` then. The sides of the
    voxels beyond the band are added when a step has not become lower (``complete``): most states of a falling
    potential are replaced by the next one before that.
    """

    potential: float
    step: int
    surface: SurfaceState
    flow: dict[str, Any]
    energy: Any
    complete: bool = False

    @property
    def snapshot(self) -> Snapshot:
        """The surface, for `LevelSet.distance_from`."""
        return Snapshot(self.surface.cells, self.surface.psi)

    @property
    def nbytes(self) -> int:
        """Its memory without the energy's, bytes."""
        fields = sum(value.nbytes for value in self.flow.values() if isinstance(value, np.ndarray))
        return self.surface.nbytes + fields

    def is_below(self, potential: float) -> bool:
        """Test if it is lower than ``potential``; lower than one that is not a number, too."""
        return not potential <= self.potential

    def restore(self, surface: LevelSet, flow: Flow, energy: Energy) -> None:
        """Set surface, flow and energy back to it."""
        restore_surface(surface, self.surface)
        flow.restore(surface, self.flow)
        energy.restore(surface, self.energy)


def lowest_of(
    before: LowestState | None, potential: float, step: int, surface: LevelSet, flow: Flow, energy: Energy
) -> LowestState:
    """The lowest of ``before`` and the present state; to be called at every step, as the band is kept by reference."""
    if before is None or potential < before.potential:
        return LowestState(potential, step, band_state(surface), flow.state(), energy.state())
    return completed(before, surface)


def completed(lowest: LowestState, surface: LevelSet) -> LowestState:
    """The lowest state with the sides beyond its band, not more than one step later."""
    if lowest.complete:
        return lowest
    return lowest._replace(surface=complete_state(lowest.surface, surface), complete=True)


def decide(
    reason: Reason | None,
    lowest: LowestState | None,
    returns: int,
    potential: float,
    surface: LevelSet,
    since: int,
    same: float,
) -> Decision:
    """Decide if the loop goes back to the lowest state.

    Parameters
    ----------
    reason : Reason or None
        Why the run would end here; None while it goes on.
    lowest : LowestState or None
    returns : int
        How often the run went back.
    potential : float
        The present one.
    surface : LevelSet
        The present one.
    since : int
        Steps since the lowest state, or since it was last gone back to.
    same : float
        Mean distance, voxels, up to which two surfaces count as the same: the run just ends at the lower one.
    """
    if lowest is None or not lowest.is_below(potential):
        return "stay"
    name = None if reason is None else reason.name
    if name in ("vanished", "filled"):
        # If it happens again, what is left there is smaller than the grid resolves.
        return "continue" if returns < MAX_RETURNS_IF_GONE else "stay"
    if name == "interrupted" or (name is None and (since == 0 or since % PATIENCE)):
        return "stay"
    if name == "max-steps":
        return "end"
    again: Decision = "continue" if returns < MAX_RETURNS else "end"
    if name == "diverged" or surface.distance_from(lowest.snapshot).mean > same:
        return again
    return "stay" if name is None else "end"
