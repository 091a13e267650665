"""Result of a run from the file of its state and its image."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from accelsurf.clicks import clicked_voxels, on_image
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.interact.corrected_surface import frozen_settings
from accelsurf.interact.finished import result_of
from accelsurf.interact.models import ObjectModels, clicks_on, placed_clicks, point_click
from accelsurf.interact.object_changes import voxel_of
from accelsurf.interact.state_file import (
    ObjectFile,
    StateFile,
    box_of,
    masks_of,
    surface_of,
)
from accelsurf.run import BoxMask, EarlierProbability, Result, Run, SegmentedObject, cropped
from accelsurf.settings.corrections import Correction
from accelsurf.text.clicks import clicks_of


def restored(state: StateFile, volume: Volume, channels: Sequence[Volume] = ()) -> Result:
    """Return the result that a state was written of: the same surfaces, bit for bit, and ready to be corrected.

    Parameters
    ----------
    state : StateFile
    volume : Volume
        The image of the run.
    channels : sequence of Volume, optional
        Further channels of its file.

    Raises
    ------
    InputError
        When the state does not fit the image.
    UsageError, InputError
        As of `accelsurf.segment`: files that the settings name are read again.
    """
    if volume.geometry.shape != state.shape:
        raise InputError(
            "the state is of an image of another size",
            "give the image that the run had, with --image",
        )
    with Run(volume, state.config.replace(refine=()), None, channels) as run:
        base = result_of(run)
    assert base.state is not None
    prepared, has_ids = base.state.prepared, base.has_ids or state.config.has_ids
    models, known = _replayed(state, base)
    if sorted(known) != [segmented.id for segmented in state.objects]:
        raise InputError(
            "the state has other objects than its settings name", "run accelsurf segment again"
        )
    objects = tuple(
        _object(segmented, known[segmented.id], base, has_ids) for segmented in state.objects
    )
    made, clicks = models.made, models.clicks
    placed = clicks if clicks.clicks else None
    confidences = {id: models.contexts[id].confidence(model) for id, model in made.items()}
    objects = tuple(
        dataclasses.replace(
            segmented,
            clicked=clicked_voxels(placed, segmented.id, prepared.first, segmented.box),
            confidence=confidences.get(segmented.id, segmented.confidence),
        )
        for segmented in objects
    )
    return dataclasses.replace(
        base,
        objects=objects,
        has_ids=has_ids,
        clicks=on_image(placed, prepared.first, base.geometry.shape),
        config=state.config,
        levels=list(state.levels),
        edits_done=state.edits_done,
        warnings=list(state.warnings),
        late_leakage=state.late_growth,
        state=models.state(state.totals),
    )


def _replayed(state: StateFile, base: Result) -> tuple[ObjectModels, dict[int, SegmentedObject]]:
    """Return models and result entries of each object after all corrections, made again without a step."""
    assert base.state is not None
    try:
        masks = masks_of(state)
    except (ValueError, TypeError) as error:
        raise InputError(f"the state is damaged ({error})", "run accelsurf segment again") from None
    ended = dataclasses.replace(base, config=state.config, edits_done=state.edits_done)
    models = ObjectModels(base.state, frozen_settings(ended))
    known = dict(base.by_id)
    for number, correction in enumerate(state.config.refine):
        has_ids = base.has_ids or state.config.replace(refine=state.config.refine[:number]).has_ids
        _replay(number, correction, models, known, base, masks.get(number), has_ids)
    return models, known


def _replay(
    number: int,
    correction: Correction,
    models: ObjectModels,
    known: dict[int, SegmentedObject],
    base: Result,
    mask: BoxMask | None,
    has_ids: bool,
) -> None:
    """Make one correction again, but for its surfaces."""
    if correction.kind in ("clicks", "new"):
        if correction.new in known:
            models.remove(correction.new or 0)
        new = placed_clicks(
            clicks_of(correction, base.volume, base.image, correction.target, has_ids),
            models.prepared,
            correction.near,
        )
        if correction.new is not None:
            models.add(new)
    if correction.new is not None and correction.split is None:
        models.begin_object(number, correction, mask)
        known[correction.new] = _begun(correction.new, base, models)
    elif correction.kind == "clicks":
        for click in new:  # in the order in which they were made
            models.add((click,))
            for id in known:
                model = models.model(id) if (mine := clicks_on((click,), id)) else None
                if model is not None:
                    for seen in mine:
                        model.add(seen)
    elif correction.kind == "mend":
        id = correction.object or next(iter(known))
        if mask is None or id not in known:
            raise InputError(
                f"the state says nothing of correction {number + 1}", "run accelsurf segment again"
            )
        models.begin_given(number, id, mask)
    elif correction.merge:
        models.merge(correction.merge)
        for id in correction.merge[1:]:
            del known[id]
    elif correction.remove is not None:
        models.remove(correction.remove)
        del known[correction.remove]
    else:
        if (
            mask is None
            or correction.split is None
            or correction.object not in known
            or correction.new is None
        ):
            raise InputError(
                f"the state says nothing of correction {number + 1}", "run accelsurf segment again"
            )
        voxel = voxel_of(correction.split, base) - np.array(models.prepared.first)
        models.split(
            number, correction.object, correction.new, mask, point_click(voxel, correction.new)
        )
        known[correction.new] = dataclasses.replace(
            known[correction.object], id=correction.new, plateaus=()
        )


def _begun(id: int, base: Result, models: ObjectModels) -> SegmentedObject:
    """Return the entry in results of an object that a correction has begun, but for its surface."""
    context, model = models.contexts[id], models.model(id)
    assert model is not None
    made = models.energy_on(id, model.state.box, context, models.prepared.images)
    learned = models.prepared.learned_by(context)
    return dataclasses.replace(
        base.objects[0],
        id=id,
        terms=made.terms,
        learned=learned,
        plateaus=(),
        clicked=None,
        confidence=None,
    )


def _object(
    stored: ObjectFile, known: SegmentedObject, base: Result, has_ids: bool
) -> SegmentedObject:
    """An object as the state has it, with the image of the run."""
    try:
        psi = surface_of(stored)
    except (ValueError, TypeError) as error:
        raise InputError(f"the state is damaged ({error})", "run accelsurf segment again") from None
    before = None if stored.before is None else EarlierProbability(stored.before)
    box = box_of(stored)
    if not has_ids:
        return dataclasses.replace(
            known,
            psi=psi,
            history=list(stored.history),
            stop=stored.stop,
            plateaus=stored.plateaus,
            before=before,
        )
    return dataclasses.replace(
        known,
        box=box,
        psi=psi,
        image=base.image[box],
        geometry=cropped(base.geometry, box),
        history=list(stored.history),
        stop=stored.stop,
        plateaus=stored.plateaus,
        before=before,
    )
