"""The clicks of a correction: read on the image's grid, for the object that they are about, and checked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Corner, corner_of
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.initialization.clicks import voxel_named
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.settings.edits import Correction


def placed_clicks(clicks: Sequence[Click], prepared: PreprocessedInput) -> tuple[Click, ...]:
    """Clicks of the image's grid on that of the region of interest.

    Raises
    ------
    InputError
        When a voxel clicked inside an object lies outside of the region or the mask.
    """
    geometry, distance = prepared.volumes[0].geometry, prepared.mask_distance
    own = Clicks(tuple(clicks), geometry.shape).on_box(prepared.box).clicks
    lost = sum(int(one.mask.sum()) for one in clicks if one.side == "inside" and one.id != NO_OBJECT)
    for one in own:
        if one.side == "inside" and one.id != NO_OBJECT:
            within = one.mask if distance is None else one.mask & (distance[one.box] <= 0)
            lost -= int(within.sum())
    if lost:
        raise InputError(
            f"refine: {lost} voxels are clicked inside that lie outside of the region of interest, the mask or the box",
            "click within them",
        )
    return own


def clicks_on(new: Sequence[Click], id: int) -> tuple[Click, ...]:
    """The new clicks that an object answers to, as it sees them: its own, and those on no object."""
    own = tuple(click for click in new if click.id in (id, NO_OBJECT))
    return Clicks(own, (0, 0, 0)).of(id).clicks


def check_object(refinement: Correction, ids: Sequence[int] | None) -> None:
    """Refuse a correction of an object that there is not; ``ids`` is None where there is one without an id.

    Raises
    ------
    UsageError
        With the ids that there are.
    """
    own = refinement.object
    if ids is None:
        if own not in (None, 1):
            raise UsageError(f"refine: object {own} was given, but there is a single one", "leave object out")
        return
    there = "there are " + ", ".join(map(str, ids[:20])) + (", ..." if len(ids) > 20 else "")
    if own is None and refinement.inside:
        raise UsageError("refine: inside was given without object, expected an object's id", there)
    if own is not None and own not in ids:
        raise UsageError(f"refine: object {own} was given, expected one that is in the result", there)


def refuse_contradictions(
    new: Sequence[Click], shape: tuple[int, int, int], ids: Sequence[int], geometry: Geometry, first: Corner
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
        own = Clicks(tuple(new), shape).of(id)
        for one in own.clicks:
            here = own.on_box(one.box)
            both = here.mask("inside") & here.mask("outside")
            if both.any():
                voxel = np.argwhere(both)[0] + np.array(corner_of(one.box))
                raise InputError(
                    f"refine: {voxel_named(voxel, geometry, first)} is clicked both inside and outside at once",
                    "make two corrections of it: the later one wins",
                )
