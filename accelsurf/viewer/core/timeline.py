"""Timeline: a run that can go back and forward over its steps, and the user's changes to it; has no thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.evolution import StepRecord, Stop
from accelsurf.grid.clicks import Side
from accelsurf.image.volume import Volume
from accelsurf.run import Run, RunCheckpoint
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.edits import Edit
from accelsurf.settings.flow_specs import AUTO
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core import saving
from accelsurf.viewer.core.change_log import ChangeLog, Moment, differing, edits_with, in_words
from accelsurf.viewer.core.corrected_run import Corrections
from accelsurf.viewer.core.first_answers import FirstAnswers
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.core.object_commands import ObjectCommands
from accelsurf.viewer.core.restarted import restart_message, restarted
from accelsurf.viewer.core.status import Status


class CheckpointHistory:
    """Checkpoints by step, within a memory budget.

    When the budget is exceeded, the checkpoint goes whose neighbours lie closest together relative to its age; the
    first and the last stay. One can then go back approximately to any step, and one by one over the last steps.

    Parameters
    ----------
    budget_mb : float
        Memory for the checkpoints, MB (10^6 bytes); at least two are stored whatever they take.
    """

    def __init__(self, budget_mb: float) -> None:
        self.budget = budget_mb * 1e6
        self._checkpoints: dict[int, RunCheckpoint] = {}
        self._bytes = 0

    @property
    def steps(self) -> tuple[int, ...]:
        """The steps that have a checkpoint, in order."""
        return tuple(self._checkpoints)

    @property
    def nbytes(self) -> int:
        """Memory that the checkpoints take."""
        return self._bytes

    @property
    def last(self) -> RunCheckpoint | None:
        """The checkpoint of the last step; None without any."""
        return self._checkpoints[max(self._checkpoints)] if self._checkpoints else None

    def __len__(self) -> int:
        return len(self._checkpoints)

    def __iter__(self) -> Iterator[RunCheckpoint]:
        return iter(self._checkpoints.values())

    def add(self, checkpoint: RunCheckpoint) -> None:
        """Store a checkpoint, unless there is one of that step already, which is the same."""
        if checkpoint.step in self._checkpoints:
            return
        self._checkpoints[checkpoint.step] = checkpoint
        self._bytes += checkpoint.nbytes
        steps = list(self._checkpoints)
        if steps[-2:] != sorted(steps[-2:]):
            self._checkpoints = dict(sorted(self._checkpoints.items()))
        while self._bytes > self.budget and len(self._checkpoints) > 2:
            self._thin_out()

    def nearest(self, step: int, level: int) -> RunCheckpoint | None:
        """Return the last checkpoint at or before a step that is of this level."""
        found = [c for c in self if c.step <= step and c.level == level]
        return found[-1] if found else None

    def drop_after(self, step: int) -> None:
        """Forget the checkpoints after a step."""
        for later in [other for other in self._checkpoints if other > step]:
            self._bytes -= self._checkpoints.pop(later).nbytes

    def clear(self) -> None:
        """Forget all checkpoints."""
        self._checkpoints, self._bytes = {}, 0

    def _thin_out(self) -> None:
        steps = list(self._checkpoints)
        last = steps[-1]
        gaps = {
            at: (after - before) / (last - at + 2.0)
            for before, at, after in zip(steps, steps[1:], steps[2:], strict=False)
        }
        dropped = min(gaps, key=lambda at: gaps[at])
        self._bytes -= self._checkpoints.pop(dropped).nbytes


#: Why an object has ended for good: there is nothing to continue from.
FINAL_REASONS = ("vanished", "filled", "diverged", "leaked")


class Timeline:
    """A run, its checkpoints and its past changes.

    A checkpoint is taken at each step, before the edits of that step. Going back keeps the later checkpoints and
    edits, so playing on makes the same steps again; a change made then replaces them. Clicks after the run's end are
    corrections, made near them at once; when the run goes on again, they are made again at its next end.

    Parameters
    ----------
    volume : Volume
    config : RunConfig
    checkpoint_mb : float
        Memory for checkpoints, MB.
    channels : sequence of Volume, optional
        Further channels of the image.
    on_progress : callable, optional
        Called with a line while a correction is made.

    Attributes
    ----------
    run : Run
    checkpoints : CheckpointHistory
    corrections : Corrections
    log : ChangeLog
    objects : ObjectCommands
    answers : FirstAnswers
    """

    def __init__(
        self,
        volume: Volume,
        config: RunConfig,
        checkpoint_mb: float,
        channels: Sequence[Volume] = (),
        on_progress: Callable[[str], None] | None = None,
    ) -> None:
        self.volume, self._channels = volume, tuple(channels)
        self.checkpoints = CheckpointHistory(checkpoint_mb)
        self._playing = False
        self._last_step = -1
        self._message = ""
        self.log, self.corrections = ChangeLog(), Corrections(config.refine, on_progress)
        self._written: set[Path] = set()
        self.objects, self.answers = ObjectCommands(self, config), FirstAnswers()
        #: Whether a ball in the middle is meant, which is the start where none is given.
        self._means_middle = "start" in config.model_fields_set
        self.run = Run(volume, config.replace(refine=()), None, self._channels)
        self._present = self.run.checkpoint()
        self.checkpoints.add(self._present)

    # -- where it stands ----------------------------------------------------------------------------------

    @property
    def step_number(self) -> int:
        """Steps made so far."""
        return self._present.step

    @property
    def is_playing(self) -> bool:
        """True if more steps are to be made, by `step`."""
        return self._playing

    @property
    def message(self) -> str:
        """One line: the last action."""
        return self._message

    def say(self, message: str) -> None:
        """Have another `message`."""
        self._message = message

    @property
    def stop(self) -> Stop | None:
        """Why the run, or the last correction, ended; None while it goes on."""
        return self.corrections.stop(self.run)

    @property
    def has_begun(self) -> bool:
        """True if a start, clicks or labels were given: until then the run has a start that nobody asked for."""
        config = self.run.config
        given = config.inside or config.objects or config.labels
        return self._means_middle or bool(given) or config.start != default_of("start")

    def _check_begun(self, what: str) -> None:
        if not self.has_begun:
            raise UsageError(
                f"there is no object yet to {what}", "press in it and drag until the outline fits"
            )

    def picture(self, max_voxels: int | None) -> tuple[Frame, tuple[tuple[StepRecord, ...], ...]]:
        """Return the frame, see `Frame.of_run`, and each object's records up to it; nothing before it has begun."""
        if not self.has_begun:
            return Frame(()), ()
        return self.corrections.picture(self.run, max_voxels)

    def status(self, message: str, failed: bool) -> Status:
        """Return the status of a session with this self."""
        return Status(
            ready=True,
            playing=self.is_playing,
            step=self.step_number,
            checkpoints=self.checkpoints.steps,
            settings=self.run.settings,
            edits=self.run.config.edit,
            stop=self.stop,
            message=message,
            failed=failed,
            undoable=self.log.undoable,
            objects=self.objects.ids if self.objects.has_ids else (),
            labels=self.objects.labels,
            object_words=self.objects.words if self.has_begun else {},
            redoable=self.log.redoable,
            refinements=self.corrections.wanted,
            changes=self.log.lines,
            plateaus=self._plateaus(),
            terms=self.run.objects[0].made.terms,
            answers=self.answers.offered(self.run, self.corrections.wanted),
            flow_why=self.run.flow_choice.why if self.run.settings.flow == AUTO else "",
            has_begun=self.has_begun,
            config=self._config(),
        )

    def _config(self) -> RunConfig:
        """Return the configuration of the run, with the names and colours that objects have now."""
        named = self.objects.named_settings(self.run.config)
        return self.run.config.replace(**named) if named else self.run.config

    def _plateaus(self) -> tuple[int, ...]:
        """Return the steps in which an object was on a plateau before it broke through, also those ahead that were
        made.
        """
        last = self.checkpoints.last
        watches = [evolving.evolution.state.plateaus for evolving in self.run.objects]
        watches += [
            segmented.evolution.loop.plateaus
            for segmented in (last.objects if last is not None else ())
        ]
        return tuple(sorted({plateau.step for watch in watches for plateau in watch.found}))

    def close(self) -> None:
        """End the run's threads."""
        self.pause()
        self.run.close()

    # -- play and pause -----------------------------------------------------------------------------------

    def step(self) -> None:
        """Make one step; pause when the run has ended or the wanted step is reached."""
        self.run.step()
        stop = self.run.stop
        if stop is not None:
            self._playing, self._message = False, f"{stop.reason}: {stop.message}"
            self._message = self.corrections.correct_again(self.run).line or self._message
            return
        self._add_checkpoint()
        if 0 <= self._last_step <= self.step_number:
            self._playing = False

    def play(self, last_step: int = -1) -> None:
        """Have steps made until there are ``last_step``, or with -1 until the end; a converged run continues.

        Raises
        ------
        UsageError
            When there is no surface, or none is left.
        """
        self._check_begun("run")
        run = self.run
        stop = run.stop
        if self._is_given:
            raise UsageError(
                "the surface is that of a label map, which clicks alone change",
                "click where it is wrong",
            )
        if stop is not None and all(reason in FINAL_REASONS for reason in self._reasons()):
            raise UsageError(
                f"the run has ended: {stop.message}", "go back, change the settings, or restart"
            )
        if stop is not None and "max-steps" in self._reasons():
            run.restore(self._present)
        elif stop is not None:
            self._replace_edits((*self._edits_so_far(), Edit(step=self.step_number)), "runs on")
        if self.step_number >= run.max_steps:
            run.extend(self.step_number + max(run.config.max_steps, 1))
        if 0 <= last_step <= self.step_number:
            if not self._playing:
                return
            # It plays without an end: one more step, then it pauses.
            last_step = self.step_number + 1
        self._playing = True
        self._last_step = last_step
        self._message = ""
        self.corrections.leave()

    def go_on(self, last_step: int) -> None:
        """Make the steps and corrections again with which an earlier session ended, see `Session.go_on`."""
        if self.run.stop is not None:
            self._message = self.corrections.correct_again(self.run).line or self._message
        elif last_step:
            self.play(last_step)

    def _reasons(self) -> list[str]:
        """Why the objects that have ended did."""
        return [evolving.stop.reason for evolving in self.run.objects if evolving.stop is not None]

    @property
    def _is_given(self) -> bool:
        """True if the run is of a label map, which corrections alone change."""
        return self.run.prepared.other_labels is not None

    def single_step(self) -> None:
        """Have one step more made than was asked for; pause after it."""
        self.play(1 + (self._last_step if self._playing else self.step_number))

    def pause(self) -> None:
        """Have no more steps made."""
        self._playing, self._last_step = False, -1

    def apply_edits(self) -> None:
        """Apply the edits of the present step, so that their effect is seen; not while it plays, which does that."""
        if not self._playing:
            self.run.apply_edits()

    # -- back and forward ---------------------------------------------------------------------------------

    def go_to(self, step: int) -> None:
        """Go back, or forward again, to a step that has been made.

        Raises
        ------
        UsageError
            When the step has not been made.
        """
        if not 0 <= step:
            raise UsageError(f"step {step} was given, expected a number at least 0")
        last = max((self.step_number, *self.checkpoints.steps))
        if step > last:
            raise UsageError(
                f"step {step} was given, expected at most {last}", "make more steps first"
            )
        self.pause()
        self._restore(step)
        self._message = f"step {step}"

    def restart(self) -> None:
        """Go to the start and forget all edits and corrections but the settings in force."""
        run, before = self.run, self._now()
        config = run.config
        changed = differing(config.at(-1), run.settings)
        changed.pop("seed", None)
        self.pause()
        self._restore(0)
        edits = (Edit(step=0, **changed),) if changed else ()
        if edits != config.edit:
            self._replace_edits(edits, "restart")
        elif before.refinements:
            self.log.add(before, "restart")
        self.corrections.want(())
        self._message = "at the start"

    def _restore(self, step: int) -> None:
        """Restore the state before the edits of a step: from the last checkpoint before it, steps are made again."""
        self.corrections.leave()
        run = self.run
        present = self._present if step == self.step_number else None
        checkpoint = present or self.checkpoints.nearest(step, self._present.level)
        if checkpoint is None:
            self._replace_run(run.config)
        else:
            run.restore(checkpoint)
            self._present = checkpoint
        self._catch_up(step)

    def _catch_up(self, step: int) -> None:
        """Have steps made up to one that was made before."""
        if self.step_number < step:
            self._playing, self._last_step = True, step

    def _add_checkpoint(self) -> None:
        """Take a checkpoint before the edits of the coming step."""
        checkpoint = self.run.checkpoint()
        if checkpoint.level != self._present.level:
            # Checkpoints of a coarser level cannot be restored on this one.
            self.checkpoints.clear()
        self._present = checkpoint
        self.checkpoints.add(checkpoint)

    def _replace_run(self, config: RunConfig) -> None:
        """Begin another run; the present one stays until that one is ready."""
        before, self.run = (
            self.run,
            Run(self.volume, config.replace(refine=()), None, self._channels),
        )
        before.close()
        self.corrections.leave()
        self.checkpoints.clear()
        self._present = self.run.checkpoint()
        self.checkpoints.add(self._present)

    # -- changes ------------------------------------------------------------------------------------------

    def change(self, settings: dict[str, Any]) -> None:
        """Change settings from here on.

        Raises
        ------
        UsageError
            When a setting is not valid; nothing is changed then.
        """
        run = self.run
        step = self.step_number
        edits = self._edits_so_far()
        run.check(Edit(step=step, **settings))
        altered, said = edits_with(run.config, edits, step, settings), in_words(settings)
        if altered != edits:
            self._replace_edits(altered, said)
        self._message = said

    def add_click(self, side: Side, where: tuple[str, ...], object_id: int | None = None) -> None:
        """Say of voxels that they are in the object, or are not, see `Session.add_click`.

        Raises
        ------
        UsageError, InputError
            When one is no place or lies outside, or nothing would be left that is clicked inside.
        """
        if not self.has_begun and side == "inside":
            return self.objects.begin_with(where, clicks_in_words(side, where))
        self._check_begun("click outside of")
        object_id = self._whose(where[0], object_id)
        if object_id is not None and object_id not in self.objects.ids:
            return self.objects.begin_object(object_id, side, where)
        clicks = {side: list(where), "object": object_id}
        (refinement,), said = (
            RunConfig(refine=[clicks]).refine,
            clicks_in_words(side, where, object_id),
        )
        if self.run.stop is None and self.run.level > 0:  # a coarse surface is not corrected
            return self.refine(clicks, said)
        before, moves, limit = self._now(), self.run.stop is None, self.run.max_steps
        lost = ""
        if moves:  # it ends at the present step: the surface that is seen is corrected
            self.run.extend(self.step_number)
            self.run.step()
            again = self.corrections.correct_again(self.run)
            lost = f"; {again.line}" if again.failed else ""
        try:
            self._message = self.corrections.correct(self.run, refinement, said) + lost
        except AccelsurfError:
            if moves:  # it goes on as if nothing had been clicked
                self.corrections.leave()
                self.corrections.want(before.refinements)
                self.run.extend(limit)
                self.run.restore(self._present)
            raise
        if moves:
            self.pause()
            self.checkpoints.drop_after(self.step_number)
        self.log.add(before, said)

    def reach_of(
        self, side: Side, where: tuple[str, ...], object_id: int | None = None
    ) -> float | None:
        """Return how far from the clicks an object may change, mm, see `Session.reach_of`.

        Raises
        ------
        UsageError, InputError
            When the first is no place or lies outside.
        """
        if not self.has_begun or (object_id is not None and object_id not in self.objects.ids):
            return None
        clicks = {side: list(where), "object": self._whose(where[0], object_id)}
        (refinement,) = RunConfig(refine=[clicks]).refine
        try:
            return self.corrections.reach_of(self.run, refinement)
        except AccelsurfError:
            return None  # the click itself raises the error

    def _whose(self, place: str, object_id: int | None) -> int | None:
        """Return the object that a click is for, see `Session.add_click`; None where there is one without an id."""
        return (
            self.corrections.nearest(self.run, place)
            if object_id is None
            else self.objects.named(object_id)
        )

    def refine(self, correction: dict[str, Any], said: str) -> None:
        """Make a correction of the run's end, all or nothing; while the run goes on, it goes on to its end first."""
        (refinement,) = RunConfig(refine=[correction]).refine
        before = self._now()
        if self.run.stop is None:
            self.corrections.want((*self.corrections.wanted, refinement))
            self.play()
            self._message = f"{said}: when the run has ended"
        else:
            self._message = self.corrections.correct(self.run, refinement, said)
        self.log.add(before, said)

    def start_from(self, start: tuple[str, ...]) -> None:
        """Begin another run, with the settings in force."""
        self.start_with({"start": start}, "start: " + " + ".join(start))

    def restart_with(self, settings: dict[str, Any]) -> None:
        """Begin another run with other settings and the same clicks, see `Session.restart_with`."""
        before = self.run.settings
        config = restarted(before, self.corrections.wanted, settings, self.run.has_ids)
        self._begin_again(config, restart_message(before, config))

    def start_with(self, settings: dict[str, Any], said: str) -> None:
        """Begin another run, with other settings besides those in force."""
        self._begin_again(self.run.settings.replace(**settings), said)

    def _begin_again(self, config: RunConfig, message: str) -> None:
        """Begin another run, which can be undone."""
        before = self._now()
        self.pause()
        self._replace_run(config)
        self._message = message
        self.log.add(before._replace(step=0), message)
        self.corrections.want(config.refine)

    def undo(self) -> None:
        """Undo the last change, and go to the step where it was made; UsageError when there is none."""
        self._go_back_to(self.log.undo(self._now()))
        self._message = f"undid the last change, at step {self.step_number}"

    def redo(self) -> None:
        """Make the change again that was undone last; UsageError when there is none."""
        self._go_back_to(self.log.redo(self._now()))
        self._message = f"made the undone change again, at step {self.step_number}"

    def go_to_change(self, count: int) -> None:
        """Undo changes, or make them again, until the first ``count`` are in force; in one go.

        Raises
        ------
        UsageError
            When there are fewer changes.
        """
        if count != self.log.undoable:
            self._go_back_to(self.log.move_to(count, self._now()))
        self._message = f"after change {count}" if count else "before all changes"

    def _now(self) -> Moment:
        """Return settings and corrections in force, before a change at the present step."""
        return Moment(self.run.config, self.step_number, self.corrections.wanted)

    def _go_back_to(self, moment: Moment) -> None:
        """Go to the settings and corrections of a moment; a correction alone is made, or taken back, at once."""
        run = self.run
        config = moment.config
        step = moment.step
        if config == run.config and self.corrections.go_to(run, moment.refinements):
            return
        self.corrections.want(moment.refinements)
        self.pause()
        checkpoint = self.checkpoints.nearest(min(step, self.step_number), self._present.level)
        if config.at(-1) != run.config.at(-1) or checkpoint is None:
            self._replace_run(config)
        else:
            step = min(step, self.step_number)
            self.checkpoints.drop_after(step)
            self._restore(step)
            run.set_edits(config.edit)
        self._catch_up(step)

    def _edits_so_far(self) -> tuple[Edit, ...]:
        return tuple(edit for edit in self.run.config.edit if edit.step <= self.step_number)

    def _replace_edits(self, edits: tuple[Edit, ...], said: str) -> None:
        """Continue with other edits from the present step; the steps made after it are forgotten."""
        run = self.run
        step = self.step_number
        before = self._now()
        if edits == before.config.edit and run.stop is None:
            return
        for edit in edits:
            if edit.step >= step:
                run.check(edit)
        before.config.replace(edit=edits)
        if run.stop is not None or run.edits_done > self._present.edits_done:
            run.restore(self._present)
        run.set_edits(edits)
        self.checkpoints.drop_after(step)
        self.corrections.leave()
        self.log.add(before, said)

    # -- files --------------------------------------------------------------------------------------------

    def save(
        self,
        folder: Path,
        name: str,
        source: Path | None,
        what: tuple[str, ...],
        overwrite: bool,
        mesh: str = "",
    ) -> list[Path]:
        """Write files, see `saving.save`; those written before may be replaced."""
        self._check_begun("save")
        self.run.apply_edits()
        known = None if overwrite else self._written
        result = self.corrections.result() or saving.present_result(self.run)
        others = self.objects.named_settings(self.run.config) | ({"mesh": (mesh,)} if mesh else {})
        written = saving.save(result, folder, name, source, what, known, others, self._channels)
        self._written.update(written)
        self._message = f"saved {len(written)} files in {folder}"
        return written


def clicks_in_words(side: Side, where: Sequence[str], object_id: int | None = None) -> str:
    """Return the clicks of one stroke in words.

    Examples
    --------
    >>> clicks_in_words("inside", ["ball:1,2,3,4"])
    'inside: ball:1,2,3,4'
    >>> clicks_in_words("outside", ["path:1,2,3,4;5,6,7,4"], 2)
    'outside: stroke of 2 places, object 2'
    """
    whose = "" if object_id is None else f", object {object_id}"
    if len(where) == 1 and where[0].startswith("path:"):
        return f"{side}: stroke of {where[0].count(';') + 1} places{whose}"
    more = f" and {len(where) - 1} more" if len(where) > 1 else ""
    return f"{side}: {where[0]}{more}{whose}"
