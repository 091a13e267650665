"""Model of an object's clicks while it is corrected: the voxels that a click relabels. Each click costs its own box."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.correct.corrected_surface import CorrectedSurface
from accelsurf.correct.region import around_clicks, automatic_near
from accelsurf.energies.seeded import Proposal, SeededModel
from accelsurf.energies.seeded.after_click import stage_after
from accelsurf.energies.seeded.answers import Answer, with_click
from accelsurf.energies.seeded.appearance import learn
from accelsurf.energies.seeded.contest import Balance, contest, field_of
from accelsurf.energies.seeded.edge import at_edges, mean_curvature
from accelsurf.energies.seeded.first_click import BEYOND, FARTHER
from accelsurf.energies.seeded.model import going_on, later_times
from accelsurf.energies.seeded.stages import Stage, first_and_last, in_order, mostly_left
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    box_at,
    connected_to,
    corner_of,
    counted_from,
    enclosing,
    on_box,
    placed_at,
    whole_box,
    widened,
)
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.kernels.arrival import Tissue
from accelsurf.run.image_context import ImageContext
from accelsurf.run.preprocessing import PreprocessedInput
from accelsurf.run.setup import thread_count
from accelsurf.settings.run_config import RunConfig

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Spacing = tuple[float, float, float]
#: Size of the first box of a march, in radii of a ball of as many voxels as the march may accept.
REACH = 2.5
#: Spacing, in smallest spacings, from which a slice is as thick as two voxels.
_THICK_SLICES = 2.0
#: Least voxels between those that a march accepts and the border of its box, so that the box changes nothing.
_CLEAR = 2


class LocalState(NamedTuple):
    """A model between two clicks, as a value, on a ``box`` of the grid; beyond it F is 1 and nothing is inside.

    ``clicks`` that it was made from, on the whole grid's indices; ``images``, the channels as the model sees them, on
    the whole grid; ``field`` F and ``start`` on the box; ``sized``, whether a size was stated; ``proposal`` of the
    first click; ``stages`` from which it continues, the last with all active clicks; none of a partition.
    """

    clicks: Clicks
    images: tuple[Image, ...]
    box: Box
    field: Image
    start: Mask
    sized: bool = False
    proposal: Proposal | None = None
    stages: tuple[Stage, ...] = ()

    @classmethod
    def of(cls, model: SeededModel) -> LocalState:
        """Return the state of a whole model."""
        if not model.stages:
            return cls(model.clicks, model.images, whole_box(model.field.shape), model.field, model.start)
        box = bounding_box((model.field != 1.0) | model.start, 0) or whole_box(model.field.shape)
        field, start = model.field[box].copy(), model.start[box].copy()
        return cls(model.clicks, model.images, box, field, start, model.sized, model.proposal, model.stages)


class ModelChange(NamedTuple):
    """The change by a click: the ``mask`` on a ``box`` of the grid where the object has changed; and before."""

    box: Box
    mask: Mask
    before: LocalState


class LocalModel:
    """The model of an object, click by click.

    Parameters
    ----------
    state : LocalState
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    passes : ndarray of bool or None
        The mask of the run.
    whole : callable
        Makes the whole model of clicks: needed for a partition, where a click takes voxels from an earlier one, and
        where one says that the first size hypothesis was far too large.
    threads : int, optional
        The result is the same for any number.
    """

    def __init__(
        self,
        state: LocalState,
        images: Sequence[Image],
        spacing: Spacing,
        passes: Mask | None,
        whole: Callable[[Clicks], SeededModel],
        threads: int = 1,
    ) -> None:
        self.state = state
        self._images, self.spacing, self._passes, self._threads = images, spacing, passes, threads
        self._whole = whole

    def field_on(self, box: Box) -> Image:
        """F on a box of the grid: the surface grows where it is below 0."""
        return on_box(self.state.field, self.state.box, box, 1.0)

    def mean_curvature(self) -> float:
        """Mean curvature of the model's object, 1/mm; 0 of a partition, see `SeededModel.mean_curvature`."""
        return mean_curvature(self.state.start, self.spacing) if self.state.stages else 0.0

    def add(self, click: Click) -> ModelChange:
        """Update the model by one more click, at the cost of a box.

        It is the model of all clicks; but where the click takes a small part of others, the blended score of before
        is used with the score maps of the rest of them, see `mostly_left`.

        Parameters
        ----------
        click : Click
            On the grid of the model, as its object sees it.
        """
        before, clicks = self.state, self.state.clicks.with_later([click])
        self.state = self._updated(clicks) or LocalState.of(self._whole(clicks))
        box = enclosing(self.state.box, before.box)
        now = on_box(self.state.start, self.state.box, box, False)
        return ModelChange(box, now != on_box(before.start, before.box, box, False), before)

    def _updated(self, clicks: Clicks) -> LocalState | None:
        """The state after some clicks, from the last stage that none of them changes; None where none is known."""
        known, stages, left = going_on(self.state.stages, clicks, self.spacing)
        if not stages:
            return None
        with ThreadPoolExecutor(max(self._threads, 1)) as pool:
            is_taken = not clicks.starts_with(self.state.clicks) and len(left) > 1
            if is_taken and left[-1] is clicks.clicks[-1] and mostly_left(self.state.clicks, clicks):
                after = [self._stage_beside(known, stages[-1].answer, left, pool)]
            else:
                after = list(self._stages_after(stages[-1], left, pool))
            stages = first_and_last((*stages, *after))
            seen = self._images, self.state.images, self.spacing, known, self._passes
            stated = self.state.proposal.volume_mm3 if self.state.sized and self.state.proposal is not None else None
            box, field, start = at_edges(stages[-1].shown, *seen, pool, stated_mm3=stated)
        return self.state._replace(clicks=clicks, box=box, field=field, start=start, stages=stages)

    def _stages_after(self, stage: Stage, left: Sequence[Click], pool: ThreadPoolExecutor) -> Iterator[Stage]:
        """The stages after some more clicks: labellings need no score maps, which are made beside them."""
        scoring = pool.submit(lambda: list(self._score_maps(stage.answer, left)))
        known = [stage.clicks.with_more(left[: i + 1]) for i in range(len(left))]
        labelled = [contest(self._images, self.spacing, it, self._passes, stage.answer.count, pool) for it in known]
        for clicks, score_map, parts in zip(known, scoring.result(), labelled, strict=True):
            stage = self._stage_of(stage, clicks, score_map, parts)
            yield stage

    def _stage_beside(
        self, known: Clicks, score_map: Answer, left: Sequence[Click], pool: ThreadPoolExecutor
    ) -> Stage:
        """The stage of the clicks ``known``, the last of which is new; those before it in ``left`` have lost voxels.

        It continues from the blended score before the last one, and from the ``score_map`` before all of them.
        """
        before = self.state.stages[-1]
        scoring = pool.submit(lambda: [score_map, *self._score_maps(score_map, left)][-1])
        clicks = in_order(known)
        parts = contest(self._images, self.spacing, clicks, self._passes, score_map.count, pool)
        return self._stage_of(before, clicks, scoring.result(), parts)

    def _stage_of(self, before: Stage, clicks: Clicks, score_map: Answer, parts: Sequence[Balance]) -> Stage:
        """The stage of some clicks, of which the last one is new, by their score map and labellings, after another."""
        given = score_map, parts, self.state.sized, self._images, self.spacing, self._passes
        return stage_after(before, clicks, *given)

    def _score_maps(self, score_map: Answer, left: Sequence[Click]) -> Iterator[Answer]:
        """The score map after each of some more clicks."""
        for click in left:
            score_map = self._score_map_after(score_map, click)
            yield score_map

    def _score_map_after(self, score_map: Answer, click: Click) -> Answer:
        """The score map after one more click, on a box whose border its march does not come near."""
        blocks, block_click = score_map.blocks, score_map.blocks.click(click, score_map.clicks)
        if block_click is None:
            return score_map
        appearance = learn(self.state.images, self.spacing, click)
        count = FARTHER * BEYOND * blocks.count(score_map.count)
        axes = [n for n in blocks.shape if n > 1]
        reach = REACH * (count * (3.0 / (4.0 * math.pi) if len(axes) == 3 else 1.0 / math.pi)) ** (1.0 / len(axes))
        mean = math.prod(blocks.spacing) ** (1.0 / 3.0)
        margin = [math.ceil(reach * mean / h) + _CLEAR for h in blocks.spacing]
        while True:
            box = enclosing(widened(block_click.box, blocks.shape, margin), score_map.box)
            found = _score_map_on_box(score_map, block_click, appearance, box)
            if found is not None:
                return found
            margin = [2 * m for m in margin]

    def undo(self, change: ModelChange) -> None:
        """Take back the last change."""
        self.state = change.before


def basin_of(click: Click, change: ModelChange, model: LocalModel, surface: CorrectedSurface) -> Click:
    """Return the basin of a click, as a click: its voxels, and those that the model relabels to its side.

    Of those, the voxels that the model relabels because of the click: also a part that an outside click cuts off,
    where F is as it was, but which is connected to no inside click any more. Far from the click only pieces thicker
    than a voxel: any click moves the model's boundary by parts of a voxel everywhere, and the surface need not be run
    again for that. And voxels around the click, connected to it, where the surface has left the model's boundary: the
    click says that this was wrong.

    Parameters
    ----------
    click : Click
    change : ModelChange
        That it made.
    model : LocalModel
        After the click.
    surface : CorrectedSurface
    """
    spacing = model.spacing
    near = automatic_near(surface.psi, [click._replace(box=counted_from(click.box, surface.corner))], spacing)
    around = around_clicks([click], near, 0.0, model.state.clicks.shape, spacing, 0.0)
    box = enclosing(around.box, change.box)
    on_side = on_box(model.state.start, model.state.box, box, False) == (click.side == "inside")
    changed, near_it = (
        on_side & on_box(change.mask, change.box, box, False),
        on_box(around.mask, around.box, box, False),
    )
    changed = connected_to(changed, changed & (near_it | _thicker_than_a_voxel(changed, spacing)))
    on_side &= near_it
    on_side &= (on_box(surface.psi, box_at(surface.corner, surface.psi.shape), box, 1.0) < 0) != (
        click.side == "inside"
    )
    clicked = click.mask_on(box)
    return click._replace(box=box, mask=changed | connected_to(on_side | clicked, clicked))


def _thicker_than_a_voxel(mask: Mask, spacing: Spacing) -> Mask:
    """The first voxels of the blocks in a mask of two voxels along each axis; of one along axes that are as coarse."""
    out = mask.copy()
    fine = [h < _THICK_SLICES * min(spacing) for h in spacing]
    for axis in (i for i, n in enumerate(mask.shape) if n > 1 and fine[i]):
        here: list[slice] = [slice(None)] * 3
        here[axis] = slice(None, -1)
        last, following = list(here), list(here)
        last[axis], following[axis] = slice(-1, None), slice(1, None)
        pairs = out[tuple(here)] & out[tuple(following)]
        out[tuple(here)], out[tuple(last)] = pairs, False
    return out


def local_model(
    prepared: PreprocessedInput, context: ImageContext, settings: RunConfig, state: LocalState
) -> LocalModel:
    """The model of an object of a finished run, from its ``state`` on."""
    distance = prepared.mask_distance
    passes = None if distance is None else np.asarray(distance < 0)
    spacing, threads = prepared.geometry.spacing, thread_count(settings)
    return LocalModel(state, prepared.images, spacing, passes, _maker(context), threads)


def _maker(context: ImageContext) -> Callable[[Clicks], SeededModel]:
    return lambda clicks: context.with_clicks(clicks).seeded_model()


def _score_map_on_box(score_map: Answer, click: Click, appearance: Tissue, box: Box) -> Answer | None:
    """The score map after one more click, in blocks, on a box; None where its march comes near the box's border."""
    blocks = score_map.blocks
    images = [np.ascontiguousarray(image[box]) for image in blocks.images]
    passes = None if blocks.passes is None else blocks.passes[box]
    field, corner = field_of(images, blocks.spacing, passes), corner_of(box)
    clicks = tuple(_click_counted_from(earlier, corner) for earlier in score_map.clicks)
    here = dataclasses.replace(score_map, box=counted_from(score_map.box, corner), clicks=clicks)
    here_click = _click_counted_from(click, corner)
    times = later_times(field, appearance, here_click, here)
    if _is_near_border(times.reshape(field.shape), box, blocks.shape):
        return None
    after = with_click(here, field, here_click, times)
    return dataclasses.replace(after, box=placed_at(after.box, corner), clicks=(*score_map.clicks, click))


def _click_counted_from(click: Click, corner: tuple[int, int, int]) -> Click:
    return click._replace(box=counted_from(click.box, corner))


def _is_near_border(times: Image, box: Box, shape: Sequence[int]) -> bool:
    """Return True if times on a box are known near a border of the box that is none of the grid's."""
    for axis, (side, n) in enumerate(zip(box, shape, strict=True)):
        ends = (slice(None),) * axis
        if side.start > 0 and np.isfinite(times[(*ends, slice(None, _CLEAR))]).any():
            return True
        if side.stop < n and np.isfinite(times[(*ends, slice(-_CLEAR, None))]).any():
            return True
    return False
