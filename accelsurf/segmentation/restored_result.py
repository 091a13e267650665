"""A result again from the file of its state and its image."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Corner
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.volume import Volume
from accelsurf.segmentation.clicked_voxels import clicked_voxels, on_image
from accelsurf.segmentation.local_model import LocalModel, local_models, sureness_from
from accelsurf.segmentation.new_clicks import clicks_of, clicks_on, placed_clicks
from accelsurf.segmentation.region_of_interest import cropped
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_result import result_of
from accelsurf.segmentation.state_file import ObjectFile, StateFile, box_of, rests_of, surface_of


def restored(state: StateFile, volume: Volume, channels: Sequence[Volume] = ()) -> Result:
    """Return the result that a state was written of: the same surfaces, bit for bit, and ready to be refined.

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
        raise InputError("the state is of an image of another size", "give the image that the run had, with --image")
    with Run(volume, state.config.replace(refine=()), None, channels) as run:
        base = result_of(run)
    if [one.id for one in base.objects] != [one.id for one in state.objects]:
        raise InputError("the state has other objects than its settings name", "run accelsurf segment again")
    objects = tuple(_object(one, known, base) for one, known in zip(state.objects, base.objects, strict=True))
    assert base.state is not None
    prepared = base.state.prepared
    clicks = base.state.clicks or Clicks((), prepared.geometry.shape)
    models = local_models(base.state, base.config, [one.id for one in objects])
    for refinement in state.config.refine:
        new = placed_clicks(clicks_of(refinement, base), prepared)
        clicks = clicks.with_later(new)
        for id, model in models.items():
            for click in clicks_on(new, id):
                model.add(click)
    said = clicks if clicks.clicks else None
    objects = tuple(_with_clicks(one, said, models.get(one.id), prepared.first) for one in objects)
    return dataclasses.replace(
        base,
        objects=objects,
        clicks=on_image(said, prepared.first, base.geometry.shape),
        config=state.config,
        levels=list(state.levels),
        edits_done=state.edits_done,
        warnings=list(state.warnings),
        late_growth=state.late_growth,
        state=dataclasses.replace(
            base.state,
            totals=dict(state.totals),
            clicks=clicks,
            models={id: one.state for id, one in models.items()},
        ),
    )


def _with_clicks(one: SegmentedObject, said: Clicks | None, model: LocalModel | None, first: Corner) -> SegmentedObject:
    """An object with all that was clicked on the region of interest, whose first voxel is ``first``."""
    sureness = one.sureness if model is None else sureness_from(model.state)
    return dataclasses.replace(one, clicked=clicked_voxels(said, one.id, first, one.box), sureness=sureness)


def _object(one: ObjectFile, known: SegmentedObject, base: Result) -> SegmentedObject:
    """An object as the state has it; what it shows of the image is that of the run."""
    try:
        psi, rests = surface_of(one), rests_of(one)
    except ValueError as error:
        raise InputError(f"the state is damaged ({error})", "run accelsurf segment again") from None
    box = box_of(one)
    if not base.has_ids:
        return dataclasses.replace(known, psi=psi, history=list(one.history), stop=one.stop, rests=rests)
    return dataclasses.replace(
        known, box=box, psi=psi, image=base.image[box], geometry=cropped(base.geometry, box),
        history=list(one.history), stop=one.stop, rests=rests,
    )
