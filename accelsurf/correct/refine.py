"""refine(): a result is corrected by clicks, or has other objects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from accelsurf.correct.finished import OnObjectStep
from accelsurf.correct.refiner import Refiner
from accelsurf.run.result import Result
from accelsurf.settings.corrections import corrections_of


def refine(
    result: Result,
    *,
    inside: str | Sequence[str] = (),
    outside: str | Sequence[str] = (),
    near: float | Literal["auto"] = "auto",
    object: int | None = None,
    new: int | None = None,
    size: str | None = None,
    merge: Sequence[int] = (),
    split: str | None = None,
    remove: int | None = None,
    on_step: OnObjectStep | None = None,
) -> Result:
    """Correct a result by clicks: the surface moves near them, and beyond it every byte stays. Or have other objects.

    Parameters
    ----------
    result : Result
        Of `accelsurf.segment`, `accelsurf.segment_objects` or `accelsurf.refine`; it is not changed.
    inside, outside : str or sequence of str
        Voxels that are in the object, and that are not: ``point:X,Y,Z``, ``stroke:FILE``, or written as a start.
        All together are one correction.
    near : float or "auto"
        How far from the clicks the surface may move, mm.
    object : int, optional
        Id of the object, where there are several.
    new, size, merge, split, remove : optional
        Which objects there are, as `accelsurf.settings.corrections.Correction` has it.
    on_step : callable, optional
        Called with each `StepRecord` and the id of its object; a true return value ends the correction.

    Returns
    -------
    Result
        Its ``config`` has the correction, and repeats the run and it.

    Raises
    ------
    UsageError
        When nothing was clicked, an object does not exist, or the result was made with ``keep_state="no"``.
    InputError
        When a click lies outside of the image, or a voxel was clicked on both sides.

    Examples
    --------
    >>> import numpy as np
    >>> import accelsurf
    >>> z, y, x = np.indices((24, 24, 48)) - 11.5
    >>> image = (z**2 + y**2 + np.minimum(abs(x), abs(x - 24))**2 < 7**2) * 100.0
    >>> result = accelsurf.segment(image, start="ball:11.5,11.5,11.5,4", energy="threshold:50,", smoothness=1)
    >>> more = refine(result, inside="ball:35.5,11.5,11.5,3")
    >>> bool(result.labels[12, 12, 36]), bool(more.labels[12, 12, 36])
    (False, True)
    """
    table: dict[str, Any] = {"inside": inside, "outside": outside, "near": near, "object": object}
    table |= {"new": new, "size": size, "merge": tuple(merge), "split": split, "remove": remove}
    (correction,), refiner = corrections_of({k: v for k, v in table.items() if v is not None}), Refiner(result)
    refiner.apply(correction, on_step=on_step)
    return refiner.result()


def with_corrections(result: Result, on_step: OnObjectStep | None = None) -> Result:
    """Make the corrections of a run's settings after it has ended; of one that was interrupted none is made."""
    wanted = result.config.refine
    if not wanted:
        return result
    config = result.config.replace(refine=())
    if result.stop.reason == "interrupted":
        skipped = f"{len(wanted)} refinements were not made: the run was interrupted"
        return dataclasses.replace(result, config=config, warnings=[*result.warnings, skipped])
    refiner = Refiner(dataclasses.replace(result, config=config))
    for correction in wanted:
        refiner.apply(correction, on_step=on_step)
    return refiner.result()
