"""The loop: one step after another, each yielded with what it did, until a named reason to stop."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from accelsurf.energies import Energy
from accelsurf.flows import Account, Flow, Limits, Move, Now
from accelsurf.flows.base import voxel_rates
from accelsurf.levelset import LevelSet, Snapshot

StopReason = Literal["converged", "max-steps", "vanished", "filled", "stalled", "interrupted", "diverged", "leaked"]


class Row(NamedTuple):
    """One line of the trace: the state at the beginning of a step and the move that followed.

    Attributes
    ----------
    step : int
    level : int
        Grid that the step was made on: 0 is the image's own, 1 the next coarser one; see `accelsurf.pyramid`.
    t, dt : float
        Flow time and the step's length; dt is 0 in the last row, which only records the final state.
    potential, kinetic, mass_potential, weight : float
        U, the paper's T, U_mass, and the factor w of the potentials, at time t: E = U + U_mass + T/w never rises.
    friction_work, smoothing_work, noise_work : float
        What friction has taken from E so far; what diffusion, the limiter, restarts and changes of level have; what
        noise has put in: E + friction_work + smoothing_work - noise_work stays what it was.
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
    """

    step: int
    level: int
    t: float
    dt: float
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


class Stop(NamedTuple):
    """Why a run ended: ``reason``, after how many ``steps``, at flow time ``time``, in words (``message``)."""

    reason: StopReason
    steps: int
    time: float
    message: str


class Step(NamedTuple):
    """What the loop yields: the ledger's row, and the surface as it is now (look, do not touch)."""

    row: Row
    surface: LevelSet


class StopRule(NamedTuple):
    """When a run has converged, in physical terms.

    Looked at every ``window`` steps: the surface lies on average within ``motion`` voxels of where it lay a
    window before (what it moved there and back does not count), and the kinetic energy is below ``kinetic``
    of w times the potential won so far.
    """

    window: int = 20
    motion: float = 0.1
    kinetic: float = 0.01


class Restart(NamedTuple):
    """When momentum is set to zero: the potential rises, ``travel`` voxels after the start or the last restart,
    and not within ``rest`` steps of it.
    """

    travel: float = 3.0
    rest: int = 5


class Books:
    """Adds up, from the accounts of the steps, what has become of the energy; in the units of U.

    Rates are known at the times of the rows, kicks happen around them: both are summed by the trapezoidal rule.
    """

    COLUMNS = (
        "kinetic", "mass_potential", "weight", "friction_work", "smoothing_work", "noise_work", "mass",
        "mass_correction", "clamped_fraction",
    )

    def __init__(self) -> None:
        self._friction = self._smoothing = self._noise = 0.0
        self._last, self._last_dt = Account(), 0.0

    def lose(self, energy: float) -> None:
        """A restart has taken the kinetic energy (as T/w)."""
        self._smoothing += energy - 0.5 * (self._last.smoothing - self._last.noise)
        self._last = self._last._replace(friction=0.0, smoothing=0.0, noise=0.0)

    def regrid(self, drop: float) -> None:
        """The surface came to another grid, on which its potential is less by ``drop``."""
        self._smoothing += drop

    def enter(self, now: Account, dt: float) -> dict[str, Any]:
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
        The grid's level, for the ledger. A level above 0 leaves no last row without a step: the surface goes on to
        the next level, whose first row has its state.
    before : Evolution, optional
        The evolution on the coarser level that this one goes on from: ledger, time and account are continued.
    fields : list of ndarray (n,), optional
        The fields of ``flow``, as ``before`` left it, on this band; without them the flow starts at rest.

    Attributes
    ----------
    ledger : list of Row
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
        limits: Limits | None = None,
        max_steps: int = 1000,
        restart: Restart | None = None,
        rule: StopRule | None = None,
        level: int = 0,
        before: Evolution | None = None,
        fields: list[np.ndarray] | None = None,
    ) -> None:
        self.surface, self.energy, self.flow = surface, energy, flow
        self.limits = limits or Limits()
        self.max_steps = max_steps
        self.restart = restart
        self.rule = rule
        self.level = level
        self.ledger: list[Row] = []
        self.stop: Stop | None = None
        self._asked = False
        self._time = 0.0
        self._potential = 0.0
        self._snapshot: Snapshot | None = None
        self._books = Books()
        self._fields = fields
        # What the other level had at the end, and not that level itself, which would be kept alive. What was won
        # there counts: near the end, where this level begins, there is little left to win.
        self._won_before, self._potential_before = 0.0, math.nan
        if before is not None:
            self.ledger, self._time, self._won_before = before.ledger, before._time, before._won
            if fields is not None:
                self._books, self._potential_before = before._books, before._potential
        self._first = len(self.ledger)

    def _goes_on(self) -> bool:
        """Whether this level has ended, and the next one begins where it did."""
        return self.stop is not None and self.level > 0

    def ask_to_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._asked = True

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface."""
        self.energy.start(self.surface)
        if self._fields is None:
            self.flow.start(self.surface)
        else:
            self.flow.take(self._fields)
            self._fields = None
        while self.stop is None:
            row = self._step(len(self.ledger))
            if self._goes_on():
                return
            self.ledger.append(row)
            yield Step(row, self.surface)

    # -- one step ------------------------------------------------------------------------------------------

    def _step(self, n: int) -> Row:
        began = time.perf_counter()
        surface, flow = self.surface, self.flow
        visited = surface.workers.visited
        part, area = surface.cut()
        potential = self.energy.value(surface, part, area)
        if not math.isnan(self._potential_before):
            self._books.regrid(self._potential_before - potential)
            self._potential_before = math.nan
        self._potential = potential
        state: dict[str, Any] = {
            "step": n,
            "level": self.level,
            "t": self._time,
            "potential": potential,
            "volume_mm3": surface.volume(part),
            "area_mm2": float(area.sum()),
            "band_cells": surface.size,
        }
        reason = self._reason_to_stop(n, potential)
        if reason is not None:
            self._end(*reason, n)
            return self._still(state, began)
        restarted = self._restart_due(potential)
        if restarted:
            self._books.lose(flow.rest(area))
        front = surface.front(flow.reach(surface))
        curvature = surface.curvature(front)
        force = self.energy.force(surface, front, curvature)
        move = flow.move(Now(surface, front, force, curvature, area, self.energy.alpha), self.limits)
        if not move.dt > 0:
            self._end("converged", "no force acts on the surface", n)
            return self._still(state, began)
        entries = self._books.enter(move.account, move.dt)
        rates = voxel_rates(surface, area > 0, move.speed)
        motion = move.dt * float((area * rates).sum()) / max(state["area_mm2"], 1e-300)
        removed = self._drift(move)
        self._time += move.dt
        return Row(
            **state,
            **entries,
            dt=move.dt,
            speed=move.rate,
            motion_voxels=motion,
            limited_fraction=move.limited,
            diffusion=move.diffusion,
            cells_visited=surface.workers.visited - visited,
            restarted=restarted,
            removed_components=removed,
            seconds=time.perf_counter() - began,
        )

    def _drift(self, move: Move) -> int:
        """Move the surface, and everything that lives on it; returns how many components were removed."""
        surface = self.surface
        if move.velocity is None:
            surface.advance(move.speed, move.dt)
        else:
            surface.carry(move.velocity, move.dt)
        # An energy may be infinite beyond a fence.
        hold = getattr(self.energy, "hold", None)
        if hold is not None:
            hold(surface)
        removed = surface.remove_small()
        change = surface.redistance(self.flow.fields, None if move.velocity is None else (move.velocity, move.dt))
        self.flow.take(change.fields)
        self.energy.follow(surface, change)
        return removed

    def _still(self, state: dict[str, Any], began: float) -> Row:
        """The last row: the final state, no move."""
        last = self.ledger[-1] if self.ledger else None
        entries: dict[str, Any] = {key: getattr(last, key) if last else 0.0 for key in Books.COLUMNS}
        entries["weight"] = self.flow.weight
        return Row(
            **state, **entries, dt=0.0, speed=0.0, motion_voxels=0.0, limited_fraction=0.0, diffusion=0.0,
            cells_visited=0, restarted=False, removed_components=0, seconds=time.perf_counter() - began,
        )

    # -- decisions -----------------------------------------------------------------------------------------

    def _end(self, reason: StopReason, message: str, steps: int) -> None:
        self.stop = Stop(reason, steps, self._time, message)

    @property
    def _rows(self) -> list[Row]:
        """The rows of this level."""
        return self.ledger[self._first :]

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
            return "stalled", "the time step has collapsed: the surface can no longer move"
        if n >= self.max_steps:
            return "max-steps", f"not converged within {self.max_steps} steps"
        return self._converged()

    def _has_stalled(self) -> bool:
        """Whether the last ten time steps were below a millionth of the longest."""
        rows = self._rows
        if len(rows) < 20:
            return False
        longest = max(row.dt for row in rows)
        return all(row.dt < 1e-6 * longest for row in rows[-10:])

    def _converged(self) -> tuple[StopReason, str] | None:
        rule = self.rule
        if rule is None or (len(self.ledger) - self._first) % rule.window:
            return None
        before, self._snapshot = self._snapshot, self.surface.snapshot()
        if before is None:
            return None
        moved = self.surface.distance_from(before)
        if moved > rule.motion or self.ledger[-1].kinetic > rule.kinetic * self.flow.weight * self._won:
            return None
        return "converged", f"the surface moved {moved:.3f} voxels in {rule.window} steps"
