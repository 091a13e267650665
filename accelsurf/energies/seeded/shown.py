"""Blended score after some clicks: the score map of the model and the labelling by the clicks alone.

It is their mean, after the first click with as many voxels as the model has, later between the model's size and the
labelling's. A later click changes labels towards its own side alone, F by a part, F around it by more, and from the
third on F near it alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.energies.seeded.answers import CLICKED, Answer, object_of, offset_to
from accelsurf.energies.seeded.appearance import Image, Mask
from accelsurf.energies.seeded.contest import Balance
from accelsurf.energies.seeded.nearness import Nearness
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, counted_from, enclosing, on_box
from accelsurf.grid.clicks import Clicks
from accelsurf.kernels.blocks import hold_side

#: What the learned answer counts after 1, 2, ... clicks beside the paths (1) and the walks (2): the more clicks, the
#: less has to be learned. After a stated size it is better, and counts more.
OWN, OWN_SIZED = (3.0, 1.0, 0.75, 0.6, 0.5, 0.4), (3.0, 6.0, 3.0, 1.5, 1.0)
PATHS, WALKS = 1.0, 2.0
#: So much of F before stays in F after 2, 3, ... clicks: the more there were, the less is wrong far from the new one.
INERTIA = (0.0, 0.3, 0.4, 0.5)
#: |F| of a label that is kept is at least this: it has a side.
MIN_FORCE = 1e-3
#: By the first click's field this is done in full, later by this part, where neither size is more than so many times
#: the other: the contests know the boundary between clicks better, the answer the size where no click is near.
#: What an outside click takes beyond that is taken far from it, so that F < 0 in too few voxels is mended in full,
#: near the click from the third on.
SIZE_PART, MAX_RATIO = 0.5, 4.0


class Shown(NamedTuple):
    """Field that a person sees after some clicks: on a ``box`` of the grid F, ``force``, and where it is ``inside``.

    Beyond the box F is 1 and nothing is inside.
    """

    box: Box
    force: Image
    inside: Mask

    def on(self, box: Box) -> tuple[Image, Mask]:
        """F and where it is inside, on another box."""
        return on_box(self.force, self.box, box, 1.0), on_box(self.inside, self.box, box, False)


class Shift(NamedTuple):
    """Shift of F, ``by`` on a ``box`` of the grid."""

    box: Box
    by: Image


class Neighbourhood(NamedTuple):
    """Neighbourhood of a click: a ``shift`` of F, None for none; ``near`` tells of a box where in it F
    changes, None for everywhere.
    """

    shift: Shift | None = None
    near: Callable[[Box], Nearness] | None = None


#: F changes everywhere alike.
EVERYWHERE = Neighbourhood()


def mixed_answer(
    answer: Answer,
    parts: Sequence[Balance],
    clicks: Clicks,
    sized: bool,
    before: Shown | None,
    neighbourhood: Neighbourhood = EVERYWHERE,
) -> Shown:
    """F and where it is inside: the learned answer and the contests, with the clicks marked.

    Parameters
    ----------
    answer : Answer
    parts : sequence of Balance
        The contests of `accelsurf.energies.seeded.contest`, by paths and by walks.
    clicks : Clicks
        The last one is new.
    sized : bool
        Whether a size was stated.
    before : Shown or None
        What was shown before the last click: labels change towards its side alone.
    neighbourhood : Neighbourhood, optional
        Of the last click, see `accelsurf.energies.seeded.after_click.neighbourhood`.
    """
    learned = answer.blocks.on_voxels(answer.box, np.clip(answer.force, -1.0, 1.0))
    box = learned.box if before is None else enclosing(learned.box, before.box)
    for other in (*(part.box for part in parts), *(click.box for click in clicks.clicks)):
        box = enclosing(box, other)
    by_count = OWN_SIZED if sized else OWN
    weights = (by_count[min(len(clicks), len(by_count)) - 1], PATHS, WALKS)
    mixed = np.zeros([s.stop - s.start for s in box], np.float32)
    for weight, part in zip(weights, (learned, *parts), strict=True):
        part.add_to(mixed, box, weight / sum(weights))
    if before is None:
        mixed -= offset_to(mixed, answer.voxels)
    else:
        gains, lower = clicks.clicks[-1].side == "inside", offset_to(mixed, answer.voxels, MAX_RATIO)
        mixed -= lower if lower > 0.0 and not gains else np.float32(SIZE_PART) * lower
        was, own_before = before.on(box)
        mixed = _changed_around(mixed, was, corner_of(box), neighbourhood)
        held = np.float32(INERTIA[min(len(clicks) - 2, len(INERTIA) - 1)])
        hold_side(mixed, was, own_before, held, np.float32(MIN_FORCE), gains)
    inside = object_of(mixed, box, clicks.clicks)
    for click in clicks.clicks:
        seen = click.mask_on(box)
        mixed[seen], inside[seen] = CLICKED[click.side], click.side == "inside"
    return Shown(box, mixed, inside)


def _changed_around(mixed: Image, was: Image, corner: Corner, click: Neighbourhood) -> Image:
    """F with the shift around a click, changed where it is near alone; F and F before begin at a corner of the grid."""
    if click.shift is not None:
        mixed[counted_from(click.shift.box, corner)] += click.shift.by
    if click.near is None:
        return mixed
    near = click.near(box_at(corner, mixed.shape))
    changed, part = np.clip(was, -1.0, 1.0), counted_from(near.box, corner)
    changed[part] += near.values * (mixed[part] - changed[part])
    return changed


def on_whole_grid(shown: Shown, shape: tuple[int, int, int]) -> tuple[Image, Mask]:
    """F and the start on the whole grid."""
    force, start = np.ones(shape, np.float32), np.zeros(shape, np.bool_)
    force[shown.box], start[shown.box] = shown.force, shown.inside
    return force, start
