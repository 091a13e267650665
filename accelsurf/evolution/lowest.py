"""The state of lowest potential: kept while the surface moves, and gone back to where the run would end above it."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from accelsurf.energies import Energy
from accelsurf.evolution.records import Reason
from accelsurf.evolution.state import LoopState, LowestState
from accelsurf.flows import Flow
from accelsurf.levelset import LevelSet, band_state, complete_state

#: A run goes back when this number of steps has found no lower potential and the surface has moved away since:
#: benchmarks/notes/steps-and-stop.md, "Lowest energy".
PATIENCE = 60
#: The same of a run that begins near its end and has found nothing lower than its start: it goes back there and ends.
PATIENCE_AT_START = 20
#: How often an evolution goes back and continues with shorter steps; once if the surface is gone, which is quick to
#: happen again. Then it ends. Selected, not measured.
MAX_RETURNS = 3
MAX_RETURNS_IF_GONE = 1
#: By which factor the CFL number of the following steps becomes smaller each time.
SHORTER = 0.5

#: Why a run ends that has gone back as often as it may.
NO_LOWER = "no lower energy was found in {} steps; the surface is the one with the lowest"

#: Actions at a step: stay with the present surface, go back and continue, or go back and end.
Decision = Literal["stay", "continue", "end"]


def lowest_of(
    before: LowestState | None,
    potential: float,
    step: int,
    surface: LevelSet,
    flow: Flow,
    energy: Energy,
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


def go_back(
    state: LoopState, n: int, area: np.ndarray, surface: LevelSet, flow: Flow, energy: Energy
) -> None:
    """Go back to the state of the lowest potential, at rest, before step ``n``; the steps from there are shorter."""
    assert state.lowest is not None
    before = state.potential + flow.energy(area)
    state.lowest.restore(surface, flow, energy)
    fraction, area = surface.fraction_and_area()
    flow.zero_momentum(area)
    state.record_return(energy.value(surface, fraction, area), n)
    if math.isfinite(before):
        state.budget.record_loss(before - state.potential - flow.energy(area))


def patience(state: LoopState, near_end: bool) -> int:
    """Return after how many steps without a lower potential a run goes back; ``near_end`` is where it began."""
    at_start = near_end and state.lowest is not None and state.lowest.step <= state.first
    return PATIENCE_AT_START if at_start else PATIENCE


def decide(
    reason: Reason | None,
    state: LoopState,
    surface: LevelSet,
    since: int,
    same: float,
    patient: int = PATIENCE,
) -> Decision:
    """Decide if the loop goes back to the lowest state.

    Parameters
    ----------
    reason : Reason or None
        Why the run would end here; None while it goes on.
    state : LoopState
        With the present potential.
    surface : LevelSet
        Now.
    since : int
        Steps since the lowest state, or since it was last gone back to.
    same : float
        Mean distance, voxels, up to which two surfaces count as the same: the run just ends at the lower one.
    patient : int
        From `patience`.
    """
    lowest, returns = state.lowest, state.returns
    if lowest is None or not lowest.is_below(state.potential):
        return "stay"
    name = None if reason is None else reason.name
    if name in ("vanished", "filled"):
        # If it happens again, the remainder there is smaller than the grid resolves.
        return "continue" if returns < MAX_RETURNS_IF_GONE else "stay"
    if name == "interrupted" or (name is None and (since == 0 or since % patient)):
        return "stay"
    if name == "max-steps":
        return "end"
    again: Decision = "continue" if returns < MAX_RETURNS and patient == PATIENCE else "end"
    if name == "diverged" or surface.distance_from(lowest.snapshot).mean > same:
        return again
    return "stay" if name is None else "end"
