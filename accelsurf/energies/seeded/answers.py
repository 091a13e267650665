"""Change of the score map by each click: the map of the first one, and corrections that stay near the later ones.

The first click's map balances arrival times from inside and from the surroundings, the likelihood of the values, and
the iso-value of the size. A later inside click uses the balance with all clicks, without the first size; a later
outside click what it changes in that balance, and the balance itself where it arrives first. Either changes labels
towards its own side alone, and only in the piece that is connected to it: what was right elsewhere stays.

On a large object this is computed in blocks of voxels, see `accelsurf.energies.seeded.blocks`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, log_ratio
from accelsurf.energies.seeded.blocks import Blocks
from accelsurf.energies.seeded.contest import Field, Order, Times, balance, from_beyond
from accelsurf.energies.seeded.implied import half_width
from accelsurf.grid.boxes import Box, bounding_box, connected_to, enclosing, holes_filled, on_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.kernels.arrival import Tissue

#: F in the clicks, by side.
CLICKED = {"inside": -3.0, "outside": 3.0}
#: F is the balance plus this part of the likelihood; of the first click's, this part is taken by the level of its size.
LIKELIHOOD, LEVEL = 0.5, 0.5
#: An outside click in the first proposal that is so many times as wide as the inside clicks says that it is too large.
MUCH_WIDER = 2.0
#: Where an outside click is nearer, a likelihood that speaks for the object counts this part.
DOUBTED = 0.5
#: F is moved by so much at most, so that it has the learned answer's size.
MAX_OFFSET = 0.5


class Proposed(NamedTuple):
    """Voxels of the first proposal, for as much as it rests on the even tissue around the first click: on a ``box`` of
    ``blocks`` a ``mask``; ``spacing`` (hz, hy, hx) of the voxels, mm.
    """

    blocks: Blocks
    box: Box
    mask: Mask
    spacing: Spacing

    def disowned(self, clicks: Clicks) -> Iterator[Click]:
        """Select the clicks, the first inside click before all others, that say that it is far too large.

        An outside click in it that is much wider than all inside clicks before: people click about as wide as what they
        mean is, so that what is wrong is wider than the object.
        """
        widest = 0.0
        for click in clicks.clicks:
            width = half_width(click.mask, self.spacing, clicks.shape)
            if click.side == "inside":
                widest = max(widest, width)
            elif width >= MUCH_WIDER * widest and self._holds(click):
                yield click

    def _holds(self, click: Click) -> bool:
        """Test if most of a click lies in it."""
        blocks = self.blocks.click(click, ())
        return blocks is not None and bool(np.mean(on_box(self.mask, self.box, blocks.box, False)[blocks.mask]) > 0.5)


class FirstTimes(NamedTuple):
    """Evidence that a click contradicts the first one, on the voxels: arrival ``times`` from the first click alone
    on a ``box``, beyond which it is later. An outside click that its front comes to until ``early`` says that the first
    proposal was far too large; -inf of a stated size, which no click contradicts. ``proposed`` is None where the even
    tissue says nothing.
    """

    box: Box
    times: Image
    early: float
    proposed: Proposed | None = None

    def comes_to(self, click: Click) -> float:
        """When the first click's front comes to a click; inf beyond the box."""
        return float(self.times[click.mask_on(self.box)].min(initial=np.inf))

    def contradicted(self, clicks: Clicks) -> Iterator[Click]:
        """Select the clicks, the first inside click before all others, that say that the proposal was too large.

        Not one that came after an inside click to which the front comes later: then the object goes on beyond the
        outside click, and times do not tell how large it is.
        """
        farthest = -np.inf
        for click in clicks.clicks[1:]:
            comes = self.comes_to(click)
            if click.side == "inside":
                farthest = max(farthest, comes)
            elif farthest <= comes <= self.early:
                yield click

    def contradict(self, clicks: Clicks) -> list[Click]:
        """Select the clicks, the first inside click before all others, after which the proposal is made anew."""
        disowned = () if self.proposed is None else self.proposed.disowned(clicks)
        return [*self.contradicted(clicks), *disowned]

    @classmethod
    def of(
        cls, field: Field, times: Times, order: Order, early: float, proposed: Proposed | None = None
    ) -> FirstTimes:
        """Make the times of a march over voxels, which come in ``order``."""
        arrived = order[: int(np.searchsorted(times[order], early, "right"))]
        z, y, x = (slice(int(i.min()), int(i.max()) + 1) for i in np.unravel_index(arrived, field.shape))
        return cls((z, y, x), times.reshape(field.shape)[z, y, x].copy(), early, proposed)


@dataclass(frozen=True, eq=False)
class Answer:
    """The field after some clicks, in blocks, on a box of their grid; beyond it all is surroundings.

    Attributes
    ----------
    blocks : Blocks
    box : tuple of slice
    around : tuple of slice
        Of the voxels, around all that the march from the first click came to before its surroundings begin.
    count : int
        Voxels of the first click's proposal.
    level, last : float
        Its arrival time, and that at which the surroundings begin.
    tissue : Tissue
        Of the first click.
    times_in, times_clicked : ndarray, float32
        Arrival times from inside and from outside clicks.
    times_out : ndarray, float32
        The same with the surroundings.
    total : ndarray, float32
        Balance and likelihood with all clicks.
    force : ndarray, float32
        F, clicks not marked.
    inside : ndarray of bool
        Where F < 0, connected to inside clicks.
    clicks : tuple of Click
        Those that were answered, in blocks.
    first : FirstTimes
    """

    blocks: Blocks
    box: Box
    around: Box
    count: int
    level: float
    last: float
    tissue: Tissue
    times_in: Image
    times_clicked: Image
    times_out: Image
    total: Image
    force: Image
    inside: Mask
    clicks: tuple[Click, ...]
    first: FirstTimes

    @property
    def voxels(self) -> int:
        """Voxels inside."""
        return int(np.count_nonzero(self.inside)) * self.blocks.size


def first_answer(
    field: Field,
    blocks: Blocks,
    tissue: Tissue,
    click: Click,
    times: Times,
    level: tuple[int, float, float],
    first: FirstTimes,
) -> Answer:
    """The answer to the first inside click.

    Parameters
    ----------
    field : Field
        Of the blocks, as click and times are.
    blocks : Blocks
    tissue : Tissue
    click : Click
    times : ndarray (n,) float32
    level : (count, level, last)
        See `Answer`.
    first : FirstTimes
    """
    count, at, last = level
    box = _box_of(field, times <= last)
    inside = times.reshape(field.shape)[box].copy()
    far = _is_far(field, box, inside, last)
    out = from_beyond(field.on_box(box), tissue, far)
    near = (inside <= at) & ~far
    competition = balance(inside, out)
    likely = log_ratio(field.images_on(box), near, ~(near | far))
    total = competition - LIKELIHOOD * likely
    force = (1.0 - LEVEL) * competition + LEVEL * balance(inside, np.full_like(inside, at)) - LIKELIHOOD * likely
    force -= offset_to(force, blocks.count(count)) * ~far
    none = np.full_like(inside, np.inf)
    force = np.asarray(force, np.float32)
    state = inside, none, out, total, force, near
    answer = Answer(blocks, box, blocks.box_of(box), count, at, last, tissue, *state, (click,), first)
    return replace(answer, inside=object_of(answer.force, answer.box, answer.clicks))


def with_click(answer: Answer, field: Field, click: Click, marched: Times) -> Answer:
    """The answer to one more click.

    Parameters
    ----------
    answer : Answer
        To the clicks before.
    field : Field
    click : Click
        In blocks, as the field is.
    marched : ndarray (n,) float32
        Arrival times from the click.
    """
    dense = marched.reshape(field.shape)
    reached = _box_of(field, (dense <= answer.last).ravel()) if click.side == "inside" else click.box
    answer = _on_larger_box(answer, enclosing(answer.box, reached))
    times, is_inside = dense[answer.box], click.side == "inside"
    times_in = np.minimum(answer.times_in, times) if is_inside else answer.times_in
    clicked = answer.times_clicked if is_inside else np.minimum(answer.times_clicked, times)
    far = _is_far(field, answer.box, times_in, answer.last)
    # An outside click leaves the surroundings where they were: their times need no march again.
    beyond = from_beyond(field.on_box(answer.box), answer.tissue, far) if is_inside else answer.times_out
    out = np.minimum(beyond, clicked)
    near = answer.inside & ~far
    competition = balance(times_in, out)
    likely = log_ratio(field.images_on(answer.box), near, ~(near | far))
    total = competition - LIKELIHOOD * likely
    if is_inside:
        force, changed = total, (total < 0) & (answer.force >= 0)
    else:
        force = answer.force + np.maximum(total - answer.total, 0.0)
        # What is nearer to the click and looks like the object may be what the click says is none.
        refused = competition - LIKELIHOOD * np.minimum(likely, DOUBTED * likely)
        force = np.where(times < times_in, np.maximum(force, refused), force)
        changed = (force >= 0) & (answer.force < 0)
    seen = click.mask_on(answer.box)
    changed |= seen
    force = np.where(connected_to(changed, seen), force, answer.force).astype(np.float32)
    answer = replace(
        answer,
        times_in=times_in,
        times_clicked=clicked,
        times_out=out,
        total=total,
        force=force,
        clicks=(*answer.clicks, click),
    )
    return replace(answer, inside=object_of(answer.force, answer.box, answer.clicks))


def offset_to(force: Image, count: int, most: float = np.inf) -> np.float32:
    """Find what F is to be lowered by so that F < 0 in a number of voxels, as far as that is allowed.

    0 where one of this number and the present one is more than ``most`` times the other.
    """
    now = int(np.count_nonzero(force < 0))
    if now == count or max(now, count) > most * min(now, count):
        return np.float32(0.0)
    rank = min(count, force.size - 1)
    below = int(np.count_nonzero(force < -MAX_OFFSET))
    between = force[(force >= -MAX_OFFSET) & (force <= MAX_OFFSET)]
    if not below <= rank < below + between.size:
        return np.float32(-MAX_OFFSET if rank < below else MAX_OFFSET)
    return np.float32(np.partition(between, rank - below)[rank - below])


def object_of(force: Image, box: Box, clicks: Sequence[Click]) -> Mask:
    """Voxels of F < 0 on a box, connected to inside clicks, and its holes where no outside click lies."""
    clicked = {side: np.zeros(force.shape, np.bool_) for side in CLICKED}
    for click in clicks:
        clicked[click.side] |= click.mask_on(box)
    grows = ((force < 0) | clicked["inside"]) & ~clicked["outside"]
    return holes_filled(connected_to(grows, clicked["inside"])) & ~clicked["outside"]


def _box_of(field: Field, where: NDArray[np.bool_]) -> Box:
    """The box around some voxels and one more on each side."""
    box = bounding_box(where.reshape(field.shape), 1)
    assert box is not None  # the seeds are among them
    return box


def _is_far(field: Field, box: Box, times_in: Times, last: float) -> Mask:
    """Mask of the surroundings: arrival is late, or the object may not be there."""
    far = ~(times_in <= last)
    if field.medium.open.size:
        far |= ~field.medium.open.reshape(field.shape)[box]
    return far


def _on_larger_box(answer: Answer, box: Box) -> Answer:
    """The same answer on a box that holds its own."""
    if box == answer.box:
        return answer

    def larger(values: NDArray, beyond: float) -> NDArray:
        return on_box(values, answer.box, box, beyond)

    return replace(
        answer,
        box=box,
        times_in=larger(answer.times_in, np.inf),
        times_clicked=larger(answer.times_clicked, np.inf),
        times_out=larger(answer.times_out, 0.0),
        total=larger(answer.total, 1.0),
        force=larger(answer.force, 1.0),
        inside=larger(answer.inside, False),
    )
