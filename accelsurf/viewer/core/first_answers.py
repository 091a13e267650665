"""Answers to the first click of a run: a part, the whole, or all that is alike; what each would show, without a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from accelsurf.clicks.model import Answer, Scene
from accelsurf.clicks.model.model import first_blocks
from accelsurf.clicks.model.windows import seed_of
from accelsurf.errors import UsageError
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import corner_of
from accelsurf.grid.clicks import Clicks
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
        About its volume.
    is_taken : bool
        The run is of it.
    surface : SurfaceFrame or None
        Its outline, on the blocks of voxels that the click is read in; None of the one that is taken.
    """

    number: int
    volume_mm3: float
    is_taken: bool
    surface: SurfaceFrame | None = None


class FirstAnswers:
    """Answers to the first click of a run of one object, as long as there is no other click; found once for a click."""

    def __init__(self) -> None:
        self._run: Run | None = None
        self._clicks: Clicks | None = None
        #: Others that are still to be looked at, and what was found.
        self._left: list[Answer] = []
        self._found: tuple[FirstAnswer, ...] = ()

    def is_wanted(self, run: Run) -> bool:
        """Return True if `find_next` has something to do."""
        clicks = run.objects[0].context.clicks
        if self._run is not run or self._clicks is not clicks:
            taken, *others = _answers(run) or (None,)
            self._run, self._clicks, self._left = run, clicks, others
            self._found = () if taken is None else (FirstAnswer(taken.number, taken.volume_mm3, True),)
        return bool(self._left)

    def find_next(self, run: Run) -> None:
        """Find the outline of one more; some tenths of a second."""
        if self.is_wanted(run):
            answer = self._left.pop(0)
            found = FirstAnswer(answer.number, answer.volume_mm3, False, _outline(run, answer.number))
            self._found = tuple(sorted((*self._found, found), key=lambda answer: answer.number))

    def offered(self, run: Run, refinements: Sequence[Correction]) -> tuple[FirstAnswer, ...]:
        """Return the answers to choose from, the taken one too; none while they are looked for, or where there is one
        alone, or something was corrected.
        """
        if self.is_wanted(run) or refinements or len(self._found) < 2 or not uses_model(run.settings.energy):
            return ()
        return self._found

    def settings_of(self, run: Run, refinements: Sequence[Correction], number: int) -> dict[str, int]:
        """Return the settings of another run, of an answer by its number.

        Raises
        ------
        UsageError
            When there is none of this number, or something was corrected.
        """
        if refinements or number not in [answer.number for answer in _answers(run)]:
            raise UsageError(
                f"answer: there is no answer {number} to the first click",
                "there are up to three, as long as there is one click and no size",
            )
        return {"answer": number}


def _answers(run: Run) -> tuple[Answer, ...]:
    """Answers to the first click of a run, the taken one first; none unless it has one click alone, and no size."""
    context = run.objects[0].context
    if run.has_ids or not uses_model(run.settings.energy):
        return ()
    if context.clicks is None or [click.side for click in context.clicks.clicks] != ["inside"]:
        return ()
    if context.model_inputs.partition is not None or context.model_inputs.size_mm3 is not None:
        return ()
    return context.click_model().answers


def _outline(run: Run, number: int) -> SurfaceFrame:
    """Return what an answer shows, but for its boundary, as blocks of voxels."""
    evolving = run.objects[0]
    context = evolving.context
    assert context.clicks is not None
    scene = Scene(tuple(context.images), context.spacing, context.model_inputs.mask, context.model_inputs.window)
    window, field, _, _ = first_blocks(scene, seed_of(context.clicks.clicks[0], scene), answer=number)
    nz, ny, nx = field.shape
    steps = (int(window.steps[0]), int(window.steps[1]), int(window.steps[2]))
    hz, hy, hx = (float(side) for side in window.size)
    # Places of blocks are those of their middles.
    z, y, x = (corner + 0.5 * (step - 1) for corner, step in zip(corner_of(window.box), steps, strict=True))
    level = pyramid.Level(0, steps, (nz, ny, nx), (hz, hy, hx), (z, y, x))
    record, nowhere = run.current()[0].record, (0, 0, 0)
    return SurfaceFrame(
        evolving.id, record, level, -field, nowhere, 1, nowhere, (nz, ny, nx), {}, run.prepared.first
    )
