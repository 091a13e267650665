"""Clicks, contexts and models of the objects of a finished run, correction by correction; knows no surface."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import ClickModel, GivenMask
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Box, Corner, corner_of, whole_box
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.interact.local_model import LocalModel, local_model
from accelsurf.run import (
    BoxMask,
    ImageContext,
    MadeEnergy,
    ModelInputs,
    PreprocessedInput,
    RunState,
    energy_maker,
)
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.toml import volume_mm3
from accelsurf.text.clicks import voxel_named

#: The energy of an object that begins at clicks after the run's end.
_NEW_ENERGY = "seeded"


#: Attributes of `ObjectModels` that corrections change; models that clicks change are put back by the caller.
_CHANGED = ("clicks", "contexts", "settings", "masks", "_models", "_states")


class ObjectModels:
    """Clicks, contexts, settings and models of each object, besides its surface.

    Parameters
    ----------
    state : RunState
    settings : RunConfig
        In force at the run's end.

    Attributes
    ----------
    prepared : PreprocessedInput
        Image and mask of the run.
    clicks : Clicks
        All so far, on the grid of the region of interest.
    contexts : dict of int to ImageContext
        Of each object.
    settings : dict of int to RunConfig
        Of the objects whose settings are not the run's.
    masks : dict of int to BoxMask
        By the number of the correction: voxels that its new object may not have, or that were split off.
    """

    def __init__(self, state: RunState, settings: RunConfig) -> None:
        self._state, self._frozen = state, settings
        self.prepared: PreprocessedInput = state.prepared
        self.clicks = state.clicks or Clicks((), state.prepared.geometry.shape)
        self.contexts, self.settings, self.masks = (
            dict(state.contexts),
            dict(state.settings),
            dict(state.masks),
        )
        self._states, self._models = dict(state.models), dict[int, LocalModel]()

    @property
    def made(self) -> dict[int, ClickModel]:
        """The models that corrections have needed so far, as values."""
        return {**self._states, **{id: model.state for id, model in self._models.items()}}

    def settings_of(self, id: int) -> RunConfig:
        """The settings of an object."""
        return self.settings.get(id, self._frozen)

    def model(self, id: int) -> LocalModel | None:
        """The model of an object's clicks, made when it is first needed; None where its energy has none.

        Raises
        ------
        UsageError
            When nothing was clicked inside the object.
        """
        if not self.settings_of(id).energy.uses_model:
            return None
        if id not in self._models:
            context = self.contexts[id]
            has_none = context.clicks is None or not context.clicks.ids()
            if has_none and context.model_inputs.given is None:  # all were split off
                context = self.contexts[id] = context.with_clicks(self.clicks.of(id))
            known = self._states.pop(id, None) or context.click_model()
            self._models[id] = local_model(context, known)
        return self._models[id]

    def energy_on(
        self, id: int, box: Box, context: ImageContext, shared: Sequence[np.ndarray]
    ) -> MadeEnergy:
        """The energy of an object on a box of the grid; ``shared`` are the channels on the whole grid."""
        images = [np.ascontiguousarray(image[box]) for image in shared]
        model, settings = self.model(id), self.settings_of(id)
        field, curvature = (
            (None, None) if model is None else (lambda: model.field_on(box), model.mean_curvature)
        )
        given = None if id in self.settings else self._state.energy
        make = energy_maker(given, settings, 1, True)
        return make(
            images[0],
            self.prepared.geometry.spacing,
            context.with_channels(images[1:], field, curvature),
        )

    # -- changes of the objects ----------------------------------------------------------------------------

    def add(self, clicks: Sequence[Click]) -> None:
        """Note new clicks."""
        self.clicks = self.clicks.with_later(clicks)

    def begin_object(self, number: int, correction: Correction, taken: BoxMask | None) -> None:
        """Begin an object at clicks that have been noted.

        Parameters
        ----------
        number : int
            Of the correction.
        correction : Correction
            With ``new``.
        taken : BoxMask or None
            Voxels that it may not have.
        """
        id, prepared = correction.new, self.prepared
        assert id is not None
        self.settings[id] = self._frozen.replace(
            objects=None,
            inside=(),
            outside=(),
            box=None,
            start=("clicks",),
            energy=_NEW_ENERGY,
            size=correction.size,
        )
        passes = prepared.open_on(whole_box(prepared.geometry.shape))
        if taken is not None:
            self.masks[number] = taken
            passes = np.ones(prepared.geometry.shape, np.bool_) if passes is None else passes
            passes[taken.box] &= ~taken.mask
        size = None if correction.size is None else volume_mm3(correction.size)
        inputs = ModelInputs(size, passes)
        self.contexts[id] = prepared.context.with_model_inputs(inputs).with_clicks(
            self.clicks.of(id)
        )
        self._forget(id)

    def begin_given(self, number: int, id: int, mask: BoxMask) -> None:
        """Take the voxels that an object has after a correction without clicks as given; its clicks stay.

        Parameters
        ----------
        number : int
            Of the correction.
        id : int
        mask : BoxMask
            Those voxels.
        """
        self.masks[number] = mask
        context = self.contexts[id]
        inputs = context.model_inputs._replace(given=GivenMask(mask.box, mask.mask))
        self.contexts[id] = context.with_model_inputs(inputs).with_clicks(self.clicks.of(id))
        self._forget(id)

    def merge(self, ids: Sequence[int]) -> None:
        """Give the clicks of several objects to the first; where it may be is not bounded by the others."""
        first, others = ids[0], ids[1:]
        self.clicks = Clicks(
            tuple(
                click._replace(id=first) if click.id in others else click
                for click in self.clicks.clicks
            ),
            self.clicks.shape,
        )
        for id in others:
            self._forget_object(id)
        passes = self.prepared.open_on(whole_box(self.prepared.geometry.shape))
        context = self.contexts[first]
        inputs = context.model_inputs._replace(size_mm3=None, mask=passes)
        self.contexts[first] = context.with_model_inputs(inputs).with_clicks(self.clicks.of(first))
        self._forget(first)

    def split(self, number: int, id: int, new: int, part: BoxMask, click: Click) -> None:
        """Give the voxels clicked inside an object that lie in ``part``, and the ``click``, to a new one."""
        out: list[Click] = []
        for click_before in self.clicks.clicks:
            if (click_before.side, click_before.id) != ("inside", id):
                out.append(click_before)
                continue
            there = Click("inside", part.box, part.mask, new).mask_on(click_before.box)
            out += [
                click_before._replace(id=owner, mask=mask)
                for owner, mask in (
                    (id, click_before.mask & ~there),
                    (new, click_before.mask & there),
                )
                if mask.any()
            ]
        self.clicks = Clicks((*out, click), self.clicks.shape)
        self.masks[number] = part
        if id in self.settings:
            self.settings[new] = self.settings[id]
        context = self.contexts[id]
        for owner in (id, new):
            self.contexts[owner] = context.with_clicks(self.clicks.of(owner))
            self._forget(owner)

    def remove(self, id: int) -> None:
        """Forget an object and its clicks."""
        self.clicks = Clicks(
            tuple(click for click in self.clicks.clicks if click.id != id), self.clicks.shape
        )
        self._forget_object(id)

    def _forget_object(self, id: int) -> None:
        self.contexts.pop(id, None)
        self.settings.pop(id, None)
        self._forget(id)

    def _forget(self, id: int) -> None:
        """Make the model of an object anew when it is needed."""
        self._models.pop(id, None)
        self._states.pop(id, None)

    def snapshot(self) -> dict[str, Any]:
        """Return the present values, for `restore`."""
        return {name: copy.copy(getattr(self, name)) for name in _CHANGED}

    def restore(self, before: dict[str, Any]) -> None:
        """Go back to the values of a `snapshot`."""
        vars(self).update({name: copy.copy(value) for name, value in before.items()})

    def state(self, totals: Mapping[str, NDArray[np.float64]]) -> RunState:
        """Return the state from which a later correction continues; ``totals`` as of `RunState`."""
        return replace(
            self._state,
            totals=dict(totals),
            clicks=self.clicks,
            models=self.made,
            contexts=dict(self.contexts),
            settings=dict(self.settings),
            masks=dict(self.masks),
        )


def point_click(voxel: Sequence[int], id: int) -> Click:
    """A click of one voxel inside an object."""
    z, y, x = (slice(int(i), int(i) + 1) for i in voxel)
    return Click("inside", (z, y, x), np.ones((1, 1, 1), np.bool_), id)


def check_id(id: int, ids: Sequence[int], what: str) -> None:
    """Refuse an object that there is not.

    Raises
    ------
    UsageError
        With the ids that there are.
    """
    if id not in ids:
        raise UsageError(
            f"refine: {what} {id} was given, expected one that is in the result", ids_text(ids)
        )


def ids_text(ids: Sequence[int]) -> str:
    """Return which objects there are, for messages; of many the first ones."""
    return "there are " + ", ".join(map(str, ids[:20])) + (", ..." if len(ids) > 20 else "")


def placed_clicks(
    clicks: Sequence[Click], prepared: PreprocessedInput, near: float | str
) -> tuple[Click, ...]:
    """Clicks of the image's grid on that of the region of interest, which reach as far as ``near`` says, mm or "auto".

    Raises
    ------
    InputError
        When a voxel clicked inside an object lies outside of the region or the mask.
    """
    geometry = prepared.volumes[0].geometry
    placed = Clicks(tuple(clicks), geometry.shape).on_box(prepared.box).clicks
    lost = sum(
        int(click.mask.sum())
        for click in clicks
        if click.side == "inside" and click.id != NO_OBJECT
    )
    for click in placed:
        if click.side == "inside" and click.id != NO_OBJECT:
            is_open = prepared.open_on(click.box)
            lost -= int((click.mask if is_open is None else click.mask & is_open).sum())
    if lost:
        raise InputError(
            f"refine: {lost} voxels are clicked inside that lie outside of the region of interest, the mask or the box"
            if prepared.other_labels is None
            else f"refine: {lost} voxels are clicked inside that have labels which are not to change",
            "click within them"
            if prepared.other_labels is None
            else "click elsewhere, or ask for these labels too",
        )
    if isinstance(near, str):
        return placed
    return tuple(click._replace(near=near) for click in placed)


def clicks_on(new: Sequence[Click], id: int) -> tuple[Click, ...]:
    """New clicks on an object, as it sees them, and those on no object."""
    mine = tuple(click for click in new if click.id in (id, NO_OBJECT))
    return Clicks(mine, (0, 0, 0)).of(id).clicks


def check_object(correction: Correction, ids: Sequence[int] | None) -> None:
    """Refuse a correction of an object that there is not; ``ids`` is None where there is one without an id.

    Raises
    ------
    UsageError
        With the ids that there are.
    """
    id = correction.object
    if ids is None:
        if id not in (None, 1):
            raise UsageError(
                f"refine: object {id} was given, but there is a single one", "leave object out"
            )
        return
    if id is None and correction.inside:
        raise UsageError(
            "refine: inside was given without object, expected an object's id", ids_text(ids)
        )
    if id is not None:
        check_id(id, ids, "object")


def refuse_contradictions(
    new: Sequence[Click],
    shape: tuple[int, int, int],
    ids: Sequence[int],
    geometry: Geometry,
    first: Corner,
) -> None:
    """Refuse clicks of one correction that put a voxel on both sides of an object; costs no more than their boxes.

    Parameters
    ----------
    new : sequence of Click
    shape : (nz, ny, nx)
        Of their grid.
    ids : sequence of int
        Of the objects.
    geometry : Geometry
        Of their grid.
    first : (z, y, x)
        Index in the image of its first voxel.

    Raises
    ------
    InputError
        With the voxel.
    """
    if len({click.side for click in new}) == 1 and len({click.id for click in new}) == 1:
        return
    for id in ids:
        of_object = Clicks(tuple(new), shape).of(id)
        for click in of_object.clicks:
            here = of_object.on_box(click.box)
            both = here.mask("inside") & here.mask("outside")
            if both.any():
                voxel = np.argwhere(both)[0] + np.array(corner_of(click.box))
                raise InputError(
                    f"refine: {voxel_named(voxel, geometry, first)} is clicked both inside and outside at once",
                    "make two corrections of it: the later one wins",
                )
