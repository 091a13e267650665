"""Score map of the first inside click: how large the object is, and F for that size.

Volumes up to many times the expected one are compared. The march over voxels ends where an object of blocks of one
voxel has its surroundings; beyond, where a single voxel does not count, a march over blocks goes on: so the first click
on a large image takes no longer than on a small one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.answers import Answer, FirstTimes, Proposed, first_answer
from accelsurf.energies.seeded.appearance import Image, Spacing, count_of, even_radius, learn
from accelsurf.energies.seeded.blocks import MAX_BLOCKS, Blocks, Domain, field_in, in_blocks
from accelsurf.energies.seeded.contest import Field, Order, Times, arrival
from accelsurf.energies.seeded.proposal import (
    NEARBY,
    LevelEvidence,
    Prior,
    Proposal,
    by_evidence,
    edges_of,
    joined,
    level_evidence,
    of_size,
    prior_of,
    with_finer_evidence,
)
from accelsurf.energies.seeded.stages import in_order
from accelsurf.errors import InputError
from accelsurf.grid.boxes import bounding_box, box_at
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.kernels.arrival import Tissue

#: The surroundings begin where the first click's arrival time has so many times the object's volume.
BEYOND = 3.0
#: A march goes so much farther than that.
FARTHER = 1.05
#: At least this part of the object arrives before an outside click; if not of the proposed size, a smaller one is
#: proposed. Later clicks say where the object ends, not how large it is.
FAR_TOO_LARGE = 0.1
#: No march of a first click without a size accepts more than this part of the volume.
MAX_PART = 0.25
#: A march accepts so many voxels, or blocks: an object of `MAX_BLOCKS` has its surroundings. It may be up to so many
#: times longer before it takes larger blocks.
MAX_MARCH, MAX_LONGER = int(FARTHER * BEYOND * MAX_BLOCKS) + 1, 2


class Front(NamedTuple):
    """A march from the first click over blocks of voxels; ``click`` in blocks, ``order`` the blocks by their times."""

    blocks: Blocks
    field: Field
    click: Click
    times: Times
    order: Order

    @classmethod
    def of(cls, blocks: Blocks, click: Click, tissue: Tissue, voxels: float) -> Front:
        """March from a click, on the voxels, until about so many voxels are accepted."""
        placed, field = blocks.click(click, ()), field_in(blocks)
        assert placed is not None  # no click was before it
        found = arrival(field, tissue, seeds_of(placed, field), int(voxels / blocks.size) + 1)
        return cls(blocks, field, placed, *found)

    @property
    def voxels(self) -> int:
        """Number of voxels that have arrived."""
        return len(self.order) * self.blocks.size

    def at(self, voxels: float) -> float:
        """When so many voxels have arrived."""
        return float(self.times[self.order[min(self.blocks.count(voxels), len(self.order)) - 1]])

    def proposed(self, voxels: float, spacing: Spacing) -> Proposed:
        """Make the proposal of the first so many voxels that have arrived; ``spacing`` of the voxels, mm."""
        mask = (self.times <= self.at(voxels)).reshape(self.field.shape)
        box = bounding_box(mask)
        assert box is not None  # the click is in it
        return Proposed(self.blocks, box, mask[box].copy(), spacing)

    def evidence(self, tissue: Tissue) -> LevelEvidence:
        """Evidence of the image for each level."""
        edges = edges_of(self.blocks.images, self.blocks.spacing, tissue, self.order)
        first = int(np.count_nonzero(self.click.mask))
        return level_evidence(self.field.medium.values, edges, self.times, self.order, first, self.blocks.size)


def first_inside(clicks: Clicks) -> Click:
    """The first inside click.

    Raises
    ------
    InputError
        When there is none.
    """
    for click in clicks.clicks:
        if click.side == "inside":
            return click
    raise InputError("seeded: no inside click was given", "give one with --inside")


def seeds_of(click: Click, field: Field) -> NDArray[np.int64]:
    """The voxels of a click on a field's grid, as flat indices."""
    where = [axis + side.start for axis, side in zip(np.nonzero(click.mask), click.box, strict=True)]
    return np.ravel_multi_index(tuple(where), field.shape).astype(np.int64)


class Asked(NamedTuple):
    """A click, and the local appearance under it."""

    click: Click
    tissue: Tissue


def answer_to_first(
    images: Sequence[Image],
    spacing: Spacing,
    where: Domain,
    clicks: Clicks,
    size_mm3: float | None,
    boxed: bool,
) -> tuple[Answer, Proposal]:
    """The answer to the first inside click, and the size that it was made with: smaller where outside clicks ask.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, smoothed.
    spacing : (hz, hy, hx)
        mm.
    where : Domain
    clicks : Clicks
        One of them at least is inside.
    size_mm3 : float or None
        About the object's volume.
    boxed : bool
        Whether a person drew a box around it.

    Raises
    ------
    InputError
        When the click lies outside box or mask; LeavesWindow when it looks beyond the window.
    """
    click, voxel = first_inside(clicks), float(np.prod(spacing))
    if where.mask is not None and not where.mask[click.box][click.mask].any():
        raise InputError("seeded: the inside click lies outside the box or the mask", "click in it, or make it larger")
    tissue = learn(images, spacing, click)
    if size_mm3 is not None:
        blocks = in_blocks(images, spacing, *where, round(size_mm3 / voxel))
        front = Front.of(blocks, click, tissue, FARTHER * BEYOND * size_mm3 / voxel)
        proposal, none = of_size(front.voxels, voxel, size_mm3), np.zeros((0, 0, 0), np.float32)
        first = FirstTimes(box_at((0, 0, 0), (0, 0, 0)), none, -np.inf)
    else:
        front, proposal, first = _by_evidence(images, spacing, where, clicks, Asked(click, tissue), boxed)
    count = round(proposal.volume_mm3 / voxel)
    level = count, front.at(count), front.at(BEYOND * count)
    return first_answer(front.field, front.blocks, tissue, front.click, front.times, level, first), proposal


def _by_evidence(
    images: Sequence[Image],
    spacing: Spacing,
    where: Domain,
    clicks: Clicks,
    asked: Asked,
    boxed: bool,
    by_tissue: bool = True,
) -> tuple[Front, Proposal, FirstTimes]:
    """The answer's march, the size that is likely, and what contradicts it; ``asked`` are a click and its tissue.

    ``by_tissue``: the even tissue around the click may be the object.
    """
    (click, tissue), voxel = asked, float(np.prod(spacing))
    prior, farthest = _expected(images, spacing, where, asked, boxed, by_tissue)
    is_far = farthest > MAX_LONGER * MAX_MARCH
    near = Front.of(in_blocks(images, spacing, *where, 0), click, tissue, (MAX_MARCH if is_far else farthest) - 1)
    evidence, most, whole = near.evidence(tissue), np.inf, near
    if is_far and near.voxels >= MAX_MARCH:  # it did not end before
        blocks = in_blocks(images, spacing, *where, math.ceil(farthest * MAX_BLOCKS / MAX_MARCH))
        whole = Front.of(blocks, click, tissue, farthest)
        evidence = joined(evidence, whole.evidence(tissue))
    proposal, proposed = by_evidence(evidence, prior, voxel), None
    if prior.even and np.isfinite(prior.spread):
        proposed = whole.proposed(proposal.volume_mm3 / voxel, spacing)
        if any(proposed.disowned(in_order(clicks))):
            return _by_evidence(images, spacing, where, clicks, asked, boxed, by_tissue=False)
    early = near.at(int(FAR_TOO_LARGE * proposal.volume_mm3 / voxel) + 1)
    first, front = FirstTimes.of(near.field, near.times, near.order, early, proposed), near
    earliest = min((first.comes_to(click) for click in first.contradicted(in_order(clicks))), default=np.inf)
    if np.isfinite(earliest):
        most = float(np.searchsorted(near.times[near.order], earliest)) / FAR_TOO_LARGE
        proposal = by_evidence(evidence, prior, voxel, most)
    count = round(proposal.volume_mm3 / voxel)
    blocks = in_blocks(images, spacing, *where, count)
    if blocks.size > 1:
        is_coarse = is_far and 2 * NEARBY * count > near.voxels
        front = Front.of(blocks, click, tissue, FARTHER * BEYOND * (NEARBY if is_coarse else 1.0) * count)
        if is_coarse:
            proposal = with_finer_evidence(proposal, front.evidence(tissue), prior, voxel, most)
    return front, proposal, first


def _expected(
    images: Sequence[Image],
    spacing: Spacing,
    where: Domain,
    asked: Asked,
    boxed: bool,
    by_tissue: bool,
) -> tuple[Prior, int]:
    """Find the expected number of voxels, and how many a march may accept."""
    (click, tissue), (allowed, window), flat = asked, where, images[0].shape[0] == 1
    whole = math.prod(images[0].shape) if window is None else window.voxels
    open_count = whole if allowed is None else int(np.count_nonzero(allowed))
    even = count_of(even_radius(images, spacing, click, tissue, window), spacing, flat)
    prior = prior_of(int(np.count_nonzero(click.mask)), open_count if boxed else None, even, flat)
    if not by_tissue:
        prior = prior._replace(even=0.0)
    return prior, open_count if boxed else int(min(prior.farthest(), int(MAX_PART * open_count)))
