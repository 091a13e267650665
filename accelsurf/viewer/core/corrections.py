"""The corrections of a session: made after the run's end, and made again when it has gone on and ends once more."""

from __future__ import annotations

from collections.abc import Callable

from accelsurf.errors import AccelsurfError
from accelsurf.evolution.records import StepRecord, Stop
from accelsurf.segmentation.result import Result
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_state import BoxMask
from accelsurf.settings.edits import Correction
from accelsurf.viewer.core.corrected_run import CorrectedRun
from accelsurf.viewer.core.frame import Frame, histories_of_run


class Corrections:
    """The corrections of a session.

    Parameters
    ----------
    wanted : tuple of Correction
        Those of its configuration, to be made when the run ends.

    Attributes
    ----------
    wanted : tuple of Correction
        Made after the run's end; while it goes on, to be made then.
    progress : callable
        Called with a line while one is being made.
    """

    def __init__(self, wanted: tuple[Correction, ...]) -> None:
        self.wanted = wanted
        self.progress: Callable[[str], None] = lambda message: None
        self._corrected: CorrectedRun | None = None

    def correct(self, run: Run, refinement: Correction, said: str) -> str:
        """Make a correction of a run that has ended; returns a line that says what it did.

        Raises
        ------
        UsageError, InputError
            When it cannot be made; nothing is changed then.
        """
        self.progress(f"{said}: correcting")
        corrected = self._corrected or CorrectedRun(run)
        changes = corrected.apply(refinement, lambda step: self.progress(f"{said}: correcting, step {step}"))
        self._corrected, self.wanted = corrected, corrected.made
        moved, seconds = sum(one.voxels for one in changes), sum(one.seconds for one in changes)
        return f"{said}: " + (f"moved {moved} voxels in {seconds:.2f} s" if moved else "nothing changed")

    def correct_again(self, run: Run) -> str:
        """Make those that are wanted of a run that has ended; the first that does not fit ends them. Returns a line."""
        wanted, self.wanted, line = self.wanted, (), ""
        for number, refinement in enumerate(wanted, 1):
            said = f"correction {number} of {len(wanted)}"
            try:
                line = self.correct(run, refinement, said)
            except AccelsurfError as error:
                return f"{said} cannot be made again: {error.message}"
        return line

    def go_to(self, run: Run, wanted: tuple[Correction, ...]) -> bool:
        """Take back corrections and make others, so that these are made; False where it takes another run."""
        now = self.wanted
        if run.stop is None or now == wanted or (self._corrected is None and now):
            return False
        pairs = enumerate(zip(now, wanted, strict=False))
        common = next((n for n, (a, b) in pairs if a != b), min(len(now), len(wanted)))
        for _ in now[common:]:
            assert self._corrected is not None
            self._corrected.undo()
        self.wanted = now[:common]
        for number, refinement in enumerate(wanted[common:], 1):
            self.correct(run, refinement, f"made again, {number} of {len(wanted) - common}")
        return True

    def leave(self) -> None:
        """The run goes on: what was corrected is made again when it ends."""
        self._corrected = None

    # -- what there is now --------------------------------------------------------------------------------

    def stop(self, run: Run) -> Stop | None:
        """Why the run, or the last correction, ended; None while it goes on."""
        return run.stop if self._corrected is None else self._corrected.stop

    def stops(self, run: Run) -> dict[int, Stop | None]:
        """Why each object, or its last correction, ended."""
        return {one.id: one.stop for one in run.objects} if self._corrected is None else {**self._corrected.stops}

    @property
    def ids(self) -> tuple[int, ...] | None:
        """Ids of the objects after the corrections; None where none was made."""
        return None if self._corrected is None else self._corrected.ids

    def nearest(self, place: str) -> int | None:
        """The object that is nearest to a ball's centre after the corrections; None where none was made, or there is
        one without an id.
        """
        return None if self._corrected is None or not self._corrected.has_ids else self._corrected.nearest(place)

    def taken(self, run: Run, ball: str, object_id: int) -> BoxMask | None:
        """Voxels of the region of interest that an object which is pressed at a ball may not have."""
        if run.stop is None:
            return None
        if self._corrected is None and not run.has_ids and object_id == run.objects[0].id:
            return None
        corrected = self._corrected = self._corrected or CorrectedRun(run)
        return corrected.taken(ball, object_id)

    def result(self) -> Result | None:
        """The corrected result; None where no correction was made."""
        return None if self._corrected is None else self._corrected.result()

    def picture(self, run: Run, max_voxels: int | None) -> tuple[Frame, tuple[tuple[StepRecord, ...], ...]]:
        """What is drawn, see `Frame.of_run`, and each object's records up to it."""
        if self._corrected is not None:
            return self._corrected.frame(), self._corrected.histories
        records = [step.record for step in run.current()]
        return Frame.of_run(run, records, max_voxels), histories_of_run(run, records)
