"""The seeded model: from clicks to a force field and a first surface.

A model goes on from click to click and looks at a box around all of them. Clicks inside other objects are outside of
this one, but say little of places far from them: with all of them each of many objects would look at the whole image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from accelsurf.energies.seeded.after_click import stage_after
from accelsurf.energies.seeded.answers import Answer, with_click
from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, learn
from accelsurf.energies.seeded.blocks import Domain, field_in
from accelsurf.energies.seeded.contest import PATHS_REACH, WALKS_REACH, Field, Times, box_around, contest, reached
from accelsurf.energies.seeded.edge import area_weight, at_edges, mean_curvature
from accelsurf.energies.seeded.first_click import BEYOND, FARTHER, answer_to_first, seeds_of
from accelsurf.energies.seeded.proposal import Proposal
from accelsurf.energies.seeded.shown import mixed_answer, on_whole_grid
from accelsurf.energies.seeded.stages import Stage, contradicting, in_order, unchanged
from accelsurf.grid.boxes import Box, overlap
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.window import Window
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.kernels.arrival import Tissue

#: Smoothing of the image before anything is learned from it, of the smallest spacing.
SMOOTHING = 0.6
#: Arrival times from a later click, as multiples of those that would give the object's volume at the same level.
LATER = {"inside": 1.5, "outside": 1.0}


@dataclass(frozen=True, eq=False)
class SeededModel:
    """A force field and a first surface from clicks.

    Attributes
    ----------
    field : ndarray (nz, ny, nx), float32
        F: the surface grows where F < 0; -3 and 3 in clicked voxels, about -1 to 1 elsewhere.
    start : ndarray (nz, ny, nx) of bool
        Where F < 0, as far as it is connected to inside clicks, with holes filled.
    proposal : Proposal
        The level of the first click's arrival time.
    area_weight_mm : float
        Weight of the area that suits the field, mm.
    clicks : Clicks
        What it was made from.
    images : tuple of ndarray (nz, ny, nx), float32
        The channels, smoothed.
    sized : bool
        Whether a size was stated.
    stages : tuple of Stage
        From which it goes on when clicks are added or changed, the last with all that are `heard`; none of a partition.
    """

    field: Image
    start: Mask
    proposal: Proposal
    area_weight_mm: float
    clicks: Clicks
    images: tuple[Image, ...]
    sized: bool = False
    stages: tuple[Stage, ...] = ()

    @property
    def answer(self) -> Answer | None:
        """Answer that the next click's is made from; None of a partition."""
        return self.stages[-1].answer if self.stages else None

    def mean_curvature(self, spacing: Spacing) -> float:
        """Mean curvature of the start, 1/mm; 0 of a partition, whose walls are drawn to no side."""
        return mean_curvature(self.start, spacing) if self.stages else 0.0


def seeded_model(
    images: Sequence[Image],
    spacing: Spacing,
    clicks: Clicks,
    *,
    size_mm3: float | None = None,
    box: Box | None = None,
    mask: Mask | None = None,
    threads: int = 1,
    previous: SeededModel | None = None,
    window: Window | None = None,
    learned: Callable[[], tuple[Image, ...]] | None = None,
) -> SeededModel:
    """Make the model of one object from its clicks.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
        Those of one object, see `Clicks.of`.
    size_mm3 : float, optional
        About the object's volume.
    box, mask : tuple of slice, ndarray (nz, ny, nx) of bool, optional
        The object lies in both.
    threads : int, optional
        Marches from so many clicks at once; the result is the same for any number.
    previous : SeededModel, optional
        The model of the first of these clicks, all else being the same: the result is the same, sooner.
    window : Window, optional
        The images are this part of larger ones; the result is the part of theirs.
    learned : callable, optional
        Returns their `learned_images`, which several objects share.

    Raises
    ------
    InputError
        When no click is inside, or the first lies outside box or mask; LeavesWindow when it looks beyond the window.
    """
    sized, where = size_mm3 is not None, Domain(_allowed(images[0].shape, box, mask), window)
    with ThreadPoolExecutor(max(threads, 1)) as pool:
        seen, stages, left = going_on(() if previous is None else previous.stages, clicks, spacing)
        if previous is not None and stages:
            smooth, proposal = previous.images, previous.proposal
        else:
            smooth = learned_images(images, spacing) if learned is None else learned()
            answer, proposal = answer_to_first(smooth, spacing, where, clicks, size_mm3, box is not None)
            seen = heard(clicks, answer, spacing)
            first, left = Clicks(in_order(seen).clicks[:1], seen.shape), in_order(seen).clicks[1:]
            stages = (_stage_of(None, first, answer, sized, images, spacing, where, pool),)
        contradicts = contradicting(stages[-1].answer, in_order(seen), left)
        answers = zip(left, _answers(stages[-1].answer, left, smooth, spacing, pool), strict=True)
        stages = _stages_after(stages, answers, contradicts, sized, images, spacing, where, pool)
        stated = proposal.volume_mm3 if sized else None
        edged = at_edges(stages[-1].shown, images, smooth, spacing, seen, where.mask, pool, stated_mm3=stated)
        arrays = on_whole_grid(edged, clicks.shape)
    area = area_weight(images, spacing, arrays[1], where.mask)
    return SeededModel(*arrays, proposal, area, clicks, smooth, sized, stages)


def _stages_after(
    stages: tuple[Stage, ...],
    answers: Iterable[tuple[Click, Answer]],
    contradicts: Sequence[Click],
    sized: bool,
    images: Sequence[Image],
    spacing: Spacing,
    where: Domain,
    pool: ThreadPoolExecutor,
) -> tuple[Stage, ...]:
    """The first stage and that of all clicks; ``answers`` are more clicks and the answer after each.

    The size that a click contradicts is known from that click on: no model without it goes on from a stage before.
    """
    for click, answer in answers:
        known = stages[-1].clicks.with_more([click])
        stage = _stage_of(stages[-1], known, answer, sized, images, spacing, where, pool)
        stages = (stage,) if any(click is other for other in contradicts) else (*stages[:1], stage)
    return stages


def _stage_of(
    before: Stage | None,
    clicks: Clicks,
    answer: Answer,
    sized: bool,
    images: Sequence[Image],
    spacing: Spacing,
    where: Domain,
    pool: ThreadPoolExecutor,
) -> Stage:
    """The stage of some clicks, of which the last one is new, by their answer; ``before`` is None of the first."""
    allowed, window = where
    if window is not None:  # a part of what is looked at is shown
        window.check_box(box_around(clicks, spacing, WALKS_REACH, answer.count)[0])
    parts = contest(images, spacing, clicks, allowed, answer.count, pool)
    if before is None:
        stage = Stage(clicks, answer, mixed_answer(answer, parts, clicks, sized, None))
    else:
        stage = stage_after(before, clicks, answer, parts, sized, images, spacing, allowed)
    if window is not None:
        window.check_box(stage.shown.box)
    return stage


def learned_images(images: Sequence[Image], spacing: Spacing) -> tuple[Image, ...]:
    """The channels as clicks learn from them: smoothed by `SMOOTHING`."""
    return tuple(gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images)


def _allowed(shape: tuple[int, ...], box: Box | None, mask: Mask | None) -> Mask | None:
    """Mask of the voxels where the object may be; None for everywhere."""
    if box is None:
        return mask
    out = np.zeros(shape, np.bool_)
    out[box] = True if mask is None else mask[box]
    return out


def _answers(
    answer: Answer, clicks: Sequence[Click], images: Sequence[Image], spacing: Spacing, pool: ThreadPoolExecutor
) -> Iterator[Answer]:
    """The answer after each of some later clicks; one without blocks of its own changes nothing."""
    first, field, known = answer, field_in(answer.blocks), list[Click | None]()
    for click in clicks:
        before = [*first.clicks, *(placed for placed in known if placed is not None)]
        known.append(first.blocks.click(click, before))

    def marched(click: Click, placed: Click | None) -> Times | None:
        return None if placed is None else later_times(field, learn(images, spacing, click), placed, first)

    for placed, times in zip(known, pool.map(marched, clicks, known), strict=True):
        if placed is not None and times is not None:
            answer = with_click(answer, field, placed, times)
        yield answer


def later_times(field: Field, tissue: Tissue, click: Click, answer: Answer) -> Times:
    """Arrival times from a later click, on the scale of the first one's.

    From an inside click the march ends where the surroundings begin: later times say nothing more.

    Parameters
    ----------
    field : Field
        Of the answer's blocks.
    tissue : Tissue
        Of the click, learned voxel by voxel.
    click : Click
        In blocks.
    answer : Answer
        To clicks before it.
    """
    seeds, count = seeds_of(click, field), answer.blocks.count(answer.count)
    faster = LATER[click.side] * answer.level
    ends = click.side == "inside" and faster > 0.0 and len(seeds) < count
    late = (count, answer.last / faster) if ends else (0, np.inf)
    times, cells = reached(field, tissue, seeds, int(FARTHER * BEYOND * count), late=late)
    found, rank = times[cells], min(count, len(cells)) - 1
    rank_time = float(np.partition(found, rank)[rank])
    times[cells] = found * np.float32(faster / rank_time if rank_time > 0.0 else 1.0)  # all others are inf
    return times


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
