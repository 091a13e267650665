"""State of the loop as a value: copied for a checkpoint, passed on to the next grid.

It has the energy budget, the state of lowest potential, and the plateaus of the front.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from accelsurf.energies import Energy
from accelsurf.evolution.records import StepFields, StepRecord, Stop, without_costs
from accelsurf.flows import EnergyRates, Flow
from accelsurf.grid.boxes import Corner
from accelsurf.levelset import LevelSet, Snapshot, SurfaceState, restore_surface

#: Those columns of the trace that the flow's mass gives, and all that the budget gives.
MASS_COLUMNS = ("mass_potential", "mass", "mass_correction", "clamped_fraction")
COLUMNS = ("kinetic", "weight", "friction_work", "smoothing_work", "noise_work", *MASS_COLUMNS)


@dataclass
class EnergyBudget:
    """Adds up the energy rates of the steps, in the units of U.

    Rates are known at the times of the records, kicks happen around them: both are summed by the trapezoidal rule.

    Attributes
    ----------
    friction, smoothing, noise : float
        Work so far: taken by friction; taken by diffusion, limiter, restarts and changes; added by noise.
    last : EnergyRates
        Of the last step.
    last_dt : float
        Its length.
    """

    friction: float = 0.0
    smoothing: float = 0.0
    noise: float = 0.0
    last: EnergyRates = field(default_factory=EnergyRates)
    last_dt: float = 0.0

    def record_loss(self, energy: float) -> None:
        """A restart has taken the kinetic energy (as T/w), that of the velocity half a step before.

        Of the last kick the second half was not counted yet, nor friction since the record before.
        """
        last = self.last
        self.friction += 0.5 * self.last_dt * last.friction
        self.smoothing += energy + 0.5 * (last.smoothing - last.noise)
        self.last = last._replace(friction=0.0, smoothing=0.0, noise=0.0)

    def record_jump(self, energy: float) -> None:
        """E became less by ``energy`` at once: another grid, other settings, or another surface."""
        self.smoothing += energy

    def record_step(self, now: EnergyRates, dt: float) -> dict[str, Any]:
        """The columns of a record that begins with ``now`` and lasts ``dt``."""
        last = self.last
        at_its_end = now.friction if now.friction_before is None else now.friction_before
        self.friction += 0.5 * self.last_dt * (last.friction + at_its_end)
        self.smoothing += 0.5 * (last.smoothing + now.smoothing)
        self.noise += 0.5 * (last.noise + now.noise)
        self.last, self.last_dt = now, dt
        return {
            "kinetic": now.kinetic,
            "mass_potential": now.mass_potential,
            "weight": now.weight,
            "friction_work": self.friction,
            "smoothing_work": self.smoothing,
            "noise_work": self.noise,
            "mass": now.mass,
            "mass_correction": now.mass_correction,
            "clamped_fraction": now.clamped,
        }


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


class Slowest(NamedTuple):
    """A surface that hardly moves: the ``step``, the ``level``, its mean ``speed`` (at least 0) and ``volume_mm3``, the
    first voxel (z, y, x) of its box on the level's grid, the ``shape`` of that box, and the ``surface``; the sides of
    the voxels beyond its band are added one step later (``complete``).
    """

    step: int
    level: int
    speed: float
    volume_mm3: float
    corner: Corner
    shape: tuple[int, int, int]
    surface: SurfaceState
    complete: bool = False


class FoundPlateau(NamedTuple):
    """Plateau of the front: its ``step``, the ``level``, the ``volume_mm3`` then, the step ``left_at`` in which it was
    seen to break through, and the voxel ``place`` (z, y, x) of that level's grid in which it grew fastest then.
    """

    step: int
    level: int
    volume_mm3: float
    left_at: int
    place: Corner


class PlateauWatch(NamedTuple):
    """Plateaus found so far; a value, replaced at each step.

    ``peak`` speed of the front, mm per unit of flow time; ``slowest`` state since it fell below
    `accelsurf.evolution.plateaus.SLOW` of that; the plateaus ``found``, on all grids.
    """

    peak: float = 0.0
    slowest: Slowest | None = None
    found: tuple[FoundPlateau, ...] = ()

    def on_next_grid(self) -> PlateauWatch:
        """The watch on another grid; a state whose sides are not known yet is left behind."""
        return (
            self if self.slowest is None or self.slowest.complete else self._replace(slowest=None)
        )

    def anew(self) -> PlateauWatch:
        """The watch under other settings: it begins anew, and keeps the plateaus found."""
        return PlateauWatch(found=self.found)

    @property
    def nbytes(self) -> int:
        """Memory of the surface, bytes."""
        return 0 if self.slowest is None else self.slowest.surface.nbytes


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
        The fields that moved the surface last on this grid.
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
    plateaus : PlateauWatch
        Where the front was on a plateau, and the data to find the next place.
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
    plateaus: PlateauWatch = PlateauWatch()

    def copy(self) -> LoopState:
        """An independent copy; arrays and records are shared, as nothing writes to them."""
        return replace(self, history=list(self.history), budget=copy.copy(self.budget))

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
        state = LoopState(
            self.history,
            self.time,
            gained_before=self.gained,
            first=count,
            judged_at=count,
            returned_at=count,
            edits=self.edits,
            plateaus=self.plateaus.on_next_grid(),
        )
        return (
            replace(state, budget=self.budget, potential_before=self.potential)
            if with_fields
            else state
        )

    def after_edit(self, compares: bool) -> LoopState:
        """Return the state to continue from after an edit; ``compares``: the potentials before and after compare."""
        return replace(
            self.on_next_grid(with_fields=True),
            gained_before=self.gained if compares else 0.0,
            edits=self.edits + 1,
            fields=self.fields,
            plateaus=self.plateaus.anew(),
        )

    def record_potential(self, potential: float) -> None:
        """Record the present potential, the first one here beside that on the grid before."""
        if not math.isnan(self.potential_before):
            self.budget.record_jump(self.potential_before - potential)
            self.potential_before = math.nan
        self.potential = potential

    def expect(self, potential: float) -> None:
        """Record the potential before a change, to be compared with the first one after it."""
        self.potential_before = potential

    def record_check(self, snapshot: Snapshot, moved: float) -> None:
        """Record a check of convergence: the surface, and its mean distance from the one before."""
        self.earlier, self.snapshot, self.moved, self.judged_at = (
            self.snapshot,
            snapshot,
            moved,
            len(self.history),
        )

    def record_motion(self, fields: StepFields, dt: float) -> None:
        """Record a step of the surface."""
        self.fields, self.time = fields, self.time + dt

    def record_return(self, potential: float, step: int) -> None:
        """Record that the surface went back to that of the lowest potential before a step."""
        self.potential = potential
        self.returns = self.returns + 1
        self.returned_at = step
        self.judged_at = step
        self.snapshot = None
        self.earlier = None
        self.moved = math.nan
        self.fields = None

    def record_plateau(self, potential: float) -> None:
        """Record that the surface went back to where its front was on a plateau."""
        self.potential = potential


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
        """The checkpoint for a file: without the costs of the steps."""
        return self._replace(loop=replace(self.loop, history=without_costs(self.loop.history)))

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes: without records, with arrays that checkpoints may share."""
        fields = sum(value.nbytes for value in self.flow.values() if isinstance(value, np.ndarray))
        acting = self.loop.fields
        shared = sum(
            12 * snapshot.psi.size
            for snapshot in (self.loop.snapshot, self.loop.earlier)
            if snapshot
        )
        shared += 16 * acting.speed.size if acting else 0
        shared += self.loop.lowest.nbytes if self.loop.lowest is not None else 0
        shared += self.loop.plateaus.nbytes
        return self.surface.nbytes + fields + 8 * len(self.loop.history) + shared
