"""The clicks of a correction: read on the image's grid, for the object that they are about, and checked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.segmentation.result import Result
from accelsurf.settings.refinements import Refinement


def check_object(refinement: Refinement, ids: Sequence[int] | None) -> None:
    """Refuse a correction of an object that there is not; ``ids`` is None where there is one without an id.

    Raises
    ------
    UsageError
        With the ids that there are.
    """
    own = refinement.object
    if ids is None:
        if own is not None and own != 1:
            raise UsageError(f"refine: object {own} was given, but there is a single one", "leave object out")
        return
    known = ", ".join(map(str, ids[:20])) + (", ..." if len(ids) > 20 else "")
    if own is None and refinement.inside:
        raise UsageError("refine: inside was given without object, expected an object's id", f"there are {known}")
    if own is not None and own not in ids:
        raise UsageError(f"refine: object {own} was given, expected one that there is", f"there are {known}")


def refuse_contradictions(clicks: Clicks, ids: Sequence[int]) -> None:
    """Refuse clicks that put a voxel on both sides of an object.

    Raises
    ------
    InputError
        With the voxel.
    """
    for id in ids:
        own = clicks.of(id).clicks
        for last in own[-1:] if not own else own:
            for other in own:
                if other.side == last.side:
                    continue
                both = Clicks((other,), clicks.shape).on_box(last.box).mask("inside" if other.side == "inside" else "outside")
                where = np.argwhere(both & last.mask)
                if where.size:
                    z, y, x = (int(i) + s.start for i, s in zip(where[0], last.box, strict=True))
                    raise InputError(
                        f"the voxel {x},{y},{z} was clicked inside and outside", "undo one of the two clicks"
                    )
