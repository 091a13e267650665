"""Confidence of the clicks' model in its object: numbers from which a probability is computed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.clicks.model.answers import Answer
from accelsurf.clicks.model.model import ClickModel, least_overlap_with


class Confidence(NamedTuple):
    """Measures of how sure a model of clicks is.

    Attributes
    ----------
    overlap : float
        Dice of the objects {F < -0.2} and {F < 0.2}: 1 where F is steep at its boundary. The least after any of the
        clicks: a click makes F steep around it, and that is no better surface.
    spread : float
        Logarithm of how much larger the first answer is at a low probability than at a high one.
    correction : float or None
        Radius of the last click that corrected the object, over the object's radius; None where there was none.
    unchanged : float or None
        Dice of the object before that click with the object after it.
    taken : float
        Share of the object that the last click took away.
    disagreement : float or None
        How sure the model was of the opposite where clicks corrected it, mean over them: 1 where it was certain.
    answers : tuple of Answer
        To the first click: the one that was taken, and others that are likely; none where a click has corrected it.
    is_ambiguous : bool
        The only click means objects whose sizes differ by a factor.
    """

    overlap: float
    spread: float
    correction: float | None
    unchanged: float | None
    taken: float
    disagreement: float | None
    answers: tuple[Answer, ...]
    is_ambiguous: bool = False


def confidence_of(model: ClickModel) -> Confidence | None:
    """Measure how sure a model is; None of one of several objects that fill a space."""
    if model.is_partition:
        return None
    disagreement = float(np.mean(model.disagreements)) if model.disagreements else None
    return Confidence(
        least_overlap_with(model),
        model.spread,
        model.correction,
        model.unchanged,
        model.taken,
        disagreement,
        model.answers if model.correction is None else (),
        model.is_ambiguous,
    )
