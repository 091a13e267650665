"""Answers to the first click of a run: a part, the whole, or all that is alike; what each would show, without a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from accelsurf.errors import UsageError
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import corner_of
from accelsurf.grid.clicks import Clicks
from accelsurf.run.image_context import ImageContext
from accelsurf.run.run import Run
from accelsurf.settings.corrections import Correction
from accelsurf.settings.energy_expression import uses_model
from accelsurf.viewer.core.frame import SurfaceFrame


@dataclass(frozen=True, eq=False)
class FirstAnswer:
    """An answer to the first click.

    Attributes
    ----------
    number : int
        The setting ``answer`` that takes it; 1 is the likeliest.
    volume_mm3 : float
        Of the object that the clicks' model shows.
    is_taken : bool
        The run is of it.
    surface : SurfaceFrame
        Its outline, where F of the model is 0.
    """

    number: int
    volume_mm3: float
    is_taken: bool
    surface: SurfaceFrame


class FirstAnswers:
    """Answers to the first click of a run of one object, as long as there is no other click; found once for a click."""

    def __init__(self) -> None:
        self._run: Run | None = None
        self._clicks: Clicks | None = None
        #: Numbers that are still to be looked at, and what was found.
        self._left: list[int] = []
        self._found: tuple[FirstAnswer, ...] = ()

    def is_wanted(self, run: Run) -> bool:
        """Return True if `find_next` has something to do."""
        clicks = run.objects[0].context.clicks
        if self._run is not run or self._clicks is not clicks:
            self._run, self._clicks, self._found = run, clicks, ()
            self._left = _numbers(run)
        return bool(self._left)

    def find_next(self, run: Run) -> None:
        """Find one more; some tenths of a second. Those that are as large as one before are left out."""
        if not self.is_wanted(run):
            return
        found = _shown(run, self._left.pop(0))
        if all(found.volume_mm3 != other.volume_mm3 for other in self._found):
            self._found = tuple(sorted((*self._found, found), key=lambda answer: answer.number))

    def offered(self, run: Run, refinements: Sequence[Correction]) -> tuple[FirstAnswer, ...]:
        """Return the answers to choose from, the taken one too; none while they are looked for, or where there is one
        alone, or something was corrected.
        """
        if self.is_wanted(run) or refinements or len(self._found) < 2:
            return ()
        return self._found

    def settings_of(self, run: Run, refinements: Sequence[Correction], number: int) -> dict[str, int]:
        """Return the settings of another run, of an answer by its number.

        Raises
        ------
        UsageError
            When there is none of this number, or something was corrected.
        """
        if refinements or number not in _numbers(run):
            raise UsageError(
                f"answer: there is no answer {number} to the first click",
                "there are up to three, as long as there is one click and no size",
            )
        return {"answer": number}


def _numbers(run: Run) -> list[int]:
    """Numbers of the answers to the first click of a run, the taken one first; none unless it has one click alone."""
    context = run.objects[0].context
    if run.has_ids or not uses_model(run.settings.energy):
        return []
    if context.clicks is None or [click.side for click in context.clicks.clicks] != ["inside"]:
        return []
    if context.model_inputs.partition is not None or context.model_inputs.size_mm3 is not None:
        return []
    return [answer.number for answer in context.click_model().answers]


def _shown(run: Run, number: int) -> FirstAnswer:
    """Return an answer as the clicks' model shows it."""
    evolving, geometry = run.objects[0], run.geometry
    context: ImageContext = evolving.context
    model, taken = context.click_model(), context.click_model().answers[0].number
    if number != taken:
        assert context.clicks is not None
        inputs = context.model_inputs._replace(answer=number)
        model = context.with_model_inputs(inputs).with_clicks(context.clicks).click_model()
    level = pyramid.levels(geometry.shape, geometry.spacing, 1)[0]
    record, corner, shape = run.current()[0].record, corner_of(model.box), geometry.shape
    surface = SurfaceFrame(
        evolving.id, record, level, model.field, corner, 1, (0, 0, 0), shape, {}, run.prepared.first
    )
    return FirstAnswer(number, model.count * geometry.voxel_volume, number == taken, surface)
