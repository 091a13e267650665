"""refine(): a result is corrected by clicks, or has other objects."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any, Literal

from accelsurf.errors import UsageError
from accelsurf.interact.finished import OnObjectStep, finished
from accelsurf.interact.refiner import Refiner
from accelsurf.io import ImageLike, as_volume, from_library
from accelsurf.run import Result, Run
from accelsurf.settings.corrections import corrections_in_order
from accelsurf.settings.run_config import RunConfig


def refine(  # noqa: PLR0913
    result: Result | ImageLike,
    *,
    labels: ImageLike | None = None,
    spacing: float | str | tuple[float, float, float] | None = None,
    inside: str | Sequence[str] = (),
    outside: str | Sequence[str] = (),
    near: float | Literal["auto"] = "auto",
    object: int | None = None,
    new: int | None = None,
    size: str | None = None,
    merge: Sequence[int] = (),
    split: str | None = None,
    remove: int | None = None,
    to_edges: float | None = None,
    islands: str | None = None,
    holes: str | None = None,
    on_step: OnObjectStep | None = None,
) -> Result:
    """Correct a result by clicks: the surface moves near them, and beyond it every byte stays. Or have other objects.

    With ``labels`` a mask that is nearly right is mended: `Result.labels` has all labels of the map, and those that are
    not asked for are neither changed nor entered.

    Parameters
    ----------
    result : Result or image
        Of `accelsurf.segment`, `accelsurf.segment_objects` or `accelsurf.refine`; it is not changed. With ``labels``
        the image, as `accelsurf.segment` takes it.
    labels : image, optional
        Label map on the image's grid, or its file (``FILE@2,5-9``: objects with these ids).
    spacing : float, str or (hz, hy, hx), optional
        mm, of an image that is an array; 1 by default.
    inside, outside : str or sequence of str
        Voxels that are in the object, and that are not: ``point:X,Y,Z``, ``stroke:FILE``, or written as a start.
        They are made one after the other, first those inside: the surface is the same as after a call for each.
    near : float or "auto"
        How far from the clicks the surface may move, mm.
    object : int, optional
        Id of the object, where there are several.
    new, size, merge, split, remove : optional
        Which objects there are, as `accelsurf.settings.corrections.Correction` has it.
    to_edges, islands, holes : optional
        The object as a whole, as of `Correction`; with clicks it is done before them.
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
        When a click lies outside of the image, a voxel was clicked on both sides, or the label map cannot be used;
        GeometryError when that lies on another grid.

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
    >>> mask = accelsurf.segment(image, start="ball:12,12,12,4", energy="threshold:50,").labels
    >>> mended = refine(image, labels=5 * mask, to_edges=2)
    >>> mended.labels.dtype, sorted(mended.by_id)
    (dtype('uint8'), [5])
    """
    if isinstance(result, Result):
        if labels is not None or spacing is not None:
            raise UsageError(
                "refine: labels or spacing were given with a result", "give the image in its place"
            )
    else:
        result = beginning_with(result, labels, spacing)
    table: dict[str, Any] = {"inside": inside, "outside": outside, "near": near, "object": object}
    table |= {"new": new, "size": size, "merge": tuple(merge), "split": split, "remove": remove}
    table |= {"to_edges": to_edges, "islands": islands, "holes": holes}
    corrections, refiner = corrections_in_order(table), Refiner(result)
    for correction in corrections:
        refiner.apply(correction, on_step=on_step)
    return refiner.result()


def beginning_with(
    image: ImageLike,
    labels: ImageLike | None,
    spacing: float | str | tuple[float, float, float] | None = None,
) -> Result:
    """Return the result that a label map is, before it is mended."""
    if labels is None:
        raise UsageError(
            "refine: an image was given without labels", "give the label map that is to be mended"
        )
    volume, given = as_volume(image, spacing), from_library(labels, "labels")
    if isinstance(given, (str, os.PathLike)):
        run = Run(volume, RunConfig(labels=os.fspath(given)))
    else:
        run = Run(volume, RunConfig(energy="seeded"), labels=given)
    return finished(run, None, None)


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
