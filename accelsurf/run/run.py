"""A run of one or several objects: preparation, steps, levels, edits, checkpoints."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.evolution import LevelSummary, Step, StepRecord, Stop
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import Corner
from accelsurf.grid.clicks import NO_OBJECT, Click
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.levelset import Workers
from accelsurf.run.checkpoint import RunCheckpoint
from accelsurf.run.ensemble import Ensemble, overall_stop
from accelsurf.run.evolving_object import EvolvingObject, ObjectSolver
from accelsurf.run.image_context import ImageContext
from accelsurf.run.setup import (
    EnergyLike,
    ObjectsLike,
    choose_flow,
    choose_levels,
    energy_key,
    energy_maker,
    seeded,
    setup_of,
    thin_start_warnings,
    thread_count,
)
from accelsurf.run.start import AROUND, start_of_run
from accelsurf.run.start_checks import start_checks
from accelsurf.run.start_pyramid import LevelInputs
from accelsurf.run.window_input import WindowInput
from accelsurf.settings.catalogue import energy_settings
from accelsurf.settings.edits import Edit
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart

__all__ = ["AROUND", "Run"]


class Run:
    """A run of n >= 1 objects; iterate over it to run to the end.

    Between two steps `checkpoint` returns its state, `restore` goes back to one, and `set_edits` changes the edits. An
    edit is applied right before its step.

    Parameters
    ----------
    volume : Volume
    config : RunConfig
    energy : Energy or callable, optional
        In place of the energy that ``config`` names; see `accelsurf.segment`.
    channels : sequence of Volume, optional
        Further channels, before those that ``config`` names.
    objects : str, Volume, ndarray or sequence of ObjectStart, optional
        First voxels of several objects, or their first surfaces, in place of those that ``config`` names.
    arrays : mapping of str to ndarray, optional
        psi (nz, ny, nx) on the image's grid in place of the settings ``start``, ``mask``, ``foreground`` and
        ``background``.
    clicks : sequence of Click, optional
        On the image's grid, besides those that ``config`` names.
    part : WindowInput, optional
        Volume and channels are windows on larger ones, to whose grid the texts of ``config`` belong.
    labels : Volume or ndarray (nz, ny, nx), optional
        Label map whose objects are the result, in place of that which ``config`` names.

    Attributes
    ----------
    config : RunConfig
        As given, with the current edits, and with the seed that was drawn if none was given.
    settings : RunConfig
        The settings in force.
    has_ids : bool
        Whether objects with ids were given: labels are then ids, and none overlap.
    given : tuple of str
        Settings given as arrays in place of texts; ``given_digest`` is their SHA-256. ``energy_given``: the energy.
    prepared : PreprocessedInput
        Image and mask, on the grid of the region of interest.
    objects : tuple of EvolvingObject
        In order of their ids; without the one that competes for the id 0, "no object".
    flow_choice : FlowChoice
        The flow where the settings leave it open.
    window : Window or None
        The part of a larger grid that the volume is.
    level : int
        The present level; 0 is the image's own grid.
    workers : Workers
        To be closed at the end (`close`).
    start_seconds, began : float
        Duration of the preparation, s, and the clock (`time.perf_counter`) at its end.
    """

    def __init__(  # noqa: PLR0913
        self,
        volume: Volume,
        config: RunConfig,
        energy: EnergyLike | None = None,
        channels: Sequence[Volume] = (),
        objects: ObjectsLike | None = None,
        arrays: Mapping[str, NDArray[np.float32]] | None = None,
        clicks: Sequence[Click] = (),
        part: WindowInput | None = None,
        labels: Volume | NDArray[Any] | None = None,
    ) -> None:
        began = time.perf_counter()
        begin = start_of_run(
            volume, seeded(config), channels, objects, arrays, clicks, part, labels
        )
        self.volume = volume
        self.config = begin.config
        self.energy_given = energy
        config = begin.config
        self.settings, self._edits_done = config.model_copy(update={"edit": ()}), 0
        self.has_ids = begin.has_ids
        self.given = begin.given
        self.given_digest = begin.given_digest
        self.prepared = begin.prepared
        starts = begin.starts
        contexts = begin.contexts
        for edit in config.edit:
            self.check(edit)
        self.workers = Workers(thread_count(config))
        named = energy is None or isinstance(energy, str)
        self.window = None if part is None else part.window
        beyond = None if part is None else part.open_window
        grids = choose_levels(
            config, self.geometry, None if self.has_ids else starts[0].psi, named, beyond
        )
        self._levels = len(grids)
        self.flow_choice = choose_flow(config, named)
        self._inputs = LevelInputs(self.prepared.images, self.prepared.mask_distance, grids)
        is_given = self.prepared.other_labels is not None
        self.level_warnings = (
            [] if is_given else thin_start_warnings(starts, self.geometry, self.has_ids)
        )
        is_least = named and begin.at_least
        del begin
        self._max_steps = config.max_steps
        self._all = tuple(
            self._object(place, *start)
            for place, start in enumerate(zip(starts, contexts, strict=True))
        )
        self.objects = tuple(evolving for evolving in self._all if evolving.id != NO_OBJECT)
        self.level_summaries: list[LevelSummary] = []
        self.level = self._levels - 1
        self._ensemble = Ensemble(
            self._all, self.workers, self.geometry.steps, self.has_ids, beyond
        )
        self._stop_requested, self._steps_made = False, 0
        self._begin_first_level()
        if is_given:
            for evolving in self._all:
                evolving.evolution.end_at_once("given", "its surface is that of the label map")
        else:
            for evolving in self._all if is_least else ():
                evolving.evolution.end_at_once(
                    "converged", "it has the voxels that are nearest to its clicks"
                )
            self.level_warnings += start_checks(self._all, starts, self.prepared, self.has_ids)
        moved = self.flow_choice.applied(config)
        self.level_warnings += [
            f"{key} was given, but has no effect on flow {moved.flow} with energy {self.energy_name}"
            for key in moved.unused()
        ]
        self.start_seconds = time.perf_counter() - began
        self.workers.seconds.clear()
        self.began = time.perf_counter()

    def _object(self, place: int, start: ObjectStart, context: ImageContext) -> EvolvingObject:
        return EvolvingObject(
            start,
            self._inputs,
            self._solver(self.settings, place, context),
            Workers(1) if self.has_ids else self.workers,
            self._max_steps,
            self.has_ids,
        )

    def _solver(self, settings: RunConfig, place: int, context: ImageContext) -> ObjectSolver:
        """Return the solver of the object at a position in the run."""
        settings = self.flow_choice.applied(settings)
        make_energy = energy_maker(self.energy_given, settings, self._levels, self.has_ids)
        return ObjectSolver(
            setup_of(settings, place, self._levels, self.geometry), make_energy, context
        )

    @property
    def geometry(self) -> Geometry:
        """The grid of the surfaces on the finest level: that of the region of interest."""
        return self.prepared.geometry

    @property
    def grid(self) -> pyramid.Level:
        """The grid of the present level."""
        return self._inputs.grids[self.level]

    @property
    def energy_name(self) -> str:
        """Name of the energy: that of the settings, or ``custom: ClassName``."""
        return self.objects[0].made.name

    @property
    def stop(self) -> Stop | None:
        """Why the run ended; None while it goes on."""
        stops = [segmented.stop for segmented in self.objects]
        ended = [stop for stop in stops if stop is not None]
        if len(ended) < len(stops):
            return None
        return ended[0] if not self.has_ids else overall_stop(ended)

    @property
    def history(self) -> list[StepRecord]:
        """Every step so far of the first object; see `objects` for the others."""
        return self.objects[0].evolution.history

    # -- to run --------------------------------------------------------------------------------------------

    @property
    def step_number(self) -> int:
        """Number of the step that comes next."""
        return self._steps_made

    @property
    def max_steps(self) -> int:
        """Limit of the steps, on all levels together; those in which an object stands still count too."""
        return self._max_steps

    def extend(self, max_steps: int) -> None:
        """Set the limit of the steps."""
        self._max_steps = max_steps
        for evolving in self._all:
            evolving.set_max_steps(max_steps)

    def request_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._stop_requested = True
        for evolving in self._all:
            evolving.request_stop()

    def close(self) -> None:
        """End the run's threads."""
        self._ensemble.close()
        self.workers.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of each object."""
        while steps := self.step():
            yield from (step for step in steps if step.object_id != NO_OBJECT)

    def step(self) -> tuple[Step, ...]:
        """Apply the edits of the coming step, then make one step of each object that moves.

        Returns
        -------
        tuple of Step
            In the order in which they were made; empty when the run has ended.

        Raises
        ------
        LeavesWindow
            When a surface comes near an open face of the window.
        """
        self.apply_edits()
        left = self._max_steps - self._steps_made
        steps = self._ensemble.step(left, not self._stop_requested) if self.stop is None else ()
        while not steps and self.level > 0:
            self._next_level()
            steps = self._ensemble.step(left, not self._stop_requested)
        if steps:
            self._steps_made += 1
        return steps

    def current(self) -> tuple[Step, ...]:
        """The present state of each object: its last record once it has ended, else a record without motion."""
        steps = []
        for segmented in self.objects:
            now = segmented.evolution
            ended = segmented.stop is not None
            step = Step(now.history[-1], now.surface, now.state.fields) if ended else now.current()
            steps.append(step._replace(object_id=segmented.id))
        return tuple(steps)

    # -- levels --------------------------------------------------------------------------------------------

    def _begin_first_level(self) -> None:
        """Begin on the coarsest level whose grid has voxels inside and outside of each start."""
        while self.level > 0 and not all(evolving.start_is_resolved() for evolving in self._all):
            self._warn("the start is not resolved there", "began")
            self.level_summaries.append(LevelSummary(self.grid, 0, None))
            self.level -= 1
            for evolving in self._all:
                evolving.skip_level()
        self._inputs.release_coarser(self.level)
        for evolving in self._all:
            evolving.start_level()

    def _next_level(self) -> None:
        """Continue every object on the next finer level: from its surface, or from its start if the level failed."""
        for evolving in self._all:
            if (failed := evolving.failed_on_level()) is not None:
                name = f"object {evolving.id}: " if self.has_ids else ""
                self._warn(f"{name}{failed.message}", "went on from the start")
        self.level_summaries.append(self._ensemble.summary(self.grid))
        self.level -= 1
        self._inputs.release_coarser(self.level)
        for evolving in self._all:
            evolving.next_level()

    def summaries(self) -> list[LevelSummary]:
        """The levels so far, coarsest first."""
        return [*self.level_summaries, self._ensemble.summary(self.grid)]

    def _warn(self, event: str, then: str) -> None:
        size = " x ".join(str(n) for n in reversed(self.grid.shape))
        self.level_warnings.append(
            f"level {self.grid.number} ({size} voxels): {event}; the run {then} on the next finer level"
        )

    # -- edits ---------------------------------------------------------------------------------------------

    def apply_edits(self) -> None:
        """Apply the edits that are due and not yet applied; `step` does it too."""
        while self.stop is None and self._edits_done < len(self.config.edit):
            edit = self.config.edit[self._edits_done]
            if edit.step > self.step_number:
                break
            settings = self.settings
            if edit.settings:
                settings = settings.replace(**edit.settings, seed=self.config.seed)
            new_energy = energy_key(settings) != energy_key(self.settings)
            for place, evolving in enumerate(self._all):
                solver = self._solver(settings, place, evolving.context)
                if evolving.takes_edits:
                    evolving.edit(solver, new_energy)
                else:
                    evolving.set_up(solver)
            self.settings, self._edits_done = settings, self._edits_done + 1

    @property
    def edits_done(self) -> int:
        """Number of edits that have been applied."""
        return self._edits_done

    def set_edits(self, edits: tuple[Edit, ...]) -> None:
        """Replace the edits; those that have been applied must stay the same.

        Raises
        ------
        UsageError
            When one is not valid for this run.
        """
        for edit in edits:
            self.check(edit)
        config = seeded(self.config.replace(edit=edits))
        if config.edit[: self._edits_done] != self.config.edit[: self._edits_done]:
            raise ValueError(
                "an edit that has been applied cannot change: restore a state before it first"
            )
        self.config = config

    def check(self, edit: Edit) -> None:
        """Refuse an edit that this run cannot apply.

        Raises
        ------
        UsageError
            When the energy has nothing to learn from, or is one of the user's own, whose settings stay.
        """
        where = f"edit at step {edit.step}"
        terms = EnergyText(str(edit.settings.get("energy", self.config.energy))).terms
        learns = any(term.settings.get("update") == "no" for term in terms)
        if learns and self.prepared.context.foreground is None:
            raise UsageError(
                f"{where}: likelihood:update=no was given, and the run has nothing to learn from",
                "give --foreground to the run, or use update=yes",
            )
        if self.energy_given is None or isinstance(self.energy_given, str):
            return
        for key in edit.settings:
            if key == "energy" or key in energy_settings():
                raise UsageError(
                    f"{where}: {key} was given, but the energy is one of your own",
                    "it has its own settings, which do not change while it runs",
                )

    # -- checkpoints ---------------------------------------------------------------------------------------

    def checkpoint(self) -> RunCheckpoint:
        """The state between two steps, before the edits of the coming one are applied, as a value."""
        return RunCheckpoint(
            self.step_number,
            self.settings,
            self._edits_done,
            self.level,
            tuple(evolving.checkpoint() for evolving in self._all),
            tuple(self.level_summaries),
            tuple(self.level_warnings),
        )

    def restore(self, checkpoint: RunCheckpoint) -> None:
        """Go back to a state of this run; with the same edits the steps that follow are the same, bit for bit.

        Raises
        ------
        ValueError
            When the state is of a coarser level than the present one, whose images have been released.
        """
        if checkpoint.level > self.level:
            raise ValueError(
                f"a checkpoint of level {checkpoint.level} was given, the run is on level {self.level}"
            )
        changed = energy_key(checkpoint.settings) != energy_key(self.settings)
        if checkpoint.level < self.level:
            self.level = checkpoint.level
            self._inputs.release_coarser(self.level)
            for evolving in self._all:
                evolving.release_to(self.level)
        for place, (evolving, state) in enumerate(zip(self._all, checkpoint.objects, strict=True)):
            solver = self._solver(checkpoint.settings, place, evolving.context)
            evolving.restore(state, solver, changed)
        self._stop_requested = False
        self.settings, self._edits_done = checkpoint.settings, checkpoint.edits_done
        self._steps_made = checkpoint.step
        self.level_summaries = list(checkpoint.summaries)
        self.level_warnings = list(checkpoint.warnings)

    def separated(self) -> list[tuple[Corner, NDArray[np.float32]]]:
        """First voxel and psi of each object on the finest grid, cut where it meets another: none overlap."""
        parts = self._ensemble.separated(self.prepared.mask_distance)
        return [
            part
            for evolving, part in zip(self._all, parts, strict=True)
            if evolving.id != NO_OBJECT
        ]
