"""The seeded model: from clicks to a force field and a first surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, learn
from accelsurf.energies.seeded.competition import Field, Times, arrival, balance, field_of, from_beyond
from accelsurf.energies.seeded.likelihood import log_ratio
from accelsurf.energies.seeded.proposal import Proposal, by_evidence, of_size
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.smoothing import gaussian_mm

#: Smoothing of the image before costs are read from it, of the smallest spacing.
SMOOTHING = 0.6
#: F in the clicks; weight of the likelihood beside the competition; default weight of the area, smallest spacings.
CLICKED, LIKELIHOOD, AREA = 3.0, 0.7, 0.3
#: The surroundings of the first object start where the arrival time has so many times its volume.
BEYOND = 3.0
#: A later click changes the field where it arrives earlier than this part of the earliest time before.
EARLIER = 0.7


@dataclass(frozen=True)
class SeededModel:
    """A force field and a first surface from clicks.

    Attributes
    ----------
    field : ndarray (nz, ny, nx), float32
        F: the surface grows where F < 0; -3 and 3 in clicked voxels, about -1 to 1 elsewhere.
    start : ndarray (nz, ny, nx) of bool
        Where F < 0, as far as it is connected to inside clicks, with holes filled.
    times_in, times_out : ndarray (nz, ny, nx), float32
        Arrival times from inside and from outside clicks and the surroundings; inf where they do not come.
    proposal : Proposal
        The level of the first click's arrival time that the surroundings were found with.
    area_weight_mm : float
        Weight of the area that suits the field.
    clicks : Clicks
        What it was made from.
    """

    field: Image
    start: Mask
    times_in: Image
    times_out: Image
    proposal: Proposal
    area_weight_mm: float
    clicks: Clicks


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
    box : tuple of slice, optional
        The object lies in it.
    mask : ndarray (nz, ny, nx) of bool, optional
        The object lies in it.
    threads : int, optional
        The result is the same for any number.
    previous : SeededModel, optional
        The model of all these clicks but the last ones; saves time, the result is the same.

    Raises
    ------
    InputError
        When there is no inside click.
    """
    inside = [click for click in clicks.clicks if click.side == "inside"]
    if not inside:
        raise InputError("seeded: no inside click was given", "give one with --inside")
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images]
    open_ = mask
    if box is not None:
        open_ = np.zeros(images[0].shape, np.bool_)
        open_[box] = True if mask is None else mask[box]
    field = field_of(smooth, spacing, open_)
    first = inside[0]
    model = _first(smooth, spacing, field, first, size_mm3, clicks)
    for click in clicks.clicks:
        if click is not first:
            model = _with_click(model, smooth, spacing, field, click)
    return model


def _seeds(click: Click, shape: tuple[int, int, int]) -> NDArray[np.int64]:
    where = [axis + side.start for axis, side in zip(np.nonzero(click.mask), click.box, strict=True)]
    return np.ravel_multi_index(tuple(where), shape).astype(np.int64)


def _first(
    images: Sequence[Image], spacing: Spacing, field: Field, click: Click, size_mm3: float | None, clicks: Clicks
) -> SeededModel:
    """The model of the first inside click."""
    shape, voxel = images[0].shape, float(np.prod(spacing))
    tissue, seeds = learn(images, spacing, click), _seeds(click, clicks.shape)
    limit = field.size // 4 if size_mm3 is None else int(3.2 * size_mm3 / voxel) + 1
    times, order = arrival(field, tissue, seeds, max_count=limit)
    if size_mm3 is None:
        proposal = by_evidence(field.medium.values, times, order, len(seeds), voxel)
    else:
        proposal = of_size(times, order, voxel, size_mm3)
    count = round(proposal.volume_mm3 / voxel)
    beyond = min(round(BEYOND * count), len(order))
    edges_only = tissue._replace(weights=tissue.weights * (1, 1, 1, 0, 1, 1))
    back = from_beyond(field, edges_only, times, order, beyond)
    ratio = log_ratio(images, order[:count], order[count:beyond])
    force = (balance(times, back).reshape(shape) - LIKELIHOOD * ratio).astype(np.float32)
    return _finished(force, times.reshape(shape), back.reshape(shape), proposal, spacing, clicks)


def _with_click(
    model: SeededModel, images: Sequence[Image], spacing: Spacing, field: Field, click: Click
) -> SeededModel:
    """The model with one more click: it changes where the click arrives first."""
    shape = images[0].shape
    before = np.minimum(model.times_in, model.times_out).ravel()
    tissue, seeds = learn(images, spacing, click), _seeds(click, model.clicks.shape)
    times, _ = arrival(field, tissue, seeds, (EARLIER * before).astype(np.float32))
    nearer = balance(times, (EARLIER * before).astype(np.float32)).reshape(shape)
    sides = {"inside": model.times_in, "outside": model.times_out}
    side = np.minimum(sides[click.side], times.reshape(shape))
    force = np.minimum(model.field, nearer) if click.side == "inside" else np.maximum(model.field, -nearer)
    sides[click.side] = side
    return _finished(force, sides["inside"], sides["outside"], model.proposal, spacing, model.clicks)


def _finished(
    force: Image, times_in: Times, times_out: Times, proposal: Proposal, spacing: Spacing, clicks: Clicks
) -> SeededModel:
    """The model with its start."""
    for click in clicks.clicks:
        force[click.box][click.mask] = -CLICKED if click.side == "inside" else CLICKED
    labels, _ = ndimage.label(force < 0)
    own = np.unique(labels[clicks.mask("inside")])
    start = ndimage.binary_fill_holes(np.isin(labels, own[own > 0]))
    return SeededModel(force, np.asarray(start), times_in, times_out, proposal, AREA * min(spacing), clicks)
