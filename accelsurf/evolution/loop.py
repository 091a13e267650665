"""The loop: one step after another, each yielded with its effect, until a named reason to stop."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from accelsurf.energies import Energy
from accelsurf.evolution import lowest, plateaus
from accelsurf.evolution.convergence import stalled, surface_is_gone
from accelsurf.evolution.records import Reason, Step, StepFields, StepRecord, Stop, StopReason
from accelsurf.evolution.setup import SolverSetup
from accelsurf.evolution.state import COLUMNS, MASS_COLUMNS, Checkpoint, LoopState, Slowest
from accelsurf.flows import Flow, StepInput, StepLimits, StepPlan, voxel_rates
from accelsurf.grid.boxes import Corner
from accelsurf.grid.pyramid import Level
from accelsurf.levelset import (
    LevelSet,
    Motion,
    checkpoint_surface,
    restore_surface,
    transfer_fields,
)


class Evolution:
    """Evolves a surface; iterate over it to run, one `Step` at a time.

    Parameters
    ----------
    surface : LevelSet
        The first surface; moved in place.
    energy : Energy
    setup : SolverSetup
        The flow and the settings of steps, restarts and stop; without a stop rule it runs to ``max_steps``.
    max_steps : int
    level : int
        The grid's level, for the history. A level above 0 has no last record without motion: the surface continues on
        the next level, whose first record has its state.
    state : LoopState, optional
        State to continue from, of an evolution on another grid or under other settings (`LoopState.on_next_grid`).
    fields : list of ndarray (n,), optional
        The flow's fields on this band; without them the flow starts with zero momentum.
    corner : (z, y, x), optional
        First voxel of the surface's box on the level's grid.

    Attributes
    ----------
    state : LoopState
    stop : Stop or None
        Set when the iteration has ended.

    Notes
    -----
    The iteration can be abandoned at any time; the surface is always a valid one between two Steps.
    """

    def __init__(
        self,
        surface: LevelSet,
        energy: Energy,
        setup: SolverSetup,
        max_steps: int = 1000,
        level: int = 0,
        state: LoopState | None = None,
        fields: list[np.ndarray] | None = None,
        corner: Corner = (0, 0, 0),
    ) -> None:
        self.surface = surface
        self.energy = energy
        self.setup = setup
        self.max_steps = max_steps
        self.level = level
        self.state = state or LoopState()
        self.stop: Stop | None = None
        self._corner = corner
        self._stop_requested = False
        self._fields = fields
        self._initialized = False

    @property
    def flow(self) -> Flow:
        """The flow that moves the surface."""
        return self.setup.flow

    def use(self, setup: SolverSetup, energy: Energy | None = None) -> None:
        """Have other solver settings, and another energy unless it is None."""
        self.setup = setup
        self.energy = energy or self.energy

    def extend(self, max_steps: int) -> None:
        """Set the limit of the steps."""
        self.max_steps = max_steps

    @property
    def history(self) -> list[StepRecord]:
        """Every step so far, on all levels."""
        return self.state.history

    def request_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._stop_requested = True

    def measure(self) -> None:
        """Evaluate the potential of the present surface, so that an evolution on another grid can continue from it."""
        self.state.potential = self.energy.value(self.surface, *self.surface.fraction_and_area())

    def zero_momentum(self) -> None:
        """Set the momentum to zero, as a restart does; the energy budget records the loss."""
        self.state.budget.record_loss(self.flow.zero_momentum(self.surface.fraction_and_area()[1]))

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface."""
        while (step := self.step()) is not None:
            yield step

    def initialize(self) -> None:
        """Start energy and flow, unless that has been done; the first step does it too."""
        if self._initialized:
            return
        self._initialized = True
        self.energy.start(self.surface)
        if self._fields is None:
            self.flow.start(self.surface)
        else:
            self.flow.set_fields(self._fields)
            self._fields = None

    def step(self) -> Step | None:
        """Make one step; None when the evolution has ended.

        The last step moves nothing: its record is the final state.
        """
        if self.stop is not None:
            return None
        self.initialize()
        record = self._step(len(self.history))._replace(edits=self.state.edits)
        if self._leaves_level():
            return None
        self.state.edits = 0
        self.history.append(record)
        return Step(record, self.surface, self.state.fields)

    def _leaves_level(self) -> bool:
        """Test if this coarse level has ended: the next one begins with the record of its final state."""
        return self.stop is not None and self.level > 0

    def current(self) -> Step:
        """Return the state between two steps, as the record of a step that moves nothing; nothing is changed."""
        self.initialize()
        began = time.perf_counter()
        fraction, area = self.surface.fraction_and_area()
        columns = self._columns(
            len(self.history), self.energy.value(self.surface, fraction, area), fraction, area
        )
        record = self._final_record(columns, began)._replace(edits=self.state.edits)
        return Step(record, self.surface, self.state.fields)

    def end_at_once(self, reason: StopReason, message: str) -> None:
        """End before the first step."""
        record = self.current().record
        self.stop = Stop(reason, record.step, record.t, message)
        self.history.append(record)

    # -- edits ---------------------------------------------------------------------------------------------

    def edited(self, energy: Energy | None, setup: SolverSetup) -> Evolution:
        """Return the evolution that continues from here under other settings.

        History, time and the energy budget are continued: the change of E here counts as smoothing work. A flow of
        the same class keeps the momentum; one of another class begins with zero momentum. The rules of stop and
        restart begin anew, as at the start.

        Parameters
        ----------
        energy : Energy or None
            None for no change.
        setup : SolverSetup
            From here on; its flow is not started yet.
        """
        self.initialize()
        surface = self.surface
        old = self.flow
        flow = setup.flow
        half_width = setup.half_width
        fraction, area = surface.fraction_and_area()
        potential = self.energy.value(surface, fraction, area)
        if type(flow) is type(old):
            potential += old.energy(area)
            flow.continue_from(surface, old, energy is not None)
        else:
            self.state.budget.record_loss(old.energy(area))
            flow.start(surface)
        fields = flow.fields
        if surface.requested_half_width != half_width:
            slot = surface.dense.slot.copy()
            surface.reinitialize(half_width)
            here = Level(
                0, (1, 1, 1), surface.shape, (surface.grid.hz, surface.grid.hy, surface.grid.hx)
            )
            fields = transfer_fields(fields, flow.fill_values, slot, here, surface, here)
        state = self.state.after_edit(compares=energy is None)
        following = Evolution(
            surface,
            energy or self.energy,
            setup,
            self.max_steps,
            self.level,
            state,
            fields,
            self._corner,
        )
        following.initialize()
        state.expect(potential - flow.energy(surface.fraction_and_area()[1]))
        if self._stop_requested:
            following.request_stop()
        return following

    def checkpoint(self) -> Checkpoint:
        """The state between two steps, as a value; nothing of the run is changed by it."""
        self.initialize()
        surface = checkpoint_surface(self.surface)
        return Checkpoint(
            self.level,
            self.state.copy(),
            surface,
            self.flow.state(),
            self.energy.state(),
            self.stop,
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back to a state made under the same settings; the steps that follow are then the same, bit for bit."""
        self.state = checkpoint.loop.copy()
        restore_surface(self.surface, checkpoint.surface)
        self.flow.restore(self.surface, checkpoint.flow)
        self.energy.restore(self.surface, checkpoint.energy)
        self._initialized = True
        self._fields = None
        self._stop_requested = False
        self.stop = checkpoint.stop

    # -- one step ------------------------------------------------------------------------------------------

    def _step(self, n: int) -> StepRecord:
        began = time.perf_counter()
        surface = self.surface
        flow = self.flow
        state = self.state
        visited = surface.workers.visited
        self.energy.set_time(surface, state.time)
        fraction, area = surface.fraction_and_area()
        potential = self.energy.value(surface, fraction, area)
        state.record_potential(potential)
        reason = self._reason_to_stop(n, potential)
        decision = self._decide(n, reason)
        if decision != "stay":
            lowest.go_back(state, n, area, surface, flow, self.energy)
            if decision == "continue":
                reason = None
            elif reason is None:
                reason = Reason("stalled", lowest.NO_LOWER.format(self._patience()))
            fraction, area = surface.fraction_and_area()
            potential = state.potential
        columns = self._columns(n, potential, fraction, area) | {"returned": decision != "stay"}
        if reason is None and (plateau := self._left_plateau(n, columns)) is not None:
            fraction, area = plateaus.go_back(
                plateau, state, area, surface, self.energy, flow, self._corner
            )
            columns = self._columns(n, state.potential, fraction, area) | {
                "returned": True,
                "back_to": plateau.step,
            }
            reason = Reason("rested", plateaus.WHY.format(plateau.step))
        if reason is not None:
            if columns["returned"] and surface.size:
                fields = StepFields(
                    surface.band.cells, self._force()[1], np.zeros(surface.size, np.float32)
                )
                state.record_motion(fields, 0.0)
            return self._end(reason, columns, began)
        restarted = self.setup.restart is not None and self.setup.restart.is_due(
            potential, self.history[state.first :]
        )
        if restarted:
            state.budget.record_loss(flow.zero_momentum(area))
        self._react(area)
        front, force, curvature = self._force()
        plan = flow.move(
            StepInput(surface, front, force, curvature, area, self.energy.alpha), self._limits_now()
        )
        if not plan.dt > 0:
            return self._end(Reason("converged", "no force acts on the surface"), columns, began)
        entries = state.budget.record_step(plan.energy_rates, plan.dt)
        rates = voxel_rates(surface, area > 0, plan.speed)
        motion = plan.dt * float((area * rates).sum()) / max(columns["area_mm2"], 1e-300)
        # The arrays of the old band, which nothing writes to any more.
        fields = StepFields(surface.band.cells, force, plan.speed)
        removed = self._advance(plan)
        state.record_motion(fields, plan.dt)
        return StepRecord(
            **columns,
            **entries,
            dt=plan.dt,
            cfl_dt=plan.cfl_dt if math.isfinite(plan.cfl_dt) else plan.dt,
            speed=plan.front_speed,
            motion_voxels=motion,
            limited_fraction=plan.clipped,
            diffusion=plan.diffusion,
            cells_visited=surface.workers.visited - visited,
            restarted=restarted,
            removed_components=removed,
            seconds=time.perf_counter() - began,
        )

    def _force(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The front that the flow needs, and force and curvature there, all (n,)."""
        front = self.surface.front(self.flow.stencil_width(self.surface))
        curvature = self.surface.curvature(front)
        variation = self.surface.area_variation(front, curvature)
        return front, self.energy.force(self.surface, front, variation), curvature

    def _react(self, area: np.ndarray) -> None:
        """Take out the momentum that a constraint stops; the energy budget records the loss."""
        change = self.energy.reaction(self.surface, self.flow)
        if change is not None:
            before = self.flow.energy(area)
            self.flow.add_velocity(self.surface, change)
            self.state.budget.record_jump(before - self.flow.energy(area))

    def _columns(
        self, n: int, potential: float, fraction: np.ndarray, area: np.ndarray
    ) -> dict[str, Any]:
        """The columns of a record that say where the surface is."""
        return {
            "step": n,
            "level": self.level,
            "t": self.state.time,
            "potential": potential,
            "volume_mm3": self.surface.volume(fraction),
            "area_mm2": float(area.sum()),
            "band_cells": self.surface.size,
            "extra": tuple(
                (name, float(measure(self.surface, self.energy, self.flow)))
                for name, measure in self.setup.measures.items()
            ),
        }

    def _advance(self, plan: StepPlan) -> int:
        """Move the surface and the fields on it; returns how many components were removed."""
        surface = self.surface
        if plan.velocity is None:
            surface.advance(plan.speed, plan.dt)
        else:
            surface.advect(plan.velocity, plan.dt)
        # An energy may be infinite for some surfaces, for example beyond a mask.
        self.energy.project(surface)
        removed = surface.remove_small(self.energy.held_cells)
        motion = None if plan.velocity is None else Motion(plan.velocity, plan.dt)
        change = surface.redistance(self.flow.fields, motion)
        self.flow.set_fields(change.fields)
        self.energy.follow(surface, change)
        return removed

    def _final_record(self, columns: dict[str, Any], began: float) -> StepRecord:
        """The last record: the final state, no motion."""
        last = self.history[-1] if self.history else None
        entries: dict[str, Any] = {key: getattr(last, key) if last else 0.0 for key in COLUMNS}
        entries["weight"] = self.flow.weight
        back_to = columns.pop(
            "back_to", self.state.lowest.step if self.state.lowest is not None else 0
        )
        if columns.get("returned"):
            entries["kinetic"], entries["smoothing_work"] = 0.0, self.state.budget.smoothing
            then = self.history[back_to]
            entries.update({key: getattr(then, key) for key in MASS_COLUMNS})
        return StepRecord(
            **columns,
            **entries,
            dt=0.0,
            cfl_dt=0.0,
            speed=0.0,
            motion_voxels=0.0,
            limited_fraction=0.0,
            diffusion=0.0,
            cells_visited=0,
            restarted=False,
            removed_components=0,
            seconds=time.perf_counter() - began,
        )

    # -- decisions -----------------------------------------------------------------------------------------

    def _end(self, reason: Reason, columns: dict[str, Any], began: float) -> StepRecord:
        self.stop = Stop(reason.name, columns["step"], self.state.time, reason.message)
        return self._final_record(columns, began)

    def _decide(self, n: int, reason: Reason | None) -> lowest.Decision:
        """Note the state if its potential is the lowest, or decide whether to go back to that one.

        Without a stop rule the motion itself is wanted, not the minimum.
        """
        state, surface = self.state, self.surface
        if self.setup.rule is None or (
            self.setup.end == "present" and reason is not None and reason.name == "max-steps"
        ):
            return "stay"
        if self.energy.is_disturbed:
            self.state.lowest = None
            return "stay"
        if surface.size and math.isfinite(state.potential):
            self.state.lowest = lowest.lowest_of(
                state.lowest, state.potential, n, surface, self.flow, self.energy
            )
        elif state.lowest is not None:
            self.state.lowest = lowest.completed(state.lowest, surface)
        since = n - max(state.returned_at, state.lowest.step if state.lowest else 0)
        decision = lowest.decide(
            reason, state, surface, since, self.setup.rule.motion, self._patience()
        )
        # On a coarse level the surface has only come near its end.
        return "stay" if decision == "end" and self.level > 0 and reason is not None else decision

    def _patience(self) -> int:
        return lowest.patience(
            self.state, self.setup.rule is not None and self.setup.rule.patience is not None
        )

    def _left_plateau(self, n: int, columns: dict[str, Any]) -> Slowest | None:
        """Watch for a plateau; return that which the surface has just left, if the run shall end at it."""
        state = self.state
        before = plateaus.completed(state.plateaus, self.level, self.surface)
        now = plateaus.Moment(
            n, self.level, columns["volume_mm3"], columns["area_mm2"], self._corner
        )
        self.state.plateaus = plateaus.watched(
            before, self.history[state.first :], now, self.surface, state.fields
        )
        has_left = len(state.plateaus.found) > len(before.found)
        return before.slowest if self.setup.stop_at_rest and has_left else None

    def _limits_now(self) -> StepLimits:
        """The limits of a step, shorter the more often the run has gone back."""
        shorter = lowest.SHORTER**self.state.returns
        return (
            self.setup.limits._replace(cfl=self.setup.limits.cfl * shorter)
            if shorter < 1.0
            else self.setup.limits
        )

    def _reason_to_stop(self, n: int, potential: float) -> Reason | None:
        gone = surface_is_gone(self.surface, potential)
        if gone is not None:
            return gone
        if self._stop_requested:
            return Reason("interrupted", f"stopped on request after {n} steps")
        stuck = stalled(self.history[self.state.first :])
        if stuck is not None:
            return stuck
        if n >= self.max_steps:
            return Reason("max-steps", f"not converged within {self.max_steps} steps")
        return (
            None
            if self.setup.rule is None
            else self.setup.rule.judge(self.surface, self.flow, self.state)
        )
