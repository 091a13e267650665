"""Clicks inside other objects: what is inside of one is outside of all others, but tells its neighbours alone anything.

A model goes on from click to click and looks at a box around all of them. With the clicks of every other object among
them, each of many objects looked at the whole image, coarsely, once for every other object.
"""

from __future__ import annotations

from accelsurf.energies.seeded.answers import Answer
from accelsurf.energies.seeded.appearance import Spacing
from accelsurf.energies.seeded.contest import PATHS_REACH, box_around
from accelsurf.grid.boxes import overlap
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks


def heard(clicks: Clicks, answer: Answer, spacing: Spacing) -> Clicks:
    """The clicks that an object's model is made from, in their order.

    All on the object and on none; and those inside others that lie where the contest by paths of the first ones looks,
    or where the march from the first click may have found the object.

    Parameters
    ----------
    clicks : Clicks
        Of one object, as `Clicks.of` returns them.
    answer : Answer
        To the first of them, or to some more.
    spacing : (hz, hy, hx)
        mm.
    """
    own = tuple(click for click in clicks.clicks if not _is_of_another(click))
    if len(own) == len(clicks) or all(click.side == "outside" for click in own):
        return clicks
    boxes = box_around(Clicks(own, clicks.shape), spacing, PATHS_REACH, answer.count)[0], answer.around

    def counts(click: Click) -> bool:
        return not _is_of_another(click) or any(overlap(click.box, box) for box in boxes)

    return Clicks(tuple(filter(counts, clicks.clicks)), clicks.shape)


def _is_of_another(click: Click) -> bool:
    return click.side == "outside" and click.owner not in (None, NO_OBJECT)
