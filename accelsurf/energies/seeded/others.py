"""Clicks inside other objects: what is inside of one is outside of all others, but says little of those far from it.

A model goes on from click to click and looks at a box around all of them. With the clicks of every other object among
them, each of many objects looked at the whole image, coarsely, once for every other object.
"""

from __future__ import annotations

from collections.abc import Sequence

from accelsurf.energies.seeded.answers import Answer
from accelsurf.energies.seeded.appearance import Spacing
from accelsurf.energies.seeded.contest import PATHS_REACH, WALKS_REACH, box_around
from accelsurf.energies.seeded.stages import Stage, in_order, unchanged
from accelsurf.grid.boxes import overlap
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks


def heard(clicks: Clicks, answer: Answer, spacing: Spacing) -> Clicks:
    """The clicks that an object's model is made from, in their order.

    All that were given for the object. Of those inside others the ones where the contest by paths of the first would
    look, of those on no object the ones where that by walks would; and of both those that lie where the march from
    the first click may have found the object, or that say that its proposal was far too large.

    Parameters
    ----------
    clicks : Clicks
        Of one object, as `Clicks.of` returns them.
    answer : Answer
        To the first of them, or to some more.
    spacing : (hz, hy, hx)
        mm.
    """
    known = Clicks(tuple(click for click in clicks.clicks if not _is_foreign(click)), clicks.shape)
    if len(known) == len(clicks) or all(click.side == "outside" for click in known.clicks):
        return clicks
    near, far = (box_around(known, spacing, reach, answer.count)[0] for reach in (PATHS_REACH, WALKS_REACH))
    contradict = answer.first.contradict(in_order(clicks))

    def counts(click: Click) -> bool:
        if not _is_foreign(click) or any(click is other for other in contradict):
            return True
        return any(overlap(click.box, box) for box in (far if click.owner == NO_OBJECT else near, answer.around))

    return Clicks(tuple(filter(counts, clicks.clicks)), clicks.shape)


def going_on(
    stages: Sequence[Stage], clicks: Clicks, spacing: Spacing
) -> tuple[Clicks, tuple[Stage, ...], tuple[Click, ...]]:
    """The clicks that are `heard`, the stages of a model that none of them changes, and the clicks after these.

    Parameters
    ----------
    stages : sequence of Stage
        None of a model that is yet to be made.
    clicks : Clicks
        All that were given.
    spacing : (hz, hy, hx)
        mm.
    """
    if not stages:
        return clicks, (), ()
    known = heard(clicks, stages[-1].answer, spacing)
    return known, *unchanged(stages, known)


def _is_foreign(click: Click) -> bool:
    return click.side == "outside" and click.owner is not None
