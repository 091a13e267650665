"""The model of clicks on an object that a mask shows: the mask, and the changes by clicks since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.clicks.model.model import AROUND, CLICKED, ClickModel, is_right, with_click
from accelsurf.clicks.model.network import Network, networks
from accelsurf.clicks.model.windows import Scene, Seed, seed_of
from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    box_at,
    corner_of,
    on_box,
    overlap,
    placed_at,
    shared,
    tightened,
    widened,
)
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import axis_steps

#: Distance outside of the mask's boundary, in the smallest spacings, at which F reaches 1; it is -1 as far inside.
RAMP = 2.0


class GivenMask(NamedTuple):
    """An object that was given: a ``mask`` (nz, ny, nx) of bool on a ``box`` of the grid."""

    box: Box
    mask: Mask


def model_of_mask(given: GivenMask, shape: tuple[int, int, int], spacing: Spacing) -> ClickModel:
    """Return the model of a mask without a click: F is the distance from its boundary, -1 to 1.

    Parameters
    ----------
    given : GivenMask
    shape : (nz, ny, nx)
        Of the grid.
    spacing : (hz, hy, hx)
        mm.

    Examples
    --------
    >>> from accelsurf.grid.boxes import whole_box
    >>> mask = np.zeros((1, 9, 9), bool)
    >>> mask[0, 3:6, 3:6] = True
    >>> model = model_of_mask(GivenMask(whole_box(mask.shape), mask), mask.shape, (1.0, 1.0, 1.0))
    >>> bool((model.inside_on(whole_box(mask.shape)) == mask).all()), model.count
    (True, 9)
    """
    tight = bounding_box(given.mask)
    if tight is None:
        return ClickModel(
            Clicks((), shape),
            box_at((0, 0, 0), (1, 1, 1)),
            np.ones((1, 1, 1), np.float32),
            np.zeros((1, 1, 1), np.bool_),
        )
    margin = [max(int(AROUND * (s.stop - s.start)), int(RAMP) + 1) for s in tight]
    box = widened(placed_at(tight, corner_of(given.box)), shape, margin)
    inside = on_box(given.mask, given.box, box, False)
    field = _ramp(inside, axis_steps(shape, spacing), spacing)
    return ClickModel(Clicks((), shape), box, field, field < 0)


def _ramp(inside: Mask, steps: tuple[float, ...], spacing: Spacing) -> Singles:
    """F of a mask."""
    if inside.all():
        return np.full(inside.shape, -1.0, np.float32)
    half, reach = 0.5 * min(steps), RAMP * min(steps)
    within, beyond = (
        ndimage.distance_transform_edt(part, sampling=spacing) for part in (inside, ~inside)
    )
    return np.clip(np.where(inside, half - within, beyond - half) / reach, -1.0, 1.0).astype(
        np.float32
    )


def corrected_model(
    scene: Scene,
    given: GivenMask,
    clicks: Clicks,
    *,
    previous: ClickModel | None = None,
    asked: Mapping[str, Network] | None = None,
) -> ClickModel:
    """Return the model of a mask after clicks: changes are read from the image near them, all else is the mask.

    Parameters
    ----------
    scene : Scene
    given : GivenMask
    clicks : Clicks
        Clicks of one object, see `Clicks.of`; none need be inside.
    previous : ClickModel, optional
        The model after the first of these clicks: the result is the same, sooner.
    asked : mapping of str to Network, optional
        Other networks than the package's.

    Raises
    ------
    LeavesWindow
        When a click looks beyond the scene's part.
    """
    goes_on = previous is not None and clicks.starts_with(previous.clicks)
    model = (
        previous
        if previous is not None and goes_on
        else model_of_mask(given, scene.shape, scene.spacing)
    )
    using = networks() if asked is None else asked
    seeds: list[Seed] = []  # read when first needed: a click on its side needs none
    for number, click in enumerate(clicks.clicks[len(model.clicks) :], len(model.clicks)):
        if is_right(model, click):
            model = _with_right_click(model, click)
            continue
        if not seeds:
            # The networks read later clicks beside a first one: the middle of the mask stands for it.
            first = (_core_of(given, scene.spacing),) if given.mask.any() else ()
            seeds = [seed_of(each, scene) for each in (*first, *clicks.clicks)]
        known = seeds[: len(seeds) - len(clicks) + number + 1]
        model = with_click(model, scene, known, using)
    return replace(model, clicks=clicks)


def _core_of(given: GivenMask, spacing: Spacing) -> Click:
    """Return a ball of half its depth in the middle of a mask, as a person would click it."""
    margin = [1 if n > 1 else 0 for n in given.mask.shape]
    around = np.pad(given.mask, [(m, m) for m in margin])
    depth = ndimage.distance_transform_edt(around, sampling=spacing)
    middle = np.unravel_index(int(np.argmax(depth)), depth.shape)
    axes = np.ogrid[tuple(slice(0, n) for n in depth.shape)]
    far = sum(((axis - at) * h) ** 2 for axis, at, h in zip(axes, middle, spacing, strict=True))
    z, y, x = (side.start - m for side, m in zip(given.box, margin, strict=True))
    tight = tightened(box_at((z, y, x), around.shape), (far <= (0.5 * depth[middle]) ** 2) & around)
    assert tight is not None  # its middle is in it
    return Click("inside", *tight)


def _with_right_click(model: ClickModel, click: Click) -> ClickModel:
    """The model after one more click that is on its side already: its own voxels alone may change."""
    after = replace(model, clicks=model.clicks.with_more([click]), taken=0.0, reach=None)
    if not overlap(click.box, model.box):
        return after
    field = model.field.copy()
    here, there = shared(corner_of(model.box), field.shape, corner_of(click.box), click.mask.shape)
    field[here][click.mask[there]] = CLICKED[click.side]
    return replace(after, field=field, inside=field < 0)
