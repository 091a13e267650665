"""Stages of a model, click by click: what is known after some clicks, from which it goes on when others change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.energies.seeded.answers import Answer
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.clicks import Click, Clicks

#: So many stages are kept: that of the first click, whose march is the longest, and the last ones.
MAX_STAGES = 9
#: A click from which voxels are taken still says what it said where it keeps this part of them.
MOSTLY = 0.5


class Stage(NamedTuple):
    """A model between two clicks.

    Attributes
    ----------
    clicks : Clicks
        Those so far, the first inside click before all others.
    answer : Answer
        To them.
    shown : Shown
        F and start before they were brought to the edges of the image, from which the next click goes on.
    corrections : tuple of float
        How far off the clicks were that corrected it, see `accelsurf.energies.seeded.sureness.corrections_with`.
    """

    clicks: Clicks
    answer: Answer
    shown: Shown
    corrections: tuple[float, ...] = ()


def in_order(clicks: Clicks) -> Clicks:
    """The clicks as a model takes them: the first inside click, then all others as they were given."""
    first = next((click for click in clicks.clicks if click.side == "inside"), None)
    if first is None or first is clicks.clicks[0]:
        return clicks
    return Clicks((first, *(click for click in clicks.clicks if click is not first)), clicks.shape)


def first_and_last(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """Select the first and the last of the stages of a model."""
    return (*stages[:1], *stages[1:][1 - MAX_STAGES :])


def unchanged(stages: Sequence[Stage], clicks: Clicks) -> tuple[tuple[Stage, ...], tuple[Click, ...]]:
    """The stages that no change of the clicks touches, and the clicks that are not in the last of them.

    A model learns from each click: where voxels are taken from one, nothing that came of it may stay. No stage is left
    where a click says that the first proposal was far too large.

    Parameters
    ----------
    stages : sequence of Stage
        Each goes on from the one before.
    clicks : Clicks
        All that the model is to be made from.
    """
    asked = in_order(clicks)
    count = sum(asked.starts_with(stage.clicks) for stage in stages)
    left = asked.clicks[len(stages[count - 1].clicks) :] if count else asked.clicks
    if count and contradicting(stages[count - 1].answer, asked, left):
        return (), asked.clicks
    return tuple(stages[:count]), left


def mostly_left(before: Clicks, after: Clicks) -> bool:
    """Test if clicks keep at least the part `MOSTLY` of their voxels each, and with it what they say.

    Parameters
    ----------
    before : Clicks
    after : Clicks
        What is left of these, and one more.
    """
    if len(after) != len(before) + 1:
        return False
    pairs = zip(before.clicks, after.clicks, strict=False)
    return all(np.count_nonzero(left.mask) >= MOSTLY * np.count_nonzero(click.mask) for click, left in pairs)


def contradicting(answer: Answer, clicks: Clicks, asked: Sequence[Click]) -> tuple[Click, ...]:
    """Select the clicks ``asked`` that contradict the first proposal; ``clicks`` are all heard, in order."""
    found = answer.first.contradict(clicks)
    return tuple(click for click in asked if any(click is other for other in found))
