"""One object of a run: its surface on a box of the present level's grid, its energy, its flow, its state between steps.

Alone it has the whole grid of the region of interest. Among others its box grows with it, and its energy keeps it from
entering them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import ClickConstraint, Energy, MaskConstraint, Neighbour, NonOverlap
from accelsurf.evolution import (
    FAILED,
    Checkpoint,
    Evolution,
    LoopState,
    SolverSetup,
    Step,
    Stop,
    rule_on_level,
)
from accelsurf.flows import Flow
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, shared, widened
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.grid.geometry import farthest
from accelsurf.grid.pyramid import Level, prolong
from accelsurf.levelset import LevelSet, Workers, shift_fields, slots_of, transfer_fields
from accelsurf.run.clicks import LevelClicks
from accelsurf.run.image_context import ImageContext
from accelsurf.run.start_pyramid import LevelInputs, StartPyramid, finer_box, to_finest
from accelsurf.starts import ObjectStart

#: Margin of an object's box around the object: at least `ROOM` voxels and the fraction `_ROOM_PART` of its extent; the
#: box is made larger when the band comes within `GUARD` voxels of its edge.
ROOM = 10
_ROOM_PART = 0.5
GUARD = 3


def leaked_stop(stop: Stop, setup: SolverSetup) -> Stop:
    """Return a stop with the reason that the object is larger than allowed."""
    message = f"the object became larger than --max-volume, {setup.max_volume:g} mm3"
    return stop._replace(reason="leaked", message=message)


class EvolvingObject:
    """An object that evolves, alone or among others.

    Parameters
    ----------
    start : ObjectStart
        On the whole grid for a single object.
    inputs : LevelInputs
        Images and mask by level.
    solver : ObjectSolver
    workers : Workers
    max_steps : int
        Of all levels together.
    among_others : bool
        Whether there are other objects, which it must not overlap. It then lives on a box of the grid that grows
        with it.
    """

    def __init__(
        self,
        start: ObjectStart,
        inputs: LevelInputs,
        solver: ObjectSolver,
        workers: Workers,
        max_steps: int,
        among_others: bool,
    ) -> None:
        self.id, self.workers = start.id, workers
        self.leaked, self.reactivations = False, 0
        self._inputs, self._solver = inputs, solver
        self._among_others = among_others
        self._max_steps, self._stop_requested = max_steps, False
        self._starts = StartPyramid(start, inputs.grids)
        self._clicks = LevelClicks(solver.context, inputs)
        self.corner: Corner = (0, 0, 0)
        self.made: MadeEnergy
        self.evolution: Evolution

    @property
    def context(self) -> ImageContext:
        """Data of the image that its energy needs."""
        return self._solver.context

    @property
    def _setup(self) -> SolverSetup:
        return self._solver.setup

    # -- state --------------------------------------------------------------------------------------------

    @property
    def surface(self) -> LevelSet:
        """The surface now, on its own box."""
        return self.evolution.surface

    @property
    def flow(self) -> Flow:
        """The flow that moves it."""
        return self.evolution.flow

    @property
    def level(self) -> int:
        """The present level; 0 is the image's own grid."""
        return self._starts.level

    @property
    def grid(self) -> Level:
        """The grid of the present level, of which the object's is a box."""
        return self._inputs.grids[self.level]

    @property
    def moves(self) -> bool:
        """True if it has not stopped on this level."""
        return self.evolution.stop is None

    @property
    def stop(self) -> Stop | None:
        """Why it ended; None while it goes on, on this level or the next."""
        stop = self.evolution.stop
        if stop is None or self.level > 0:
            return None
        if self.leaked and stop.reason == "interrupted":
            return leaked_stop(stop, self._setup)
        return stop

    @property
    def contact(self) -> NonOverlap:
        """Its energy with contact; only an object among others has one."""
        energy = self.evolution.energy
        if not isinstance(energy, NonOverlap):
            raise TypeError("a single object has no contact")
        return energy

    @property
    def as_neighbour(self) -> Neighbour:
        """The object as its neighbours see it."""
        return Neighbour(self.surface, self.corner, self.contact, self.flow)

    def extent(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel of the band and the one after its last, on the level's grid; an empty box without a band."""
        return tuple(np.array(self.corner) + self.surface.extent())

    def seen(self) -> Box:
        """The voxels of the level's grid that its step depends on: its box, or its band and the reach of its energy."""
        if self._among_others:
            return box_at(self.corner, self.surface.shape)
        reach = [math.ceil(self._setup.reach / h) for h in self.grid.spacing]
        z, y, x = (
            slice(int(a) - r, int(b) + r) for a, b, r in zip(*self.extent(), reach, strict=True)
        )
        return z, y, x

    # -- starts and levels ---------------------------------------------------------------------------------

    def start_is_resolved(self) -> bool:
        """Return True if the start has something inside and outside on the present level."""
        return self._starts.is_resolved()

    def skip_level(self) -> None:
        """Begin on the next finer level instead."""
        self._starts.to_finer()

    def start_level(self) -> None:
        """Begin on the present level, from the start."""
        self._begin_from_start(None)

    def _begin_from_start(self, state: LoopState | None) -> None:
        corner, psi = self._starts.current()
        if not self._among_others:
            self.corner = corner
            self._clicks.apply(psi, self.level)
            self._evolve(self._surface_of(psi), state)
            return
        inside = np.argwhere(psi < 0)
        low, high = inside.min(axis=0) + corner, inside.max(axis=0) + 1 + corner
        low, high = self._clicks.extended(low, high, self.level)
        self._lay_out(roomy_box(low, high, self._setup.reach, self.grid), psi, corner, None, state)

    def next_level(self) -> None:
        """Continue on the next finer level, from the surface here, or from the start if this level failed."""
        before = self.evolution
        coarse = self.grid
        self.reactivations = 0
        if before.stop is None:
            raise ValueError(f"object {self.id} has not ended on level {self.level}")
        self._starts.to_finer()
        if before.stop.reason in FAILED:
            self._begin_from_start(before.state.on_next_grid(with_fields=False))
            return
        self._starts.release()
        old = before.surface
        flow = before.flow
        state = before.state.on_next_grid(with_fields=True)
        mine = coarse.on_box(self.corner, old.shape)
        slots, slots_level = slots_of(old, mine)
        self.corner, shape = finer_box(self.corner, old.shape, coarse, self.grid)
        theirs = self.grid.on_box(self.corner, shape)
        psi = prolong(old.psi, mine, theirs)
        # The coarse image, psi and slots go before the finer band is built, where memory is highest.
        del before, old, self.evolution, self.made
        self._clicks.apply(psi, self.level, box_at(self.corner, shape))
        surface = self._surface_of(psi)
        fields = transfer_fields(flow.fields, flow.fill_values, slots, slots_level, surface, theirs)
        flow.change_grid(surface, theirs.places_in(mine))
        self._evolve(surface, state, fields)

    def failed_on_level(self) -> Stop | None:
        """Why the level left no surface to continue from; None if it left one."""
        stop = self.evolution.stop
        return stop if stop is not None and stop.reason in FAILED else None

    def steps_on_level(self) -> int:
        """Steps made on the present level."""
        return sum(
            record.level == self.level and record.dt > 0 for record in self.evolution.history
        )

    # -- on a grid -----------------------------------------------------------------------------------------

    @property
    def _setup_here(self) -> SolverSetup:
        """Solver settings on the present level."""
        return self._setup._replace(rule=rule_on_level(self._setup.rule, self.level))

    def _surface_of(self, psi: NDArray[np.float32]) -> LevelSet:
        """The surface where ``psi``, on a box of the grid, is 0; the memory of ``psi`` is used."""
        setup = self._setup
        return LevelSet(
            psi, self.grid.spacing, setup.half_width, self.workers, True, setup.extension
        )

    def _lay_out(
        self,
        box: Box,
        known: NDArray[np.float32],
        at: Corner,
        before: Evolution | None,
        state: LoopState | None,
    ) -> None:
        """Transfer the surface, known from voxel ``at`` on, to a box of the grid, and continue ``before`` there."""
        self.corner = corner_of(box)
        psi = _psi_on_box(known, at, box)
        self._bound(psi)
        surface = self._surface_of(psi)
        fields = None
        if before is not None:
            fields = shift_fields(before.flow.fields, before.surface, at, surface, self.corner)
            before.flow.change_grid(surface, np.stack([np.ones(3), np.subtract(self.corner, at)]))
        self._evolve(surface, state, fields)

    def _evolve(
        self,
        surface: LevelSet,
        state: LoopState | None,
        fields: list[NDArray[np.float32]] | None = None,
        energy: Energy | None = None,
    ) -> None:
        """Begin an evolution on a surface, with a new energy for its grid unless one is given."""
        if energy is None:
            energy = self._energy_on(box_at(self.corner, surface.shape))
        self.evolution = Evolution(
            surface,
            energy,
            self._setup_here,
            self._max_steps,
            self.level,
            state,
            fields,
            self.corner,
        )
        if self._among_others:
            # Neighbours need its speed and band before its first step.
            self.evolution.initialize()
        if self._stop_requested:
            self.evolution.request_stop()

    def _energy_on(self, box: Box) -> Energy:
        """The energy on a box of the present level's grid."""
        inputs = self._inputs
        images = inputs.images(self.level, box)
        level, clicks = self.level, self._clicks
        context = self.context.with_channels(images[1:], lambda: clicks.field(level, box))
        self.made = self._solver.make_energy(images[0], self.grid.spacing, context)
        energy = constrained(
            self.made.energy, inputs.mask_distance(level, box), clicks.bounds(level, box)
        )
        return NonOverlap(energy, self.corner) if self._among_others else energy

    def _bound(self, psi: NDArray[np.float32]) -> None:
        """Cut psi, on the object's box of the present level, at the mask, and put the clicked voxels on their sides."""
        box = box_at(self.corner, psi.shape)
        distance = self._inputs.mask_distance(self.level, box)
        if distance is not None:
            np.maximum(psi, distance, out=psi)
        self._clicks.apply(psi, self.level, box)

    # -- to run --------------------------------------------------------------------------------------------

    def request_stop(self) -> None:
        """End after the present step, with the reason ``interrupted``."""
        self._stop_requested = True
        self.evolution.request_stop()

    def step(self) -> Step | None:
        """Make a step; None when the object has ended on this level."""
        step = self.evolution.step()
        if self._among_others:
            self.contact.react_to_contact(self.surface, self.flow)
            if self.evolution.stop is not None and self.surface.size:
                # Neighbours follow the speed of an object: one that has stopped must have none.
                self.evolution.zero_momentum()
        if step is None:
            return None
        limit = self._setup.max_volume
        if limit is not None and step.record.volume_mm3 > limit and not self.leaked:
            self.leaked = True
            self.request_stop()
        return step._replace(object_id=self.id)

    def grow_grid(self) -> None:
        """Change to a larger box when the band comes near its edge."""
        low, high = self.extent()
        box = _larger_box(
            low, high, box_at(self.corner, self.surface.shape), self._setup.reach, self.grid
        )
        if box is not None:
            before, at = self.evolution, self.corner
            before.measure()
            self._lay_out(
                box, before.surface.psi, at, before, before.state.on_next_grid(with_fields=True)
            )

    def reactivate(self) -> None:
        """Continue after convergence, because a neighbour moved into the object."""
        before, self.reactivations = self.evolution, self.reactivations + 1
        if self.level == 0:
            # The record of the final state: it is not final any more.
            before.history.pop()
        state = before.state.on_next_grid(with_fields=True)
        self._evolve(before.surface, state, before.flow.fields, before.energy)

    # -- edits ---------------------------------------------------------------------------------------------

    def set_max_steps(self, max_steps: int) -> None:
        """Set the limit of the steps of all levels together."""
        self._max_steps = max_steps
        self.evolution.extend(max_steps)

    @property
    def takes_edits(self) -> bool:
        """True if it evolves, or has converged or stalled and can evolve again."""
        stop = self.evolution.stop
        return stop is None or (stop.reason in ("converged", "stalled") and self.surface.size > 0)

    def set_up(self, solver: ObjectSolver) -> None:
        """Have another solver on the following levels."""
        self._solver = solver
        self.reactivations = 0

    def edit(self, solver: ObjectSolver, new_energy: bool) -> None:
        """Continue with other settings, on this level and the following ones; ``new_energy``: the energy changes."""
        if self._among_others and self.evolution.stop is not None and self.level == 0:
            self.evolution.history.pop()
        self.set_up(solver)
        energy = self._energy_on(box_at(self.corner, self.surface.shape)) if new_energy else None
        self.evolution = self.evolution.edited(energy, self._setup_here)

    # -- checkpoints ---------------------------------------------------------------------------------------

    def checkpoint(self) -> ObjectCheckpoint:
        """The state between two steps, as a value."""
        made = self.evolution.checkpoint()
        return ObjectCheckpoint(
            self.corner, self.surface.shape, self.leaked, made, self.reactivations
        )

    def restore(self, checkpoint: ObjectCheckpoint, solver: ObjectSolver, new_energy: bool) -> None:
        """Go back to a state of this level, with the settings that were in force then."""
        self.set_up(solver)
        self.leaked = checkpoint.leaked
        self.reactivations = checkpoint.reactivations
        self._stop_requested = False
        energy = None
        if (self.corner, self.surface.shape) != (checkpoint.corner, checkpoint.shape):
            self.corner = checkpoint.corner
            self._evolve(self._surface_of(np.ones(checkpoint.shape, np.float32)), None)
        elif new_energy:
            energy = self._energy_on(box_at(self.corner, self.surface.shape))
        self.evolution.use(self._setup_here, energy)
        self.evolution.restore(checkpoint.evolution)

    def release_to(self, level: int) -> None:
        """Change to a finer level without running there, so that a state of that level can be restored."""
        while self.level > level:
            self.skip_level()
        self._begin_from_start(None)

    def psi_on_finest(self) -> tuple[Corner, NDArray[np.float32]]:
        """First voxel and psi of the surface on the finest level's grid; from a coarse level it is interpolated."""
        corner, psi = to_finest(self.corner, self.surface.psi, self.level, self._inputs.grids)
        bounds = self._clicks.bounds(0, box_at(corner, psi.shape))
        if bounds is not None and not bounds.is_met_by(psi):
            psi = psi.copy()
            bounds.apply(psi)
        return corner, psi


def roomy_box(low: NDArray[np.int64], high: NDArray[np.int64], reach: float, grid: Level) -> Box:
    """Return the box for an object between two voxels: its energy sees the same there as on the whole grid.

    Parameters
    ----------
    low, high : ndarray (3,) of int
        First voxel of the object, and the one after its last.
    reach : float
        How far beyond the object its energy sees the image, mm.
    grid : Level
    """
    a, b, c = (slice(int(i), int(j)) for i, j in zip(low, high, strict=True))
    needed = [max(ROOM, math.ceil(reach / h) + GUARD) for h in grid.spacing]
    room = [
        max(m, math.ceil(_ROOM_PART * (j - i))) for m, i, j in zip(needed, low, high, strict=True)
    ]
    return widened((a, b, c), grid.shape, (room[0], room[1], room[2]))


def _larger_box(
    low: NDArray[np.int64], high: NDArray[np.int64], box: Box, reach: float, grid: Level
) -> Box | None:
    """Return a larger box for an object between two voxels that come near the edge of its box; None where they do not.

    Parameters
    ----------
    low, high, reach, grid
        As for `roomy_box`.
    box : tuple of slice
        The box now.
    """
    first, end = np.array([s.start for s in box]), np.array([s.stop for s in box])
    near = ((low - first < GUARD) & (first > 0)) | (
        (end - high < GUARD) & (end < np.array(grid.shape))
    )
    if not near.any():
        return None
    return roomy_box(np.minimum(low, first + GUARD), np.maximum(high, end - GUARD), reach, grid)


def _psi_on_box(known: NDArray[np.float32], at: Corner, box: Box) -> NDArray[np.float32]:
    """Return psi on a box, known from voxel ``at`` on; beyond the known values everything is outside."""
    psi = np.full(tuple(s.stop - s.start for s in box), farthest(known), np.float32)
    mine, theirs = shared(corner_of(box), psi.shape, at, known.shape)
    psi[mine] = np.minimum(known[theirs], psi[mine])
    return psi


def constrained(
    energy: Energy, mask_distance: NDArray[np.float32] | None, bounds: ClickBounds | None
) -> Energy:
    """Return an energy within a mask and the bounds of clicks, where there are any."""
    if mask_distance is not None:
        energy = MaskConstraint(energy, mask_distance)
    return energy if bounds is None else ClickConstraint(energy, bounds)


class MadeEnergy(NamedTuple):
    """An energy with its ``name`` and the ``terms`` that it is made of, with every setting resolved."""

    energy: Energy
    name: str
    terms: list[dict[str, Any]]


#: Makes the energy of (image, spacing, context).
EnergyMaker = Callable[[NDArray[np.float32], tuple[float, float, float], ImageContext], MadeEnergy]


class ObjectSolver(NamedTuple):
    """Solver of an object under some settings: its ``setup``, the maker of its energy, and the data that this needs."""

    setup: SolverSetup
    make_energy: EnergyMaker
    context: ImageContext


class ObjectCheckpoint(NamedTuple):
    """An object between two steps: first voxel and shape of its grid, and its evolution there; how often it has moved
    again on its level.
    """

    corner: Corner
    shape: tuple[int, int, int]
    leaked: bool
    evolution: Checkpoint
    reactivations: int = 0

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes."""
        return self.evolution.nbytes
