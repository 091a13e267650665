"""Answers to the first click of a run: a part, the whole, or all that is alike; the surface of each, without a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import OF_ALIKE, Answer, click_model, first_blocks, seed_of
from accelsurf.errors import UsageError
from accelsurf.grid import pyramid
from accelsurf.grid.arrays import Spacing
from accelsurf.grid.boxes import Box, corner_of
from accelsurf.grid.window import LeavesWindow
from accelsurf.measure import extent_text
from accelsurf.run import Run
from accelsurf.settings.corrections import Correction
from accelsurf.viewer.core.frame import Index, SurfaceFrame


@dataclass(frozen=True, eq=False)
class FirstAnswer:
    """An answer to the first click.

    Attributes
    ----------
    number : int
        The setting ``answer`` that takes it; 1 is the likeliest.
    volume_mm3 : float or None
        About its volume, if it is known.
    is_taken : bool
        The run is of it.
    size : str
        Its volume in words, in an image of one slice its area; empty if it is not known.
    surface : SurfaceFrame or None
        Its outline, on the blocks of voxels that the click is read in; None of the one that is taken, and where it
        needs more of the image than is at hand.
    """

    number: int
    volume_mm3: float | None
    is_taken: bool
    size: str = ""
    surface: SurfaceFrame | None = None


class FirstAnswers:
    """Answers to the first click of a run of one object, as long as there is no other click; found once for a click."""

    def __init__(self) -> None:
        self._run: Run | None = None
        #: Others that are still to be looked at, and found ones.
        self._left: list[Answer] = []
        self._found: tuple[FirstAnswer, ...] = ()

    def is_wanted(self, run: Run) -> bool:
        """Return True if `find_next` has something to do."""
        if self._run is not run:
            taken, *others = _answers(run) or (None,)
            self._run = run
            self._left = others
            self._found = (
                () if taken is None else (_described(run, taken.number, taken.volume_mm3, True),)
            )
        return bool(self._left)

    def find_next(self, run: Run) -> None:
        """Find the outline of one more; some tenths of a second."""
        if self.is_wanted(run):
            found = _found(run, self._left.pop(0))
            self._found = tuple(sorted((*self._found, found), key=lambda answer: answer.number))

    def offered(self, run: Run, refinements: Sequence[Correction]) -> tuple[FirstAnswer, ...]:
        """Return the answers to choose from, the taken one too; none while they are looked for, or where there is one
        alone, or something was corrected.
        """
        if (
            self.is_wanted(run)
            or refinements
            or len(self._found) < 2
            or not run.settings.energy.uses_model
        ):
            return ()
        return self._found

    def settings_of(
        self, run: Run, refinements: Sequence[Correction], number: int
    ) -> dict[str, int]:
        """Return the settings of another run, of an answer by its number.

        Raises
        ------
        UsageError
            When there is none of this number, or something was corrected.
        """
        if refinements or number not in [answer.number for answer in _answers(run)]:
            raise UsageError(
                f"answer: there is no answer {number} to the first click",
                "there are 1, 3 and mostly 2, as long as there is one click and no size",
            )
        return {"answer": number}


def _answers(run: Run) -> tuple[Answer, ...]:
    """Answers to the first click of a run, the taken one first; none unless it has one click alone, and no size."""
    context = run.objects[0].context
    if run.has_ids or not run.settings.energy.uses_model:
        return ()
    if context.clicks is None or [click.side for click in context.clicks.clicks] != ["inside"]:
        return ()
    if context.model_inputs.partition is not None or context.model_inputs.size_mm3 is not None:
        return ()
    return context.click_model().answers


def _found(run: Run, answer: Answer) -> FirstAnswer:
    """Return an answer that is not taken, and its outline."""
    evolving = run.objects[0]
    context = evolving.context
    assert context.clicks is not None
    scene = context.scene()
    if answer.number == OF_ALIKE:
        try:
            model = click_model(scene, context.clicks, answer=OF_ALIKE)
        except LeavesWindow:  # a run of it reads more of the image
            return _described(run, answer.number, None, False)
        frame = _outline(run, model.field, model.box, (1, 1, 1), context.spacing)
        return _described(run, answer.number, model.answers[0].volume_mm3, False, frame)
    shown = first_blocks(scene, seed_of(context.clicks.clicks[0], scene), answer=answer.number)
    window, field = shown.window, shown.field
    z, y, x = (int(n) for n in window.steps)
    hz, hy, hx = (float(side) for side in window.size)
    frame = _outline(run, -field, window.box, (z, y, x), (hz, hy, hx))
    return _described(run, answer.number, answer.volume_mm3, False, frame)


def _described(
    run: Run,
    number: int,
    volume_mm3: float | None,
    is_taken: bool,
    surface: SurfaceFrame | None = None,
) -> FirstAnswer:
    size = "" if volume_mm3 is None else extent_text(volume_mm3, run.volume.geometry)
    return FirstAnswer(number, volume_mm3, is_taken, size, surface)


def _outline(
    run: Run, psi: NDArray[np.float32], box: Box, steps: Index, size: Spacing
) -> SurfaceFrame:
    """Return a surface on blocks of voxels of a box."""
    # The place of a block is its middle.
    z, y, x = (
        corner + 0.5 * (step - 1) for corner, step in zip(corner_of(box), steps, strict=True)
    )
    nz, ny, nx = psi.shape
    level = pyramid.Level(0, steps, (nz, ny, nx), size, (z, y, x))
    record, nowhere = run.current()[0].record, (0, 0, 0)
    return SurfaceFrame(
        run.objects[0].id,
        record,
        level,
        psi,
        nowhere,
        1,
        nowhere,
        (nz, ny, nx),
        {},
        run.prepared.first,
    )
