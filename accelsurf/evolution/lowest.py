"""The state of lowest potential: kept while the surface moves, and gone back to where the run would end above it."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from accelsurf.energies import Energy
from accelsurf.evolution.convergence import Reason
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

    def is_below(self, potential: float) -> bool:
        """Whether it is lower than ``potential``; lower than one that is not a number, too."""
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
    if before.complete:
        return before
    return before._replace(surface=complete_state(before.surface, surface), complete=True)


def decide(
    reason: Reason | None,
    lowest: LowestState | None,
    potential: float,
    surface: LevelSet,
    steps_since: int,
    returns: int,
    tolerance: float,
) -> Decision:
    """Whether to go back to the lowest state.

    Parameters
    ----------
    reason : (str, str) or None
        Why the run would end here; None while it goes on.
    lowest : LowestState or None
    potential : float
        Now.
    surface : LevelSet
        Now.
    steps_since : int
        Steps since the lowest state, or since it was last gone back to.
    returns : int
        How often that has been.
    tolerance : float
        Mean distance, voxels, up to which two surfaces are the same: the run then just ends at the lower one.
    """
    if lowest is None or not lowest.is_below(potential):
        return "stay"
    name = None if reason is None else reason[0]
    if name in ("vanished", "filled"):
        # Without the returns it stays so: what was left was smaller than the grid resolves.
        return "continue" if returns < MAX_RETURNS_IF_GONE else "stay"
    if name == "interrupted" or (name is None and (steps_since == 0 or steps_since % PATIENCE)):
        return "stay"
    if name in ("max-steps", "diverged"):
        return "continue" if name == "diverged" and returns < MAX_RETURNS else "end"
    away = surface.distance_from(lowest.snapshot).mean > tolerance
    if name is None:
        return "stay" if not away else "continue" if returns < MAX_RETURNS else "end"
    return "continue" if away and returns < MAX_RETURNS else "end"
