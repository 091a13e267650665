"""Checks of a correction before a step, and the choice of its balls for each object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.clicks import NO_OBJECT
from accelsurf.grid.geometry import Geometry
from accelsurf.initialization import starts
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.run_clicks import BallEdit
from accelsurf.settings import energy_expression
from accelsurf.settings.catalogue import energy_settings
from accelsurf.settings.edits import Correction
from accelsurf.settings.run_config import RunConfig


def check(edit: Correction, config: RunConfig, prepared: PreprocessedInput, ids: Sequence[int], energy: Any) -> None:
    """Refuse an edit that a run cannot apply: a ball outside the grid, an unknown object, a setting without effect.

    Parameters
    ----------
    edit : Correction
    config : RunConfig
        Of the run.
    prepared : PreprocessedInput
    ids : sequence of int
        Of its objects; none for a run of one object without an id.
    energy : Energy or callable or str or None
        An energy of the user's own, if the run has one.

    Raises
    ------
    UsageError
        When the edit is not valid for this run.
    InputError
        When a ball lies outside the volume.
    """
    where = f"edit at step {edit.step}"
    terms = energy_expression.parse(str(edit.settings.get("energy", config.energy)))
    if prepared.context.foreground is None and any(term.settings.get("update") == "no" for term in terms):
        raise UsageError(
            f"{where}: likelihood:update=no was given, and the run has nothing to learn from",
            "give --foreground to the run, or use update=yes",
        )
    for _, ball in edit.balls:
        try:
            starts.ball_of(ball, prepared.geometry)
        except (UsageError, InputError) as error:
            raise type(error)(f"{where}: {error.message}", error.hint) from None
    _check_object(edit, ids, where)
    if energy is not None and not isinstance(energy, str):
        for key in edit.settings:
            if key == "energy" or key in energy_settings():
                raise UsageError(
                    f"{where}: {key} was given, but the energy is one of your own",
                    "it has its own settings, which do not change while it runs",
                )


def _check_object(edit: Correction, ids: Sequence[int], where: str) -> None:
    """Refuse an object that does not exist, and balls or clicks without an object where there are several."""
    allowed = {*ids, NO_OBJECT} if ids and edit.inside and not (edit.balls or edit.outside) else set(ids or (1,))
    if edit.object is not None and edit.object not in allowed:
        known = ", ".join(str(id) for id in ids[:8]) + (", ..." if len(ids) > 8 else "")
        raise UsageError(f"{where}: object {edit.object} was given, expected one of {known or '1'}", "as in object=3")
    if edit.object is not None and not (edit.balls or edit.has_clicks):
        raise UsageError(
            f"{where}: object {edit.object} was given without a ball or a click", "settings change for all objects"
        )
    if edit.object is None and edit.balls and len(ids) > 1:
        raise UsageError(
            f"{where}: a ball was given without its object", "write which one it is added to, as in object=3"
        )
    if edit.object is None and edit.inside and ids:
        raise UsageError(
            f"{where}: a click inside was given without its object", "write which one it is in, as in object=3"
        )


def balls_of(edit: Correction, geometry: Geometry) -> tuple[BallEdit, ...]:
    """The balls of an edit on the grid of the region of interest."""
    return tuple(BallEdit(kind, *starts.ball_of(text, geometry)) for kind, text in edit.balls)


def balls_for(id: int, edit: Correction, balls: Sequence[BallEdit]) -> tuple[BallEdit, ...]:
    """The balls of an edit for object ``own`` of several: what one object gains is taken from the others."""
    if edit.object is None or edit.object == id:
        return tuple(balls)
    return tuple(ball._replace(kind="remove") for ball in balls if ball.kind == "add")
