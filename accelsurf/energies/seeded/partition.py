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

from accelsurf.energies.seeded.answers import CLICKED
from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, learn
from accelsurf.energies.seeded.contest import Field, Times, balance, field_of, reached, times_from
from accelsurf.energies.seeded.first_click import seeds_of
from accelsurf.energies.seeded.model import SeededModel, learned_images
from accelsurf.energies.seeded.proposal import Proposal
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, bounding_box, connected_to, whole_box
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.kernels.arrival import Tissue

#: Default weight of the area, of the smallest spacing.
AREA = 0.3
_FACES = ndimage.generate_binary_structure(3, 1)


class Basins(NamedTuple):
    """Basins, which all objects share.

    Attributes
    ----------
    field : Field
    tissue : Tissue
        That the marches go through.
    clicks : tuple of Click
        Those inside of an object, or of what is no object.
    times : ndarray (n,) float32
        Arrival times from all of them.
    nearest : ndarray (n,) int32
        The click from which the front comes, by its number; -1 where none does.
    """

    field: Field
    tissue: Tissue
    clicks: tuple[Click, ...]
    times: Times
    nearest: NDArray[np.int32]


class BasinsOnce:
    """Basins that are computed once for the objects of a run."""

    def __init__(self) -> None:
        self._last: Basins | None = None
        self._seen: tuple[Image, ...] = ()

    def of(self, images: Sequence[Image], spacing: Spacing, clicks: Clicks, mask: Mask | None) -> Basins:
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


def basins_of(images: Sequence[Image], spacing: Spacing, clicks: tuple[Click, ...], mask: Mask | None) -> Basins:
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
    smooth = learned_images(images, spacing)
    field = field_of(smooth, spacing, mask)
    firsts = {click.owner: click for click in reversed(clicks) if click.owner != NO_OBJECT}
    tissue = _common([learn(smooth, spacing, click) for click in firsts.values()])
    seeds = [seeds_of(click, field) for click in clicks]
    times, _ = reached(field, tissue, np.unique(np.concatenate(seeds)), field.size)
    return Basins(field, tissue, clicks, times, _nearest(times.reshape(field.shape), seeds))


def _common(tissues: Sequence[Tissue]) -> Tissue:
    """The tissue of several clicks: medians; the spread is that of their medians where it is more."""
    medians = np.stack([tissue.median for tissue in tissues])
    middle = np.median(medians, axis=0)
    apart = 1.4826 * np.median(np.abs(medians - middle), axis=0)
    spread = np.maximum(np.median([tissue.spread for tissue in tissues], axis=0), apart)
    return tissues[0]._replace(
        median=middle, spread=spread, gradient=np.median([tissue.gradient for tissue in tissues], axis=0)
    )


def _nearest(times: Image, seeds: Sequence[NDArray[np.int64]]) -> NDArray[np.int32]:
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
    images: Sequence[Image],
    spacing: Spacing,
    clicks: Clicks,
    *,
    mask: Mask | None = None,
    basins: BasinsOnce | None = None,
) -> SeededModel:
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

    Returns
    -------
    SeededModel

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
    others = times_from(field, found.tissue, times, seeds)
    # Where others come earlier it is none of the object's: the march need not go there.
    own_seeds = np.flatnonzero(inside[box]).astype(np.int64)
    times_of_own, _ = reached(field, found.tissue, own_seeds, field.size, others.ravel())
    force = np.ones(inside.shape, np.float32)
    force[box] = balance(times_of_own.reshape(others.shape), others)
    force[inside], force[outside] = CLICKED["inside"], CLICKED["outside"]
    start = connected_to(force < 0, inside)
    volume = float(np.count_nonzero(start)) * float(np.prod(spacing))
    return SeededModel(force, start, Proposal(volume, 1.0), AREA * min(spacing), clicks, ())


def _at_other_basins(found: Basins, is_own: Sequence[bool]) -> tuple[Box, Image, Mask]:
    """A box that holds the basins of own clicks, the times in all others there, and their voxels beside the own."""
    shape = found.field.shape
    mine = np.append(is_own, False)[found.nearest].reshape(shape)  # of -1 the last
    box = bounding_box(mine, 1)
    assert box is not None  # the clicks are among them
    times = np.where(mine[box], np.float32(np.inf), found.times.reshape(shape)[box])
    return box, times, ndimage.binary_dilation(mine[box], _FACES) & np.isfinite(times)
