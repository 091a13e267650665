"""The state of the loop as a value: copied for a checkpoint, passed on to the next grid."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from accelsurf.evolution.energy_budget import EnergyBudget
from accelsurf.evolution.lowest import LowestState
from accelsurf.evolution.records import StepFields, StepRecord, Stop, without_costs
from accelsurf.evolution.rests import RestWatch
from accelsurf.levelset import Snapshot, SurfaceState


@dataclass
class LoopState:
    """State of the loop between two steps.

    Attributes
    ----------
    history : list of StepRecord
        Every step so far, on all levels.
    time : float
        Flow time.
    potential : float
        U when it was last evaluated.
    gained_before : float
        Decrease of the potential on earlier grids and before edits.
    potential_before : float
        E on the grid before, to be compared with the first value here; NaN when there is nothing to compare.
    first, judged_at : int
        Number of the first step on this grid, and of the one at which convergence was last checked.
    snapshot : Snapshot or None
        The surface then.
    fields : StepFields or None
        What moved the surface last on this grid.
    edits : int
        Edits made since the last step.
    budget : EnergyBudget
    lowest : LowestState or None
        The state of lowest potential on this grid and under these settings.
    returns, returned_at : int
        How often the run went back to it here, and the number of the step before which it did last.
    earlier : Snapshot or None
        The surface at the check of convergence before ``snapshot``.
    moved : float
        Its mean distance from there to ``snapshot``, voxels; NaN if there was none.
    rests : RestWatch
        Where the front rested, and what is needed to find the next place.
    """

    history: list[StepRecord] = field(default_factory=list)
    time: float = 0.0
    potential: float = 0.0
    gained_before: float = 0.0
    potential_before: float = math.nan
    first: int = 0
    judged_at: int = 0
    snapshot: Snapshot | None = None
    fields: StepFields | None = None
    edits: int = 0
    budget: EnergyBudget = field(default_factory=EnergyBudget)
    lowest: LowestState | None = None
    returns: int = 0
    returned_at: int = 0
    earlier: Snapshot | None = None
    moved: float = math.nan
    rests: RestWatch = RestWatch()

    def copy(self) -> LoopState:
        """An independent copy; arrays and records are shared, as nothing writes to them."""
        other = copy.copy(self)
        other.history, other.budget = list(self.history), copy.copy(self.budget)
        return other

    @property
    def gained(self) -> float:
        """Decrease of the potential so far, over all grids."""
        here = self.history[self.first :]
        return self.gained_before + (max(here[0].potential - self.potential, 0.0) if here else 0.0)

    def on_next_grid(self, with_fields: bool) -> LoopState:
        """The state to continue from on another grid or under other settings.

        Parameters
        ----------
        with_fields : bool
            Whether momentum is transferred; then the energy budget is continued too.
        """
        count = len(self.history)
        following = LoopState(self.history, self.time, gained_before=self.gained, edits=self.edits)
        following.first = following.judged_at = following.returned_at = count
        following.rests = self.rests.on_next_grid()
        if with_fields:
            following.budget, following.potential_before = self.budget, self.potential
        return following


class Checkpoint(NamedTuple):
    """An evolution between two steps: the states of its four owners; see `Evolution.checkpoint`.

    ``stop`` is why it has ended: an object may have, while others go on.
    """

    level: int
    loop: LoopState
    surface: SurfaceState
    flow: dict[str, Any]
    energy: Any
    stop: Stop | None = None

    @property
    def without_costs(self) -> Checkpoint:
        """It as a file has it: without what the steps took."""
        return self._replace(loop=replace(self.loop, history=without_costs(self.loop.history)))

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes: without records, with arrays that checkpoints may share."""
        fields = sum(value.nbytes for value in self.flow.values() if isinstance(value, np.ndarray))
        acting = self.loop.fields
        shared = sum(12 * one.psi.size for one in (self.loop.snapshot, self.loop.earlier) if one)
        shared += 16 * acting.speed.size if acting else 0
        shared += self.loop.lowest.nbytes if self.loop.lowest is not None else 0
        shared += self.loop.rests.nbytes
        return self.surface.nbytes + fields + 8 * len(self.loop.history) + shared
