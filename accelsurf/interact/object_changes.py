"""Objects of a finished run that begin, are merged, are split, are removed: exact, voxel by voxel.

A new object begins with the size hypothesis of its clicks and evolves until it has converged. The others do not move;
objects with voxels of its clicks lose the voxels that it gains. Merging and splitting move no surface at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies import ClickConstraint, MaskConstraint
from accelsurf.errors import InputError, UsageError
from accelsurf.evolution import Evolution, SolverSetup
from accelsurf.grid.boxes import (
    Box,
    Corner,
    bounding_box,
    box_at,
    corner_of,
    counted_from,
    enclosing,
    on_box,
    placed_at,
    whole_box,
    widened,
)
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Click
from accelsurf.grid.pyramid import Level
from accelsurf.interact.corrected_surface import (
    CorrectedSurface,
    count_inside,
    part_of_image,
    stop_of_whole,
)
from accelsurf.interact.local_evolution import LocalOutcome, Stepping, evolve_to_end, measures_of
from accelsurf.interact.models import check_id, point_click
from accelsurf.interact.objects import CorrectedObjects
from accelsurf.interact.region import NearRegion, box_around
from accelsurf.levelset import LevelSet, Workers
from accelsurf.run import (
    AROUND,
    BoxMask,
    Result,
    SegmentedObject,
    closed_on,
    cropped,
    half_width,
    setup_of,
)
from accelsurf.settings.corrections import MAX_ID, Correction
from accelsurf.text.clicks import point_voxels, read_point

#: Voxels of the largest spacing between the model's boundary of a new object and the border of its box.
MARGIN = 8.0


def begin_object(
    objects: CorrectedObjects,
    number: int,
    correction: Correction,
    new: Sequence[Click],
    base: Result,
    stepping: Stepping,
) -> tuple[CorrectedSurface, Box, int]:
    """Begin an object beside the others, and let it evolve until it has converged.

    Parameters
    ----------
    objects : CorrectedObjects
    number : int
        Of the correction.
    correction : Correction
        With ``new``: an object that has this id begins anew.
    new : sequence of Click
        Its clicks, on the grid of the region of interest.
    base : Result
        Of the run.
    stepping : Stepping

    Returns
    -------
    surface, box, voxels
        The new surface, the box in which it could move, and how many voxels it has.

    Raises
    ------
    InputError
        When nothing of it is left beside the others.
    """
    id = correction.new
    assert id is not None
    if id in objects.ids:
        objects.models.remove(id)
        objects.replace([here for here in objects.surfaces if here.id != id], {})
    objects.models.add(new)
    takes = frozenset(objects.holders(new))
    objects.models.begin_object(number, correction, taken_voxels(objects, takes))
    start, box, energy, terms = _start(objects, id, new, takes)
    settings = objects.models.settings_of(id)
    settings = settings.replace(seed=None if base.config.seed is None else base.config.seed + id)
    setup = setup_of(settings, 0, 1, objects.prepared.geometry)
    outcome = _evolved(id, start, objects.spacing, energy, setup, stepping)
    region = NearRegion(box, np.ones(outcome.psi.shape, np.bool_), 0.0)
    for other in sorted(takes):
        objects.take_from(other, region, outcome.psi, stepping.workers)
    surface = _surface(id, corner_of(box), outcome, objects)
    learned = objects.prepared.learned_by(objects.models.contexts[id])
    known = {id: replace(_known(surface, objects, base), terms=terms, learned=learned)}
    objects.replace([*objects.surfaces, surface], known)
    return surface, box, surface.inside


def _start(
    objects: CorrectedObjects, id: int, new: Sequence[Click], takes: frozenset[int]
) -> tuple[NDArray[np.float32], Box, ClickConstraint, list[dict[str, Any]]]:
    """First psi of a new object, the box that it is on, its energy there, and the terms of that.

    Raises
    ------
    InputError
        When nothing of it is left beside the others.
    """
    models, spacing = objects.models, objects.spacing
    model = models.model(id)
    assert model is not None
    margin = [math.ceil(MARGIN * max(spacing) / h) for h in spacing]
    box = widened(enclosing(model.state.box, box_around(new)), objects.shape, margin)
    psi = np.array(models.contexts[id].model_start(box))
    bounds = click_bounds(models.clicks.of(id).on_box(box), Level(0, (1, 1, 1), psi.shape, spacing))
    made = models.energy_on(id, box, models.contexts[id], objects.images)
    energy, distance = made.energy, objects.bounding(id, box, takes)
    if distance is not None:
        energy, psi = MaskConstraint(energy, distance), np.maximum(psi, distance)
    bounds.apply(psi)
    if not (psi < 0).any():
        raise InputError(
            f"refine: nothing of object {id} is beside the others", "click where no object is"
        )
    return psi, box, ClickConstraint(energy, bounds), made.terms


def taken_voxels(objects: CorrectedObjects, takes: frozenset[int]) -> BoxMask | None:
    """Voxels of the objects that a new one takes nothing from."""
    boxes, taken = [], None
    others = [surface for place, surface in enumerate(objects.surfaces) if place not in takes]
    for other in others:
        inside = bounding_box(other.psi < 0)
        if inside is not None:
            boxes.append(placed_at(inside, other.corner))
    for box in boxes:
        taken = box if taken is None else enclosing(taken, box)
    if taken is None:
        return None
    mask = np.zeros([s.stop - s.start for s in taken], np.bool_)
    for other in others:
        mask |= on_box(other.psi < 0, box_at(other.corner, other.psi.shape), taken, False)
    return BoxMask(taken, mask)


def _evolved(
    id: int,
    psi: NDArray[np.float32],
    spacing: tuple[float, float, float],
    energy: ClickConstraint,
    setup: SolverSetup,
    stepping: Stepping,
) -> LocalOutcome:
    """Evolve a first surface on its box."""
    surface = LevelSet(
        psi, spacing, setup.half_width, stepping.workers, overwrite=True, extension=setup.extension
    )
    evolution = Evolution(surface, energy, setup, stepping.max_steps)
    stop = evolve_to_end(evolution, setup, stepping.watch_of(id))
    return LocalOutcome(np.array(surface.psi), list(evolution.history), stop)


def _surface(
    id: int, corner: Corner, outcome: LocalOutcome, objects: CorrectedObjects
) -> CorrectedSurface:
    """A new surface on the box that it needs."""
    inside = count_inside(outcome.psi)
    stop = stop_of_whole(outcome.stop, inside, math.prod(objects.shape))
    return _on_tight_box(CorrectedSurface(id, corner, outcome.psi, inside, outcome.history, stop))


def _known(surface: CorrectedSurface, objects: CorrectedObjects, base: Result) -> SegmentedObject:
    """Return the entry in results of an object that has just begun."""
    corner = objects.prepared.corner_on_image(surface.corner)
    box = part_of_image(box_at(corner, surface.psi.shape), corner, surface, objects.prepared)
    psi, history = closed_on(surface.psi, corner, box), list(surface.history)
    return SegmentedObject(
        surface.id, box, psi, base.image[box], cropped(base.geometry, box), history, surface.stop
    )


def merge(objects: CorrectedObjects, ids: Sequence[int], workers: Workers) -> CorrectedSurface:
    """Make several objects the first of them: the union of their voxels.

    Raises
    ------
    UsageError
        When an object does not exist.
    """
    for id in ids:
        check_id(id, objects.ids, "merge")
    parts = [objects.surfaces[objects.place_of(id)] for id in ids]
    box = box_at(parts[0].corner, parts[0].psi.shape)
    for part in parts[1:]:
        box = enclosing(box, box_at(part.corner, part.psi.shape))
    psi = np.full(
        [s.stop - s.start for s in box],
        max(float(np.abs(part.psi).max()) for part in parts),
        np.float32,
    )
    for part in parts:
        where = counted_from(box_at(part.corner, part.psi.shape), corner_of(box))
        np.minimum(psi[where], part.psi, out=psi[where])
    first = parts[0]
    merged = _measured(first._replace(corner=corner_of(box), psi=psi), objects, workers)
    objects.models.merge(ids)
    objects.replace(
        [merged, *(surface for surface in objects.surfaces if surface.id not in ids)], {}
    )
    return merged


def voxel_of(point: str, base: Result) -> NDArray[np.int64]:
    """The voxel (z, y, x) of the image in which a point, ``point:X,Y,Z``, lies.

    Raises
    ------
    UsageError, InputError
        When it is none, or lies outside.
    """
    found = read_point(point).on(base.geometry)
    return point_voxels([found.numbers], point, "split", base.geometry, found.vox)[0]


def completed(objects: CorrectedObjects, correction: Correction, base: Result) -> Correction:
    """A correction that splits, with the object that is split and the id of its part.

    Raises
    ------
    UsageError
        When the id is taken.
    InputError
        When the point lies in no object, or not in the one that was given.
    """
    assert correction.split is not None
    voxel = voxel_of(correction.split, base) - np.array(objects.prepared.first)
    here = next((surface.id for surface in objects.surfaces if _contains(surface, voxel)), None)
    if here is None or here != (correction.object or here):
        where = "no object" if here is None else f"object {here}"
        raise InputError(
            f"refine: {correction.split} lies in {where}",
            "click in the part that is to be split off",
        )
    new = correction.new or max(base.label_ids + tuple(objects.ids)) + 1
    if new in objects.ids or new > MAX_ID:
        raise UsageError(
            f"refine: new {new} was given with split, expected an id that no object has"
        )
    return correction.model_copy(update={"object": here, "new": new})


def split(
    objects: CorrectedObjects, number: int, correction: Correction, base: Result, workers: Workers
) -> tuple[CorrectedSurface, CorrectedSurface]:
    """Make the part that is connected to a point a separate object; voxels are connected by their faces.

    Parameters
    ----------
    objects : CorrectedObjects
    number : int
        Of the correction.
    correction : Correction
        `completed`.
    base : Result
    workers : Workers

    Returns
    -------
    rest, part

    Raises
    ------
    InputError
        When the object is in one piece.
    """
    assert (
        correction.split is not None
        and correction.object is not None
        and correction.new is not None
    )
    voxel = voxel_of(correction.split, base) - np.array(objects.prepared.first)
    new, here = correction.new, objects.surfaces[objects.place_of(correction.object)]
    labels, count = ndimage.label(here.psi < 0)
    if count < 2:
        raise InputError(
            f"refine: object {here.id} is in one piece",
            "cut it first: outside clicks between the parts",
        )
    split_off = np.asarray(labels == labels[tuple(voxel - np.array(here.corner))])
    away = np.abs(here.psi)
    part = here._replace(id=new, psi=np.where((labels > 0) & ~split_off, away, here.psi))
    rest = here._replace(psi=np.where(split_off, away, here.psi))
    tight = bounding_box(split_off)
    assert tight is not None
    objects.models.split(
        number,
        here.id,
        new,
        BoxMask(placed_at(tight, here.corner), split_off[tight]),
        point_click(voxel, new),
    )
    rest, part = _measured(rest, objects, workers), _measured(_on_tight_box(part), objects, workers)
    known = objects.known(here.id)
    others = [surface for surface in objects.surfaces if surface.id != here.id]
    objects.replace(
        [*others, rest, part],
        {new: replace(_known(part, objects, base), terms=known.terms, learned=known.learned)},
    )
    return rest, part


def _on_tight_box(surface: CorrectedSurface) -> CorrectedSurface:
    """A surface on the array that it needs; as it is where it has no voxel."""
    box = bounding_box(surface.psi < 0, AROUND) or whole_box(surface.psi.shape)
    return surface._replace(
        corner=corner_of(placed_at(box, surface.corner)), psi=np.ascontiguousarray(surface.psi[box])
    )


def remove(objects: CorrectedObjects, id: int) -> int:
    """Take an object away; return how many voxels it had.

    Raises
    ------
    UsageError
        When the object does not exist, or no other one does.
    """
    check_id(id, objects.ids, "remove")
    if len(objects.ids) == 1:
        raise UsageError(
            f"refine: object {id} is the only one and cannot be removed", "begin another one first"
        )
    gone = objects.surfaces[objects.place_of(id)]
    objects.models.remove(id)
    objects.replace([surface for surface in objects.surfaces if surface.id != id], {})
    return gone.inside


def _contains(surface: CorrectedSurface, voxel: NDArray[np.int64]) -> bool:
    at = voxel - np.array(surface.corner)
    return bool(
        (at >= 0).all() and (at < np.array(surface.psi.shape)).all() and surface.psi[tuple(at)] < 0
    )


def _measured(
    surface: CorrectedSurface, objects: CorrectedObjects, workers: Workers
) -> CorrectedSurface:
    """A surface whose voxels have changed without a step: its last record has volume and area of now."""
    inside, settings = count_inside(surface.psi), objects.models.settings_of(surface.id)
    volume, area = measures_of(
        np.array(surface.psi), objects.spacing, half_width(settings), workers
    )
    history = [
        *surface.history[:-1],
        surface.history[-1]._replace(volume_mm3=volume, area_mm2=area),
    ]
    stop = surface.stop if inside else stop_of_whole(surface.stop, inside, math.prod(objects.shape))
    return surface._replace(
        psi=np.ascontiguousarray(surface.psi), inside=inside, history=history, stop=stop
    )
