"""The loop: one step after another, each yielded with what it did, until a named reason to stop."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from accelsurf.energies import Energy
from accelsurf.flows import EnergyRates, Flow, StepInput, StepLimits, StepPlan
from accelsurf.flows.step_limits import voxel_rates
from accelsurf.grid.pyramid import Level
from accelsurf.levelset import LevelSet, Snapshot, SurfaceState, checkpoint_surface, restore_surface
from accelsurf.levelset.transfer import transfer_fields

StopReason = Literal["converged", "max-steps", "vanished", "filled", "stalled", "interrupted", "diverged", "leaked"]


class StepRecord(NamedTuple):
    """One line of the trace: the state at the beginning of a step and the move that followed.

    Attributes
    ----------
    step : int
    level : int
        Grid that the step was made on: 0 is the image's own, 1 the next coarser one; see `accelsurf.grid.pyramid`.
    t, dt, cfl_dt : float
        Flow time, the step's length, and the length that the surface's way alone would allow: where dt is less, waves,
        diffusion, noise or density bound it. Both are 0 in the last row, which only records the final state.
    potential, kinetic, mass_potential, weight : float
        U, the paper's T, U_mass, and the factor w of the potentials, at time t: E = U + U_mass + T/w never rises.
    friction_work, smoothing_work, noise_work : float
        What friction has taken from E so far; what diffusion, the limiter, restarts, changes of level and edits have;
        what noise has put in: E + friction_work + smoothing_work - noise_work stays what it was.
    mass, mass_correction : float
        Mass of the surface, and the part that the flow has had to add so far to conserve it (relative).
    clamped_fraction : float
        Share of the surface where a negative tension of the mass potential was clamped.
    volume_mm3, area_mm2 : float
    speed : float
        The limiter's percentile of the speed (sign dropped) on the front, mm per unit time.
    motion_voxels : float
        Mean motion of the surface in the step, voxels along the normal.
    limited_fraction : float
        Share of front cells held to the CFL limit.
    diffusion : float
        Velocity diffusion used, mm2 per unit time.
    band_cells, cells_visited : int
        Size of the band, and the cells that the step's passes over it visited in all: its cost, on any machine.
    restarted : bool
        True when momentum was set to zero before this step.
    removed_components : int
        Components removed as smaller than the grid resolves.
    seconds : float
        Wall time of the step.
    edits : int
        Changes made by hand right before this step; see `accelsurf.settings.edits`.
    """

    step: int
    level: int
    t: float
    dt: float
    cfl_dt: float
    potential: float
    kinetic: float
    mass_potential: float
    weight: float
    friction_work: float
    smoothing_work: float
    noise_work: float
    mass: float
    mass_correction: float
    volume_mm3: float
    area_mm2: float
    speed: float
    motion_voxels: float
    limited_fraction: float
    clamped_fraction: float
    diffusion: float
    band_cells: int
    cells_visited: int
    restarted: bool
    removed_components: int
    seconds: float
    edits: int = 0


class Stop(NamedTuple):
    """Why a run ended: ``reason``, after how many ``steps``, at flow time ``time``, in words (``message``)."""

    reason: StopReason
    steps: int
    time: float
    message: str


class StepFields(NamedTuple):
    """What acted in a step, per cell of the band that it began on: raveled ``cells`` (n,) in raster order, ``force``
    (n,), which counts at the front, and ``speed`` (n,), mm per unit time; along N, so that above 0 shrinks.
    """

    cells: np.ndarray
    force: np.ndarray
    speed: np.ndarray


class Step(NamedTuple):
    """What the loop yields: the history's row, the surface as it is now, and what moved it there last on this grid
    (look, do not touch); the latter is None where no step was made on the grid.
    """

    row: StepRecord
    surface: LevelSet
    step_fields: StepFields | None = None


#: Mean motion in a step, voxels, of a surface that stands still: details finer than the grid pull it to and fro.
STILL = 0.05
#: A run has stalled when `LAST` steps running are shorter than this part of what the surface's way alone would allow,
#: or than that part of the longest step; steps down to the share `SHORT` are long enough to judge by.
STALLED, COLLAPSED, LAST, SHORT = 1e-3, 1e-6, 10, 0.1


class StopRule(NamedTuple):
    """When a run has converged, in physical terms.

    Looked at every ``window`` steps: the surface lies on average within ``motion`` voxels of where it lay a
    window before (what it moved there and back does not count), and no more than the share ``far`` of it further than
    `levelset.FAR`: a small part may still be on its way where all else rests. The kinetic energy is below ``kinetic``
    of w times the potential won so far, or the last step moved the surface by less than `STILL` voxels: a start that is
    the end wins nothing. Where steps are shorter than the share `SHORT` of `StepRecord.cfl_dt`, the
    window is so many times longer.
    """

    window: int = 20
    motion: float = 0.1
    kinetic: float = 0.01
    far: float = 0.01


class Restart(NamedTuple):
    """When momentum is set to zero: the potential rises, ``travel`` voxels after the start or the last restart,
    and not within ``zero_momentum`` steps of it.
    """

    travel: float = 3.0
    rest: int = 5


class EnergyBudget:
    """Adds up, from the accounts of the steps, what has become of the energy; in the units of U.

    Rates are known at the times of the rows, kicks happen around them: both are summed by the trapezoidal rule.
    """

    COLUMNS = (
        "kinetic", "mass_potential", "weight", "friction_work", "smoothing_work", "noise_work", "mass",
        "mass_correction", "clamped_fraction",
    )

    def __init__(self) -> None:
        self._friction = self._smoothing = self._noise = 0.0
        self._last, self._last_dt = EnergyRates(), 0.0

    def record_loss(self, energy: float) -> None:
        """A restart has taken the kinetic energy (as T/w)."""
        self._smoothing += energy - 0.5 * (self._last.smoothing - self._last.noise)
        self._last = self._last._replace(friction=0.0, smoothing=0.0, noise=0.0)

    def record_jump(self, energy: float) -> None:
        """E became less by ``energy`` at once: another grid, other settings, or another surface."""
        self._smoothing += energy

    def record_step(self, now: EnergyRates, dt: float) -> dict[str, Any]:
        """The columns of a row that begins with ``now`` and lasts ``dt``."""
        last = self._last
        self._friction += 0.5 * self._last_dt * (last.friction + now.friction)
        self._smoothing += 0.5 * (last.smoothing + now.smoothing)
        self._noise += 0.5 * (last.noise + now.noise)
        self._last, self._last_dt = now, dt
        return {
            "kinetic": now.kinetic,
            "mass_potential": now.mass_potential,
            "weight": now.weight,
            "friction_work": self._friction,
            "smoothing_work": self._smoothing,
            "noise_work": self._noise,
            "mass": now.mass,
            "mass_correction": now.mass_correction,
            "clamped_fraction": now.clamped,
        }


class Kept(NamedTuple):
    """An `Evolution` between two steps, put aside; see `Evolution.checkpoint`.

    ``history`` so far; ``surface``; ``flow`` and ``energy``, what they remember; ``scalars`` and ``books`` of the loop.
    """

    history: tuple[StepRecord, ...]
    surface: SurfaceState
    flow: dict[str, Any]
    energy: Any
    scalars: dict[str, Any]
    books: EnergyBudget

    @property
    def nbytes(self) -> int:
        """Memory that it takes at most; rows are not counted, and what states may share is."""
        fields = sum(value.nbytes for value in self.flow.values() if isinstance(value, np.ndarray))
        before, step_fields = self.scalars["_snapshot"], self.scalars["_step_fields"]
        shared = (12 * before.psi.size if before else 0) + (16 * step_fields.speed.size if step_fields else 0)
        return self.surface.nbytes + fields + 8 * len(self.history) + shared


class Evolution:
    """Evolves a surface; iterate over it to run, one `Step` at a time.

    Parameters
    ----------
    surface : LevelSet
        The first surface; moved in place.
    energy : Energy
    flow : Flow
    limits : Limits
        Step control, the same for every flow.
    max_steps : int
    restart : Restart or None
        None never restarts.
    rule : StopRule or None
        None runs to ``max_steps``.
    level : int
        The grid's level, for the history. A level above 0 leaves no last row without a step: the surface goes on to
        the next level, whose first row has its state.
    before : Evolution, optional
        The evolution on the coarser level that this one goes on from: history, time and account are continued.
    fields : list of ndarray (n,), optional
        The fields of ``flow``, as ``before`` left it, on this band; without them the flow starts at rest.

    Attributes
    ----------
    history : list of Row
        Every step so far.
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
        flow: Flow,
        limits: StepLimits | None = None,
        max_steps: int = 1000,
        restart: Restart | None = None,
        rule: StopRule | None = None,
        level: int = 0,
        before: Evolution | None = None,
        fields: list[np.ndarray] | None = None,
    ) -> None:
        self.surface, self.energy, self.flow = surface, energy, flow
        self.limits = limits or StepLimits()
        self.max_steps = max_steps
        self.restart = restart
        self.rule = rule
        self.level = level
        self.history: list[StepRecord] = []
        self.stop: Stop | None = None
        self._asked = False
        self._time = 0.0
        self._potential = 0.0
        self._snapshot: Snapshot | None = None
        self._step_fields: StepFields | None = None
        self._budget = EnergyBudget()
        self._fields = fields
        self._begun = False
        self._edits = 0
        # What the other level had at the end, and not that level itself, which would be kept alive. What was won
        # there counts: near the end, where this level begins, there is little left to win.
        self._won_before, self._potential_before = 0.0, math.nan
        if before is not None:
            self.history, self._time, self._won_before = before.history, before._time, before._won
            self._edits = before._edits
            if fields is not None:
                self._budget, self._potential_before = before._budget, before._potential
        self._first = self._seen = len(self.history)

    def _goes_on(self) -> bool:
        """Whether this level has ended, and the next one begins where it did."""
        return self.stop is not None and self.level > 0

    def ask_to_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._asked = True

    def hand_over(self) -> None:
        """Look at the surface as it is, so that an evolution on another grid can go on from here."""
        self._potential = self.energy.value(self.surface, *self.surface.fraction_and_area())

    def zero_momentum(self) -> None:
        """Take the momentum from the surface, as a restart does; the books know what it was."""
        self._budget.record_loss(self.flow.zero_momentum(self.surface.fraction_and_area()[1]))

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface."""
        while (step := self.step()) is not None:
            yield step

    def begin(self) -> None:
        """Start energy and flow, unless that has been done; the first step does it by itself."""
        if self._begun:
            return
        self._begun = True
        self.energy.start(self.surface)
        if self._fields is None:
            self.flow.start(self.surface)
        else:
            self.flow.set_fields(self._fields)
            self._fields = None

    def step(self) -> Step | None:
        """Make one step; None when the evolution has ended. The last one moves nothing: its row is the final state."""
        if self.stop is not None:
            return None
        self.begin()
        row = self._step(len(self.history))._replace(edits=self._edits)
        if self._goes_on():
            return None
        self._edits = 0
        self.history.append(row)
        return Step(row, self.surface, self._step_fields)

    @property
    def step_fields(self) -> StepFields | None:
        """What moved the surface last."""
        return self._step_fields

    def look(self) -> Step:
        """Return the state between two steps, as the row of a step that moves nothing; changes nothing of the run."""
        self.begin()
        began = time.perf_counter()
        fraction, area = self.surface.fraction_and_area()
        state = self._state(len(self.history), self.energy.value(self.surface, fraction, area), fraction, area)
        return Step(self._still(state, began)._replace(edits=self._edits), self.surface, self._step_fields)

    # -- changed by hand -----------------------------------------------------------------------------------

    def edited(
        self,
        energy: Energy | None,
        flow: Flow,
        limits: StepLimits,
        restart: Restart | None,
        rule: StopRule | None,
        half_width: float,
        push: Callable[[LevelSet], None] | None = None,
    ) -> Evolution:
        """Return the evolution that goes on from here under other settings, or on a surface changed by ``push``.

        Ledger, time and the account of the energy are continued: what E loses or gains here is entered as smoothing.
        Momentum stays with a flow of the same class; one of another class begins at rest. The rules of stop and
        restart begin anew, as they would at the start.

        Parameters
        ----------
        energy : Energy or None
            None keeps the one there is.
        flow : Flow
            Not started yet.
        limits, restart, rule
            From here on.
        half_width : float
            Of the band, voxels.
        push : callable, optional
            Changes the dense psi of the surface, which is then made a distance again.
        """
        self.begin()
        surface, old = self.surface, self.flow
        fraction, area = surface.fraction_and_area()
        potential = self.energy.value(surface, fraction, area)
        if type(flow) is type(old):
            potential += old.energy(area)
            flow.continue_from(surface, old, energy is not None)
        else:
            self._budget.record_loss(old.energy(area))
            flow.start(surface)
        fields = flow.fields
        if push is not None or surface.requested_half_width != half_width:
            slot = surface.dense.slot.copy()
            if push is not None:
                push(surface)
            surface.reinitialize(half_width)
            here = Level(0, (1, 1, 1), surface.shape, (surface.grid.hz, surface.grid.hy, surface.grid.hx))
            fields = transfer_fields(fields, flow.fill_values, slot, here, surface, here)
        following = Evolution(
            surface, energy or self.energy, flow, limits, self.max_steps, restart, rule, self.level, self, fields
        )
        following.begin()
        # Potentials of two energies do not compare.
        following._won_before = 0.0 if energy is not None else self._won
        following._potential_before = potential - flow.energy(surface.fraction_and_area()[1])
        following._edits, following._asked, following._step_fields = self._edits + 1, self._asked, self._step_fields
        return following

    _SCALARS = (
        "_time", "_potential", "_snapshot", "_won_before", "_potential_before", "_first", "_seen", "_step_fields",
        "level",
    )

    def checkpoint(self) -> Kept:
        """Put aside the state between two steps; nothing of the run is changed by it."""
        self.begin()
        energy = self.energy.state()
        scalars = {name: getattr(self, name) for name in self._SCALARS}
        return Kept(
            tuple(self.history),
            checkpoint_surface(self.surface),
            self.flow.state(),
            energy,
            scalars,
            copy.copy(self._budget),
        )

    def restore(self, kept: Kept) -> None:
        """Go back to a state kept under the same settings; the steps that follow are then the same, bit for bit."""
        self.history[:] = kept.history
        restore_surface(self.surface, kept.surface)
        self.flow.restore(self.surface, kept.flow)
        self.energy.restore(self.surface, kept.energy)
        for name, value in kept.scalars.items():
            setattr(self, name, value)
        self._budget = copy.copy(kept.books)
        self._begun, self._fields, self._edits, self._asked, self.stop = True, None, 0, False, None

    # -- one step ------------------------------------------------------------------------------------------

    def _step(self, n: int) -> StepRecord:
        began = time.perf_counter()
        surface, flow = self.surface, self.flow
        visited = surface.workers.visited
        fraction, area = surface.fraction_and_area()
        potential = self.energy.value(surface, fraction, area)
        if not math.isnan(self._potential_before):
            self._budget.record_jump(self._potential_before - potential)
            self._potential_before = math.nan
        self._potential = potential
        state = self._state(n, potential, fraction, area)
        reason = self._reason_to_stop(n, potential)
        if reason is not None:
            self._end(*reason, n)
            return self._still(state, began)
        restarted = self._restart_due(potential)
        if restarted:
            self._budget.record_loss(flow.zero_momentum(area))
        front = surface.front(flow.stencil_width(surface))
        curvature = surface.curvature(front)
        force = self.energy.force(surface, front, curvature)
        move = flow.move(StepInput(surface, front, force, curvature, area, self.energy.alpha), self.limits)
        if not move.dt > 0:
            self._end("converged", "no force acts on the surface", n)
            return self._still(state, began)
        entries = self._budget.record_step(move.energy_rates, move.dt)
        rates = voxel_rates(surface, area > 0, move.speed)
        motion = move.dt * float((area * rates).sum()) / max(state["area_mm2"], 1e-300)
        # The arrays of the old band, which nothing writes to any more.
        self._step_fields = StepFields(surface.band.cells, force, move.speed)
        removed = self._drift(move)
        self._time += move.dt
        return StepRecord(
            **state,
            **entries,
            dt=move.dt,
            cfl_dt=move.cfl_dt if math.isfinite(move.cfl_dt) else move.dt,
            speed=move.front_speed,
            motion_voxels=motion,
            limited_fraction=move.clipped,
            diffusion=move.diffusion,
            cells_visited=surface.workers.visited - visited,
            restarted=restarted,
            removed_components=removed,
            seconds=time.perf_counter() - began,
        )

    def _state(self, n: int, potential: float, fraction: np.ndarray, area: np.ndarray) -> dict[str, Any]:
        """The columns of a row that say where the surface is."""
        return {
            "step": n,
            "level": self.level,
            "t": self._time,
            "potential": potential,
            "volume_mm3": self.surface.volume(fraction),
            "area_mm2": float(area.sum()),
            "band_cells": self.surface.size,
        }

    def _drift(self, move: StepPlan) -> int:
        """Move the surface, and everything that lives on it; returns how many components were removed."""
        surface = self.surface
        if move.velocity is None:
            surface.advance(move.speed, move.dt)
        else:
            surface.advect(move.velocity, move.dt)
        self.energy.project(surface)
        removed = surface.remove_small()
        change = surface.redistance(self.flow.fields, None if move.velocity is None else (move.velocity, move.dt))
        self.flow.set_fields(change.fields)
        self.energy.follow(surface, change)
        return removed

    def _still(self, state: dict[str, Any], began: float) -> StepRecord:
        """The last row: the final state, no move."""
        last = self.history[-1] if self.history else None
        entries: dict[str, Any] = {key: getattr(last, key) if last else 0.0 for key in EnergyBudget.COLUMNS}
        entries["weight"] = self.flow.weight
        return StepRecord(
            **state, **entries, dt=0.0, cfl_dt=0.0, speed=0.0, motion_voxels=0.0, limited_fraction=0.0,
            diffusion=0.0, cells_visited=0, restarted=False, removed_components=0, seconds=time.perf_counter() - began,
        )

    # -- decisions -----------------------------------------------------------------------------------------

    def _end(self, reason: StopReason, message: str, steps: int) -> None:
        self.stop = Stop(reason, steps, self._time, message)

    @property
    def _rows(self) -> list[StepRecord]:
        """The rows of this level."""
        return self.history[self._first :]

    @property
    def _won(self) -> float:
        """Potential won so far, over all levels."""
        rows = self._rows
        return self._won_before + (max(rows[0].potential - self._potential, 0.0) if rows else 0.0)

    def _restart_due(self, potential: float) -> bool:
        """Whether the potential has risen, far and long enough after the last rest."""
        rows = self._rows
        if self.restart is None or len(rows) < 2:
            return False
        travelled, steps = 0.0, 0
        for row in reversed(rows):
            travelled += row.motion_voxels
            steps += 1
            if row.restarted or travelled >= self.restart.travel:
                break
        rising = potential > rows[-1].potential
        return rising and steps >= self.restart.rest and travelled >= self.restart.travel

    def _reason_to_stop(self, n: int, potential: float) -> tuple[StopReason, str] | None:
        if self.surface.size == 0:
            if self.surface.is_filled:
                return "filled", "the surface took in the whole volume"
            return "vanished", "the surface shrank to nothing"
        if not math.isfinite(potential):
            return "diverged", f"the potential became {potential}"
        if self._asked:
            return "interrupted", f"stopped on request after {n} steps"
        if self._has_stalled():
            return "stalled", self._why_stalled()
        if n >= self.max_steps:
            return "max-steps", f"not converged within {self.max_steps} steps"
        return self._converged()

    def _has_stalled(self) -> bool:
        """Whether the last `LAST` steps were too short to get anywhere."""
        rows = self._rows
        if len(rows) < LAST:
            return False
        longest = max(row.dt for row in rows)
        return all(row.dt < max(STALLED * row.cfl_dt, COLLAPSED * longest) for row in rows[-LAST:])

    def _why_stalled(self) -> str:
        last = self.history[-1]
        if last.dt < STALLED * last.cfl_dt:
            return (
                f"the steps are {last.cfl_dt / last.dt:.0e} times shorter than the forces ask for: diffusion, "
                "noise, smoothness or gravity bind them; less of it, or --diffusion free"
            )
        return "the time step has collapsed: the surface can no longer move"

    def _converged(self) -> tuple[StopReason, str] | None:
        rule = self.rule
        if rule is None or (len(self.history) - self._first) % rule.window:
            return None
        rows = self.history[self._seen :]
        own = sum(row.cfl_dt for row in rows) / max(len(rows), 1)
        if sum(row.dt for row in rows) < SHORT * rule.window * own:
            return None
        before, self._snapshot, self._seen = self._snapshot, self.surface.snapshot(), len(self.history)
        if before is None:
            return None
        moved, last = self.surface.distance_from(before), self.history[-1]
        swings = last.kinetic > rule.kinetic * self.flow.weight * self._won and last.motion_voxels > STILL
        if moved.mean > rule.motion or moved.far > rule.far or swings:
            return None
        return "converged", f"the surface moved {moved.mean:.3f} voxels in {len(rows)} steps"
