"""The inner run on a frame: what the image shows of each object, from where it is expected."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, bounding_box, box_at, corner_of, enclosing, overlap, placed_at, shared, widened
from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.initialization.object_starts import ObjectStart, apart, core_of
from accelsurf.segmentation.preprocessing import uses_model
from accelsurf.segmentation.refiner import Refiner
from accelsurf.segmentation.region_of_interest import cropped
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_result import result_of
from accelsurf.segmentation.run_setup import EnergyLike, window_reach
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.edits import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.tracking.records import SurfacePiece

#: Voxels of the image around all objects that a run on a frame sees: at least `MIN_AROUND`, and this part of the
#: largest extent of an object.
MIN_AROUND, AROUND_PART = 12, 0.75
#: A run is made again on more of the frame where a surface comes so near to the edge of what it saw.
NEAR_EDGE = 3
#: Settings of a first frame that mean places or steps there, and how following frames have them instead.
_OF_FIRST = ("start", "inside", "outside", "objects", "foreground", "background", "channel", "edit", "refine",
             "checkpoint", "time_index", "size")


class Measured(NamedTuple):
    """What a frame shows of an object.

    Attributes
    ----------
    surface : SurfacePiece
        On the frame's grid; a box of no voxels where nothing is left.
    volume_mm3, area_mm2 : float
    quality : float
        Chance that it is good, as `accelsurf.analysis.quality`.
    """

    surface: SurfacePiece
    volume_mm3: float
    area_mm2: float
    quality: float


NOTHING = Measured(SurfacePiece((0, 0, 0), np.ones((0, 0, 0), np.float32)), 0.0, 0.0, 0.0)


def following_settings(config: RunConfig, energy: str) -> RunConfig:
    """Settings of the runs on the frames after the first: what means places in the first one is left out.

    Parameters
    ----------
    config : RunConfig
        Of the first frame.
    energy : str
        Of the following ones; auto is that of the first.
    """
    given = config.model_fields_set
    changes = {key: default_of(key) for key in _OF_FIRST if key in given or getattr(config, key) != default_of(key)}
    changes["energy"] = config.energy if energy == "auto" else energy
    changes |= {"start": default_of("start"), "levels": 1, "keep_state": "no"}
    return config.replace(**changes)


def measure(
    channels: Sequence[Volume],
    starts: Sequence[ObjectStart],
    config: RunConfig,
    energy: EnergyLike | None = None,
    refinements: Sequence[Correction] = (),
    taken: Sequence[SurfacePiece] = (),
) -> dict[int, Measured]:
    """Run from predictions on the part of a frame where they are.

    Parameters
    ----------
    channels : sequence of Volume
        The frame.
    starts : sequence of ObjectStart
        The predictions; where they overlap the deeper one has the voxel, and of one that others cover nothing is run.
    config : RunConfig
        As `following_settings` returns it.
    energy : Energy or callable, optional
        One of the user's own.
    refinements : sequence of Correction
        Corrections of the frame; the run then sees all of it.
    taken : sequence of SurfacePiece
        Where no object may go; of a prediction that lies in it entirely nothing is run.

    Returns
    -------
    dict of int to Measured
        By id; with corrections also what these began, and without what these removed.
    """
    alone = [one for one in apart(sorted(starts, key=lambda one: one.id)) if _has_room(one, taken)]
    found = {one.id: NOTHING for one in starts}
    if not alone:
        return found
    geometry = channels[0].geometry
    whole = any(getattr(config, key) is not None for key in ("roi", "mask", "box")) or bool(refinements)
    margin = _margin(alone, geometry, config)
    while True:
        inside = functools.reduce(enclosing, (_tight(one) for one in alone))
        box = widened(inside, geometry.shape, [max(geometry.shape)] * 3 if whole else margin)
        result = _result(channels, box, alone, config, energy, refinements, taken)
        if not _comes_near(result, box, geometry):
            break
        margin = [2 * n for n in margin]
    for one in result.objects:
        found[one.id] = measured(one, box)
    for refinement in refinements:
        for id in (*refinement.merge[1:], *([refinement.removed_id] if refinement.removed_id is not None else [])):
            found.pop(id, None)
    return found


def _has_room(one: ObjectStart, taken: Sequence[SurfacePiece]) -> bool:
    """Whether something of a prediction is left, and others leave some of it free."""
    room = one.psi < 0
    for piece in taken:
        if overlap(box_at(one.corner, one.psi.shape), piece.box):
            mine, theirs = shared(one.corner, one.psi.shape, piece.corner, piece.psi.shape)
            room[mine] &= piece.psi[theirs] > 0
    return bool(room.any())


def _margin(starts: Sequence[ObjectStart], geometry: Geometry, config: RunConfig) -> list[int]:
    extent = np.max([[s.stop - s.start for s in _tight(one)] for one in starts], axis=0)
    reach = [math.ceil(window_reach(config, geometry) / h) for h in geometry.spacing]
    return [max(MIN_AROUND, math.ceil(AROUND_PART * n)) + r for n, r in zip(extent.tolist(), reach, strict=True)]


def _tight(one: ObjectStart) -> Box:
    """The box of the voxels inside, on the frame's grid."""
    inner = bounding_box(one.psi < 0)
    assert inner is not None  # of an empty one no run is made
    return placed_at(inner, one.corner)


def _result(
    channels: Sequence[Volume],
    box: Box,
    starts: Sequence[ObjectStart],
    config: RunConfig,
    energy: EnergyLike | None,
    refinements: Sequence[Correction],
    taken: Sequence[SurfacePiece],
) -> Result:
    """The run on a box of the frame."""
    seen = [Volume(one.array[box], cropped(one.geometry, box)) for one in channels]
    own = tuple(_on_box(one, box) for one in starts)
    clicks = [_core(one, seen[0].geometry) for one in own] if uses_model(config) and energy is None else []
    arrays = {"mask": _free(taken, box, seen[0].geometry)} if taken else None
    if refinements:
        config = config.replace(keep_state="yes")
    with Run(seen[0], config, energy, seen[1:], own, arrays, clicks) as run:
        while run.step():
            pass
        result = result_of(run)
    if refinements:
        refiner = Refiner(result)
        for one in refinements:
            refiner.apply(one)
        result = refiner.result()
    return result


def _on_box(one: ObjectStart, box: Box) -> ObjectStart:
    """A start on a box of the frame, cut where that ends."""
    own = box_at(one.corner, one.psi.shape)
    z, y, x = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(own, box, strict=True))
    psi = one.psi[tuple(slice(s.start - c, s.stop - c) for s, c in zip((z, y, x), one.corner, strict=True))]
    corner = (z.start - box[0].start, y.start - box[1].start, x.start - box[2].start)
    return ObjectStart(one.id, corner, np.ascontiguousarray(psi))


def _core(one: ObjectStart, geometry: Geometry) -> Click:
    """The deeper part of a prediction as a click: there the model of clicks learns what the object is like."""
    return Click("inside", box_at(one.corner, one.psi.shape), core_of(one.psi, geometry.spacing), one.id)


def _free(taken: Sequence[SurfacePiece], box: Box, geometry: Geometry) -> NDArray[np.float32]:
    """Psi on a box of the frame of all that others leave free."""
    psi = np.full(geometry.shape, -max(geometry.spacing), np.float32)
    for piece in taken:
        one = ObjectStart(0, piece.corner, piece.psi)
        if overlap(piece.box, box):
            own = _on_box(one, box)
            here = psi[box_at(own.corner, own.psi.shape)]
            np.maximum(here, -own.psi, out=here)
    return psi


def _comes_near(result: Result, box: Box, geometry: Geometry) -> bool:
    """Whether a surface comes near an edge of the box beyond which the frame goes on."""
    for one in result.objects:
        inner = bounding_box(one.labels > 0)
        if inner is None:
            continue
        for own, place, part, n in zip(inner, one.box, box, geometry.shape, strict=True):
            low, high = own.start + place.start, own.stop + place.start
            if (low < NEAR_EDGE and part.start > 0) or (part.stop - part.start - high < NEAR_EDGE and part.stop < n):
                return True
    return False


def measured(one: SegmentedObject, box: Box) -> Measured:
    """What a run on a box of the frame has left of an object, on the frame's grid."""
    z, y, x = (a + b for a, b in zip(corner_of(one.box), corner_of(box), strict=True))
    whole = SurfacePiece((z, y, x), one.psi)
    if not whole.has_inside:
        return NOTHING
    last = one.history[-1]
    return Measured(whole.tight(), last.volume_mm3, last.area_mm2, one.quality.probability)
