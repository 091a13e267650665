"""Cells that fill a space: each voxel belongs to the click that comes to it at the lowest cost, whatever lies behind.

No likelihood and no surroundings: neighbours look alike, and only membranes between them tell them apart. One march
from all clicks says where the cells are; marches within each cell say how much nearer the next one is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.model.fronts import CROSS, Field, balance, field_of, learned
from accelsurf.clicks.model.model import CLICKED, ClickModel
from accelsurf.clicks.model.windows import Floats, Mask, Spacing
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, bounding_box, connected_to, whole_box
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.kernels.arrival import Tissue

#: Smoothing of the image before anything is learned from it, of the smallest spacing.
SMOOTHING = 0.6


class Basins(NamedTuple):
    """Basins, which all objects share.

    Attributes
    ----------
    field : Field
    tissue : Tissue
        That the marches go through.
    clicks : tuple of Click
        Those inside of an object, or of what is no object.
    times : ndarray (nz, ny, nx) float32
        Arrival times from all of them.
    nearest : ndarray (n,) int32
        The click from which the front comes, by its number; -1 where none does.
    """

    field: Field
    tissue: Tissue
    clicks: tuple[Click, ...]
    times: Floats
    nearest: NDArray[np.int32]


class BasinsOnce:
    """Basins that are computed once for the objects of a run."""

    def __init__(self) -> None:
        self._last: Basins | None = None
        self._seen: tuple[Floats, ...] = ()

    def of(self, images: Sequence[Floats], spacing: Spacing, clicks: Clicks, mask: Mask | None) -> Basins:
        """The basins of clicks as one object sees them; those of the last time where clicks and images are the same."""
        owned, last = tuple(click for click in clicks.clicks if _is_owned(click)), self._last
        if last is None or not _are_same(self._seen, images) or not _are_same(_masks(last.clicks), _masks(owned)):
            last = basins_of(images, spacing, owned, mask)
            self._last, self._seen = last, tuple(images)
        return last


def _is_owned(click: Click) -> bool:
    """Test if it lies inside of something, and says the same to all objects."""
    return click.side == "inside" or click.owner is not None


def _are_same(first: Sequence[object], second: Sequence[object]) -> bool:
    return len(first) == len(second) and all(a is b for a, b in zip(first, second, strict=True))


def _masks(clicks: Sequence[Click]) -> list[Mask]:
    return [click.mask for click in clicks]


def basins_of(images: Sequence[Floats], spacing: Spacing, clicks: tuple[Click, ...], mask: Mask | None) -> Basins:
    """The basins of clicks inside of objects, or of what is no object.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    clicks : tuple of Click
        No two of different owners share a voxel.
    mask : ndarray (nz, ny, nx) of bool, optional
        All objects lie in it.
    """
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images]
    field = field_of(smooth, spacing, mask)
    firsts = {click.owner: click for click in reversed(clicks) if click.owner != NO_OBJECT}
    tissue = _common([learned(smooth, spacing, click) for click in firsts.values()])
    seeds = [_voxels(click, field.shape) for click in clicks]
    clicked = np.zeros(field.shape, np.bool_)
    clicked.ravel()[np.concatenate(seeds)] = True
    times = field.times_from(tissue, clicked)
    return Basins(field, tissue, clicks, times, _nearest(times, seeds))


def _voxels(click: Click, shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """The voxels of a click, as flat indices."""
    where = [axis + side.start for axis, side in zip(np.nonzero(click.mask), click.box, strict=True)]
    return np.ravel_multi_index(tuple(where), shape).astype(np.int64)


def _common(tissues: Sequence[Tissue]) -> Tissue:
    """The tissue of several clicks: medians; the spread is that of their medians where it is more."""
    medians = np.stack([tissue.median for tissue in tissues])
    middle = np.median(medians, axis=0)
    apart = 1.4826 * np.median(np.abs(medians - middle), axis=0)
    spread = np.maximum(np.median([tissue.spread for tissue in tissues], axis=0), apart)
    return tissues[0]._replace(
        median=middle, spread=spread, gradient=np.median([tissue.gradient for tissue in tissues], axis=0)
    )


def _nearest(times: Floats, seeds: Sequence[NDArray[np.int64]]) -> NDArray[np.int32]:
    """From which of the seeds the front came to each voxel: back from voxel to earliest neighbour, by leaps."""
    voxels = np.arange(times.size).reshape(times.shape)
    before, earliest = voxels.copy(), times.copy()
    for axis in range(3):
        ends = slice(1, None), slice(None, -1)
        for here, there in (ends, ends[::-1]):
            mine, theirs = ((slice(None),) * axis + (part,) for part in (here, there))
            is_earlier = times[theirs] < earliest[mine]
            earliest[mine][is_earlier] = times[theirs][is_earlier]
            before[mine][is_earlier] = voxels[theirs][is_earlier]
    out, came = np.full(times.size, -1, np.int32), before.ravel()
    for number, seed in enumerate(seeds):
        out[seed], came[seed] = number, seed
    while True:
        farther = came[came]
        if np.array_equal(farther, came):
            return np.where(np.isfinite(times.ravel()), out[came], np.int32(-1))
        came = farther


def partition_model(
    images: Sequence[Floats],
    spacing: Spacing,
    clicks: Clicks,
    *,
    mask: Mask | None = None,
    basins: BasinsOnce | None = None,
) -> ClickModel:
    """Make the model of one of several objects that touch.

    F = (T_in - T_out) / (T_in + T_out), with the arrival times from its own clicks and from those of all others, and 1
    where others come earlier. All go through one tissue, that of the first clicks of all objects.

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
        Of the run, so that what its objects share is computed once.

    Raises
    ------
    InputError
        When it has no inside click, or nothing is outside of it.
    """
    inside, outside = clicks.mask("inside"), clicks.mask("outside")
    if not inside.any() or not outside.any():
        raise InputError(
            "partition: clicks inside and outside of the object are needed", "give clicks in its neighbours too"
        )
    found = (basins or BasinsOnce()).of(images, spacing, clicks, mask)
    if not all(map(_is_owned, clicks.clicks)):  # they say something of this object alone
        times, seeds = np.where(outside, np.float32(0.0), np.float32(np.inf)), outside
        box = whole_box(inside.shape)
    else:
        box, times, seeds = _at_other_basins(found, [click.side == "inside" for click in clicks.clicks])
    field = field_of(found.field.images_on(box), spacing, None if mask is None else mask[box])
    others = field.times(found.tissue, times, np.flatnonzero(seeds))
    # Where others come earlier it is none of the object's: the march need not go there.
    mine = field.times_from(found.tissue, inside[box], others.ravel())
    force = balance(mine, others)
    force[inside[box]], force[outside[box]] = CLICKED["inside"], CLICKED["outside"]
    start = connected_to(force < 0, inside[box])
    return ClickModel(clicks, box, force, start, is_partition=True)


def _at_other_basins(found: Basins, is_own: Sequence[bool]) -> tuple[Box, Floats, Mask]:
    """A box that holds the basins of own clicks, the times in all others there, and their voxels beside the own."""
    mine = np.append(is_own, False)[found.nearest].reshape(found.field.shape)  # of -1 the last
    box = bounding_box(mine, 1)
    assert box is not None  # the clicks are among them
    times = np.where(mine[box], np.float32(np.inf), found.times[box])
    return box, times, ndimage.binary_dilation(mine[box], CROSS) & np.isfinite(times)
