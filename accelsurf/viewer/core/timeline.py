"""Timeline: a run that goes to and fro over its steps, and the changes that make it what it is; without a thread."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.grid.volume import Volume
from accelsurf.segmentation.run import Run, RunCheckpoint
from accelsurf.settings.edits import Edit
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core import saving
from accelsurf.viewer.core.history import CheckpointHistory

#: Why a run ended for good: there is nothing to go on from.
ENDED = ("vanished", "filled", "diverged", "leaked")


class Timeline:
    """A run, its kept states and its past changes.

    A state is kept at each step, before the edits of that step. Going back keeps what comes after, edits too, so going
    on makes the same steps again; a change made then takes their place.

    Parameters
    ----------
    volume : Volume
    config : RunConfig
    kept_mb : float
        Memory for kept states, MB.
    channels : sequence of Volume, optional
        Further channels of the image.

    Attributes
    ----------
    run : Run
    kept : CheckpointHistory
    running : bool
        Whether more steps are to be made (by `advance`).
    until : int
        Step to rest at; -1: none.
    message : str
        One line: what was done last.
    """

    def __init__(
        self, volume: Volume, config: RunConfig, kept_mb: float, channels: Sequence[Volume] = ()
    ) -> None:
        self.volume, self._channels, self.kept = volume, tuple(channels), CheckpointHistory(kept_mb)
        self.running, self.until, self.message = False, -1, ""
        self._past: list[tuple[RunConfig, int]] = []
        self._own: set[Path] = set()
        self._here: RunCheckpoint
        self.run = Run(volume, config, None, self._channels)
        self._arrive()

    @property
    def place(self) -> int:
        """Steps made so far."""
        return self._here.step

    @property
    def undoable(self) -> int:
        """How many changes can be taken back."""
        return len(self._past)

    def close(self) -> None:
        """End the run's threads."""
        self.run.workers.close()

    def advance(self) -> None:
        """Make one step, and rest when the run has ended or the wanted step is there."""
        self.run.step()
        stop = self.run.stop
        if stop is not None:
            self.running, self.message = False, f"{stop.reason}: {stop.message}"
            return
        self._keep()
        if 0 <= self.until <= self.place:
            self.running = False
            self.settle()

    def settle(self) -> None:
        """Apply the edits of the present step to a run that rests, so that they are seen."""
        if not self.running:
            self.run.apply()

    def _build(self, config: RunConfig) -> None:
        """Begin another run; the present one goes on to exist until that one is ready."""
        before, self.run = self.run, Run(self.volume, config, None, self._channels)
        before.workers.close()
        self._arrive()

    def _arrive(self) -> None:
        """At the start of a run."""
        self.kept.clear()
        self._here = self.run.checkpoint()
        self.kept.add(self._here)

    def _keep(self) -> None:
        """Keep the state before the edits of the coming step."""
        state = self.run.checkpoint()
        if state.level != self._here.level:
            # States of a coarser level cannot be taken back on this one.
            self.kept.clear()
        self._here = state
        self.kept.add(state)

    def go_on(self, until: int) -> None:
        """Have steps made until so many are, or with -1 until the end; one that has converged goes on all the same.

        Raises
        ------
        UsageError
            When there is no surface left.
        """
        run = self.run
        stop = run.stop
        if stop is not None and stop.reason in ENDED:
            raise UsageError(f"the run has ended: {stop.message}", "go back, change the settings, or restart")
        if stop is not None and stop.reason == "max-steps":
            run.restore(self._here)
        elif stop is not None:
            self._edit((*self._edits_so_far(), Edit(step=self.place)))
        if self.place >= run.evolution.max_steps:
            run.evolution.extend(self.place + max(run.config.max_steps, 1))
        if 0 <= until <= self.place:
            # Asked of a run without an end.
            until = self.place + 1 if self.running else until
        if 0 <= until <= self.place:
            return
        self.running, self.until = True, until
        self.message = ""

    def one_more(self) -> None:
        """One step more than was asked for; a run without an end rests after it."""
        self.go_on(1 + (self.until if self.running else self.place))

    def pause(self) -> None:
        """Have no more steps made."""
        self.running, self.until = False, -1

    def go_back(self, step: int) -> None:
        """Go to a step that has been made; also forward again.

        Raises
        ------
        UsageError
            When there is no such step.
        """
        if not 0 <= step:
            raise UsageError(f"step {step} was given, expected a number at least 0")
        kept = self.kept.steps
        if step > max(self.place, kept[-1] if kept else 0):
            raise UsageError(f"step {step} was given, expected at most {max(self.place, kept[-1])}", "run on to it")
        self.pause()
        self._go(step)
        self.message = f"step {step}"

    def _go(self, step: int) -> None:
        """To the state before the edits of a step; runs there from the last kept one."""
        run = self.run
        state = self._here if step == self.place else None
        state = state or self.kept.nearest(step, self._here.level)
        if state is None:
            self._build(run.config)
        else:
            run.restore(state)
            self._here = state
        if self.place < step:
            self.running, self.until = True, step

    def _edits_so_far(self) -> tuple[Edit, ...]:
        return tuple(edit for edit in self.run.config.edit if edit.step <= self.place)

    def _edit(self, edits: tuple[Edit, ...]) -> None:
        """Go on with other edits from the present step; what came after it is forgotten."""
        run, place = self.run, self.place
        before = run.config
        if edits == before.edit and run.stop is None:
            return
        for edit in edits:
            if edit.step >= place:
                run.check(edit)
        before.replace(edit=edits)
        if run.stop is not None or run.edits_done > self._here.done:
            run.restore(self._here)
        run.set_edits(edits)
        self.kept.drop_after(place)
        self._past.append((before, place))

    def change(self, settings: dict[str, Any]) -> None:
        """Change settings from here on.

        Raises
        ------
        UsageError
            When one makes no sense; nothing is changed then.
        """
        run, place = self.run, self.place
        edits = self._edits_so_far()
        # Several changes at one step are one edit: a slider that is drawn to and fro.
        last = edits[-1] if edits and edits[-1].step == place and not edits[-1].balls else None
        earlier = edits if last is None else edits[:-1]
        run.check(Edit(step=place, **settings))
        run.config.replace(edit=(*earlier, Edit(step=place, **settings)))
        before = run.config.replace(edit=earlier).at(place)
        after = before.replace(**{**(last.settings if last else {}), **settings})
        changed = {
            key: getattr(after, key) for key in RunConfig.model_fields if getattr(after, key) != getattr(before, key)
        }
        goes_on = last is not None and not last.settings
        altered = (*earlier, Edit(step=place, **changed)) if changed or goes_on else earlier
        if altered != edits:
            self._edit(altered)
        self.message = ", ".join(f"{key} {value}" for key, value in settings.items())

    def push(self, kind: str, ball: str) -> None:
        """Unite the object with a ball (``add``), or take one away from it (``remove``).

        Raises
        ------
        UsageError, InputError
            When it is no ball or lies outside.
        """
        self._edit((*self._edits_so_far(), *RunConfig(edit=[{"step": self.place, kind: ball}]).edit))
        self.message = f"{'added' if kind == 'add' else 'took away'} {ball}"

    def restart(self) -> None:
        """Go to the start and forget all edits but the settings in force."""
        run = self.run
        base, now, config = run.config.at(-1), run.now, run.config
        changed = {key: getattr(now, key) for key in RunConfig.model_fields if getattr(now, key) != getattr(base, key)}
        changed.pop("seed", None)
        self.pause()
        self._go(0)
        edits = (Edit(step=0, **changed),) if changed else ()
        if edits != config.edit:
            self._edit(edits)
        self.message = "at the start"

    def start_from(self, start: tuple[str, ...]) -> None:
        """Begin another run, with the settings in force."""
        run = self.run
        before = run.config
        self.pause()
        self._build(run.now.replace(start=start))
        self._past.append((before, 0))
        self.message = "start: " + " + ".join(start)

    def undo(self) -> None:
        """Take the last change back, and go to where it was made.

        Raises
        ------
        UsageError
            When there is none.
        """
        if not self._past:
            raise UsageError("there is no change to take back")
        run = self.run
        config, place = self._past.pop()
        self.pause()
        state = self.kept.nearest(min(place, self.place), self._here.level)
        if config.at(-1) != run.config.at(-1) or state is None:
            self._build(config)
        else:
            place = min(place, self.place)
            self.kept.drop_after(place)
            self._go(place)
            run.set_edits(config.edit)
        if self.place < place:
            self.running, self.until = True, place
        self.message = f"took the last change back, at step {place}"

    def save(
        self, folder: Path, name: str, source: Path | None, what: tuple[str, ...], overwrite: bool
    ) -> list[Path]:
        """Write files, see `saving.save`; those written before may be replaced."""
        self.run.apply()
        written = saving.save(self.run, folder, name, source, what, None if overwrite else self._own)
        self._own.update(written)
        self.message = f"saved {len(written)} files in {folder}"
        return written
