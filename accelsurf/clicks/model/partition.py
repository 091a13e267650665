"""Objects that part a space: each voxel belongs to the click that comes to it at the lowest cost.

One model for all of them. One march from all clicks says which voxels are whose; a path is about as long as its worst
place is unlike the clicks, as in a watershed, and where nothing differs the nearer click has the voxel. The
background competes with its appearance. The shares of the objects around each voxel say where, between voxels,
two of them meet. The cost is that of the volume and of the sum of the objects' boxes.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.kernels.arrival import Appearance, Sources
from accelsurf.clicks.model.fronts import learned, times_from
from accelsurf.clicks.model.model import CLICKED, JUST, ClickModel
from accelsurf.errors import InputError
from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import Box, connected_to, whole_box, widened
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.image.smoothing import gaussian_mm

#: Smoothing of the image before anything is learned from it, and of the shares of objects; of the smallest spacing.
SMOOTHING = 0.3
SHARES = 0.7
#: Shares are cut at this number of their widths.
REACH = 4.0
#: Cost per mm where a voxel looks like the clicks; the power of how many spreads it differs by, and most of these.
LEAST = 0.2
POWER = 4
MAX_SPREADS = 10.0
#: Medium of a front: an image of costs.
_COSTS = Appearance(
    np.zeros(1), np.ones(1), np.ones(1), np.array((LEAST, 0.0, 0.0, 1.0, 0.0, MAX_SPREADS**POWER))
)
#: The same for the background, which is all around: how far it lies from a click says next to nothing.
_GROUND = _COSTS._replace(weights=np.array((0.05 * LEAST, *_COSTS.weights[1:])))
#: Label of voxels of the background or of an outside click; and of voxels where no front comes.
NOBODY = 0
UNREACHED = -1


class Basins(NamedTuple):
    """Voxels of all objects, which have the numbers from 1 on in the order of their ids.

    Attributes
    ----------
    numbers : dict of int to int
        Number of each owner of clicks.
    labels : ndarray (nz, ny, nx) int32
        Number of the owner from whose clicks a front comes first; `NOBODY`, `UNREACHED`.
    boxes : list of tuple of slice
        Of the voxels of each number, with room for the reach of its share.
    first, second : ndarray (nz, ny, nx) float32
        The largest share of a number in the voxels around each, and the next.
    largest : ndarray (nz, ny, nx) int32
        Whose the largest is; its own in a clicked voxel.
    """

    numbers: dict[int, int]
    labels: NDArray[np.int32]
    boxes: list[Box]
    first: Singles
    second: Singles
    largest: NDArray[np.int32]


class BasinsOnce:
    """Basins that are computed once for the objects of a run."""

    def __init__(self) -> None:
        self._last: Basins | None = None
        self._seen: tuple[object, ...] = ()

    def of(
        self, images: Sequence[Singles], spacing: Spacing, clicks: Clicks, mask: Mask | None
    ) -> Basins:
        """The basins of clicks as one object sees them; the last ones again where clicks and images are the same."""
        if not all(click.side == "inside" or click.owner is not None for click in clicks.clicks):
            return basins_of(
                images, spacing, clicks.clicks, mask
            )  # some say nothing of the other objects
        seen = *images, *(click.mask for click in clicks.clicks)
        is_same = len(seen) == len(self._seen) and all(map(operator.is_, seen, self._seen))
        if self._last is None or not is_same:
            self._last, self._seen = basins_of(images, spacing, clicks.clicks, mask), seen
        return self._last


def owner_of(click: Click) -> int:
    """Return the id inside which an object sees a click; `NO_OBJECT` of one that is outside of it alone."""
    return (
        click.owner
        if click.owner is not None
        else click.id
        if click.side == "inside"
        else NO_OBJECT
    )


def basins_of(
    images: Sequence[Singles], spacing: Spacing, clicks: Sequence[Click], mask: Mask | None
) -> Basins:
    """Find the basins of clicks.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    clicks : sequence of Click
        As one object sees them; no two of different owners share a voxel.
    mask : ndarray (nz, ny, nx) of bool, optional
        All objects lie in it.
    """
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images]
    firsts = {owner_of(click): click for click in reversed(clicks)}
    numbers = {owner: number for number, owner in enumerate(sorted(firsts.keys() | {NO_OBJECT}))}
    common = _common(
        [learned(smooth, spacing, click) for owner, click in firsts.items() if owner != NO_OBJECT]
    )
    seeds, ground = (
        np.full(images[0].shape, UNREACHED, np.int32),
        np.zeros(images[0].shape, np.bool_),
    )
    beyond = np.full(ground.shape, np.inf, np.float32)
    for click in clicks:
        if (
            click.owner == NO_OBJECT
        ):  # with one spread two appearances meet halfway between their values
            ground[click.box] |= click.mask
            appearance = learned(smooth, spacing, click)._replace(spread=common.spread)
            np.minimum(beyond, _cost(smooth, appearance), out=beyond)
        else:
            seeds[click.box][click.mask] = numbers[owner_of(click)]
    sooner = times_from(ground, beyond, spacing, _GROUND, mask) if ground.any() else None
    cost = _cost(smooth, common)
    del smooth, beyond
    origin: NDArray[Any] = np.empty(seeds.size, np.int32 if seeds.size < 2**31 else np.int64)
    sources = Sources(origin, seeds.ravel())
    times_from(seeds != UNREACHED, cost, spacing, _COSTS, mask, sooner, sources)
    del cost
    labels = np.where(origin >= 0, seeds.ravel()[origin], np.int32(UNREACHED)).reshape(seeds.shape)
    if sooner is not None:
        labels[(labels == UNREACHED) & np.isfinite(sooner)] = NOBODY
    del origin, sources, sooner
    return _with_shares(numbers, labels, spacing, clicks)


def _cost(images: Sequence[Singles], appearance: Appearance) -> Singles:
    """Cost of each voxel: a power of how many spreads it differs by from an appearance, in the channel where most."""
    out = np.zeros(images[0].shape, np.float32)
    for image, median, spread in zip(images, appearance.median, appearance.spread, strict=True):
        np.maximum(out, np.abs(image - np.float32(median)) / np.float32(spread), out=out)
    np.minimum(out, np.float32(MAX_SPREADS), out=out)
    return np.asarray(out**POWER)


def _common(appearances: Sequence[Appearance]) -> Appearance:
    """Appearance of several clicks: medians; the spread is that of their medians where it is more."""
    medians = np.stack([appearance.median for appearance in appearances])
    middle = np.median(medians, axis=0)
    apart = 1.4826 * np.median(np.abs(medians - middle), axis=0)
    spread = np.maximum(np.median([appearance.spread for appearance in appearances], axis=0), apart)
    return appearances[0]._replace(median=middle, spread=spread)


def _with_shares(
    numbers: dict[int, int], labels: NDArray[np.int32], spacing: Spacing, clicks: Sequence[Click]
) -> Basins:
    """The basins with the shares of all numbers."""
    margin = [math.ceil(REACH * SHARES * min(spacing) / h) for h in spacing]
    tight = ndimage.find_objects(labels, max(numbers.values()))
    whole = whole_box(labels.shape)
    found = Basins(
        numbers,
        labels,
        [whole, *(whole if box is None else widened(box, labels.shape, margin) for box in tight)],
        np.zeros(labels.shape, np.float32),
        np.zeros(labels.shape, np.float32),
        labels.copy(),
    )
    for number, box in enumerate(found.boxes):
        if number == NOBODY and not (labels == NOBODY).any():
            continue
        share = _share(found, number, spacing)
        first = found.first[box]
        second = found.second[box]
        is_more = share > first
        second[...] = np.where(is_more, first, np.maximum(second, share))
        first[is_more], found.largest[box][is_more] = share[is_more], number
    for click in clicks:
        found.largest[click.box][click.mask] = numbers[owner_of(click)]
        found.first[click.box][click.mask], found.second[click.box][click.mask] = 1.0, 0.0
    found.largest[labels == UNREACHED] = UNREACHED
    return found


def _share(found: Basins, number: int, spacing: Spacing) -> Singles:
    """The share of a number in the surroundings of each voxel of its box."""
    mine = found.labels[found.boxes[number]] == number
    return gaussian_mm(mine.astype(np.float32), spacing, SHARES * min(spacing))


def partition_model(
    images: Sequence[Singles],
    spacing: Spacing,
    clicks: Clicks,
    *,
    mask: Mask | None = None,
    basins: BasinsOnce | None = None,
) -> ClickModel:
    """Make the model of one of several objects that touch.

    F is the largest share of another object in the surroundings of a voxel, less that of its own.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
        As the object sees them, see `Clicks.of`.
    mask : ndarray (nz, ny, nx) of bool, optional
        The object lies in it.
    basins : BasinsOnce, optional
        Of the run: they are computed once for its objects.

    Raises
    ------
    InputError
        When it has no inside click, or nothing is outside of it.
    """
    mine = clicks.on_side("inside").clicks
    if not mine or len(mine) == len(clicks):
        raise InputError(
            "partition: clicks inside and outside of the object are needed",
            "give clicks in its neighbours too",
        )
    found = (basins or BasinsOnce()).of(images, spacing, clicks, mask)
    number = found.numbers[owner_of(mine[0])]
    box, share = found.boxes[number], _share(found, number, spacing)
    largest = found.largest[box]
    first = found.first[box]
    second = found.second[box]
    force = np.where(
        largest == number, np.minimum(second - first, -JUST), np.maximum(first - share, JUST)
    )
    force[largest == UNREACHED] = 1.0
    clicked = np.logical_or.reduce([click.mask_on(box) for click in mine])
    force[clicked] = CLICKED["inside"]
    start = connected_to(force < 0, clicked)
    force[~start] = np.maximum(force[~start], JUST)
    return ClickModel(clicks, box, force.astype(np.float32), start, is_partition=True)
