"""First window of a run: the voxels that its start and clicks name, and a margin around them."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import SCALES, Scene, inscribed_radius, seed_of
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Box, bounding_box, enclosing, slabs, whole_box, widened
from accelsurf.grid.clicks import SIDES, Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import GUARD, Window
from accelsurf.image.volume import Volume
from accelsurf.io import read_mesh
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import shown
from accelsurf.text.clicks import KINDS, read_clicks
from accelsurf.text.starts import (
    CLICKS,
    Start,
    extent_hint,
    label_box,
    parse_start,
    refuse_values,
)

#: Least voxels around the start and clicks; otherwise as many as their extent.
MIN_MARGIN = 4 * GUARD
#: The window of this scale has room around the clicks.
FIRST = 1


def first_box(config: RunConfig, geometry: Geometry) -> Box:
    """Return the box of a whole grid that a run begins on.

    Parameters
    ----------
    config : RunConfig
        Its start and its clicks are near the object.
    geometry : Geometry
        Of the whole grid.

    Raises
    ------
    UsageError
        When a start looks at values everywhere; InputError when one lies outside.
    """
    texts = [*config.start, *(config.foreground or ()), *(config.background or ())]
    boxes = [_extent_of(text, geometry) for text in texts if text != CLICKS]
    clicks = []
    for side in SIDES:
        for text in getattr(config, side):
            found = _clicks_of(text, side, geometry)
            boxes += [click.box for click in found] or [_extent_of(text, geometry)]
            clicks += found
    if not boxes:
        raise UsageError(
            "start: there is no click inside", "give --inside point:X,Y,Z, or another start"
        )
    box = functools.reduce(enclosing, boxes)
    margin = [max(MIN_MARGIN, max(s.stop - s.start for s in box)) for _ in range(3)]
    if (config.inside or config.outside) and config.energy.uses_model:
        margin = _model_margin(geometry, clicks)
    return widened(box, geometry.shape, margin)


def _model_margin(geometry: Geometry, clicks: Sequence[Click]) -> list[int]:
    """Return the voxels beyond the clicks that their model looks at first, as far as known before it is made."""
    nothing = Scene(
        (np.zeros((1, 1, 1), np.float32),),
        geometry.spacing,
        None,
        Window(geometry, whole_box((1, 1, 1))),
    )
    widest = max(
        (inscribed_radius(seed_of(click, nothing), nothing) for click in clicks),
        default=min(geometry.steps),
    )
    return [math.ceil(SCALES[FIRST].reach * widest / h) + 2 * GUARD for h in geometry.spacing]


def _clicks_of(text: str, side: Side, geometry: Geometry) -> list[Click]:
    """Read a click that is no start but a ball, on the whole grid; none of another start."""
    if text.partition(":")[0] not in (*KINDS, "ball"):
        return []
    grid = Volume(np.zeros((1, 1, 1), np.uint8), Geometry((1, 1, 1), (1.0, 1.0, 1.0)))
    return read_clicks([text], side, grid, window=Window(geometry, whole_box(geometry.shape)))


def _extent_of(text: str, geometry: Geometry) -> Box:
    """Return the box of a start or click on a grid.

    Parameters
    ----------
    text : str
        As `accelsurf.text.starts.parse_start` or `accelsurf.text.clicks.read_clicks` take it.
    geometry : Geometry

    Raises
    ------
    UsageError
        When it cannot be parsed, or looks at values everywhere; InputError when it lies outside of the grid.

    Examples
    --------
    >>> _extent_of("ball:4,4,4,2", Geometry((20, 20, 9), (1.0, 1.0, 1.0)))
    (slice(2, 7, None), slice(2, 7, None), slice(2, 7, None))
    """
    if found := _clicks_of(text, "inside", geometry):
        return functools.reduce(enclosing, (click.box for click in found))
    start = parse_start(text).on(geometry)
    refuse_values(start)
    if start.kind == "label":
        return _of_label(start, geometry)
    if start.kind == "center":
        half = 0.25 * min(
            n * h for n, h in zip(geometry.shape, geometry.spacing, strict=True) if n > 1
        )
        middle = [0.5 * (n - 1) for n in geometry.shape]
        points = [
            [m + sign * half / h for m, h in zip(middle, geometry.spacing, strict=True)]
            for sign in (-1, 1)
        ]
        return _around(np.array(points), text, geometry)
    if start.kind == "mesh":
        corners = read_mesh(start.file, start.word)[0]
    else:
        low, high = start.numbers[:3], start.numbers[3:]
        corners = np.array(
            [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
        )
        if start.vox:
            return _around(corners[:, ::-1], text, geometry)
    return _around(geometry.world_to_index(corners), text, geometry)


def _around(index: NDArray[np.float64], text: str, geometry: Geometry) -> Box:
    """The voxels around places (n, 3), as far as the grid goes."""
    low, high = np.floor(index.min(axis=0)).astype(int), np.ceil(index.max(axis=0)).astype(int) + 1
    z, y, x = (
        slice(max(int(a), 0), min(int(b), n))
        for a, b, n in zip(low, high, geometry.shape, strict=True)
    )
    if any(s.start >= s.stop for s in (z, y, x)):
        raise InputError(
            f"start {shown(text)!r}: no voxel centre is inside it", extent_hint(geometry)
        )
    return z, y, x


def _of_label(start: Start, geometry: Geometry) -> Box:
    """The box of some labels of a map, which is read a slab at a time."""
    found: Box | None = None
    for planes in slabs(geometry.shape):
        slab: Box = (planes, slice(0, geometry.shape[1]), slice(0, geometry.shape[2]))
        labels = label_box(start.file, Window(geometry, slab), f"start label:{start.file}")
        found_box = bounding_box(start.mask_of(labels))
        if found_box is not None:
            here = (
                slice(found_box[0].start + planes.start, found_box[0].stop + planes.start),
                found_box[1],
                found_box[2],
            )
            found = here if found is None else enclosing(found, here)
    if found is None:
        raise InputError(
            f"start label:{shown(start.file)}: the label map has no voxel of these labels",
            "give a map and labels that it has",
        )
    return found
