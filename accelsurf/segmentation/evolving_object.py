"""One object of a run: its surface on a box of the present level's grid, its energy and its flow."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.energies.constraints.contact import Neighbour, NonOverlap
from accelsurf.energies.constraints.mask import MaskConstraint
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.multilevel import FAILED, prolong_surface, rule_on_level
from accelsurf.evolution.records import Step, Stop
from accelsurf.evolution.setup import SolverSetup
from accelsurf.evolution.state import LoopState
from accelsurf.flows import Flow
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, shared, widened
from accelsurf.grid.pyramid import Level
from accelsurf.initialization.object_starts import ObjectStart
from accelsurf.levelset import LevelSet, Workers
from accelsurf.levelset.transfer import shift_fields
from accelsurf.segmentation.balls import BallEdit, apply_balls
from accelsurf.segmentation.image_context import ImageContext
from accelsurf.segmentation.level_arrays import LevelInputs
from accelsurf.segmentation.object_records import EnergyMaker, MadeEnergy, ObjectCheckpoint
from accelsurf.segmentation.start_pyramid import StartPyramid, finer_box, to_finest

#: Margin of an object's box around the object: at least `ROOM` voxels and the fraction `ROOM_PART` of its extent; the
#: box is made larger when the band comes within `GUARD` voxels of its edge.
ROOM, ROOM_PART, GUARD = 10, 0.5, 3


class EvolvingObject:
    """An object that evolves, alone or among others.

    Parameters
    ----------
    start : ObjectStart
        On the whole grid for a single object.
    inputs : LevelInputs
        Images and mask by level.
    context : ImageContext
        Data of the image that its energy needs.
    setup : SolverSetup
    make_energy : callable
        Makes a `MadeEnergy` of (image, spacing, context).
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
        context: ImageContext,
        setup: SolverSetup,
        make_energy: EnergyMaker,
        workers: Workers,
        max_steps: int,
        among_others: bool,
    ) -> None:
        self.id, self.workers, self.context = start.id, workers, context
        self.leaked = False
        self._inputs, self._setup, self._make_energy = inputs, setup, make_energy
        self._among_others = among_others
        self._max_steps, self._stop_requested = max_steps, False
        self._starts = StartPyramid(start, inputs.grids)
        self.corner: Corner = (0, 0, 0)
        self.made: MadeEnergy
        self.evolution: Evolution

    # -- what it is ----------------------------------------------------------------------------------------

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
        """Whether it has not stopped on this level."""
        return self.evolution.stop is None

    @property
    def stop(self) -> Stop | None:
        """Why it ended; None while it goes on, on this level or the next."""
        stop = self.evolution.stop
        if stop is None or self.level > 0:
            return None
        if self.leaked and stop.reason == "interrupted":
            message = f"the object grew beyond {self._setup.max_volume:g} mm3, its largest allowed volume"
            return stop._replace(reason="leaked", message=message)
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
        """What its neighbours need to know of it."""
        return Neighbour(self.surface, self.corner, self.contact, self.flow)

    def extent(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel of the band and the one after its last, on the level's grid; an empty box without a band."""
        if self.surface.size == 0:
            return np.array(self.corner), np.array(self.corner)
        index = np.unravel_index(self.surface.band.cells, self.surface.shape)
        low, high = ([int(f(i)) + c for i, c in zip(index, self.corner, strict=True)] for f in (np.min, np.max))
        return np.array(low), np.array(high) + 1

    # -- starts and levels ---------------------------------------------------------------------------------

    def start_is_resolved(self) -> bool:
        """Whether the start has something inside and outside on the present level."""
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
            self._evolve(self._surface_of(psi), state)
            return
        inside = np.argwhere(psi < 0)
        low, high = inside.min(axis=0) + corner, inside.max(axis=0) + 1 + corner
        self._lay_out(self._boxed(low, high), psi, corner, None, state)

    def next_level(self) -> None:
        """Continue on the next finer level, from the surface here, or from the start if this level failed."""
        before, coarse = self.evolution, self.grid
        if before.stop is None:
            raise ValueError(f"object {self.id} has not ended on level {self.level}")
        self._starts.to_finer()
        if before.stop.reason in FAILED:
            self._begin_from_start(before.state.on_next_grid(with_fields=False))
            return
        self._starts.release()
        mine = coarse.on_box(self.corner, before.surface.shape)
        self.corner, shape = finer_box(self.corner, before.surface.shape, coarse, self.grid)
        theirs = self.grid.on_box(self.corner, shape)
        surface, fields = prolong_surface(before.surface, before.flow, mine, theirs, self._setup.half_width)
        self._evolve(surface, before.state.on_next_grid(with_fields=True), fields)

    def failed_on_level(self) -> Stop | None:
        """Why the level left no surface to continue from; None if it left one."""
        stop = self.evolution.stop
        return stop if stop is not None and stop.reason in FAILED else None

    def steps_on_level(self) -> int:
        """Steps made on the present level."""
        return sum(record.level == self.level and record.dt > 0 for record in self.evolution.history)

    # -- on a grid -----------------------------------------------------------------------------------------

    def _boxed(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> Box:
        """The box for an object between two voxels: its energy sees there what it sees on the whole grid."""
        a, b, c = (slice(int(i), int(j)) for i, j in zip(low, high, strict=True))
        needed = [max(ROOM, math.ceil(self._setup.reach / h) + GUARD) for h in self.grid.spacing]
        room = [max(m, math.ceil(ROOM_PART * (j - i))) for m, i, j in zip(needed, low, high, strict=True)]
        return widened((a, b, c), self.grid.shape, (room[0], room[1], room[2]))

    def _surface_of(self, psi: NDArray[np.float32]) -> LevelSet:
        """The surface where ``psi``, on a box of the grid, is 0; the memory of ``psi`` is used."""
        setup = self._setup
        return LevelSet(psi, self.grid.spacing, setup.half_width, self.workers, True, setup.extension)

    def _lay_out(
        self, box: Box, known: NDArray[np.float32], at: Corner, before: Evolution | None, state: LoopState | None
    ) -> None:
        """Transfer the surface, known from voxel ``at`` on, to a box of the grid, and continue ``before`` there."""
        self.corner = corner_of(box)
        # Beyond the known values everything is outside.
        psi = np.full(tuple(s.stop - s.start for s in box), np.abs(known[np.isfinite(known)]).max(), np.float32)
        mine, theirs = shared(self.corner, psi.shape, at, known.shape)
        psi[mine] = np.minimum(known[theirs], psi[mine])
        distance = self._inputs.mask_distance(self.level, box)
        if distance is not None:
            np.maximum(psi, distance, out=psi)
        surface = self._surface_of(psi)
        fields = None
        if before is not None:
            fields = shift_fields(before.flow.fields, before.surface, at, surface, self.corner)
        self._evolve(surface, state, fields)

    def _evolve(
        self,
        surface: LevelSet,
        state: LoopState | None,
        fields: list[NDArray[np.float32]] | None = None,
        energy: Energy | None = None,
    ) -> None:
        """Begin an evolution on a surface, with a new energy for its grid unless one is given."""
        setup = self._setup
        self.evolution = Evolution(
            surface,
            self._energy_on(box_at(self.corner, surface.shape)) if energy is None else energy,
            setup.flow,
            setup.limits,
            self._max_steps,
            setup.restart,
            rule_on_level(setup.rule, self.level),
            self.level,
            state,
            fields,
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
        self.made = self._make_energy(images[0], self.grid.spacing, self.context.with_channels(images[1:]))
        energy, distance = self.made.energy, inputs.mask_distance(self.level, box)
        if distance is not None:
            energy = MaskConstraint(energy, distance)
        return NonOverlap(energy, self.corner) if self._among_others else energy

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

    def grow_grid(self, low: NDArray[np.int64] | None = None, high: NDArray[np.int64] | None = None) -> None:
        """Change to a larger box when the band, or the part from ``low`` to ``high``, comes near its edge."""
        if low is None or high is None:
            low, high = self.extent()
        corner, shape = np.array(self.corner), np.array(self.surface.shape)
        ends = np.array(self.grid.shape)
        near = ((low - corner < GUARD) & (corner > 0)) | ((corner + shape - high < GUARD) & (corner + shape < ends))
        if near.any():
            box = self._boxed(np.minimum(low, corner + GUARD), np.maximum(high, corner + shape - GUARD))
            before, at = self.evolution, self.corner
            before.measure()
            self._lay_out(box, before.surface.psi, at, before, before.state.on_next_grid(with_fields=True))

    def reactivate(self) -> None:
        """Continue after convergence, because a neighbour moved into the object."""
        before = self.evolution
        if self.level == 0:
            # The record of the final state: it is not final any more.
            before.history.pop()
        state = before.state.on_next_grid(with_fields=True)
        self._evolve(before.surface, state, before.flow.fields, before.energy)

    # -- edits ---------------------------------------------------------------------------------------------

    def set_max_steps(self, max_steps: int) -> None:
        """Set the limit of the steps of all levels together."""
        self._max_steps = self.evolution.max_steps = max_steps

    @property
    def takes_edits(self) -> bool:
        """Whether it evolves, or has converged or stalled and can evolve again."""
        stop = self.evolution.stop
        return stop is None or (stop.reason in ("converged", "stalled") and self.surface.size > 0)

    def set_up(self, setup: SolverSetup, make_energy: EnergyMaker) -> None:
        """Have another set-up and energy on the following levels."""
        self._setup, self._make_energy = setup, make_energy

    def edit(
        self, setup: SolverSetup, make_energy: EnergyMaker, new_energy: bool, balls: tuple[BallEdit, ...]
    ) -> None:
        """Continue with other settings, and with balls added to the object or removed from it.

        Parameters
        ----------
        setup : SolverSetup
            Of this level and the following ones.
        make_energy : callable
            Of the following levels, and of this one if the energy changes.
        new_energy : bool
            Whether the energy changes.
        balls : tuple of Ball
        """
        if self._among_others:
            for ball in balls:
                if ball.kind == "add":
                    self._make_room(ball)
            if self.evolution.stop is not None and self.level == 0:
                self.evolution.history.pop()
        self.set_up(setup, make_energy)
        energy = self._energy_on(box_at(self.corner, self.surface.shape)) if new_energy else None
        self.evolution = self.evolution.edited(
            energy,
            setup.flow,
            setup.limits,
            setup.restart,
            rule_on_level(setup.rule, self.level),
            setup.half_width,
            (lambda surface: self._change_psi(surface, balls)) if balls else None,
        )

    def _make_room(self, ball: BallEdit) -> None:
        """Make the box large enough for a ball."""
        low, high = ball.extent(self.grid)
        own_low, own_high = self.extent()
        if self.surface.size:
            low, high = np.minimum(low, own_low), np.maximum(high, own_high)
        self.grow_grid(low, high)

    def _change_psi(self, surface: LevelSet, balls: tuple[BallEdit, ...]) -> None:
        """Add balls to the object or remove them from it, within the mask."""
        psi = surface.dense.psi.reshape(surface.shape)
        apply_balls(psi, balls, self.grid, self.corner, float(surface.gamma))
        distance = self._inputs.mask_distance(self.level, box_at(self.corner, self.surface.shape))
        if distance is not None:
            np.maximum(psi, distance, out=psi)

    # -- checkpoints ---------------------------------------------------------------------------------------

    def checkpoint(self) -> ObjectCheckpoint:
        """The state between two steps, as a value."""
        return ObjectCheckpoint(self.corner, self.surface.shape, self.leaked, self.evolution.checkpoint())

    def restore(
        self, checkpoint: ObjectCheckpoint, setup: SolverSetup, make_energy: EnergyMaker, new_energy: bool
    ) -> None:
        """Go back to a state of this level, with the settings that were in force then."""
        self.set_up(setup, make_energy)
        self.leaked, self._stop_requested = checkpoint.leaked, False
        now = self.evolution
        if (self.corner, now.surface.shape) != (checkpoint.corner, checkpoint.shape):
            self.corner = checkpoint.corner
            empty = np.ones(checkpoint.shape, np.float32)
            self._evolve(self._surface_of(empty), None)
            now = self.evolution
        elif new_energy:
            now.energy = self._energy_on(box_at(self.corner, self.surface.shape))
        now.flow, now.limits, now.restart = setup.flow, setup.limits, setup.restart
        now.rule = rule_on_level(setup.rule, self.level)
        now.restore(checkpoint.evolution)

    def release_to(self, level: int) -> None:
        """Change to a finer level without running there, so that a state of that level can be restored."""
        while self.level > level:
            self.skip_level()
        self._begin_from_start(None)

    def psi_on_finest(self) -> tuple[Corner, NDArray[np.float32]]:
        """First voxel and psi of the surface on the finest level's grid; from a coarse level it is interpolated."""
        return to_finest(self.corner, self.surface.psi, self.level, self._inputs.grids)
