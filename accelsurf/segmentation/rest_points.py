"""Rests of an object's front before it broke through, on the image's grid, with a place in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution.rests import FoundRest
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import Box, shared
from accelsurf.grid.geometry import Geometry
from accelsurf.levelset.checkpoint import psi_of
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.start_pyramid import to_finest


class RestPoint(NamedTuple):
    """A rest of an object's front.

    Attributes
    ----------
    step : int
        When it rested.
    volume_mm3 : float
        Its volume then.
    left_at : int
        Step in which it was seen to break through.
    place : (x, y, z)
        Where it grew fastest then, world mm.
    labels : ndarray (nz, ny, nx), uint8
        1 where it was inside then, on the object's part of the image's grid.
    """

    step: int
    volume_mm3: float
    left_at: int
    place: tuple[float, float, float]
    labels: NDArray[np.uint8]


def rest_points(rests: Sequence[FoundRest], prepared: PreprocessedInput, box: Box) -> tuple[RestPoint, ...]:
    """The rests of an object whose part of the image's grid is ``box``."""
    return tuple(_point(rest, prepared, box) for rest in rests)


def on_larger_box(rests: Sequence[RestPoint], before: Box, box: Box) -> tuple[RestPoint, ...]:
    """The rests of an object whose part of the image's grid was ``before``, and is now the larger ``box``."""
    around = [(a.start - b.start, b.stop - a.stop) for a, b in zip(before, box, strict=True)]
    return tuple(rest._replace(labels=np.pad(rest.labels, around)) for rest in rests)


def _point(rest: FoundRest, prepared: PreprocessedInput, box: Box) -> RestPoint:
    geometry, at = prepared.geometry, rest.at
    grids = pyramid.levels(geometry.shape, geometry.spacing, at.level + 1)
    far = float(np.abs(at.surface.psi).max(initial=0.0)) or 1.0
    corner, psi = to_finest(at.corner, psi_of(at.surface, at.shape, far), at.level, grids)
    labels = np.zeros(tuple(s.stop - s.start for s in box), np.uint8)
    first = prepared.first
    on_image = (corner[0] + first[0], corner[1] + first[1], corner[2] + first[2])
    mine, theirs = shared((box[0].start, box[1].start, box[2].start), labels.shape, on_image, psi.shape)
    labels[mine] = psi[theirs] < 0
    return RestPoint(at.step, at.volume_mm3, rest.left_at, _place(rest, grids[at.level], geometry), labels)


def _place(rest: FoundRest, grid: pyramid.Level, geometry: Geometry) -> tuple[float, float, float]:
    middle = [f + i * width for f, i, width in zip(grid.first, rest.place, grid.factors, strict=True)]
    x, y, z = (float(v) for v in geometry.index_to_world(middle))
    return x, y, z
