"""The inner run on a frame: the surface of each object in the image, from the predicted one."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import RegionField
from accelsurf.evolution import Evolution, SolverSetup, StopRule
from accelsurf.flows import ConstantDensity
from accelsurf.grid.boxes import (
    Box,
    as_corner,
    bounding_box,
    box_at,
    corner_of,
    enclosing,
    overlap,
    placed_at,
    shared,
    widened,
)
from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.interact import Refiner, result_of
from accelsurf.levelset import LevelSet
from accelsurf.run import EnergyLike, Result, Run, SegmentedObject, cropped, window_reach
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart, core_of, keep_apart
from accelsurf.track.appearance import Appearance
from accelsurf.track.momentum import MovedSurface
from accelsurf.track.records import BAND, SurfacePiece

#: Voxels of the image around all objects that a run on a frame sees: at least `MIN_AROUND`, and this part of the
#: largest extent of an object.
MIN_AROUND = 12
AROUND_PART = 0.75
#: A run is made again on more of the frame where a surface comes this near, voxels, to the edge of the part it saw.
NEAR_EDGE = 3
#: A run by an appearance: friction in the time between two frames, speed (voxels in that time) that a logarithm of odds
#: of 1 gives in it, weight of the area in voxels, and steps at most.
FRICTION = 3.0
DRIVE = 20.0
AREA = 1.0
STEPS = 60
#: Least distance of a given voxel's centre from the surface, voxels.
SIDE = 0.05
#: Settings of a first frame that mean places or steps there, and how following frames have them instead.
_FIRST_ONLY = (
    "start",
    "inside",
    "outside",
    "objects",
    "foreground",
    "background",
    "channel",
    "edit",
    "refine",
    "checkpoint",
    "time_index",
    "size",
)


class Measured(NamedTuple):
    """Measurement of an object in a frame.

    Attributes
    ----------
    surface : SurfacePiece
        On the frame's grid; a box of no voxels where nothing is left.
    volume_mm3, area_mm2 : float
    quality : float
        Chance that it is good, as `accelsurf.measure.quality`.
    """

    surface: SurfacePiece
    volume_mm3: float
    area_mm2: float
    quality: float


NOTHING = Measured(SurfacePiece((0, 0, 0), np.ones((0, 0, 0), np.float32)), 0.0, 0.0, 0.0)


def following_settings(config: RunConfig, energy: str) -> RunConfig:
    """Settings of the runs on the frames after the first: without the settings that are places in the first one.

    Parameters
    ----------
    config : RunConfig
        Of the first frame.
    energy : str
        Of the following ones; auto is that of the first.
    """
    given = config.model_fields_set
    changes = {
        key: default_of(key)
        for key in _FIRST_ONLY
        if key in given or getattr(config, key) != default_of(key)
    }
    changes["energy"] = config.energy if energy == "auto" else energy
    changes |= {"start": default_of("start"), "levels": 1, "keep_state": "no"}
    return config.replace(**changes)


def measure(
    channels: Sequence[Volume],
    starts: Sequence[ObjectStart],
    config: RunConfig,
    energy: EnergyLike | None = None,
    refinements: Sequence[Correction] = (),
    occupied: Sequence[SurfacePiece] = (),
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
    occupied : sequence of SurfacePiece
        Where no object may go; of a prediction that lies in it entirely nothing is run.

    Returns
    -------
    dict of int to Measured
        By id; with corrections also the objects that these began, and none that these removed.
    """
    alone = [
        start
        for start in keep_apart(sorted(starts, key=lambda start: start.id))
        if _has_room(start, occupied)
    ]
    found = {start.id: NOTHING for start in starts}
    if not alone:
        return found
    geometry = channels[0].geometry
    whole = any(getattr(config, key) is not None for key in ("roi", "mask", "box")) or bool(
        refinements
    )
    margin = _margin(alone, geometry, config)
    while True:
        inside = functools.reduce(enclosing, (_tight(start) for start in alone))
        box = widened(inside, geometry.shape, [max(geometry.shape)] * 3 if whole else margin)
        result = _result(channels, box, alone, config, energy, refinements, occupied)
        if not _comes_near(result, box, geometry):
            break
        margin = [2 * n for n in margin]
    for start in result.objects:
        found[start.id] = measured(start, box)
    for refinement in refinements:
        for id in (
            *refinement.merge[1:],
            *([refinement.remove] if refinement.remove is not None else []),
        ):
            found.pop(id, None)
    return found


def _has_room(start: ObjectStart, occupied: Sequence[SurfacePiece]) -> bool:
    """Test if a prediction has an inside, of which others leave some free."""
    room = start.psi < 0
    for piece in occupied:
        if overlap(box_at(start.corner, start.psi.shape), piece.box):
            mine, theirs = shared(start.corner, start.psi.shape, piece.corner, piece.psi.shape)
            room[mine] &= piece.psi[theirs] > 0
    return bool(room.any())


def _margin(starts: Sequence[ObjectStart], geometry: Geometry, config: RunConfig) -> list[int]:
    extent = np.max([[s.stop - s.start for s in _tight(start)] for start in starts], axis=0)
    reach = [math.ceil(window_reach(config, geometry) / h) for h in geometry.spacing]
    return [
        max(MIN_AROUND, math.ceil(AROUND_PART * n)) + r
        for n, r in zip(extent.tolist(), reach, strict=True)
    ]


def _tight(start: ObjectStart) -> Box:
    """The box of the voxels inside, on the frame's grid."""
    inner = bounding_box(start.psi < 0)
    assert inner is not None  # of an empty one no run is made
    return placed_at(inner, start.corner)


def _result(
    channels: Sequence[Volume],
    box: Box,
    starts: Sequence[ObjectStart],
    config: RunConfig,
    energy: EnergyLike | None,
    refinements: Sequence[Correction],
    occupied: Sequence[SurfacePiece],
) -> Result:
    """The run on a box of the frame."""
    seen = [Volume(channel.array[box], cropped(channel.geometry, box)) for channel in channels]
    on_box = tuple(_on_box(start, box) for start in starts)
    clicks = (
        [_core(start, seen[0].geometry) for start in on_box]
        if config.energy.uses_model and energy is None
        else []
    )
    arrays = {"mask": _free(occupied, box, seen[0].geometry)} if occupied else None
    if refinements:
        config = config.replace(keep_state="yes")
    with Run(seen[0], config, energy, seen[1:], on_box, arrays, clicks) as run:
        while run.step():
            pass
        result = result_of(run)
    if refinements:
        refiner = Refiner(result)
        for refinement in refinements:
            refiner.apply(refinement)
        result = refiner.result()
    return result


def _on_box(start: ObjectStart, box: Box) -> ObjectStart:
    """A start on a box of the frame, cut where that ends."""
    shape = [side.stop - side.start for side in box]
    here, there = shared(corner_of(box), shape, start.corner, start.psi.shape)
    return ObjectStart(start.id, corner_of(here), np.ascontiguousarray(start.psi[there]))


def _core(start: ObjectStart, geometry: Geometry) -> Click:
    """The deeper part of a prediction as a click: from it the model of clicks learns the object."""
    return Click(
        "inside",
        box_at(start.corner, start.psi.shape),
        core_of(start.psi, geometry.spacing),
        start.id,
    )


def _free(occupied: Sequence[SurfacePiece], box: Box, geometry: Geometry) -> NDArray[np.float32]:
    """Psi on a box of the frame of all that others leave free."""
    psi = np.full(geometry.shape, -max(geometry.spacing), np.float32)
    for piece in occupied:
        if overlap(piece.box, box):
            here, there = shared(corner_of(box), psi.shape, piece.corner, piece.psi.shape)
            psi[here] = np.maximum(psi[here], -piece.psi[there])
    return psi


def _comes_near(result: Result, box: Box, geometry: Geometry) -> bool:
    """Test if a surface comes near an edge of the box beyond which the frame goes on."""
    for found in result.objects:
        inner = bounding_box(found.labels > 0)
        if inner is None:
            continue
        for side, place, part, n in zip(inner, found.box, box, geometry.shape, strict=True):
            low, high = side.start + place.start, side.stop + place.start
            if (low < NEAR_EDGE and part.start > 0) or (
                part.stop - part.start - high < NEAR_EDGE and part.stop < n
            ):
                return True
    return False


def recognised(
    predicted: MovedSurface, appearance: Appearance, image: Volume, prior: float
) -> Measured:
    """Run a surface in a frame, by an appearance, from the momentum that it has; the chance of its result is even.

    The energy is U = int_inside (prior psi_0 - odds) dx + alpha A, psi_0 where it begins. The surface has constant
    density and a constant friction.

    Parameters
    ----------
    predicted : MovedSurface
        Moved in place.
    appearance : Appearance
    image : Volume
        The frame.
    prior : float
        Weight of the distance from where it begins, 1/mm.
    """
    boxed, speed = predicted
    surface, h = boxed.surface, min(image.geometry.steps)
    evidence = functools.partial(appearance.evidence, image)
    odds = (evidence if boxed.halving is None else boxed.halving.on_coarse(evidence))(
        boxed.corner, surface.shape
    )
    field = np.ascontiguousarray(prior * surface.psi - odds, np.float32)
    flow = ConstantDensity(friction=FRICTION, lambda_=DRIVE * h)
    flow.start_moving(surface, [speed])
    rule = StopRule(window=4, motion=0.05, further=0.1, kinetic=1.0)
    for _ in Evolution(
        surface, RegionField(field, AREA * h), SolverSetup(flow, rule=rule), STEPS, fields=[speed]
    ):
        pass
    piece = boxed.on_frame()
    return _measures(piece.tight(), surface, 0.5) if piece.has_inside else NOTHING


def _measures(piece: SurfacePiece, surface: LevelSet, quality: float) -> Measured:
    fraction, area = surface.fraction_and_area()
    return Measured(piece, surface.volume(fraction), float(area.sum()), quality)


def measured_start(start: ObjectStart, geometry: Geometry) -> Measured:
    """Measure an object whose voxels are given: nothing of it is uncertain."""
    surface = LevelSet(start.psi, geometry.spacing, BAND)
    # The distance to the surface through the voxels' faces, on the same side in every voxel.
    least = np.float32(SIDE * min(geometry.steps))
    psi = np.where(start.psi < 0, np.minimum(surface.psi, -least), np.maximum(surface.psi, least))
    return _measures(SurfacePiece(start.corner, psi), surface, 1.0)


def measured_piece(piece: SurfacePiece, geometry: Geometry) -> Measured:
    """Measure a surface; as nothing tells how good it is, its chance is even."""
    if not piece.has_inside:
        return NOTHING
    return _measures(piece.tight(), LevelSet(piece.psi, geometry.spacing, BAND), 0.5)


def measured(found: SegmentedObject, box: Box) -> Measured:
    """Measure an object after a run on a box of the frame, on the frame's grid."""
    corner = as_corner(np.add(corner_of(found.box), corner_of(box)))
    whole = SurfacePiece(corner, found.psi)
    if not whole.has_inside:
        return NOTHING
    last = found.history[-1]
    return Measured(whole.tight(), last.volume_mm3, last.area_mm2, found.quality.probability)
