"""Objects of the first frame of a tracking: segmented as an image, or given as labels that stay as they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.api import segment, segment_objects
from accelsurf.errors import EmptyResultError
from accelsurf.evolution import StepRecord
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.interact import Refiner
from accelsurf.run import EnergyLike, ObjectsLike, Result
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.objects import read_objects
from accelsurf.text.starts import read_starts
from accelsurf.track.boxed_surface import separate_parts
from accelsurf.track.frame_run import Measured, measured, measured_start
from accelsurf.track.records import BAND

#: Called with each step and the id of its object; a true value ends the run.
OnStep = Callable[[StepRecord, int], bool | None]


class FirstObjects(NamedTuple):
    """Objects of the first frame: ids and surfaces, and the warnings of the run."""

    found: tuple[tuple[int, Measured], ...]
    warnings: tuple[str, ...]
    interrupted: bool


def first_objects(
    channels: Sequence[Volume],
    config: RunConfig,
    refinements: Sequence[Correction],
    divide: bool,
    energy: EnergyLike | None = None,
    objects: ObjectsLike | None = None,
    on_step: OnStep | None = None,
) -> FirstObjects:
    """Segment the first frame.

    Parameters
    ----------
    channels : sequence of Volume
    config : RunConfig
    refinements : sequence of Correction
        Corrections of this frame.
    divide : bool
        Whether parts that are no crumbs are objects of their own.
    energy : Energy or callable, optional
        One of the user's own.
    objects : str, Volume or ndarray, optional
        First voxels of several objects, in place of the objects in ``config``.
    on_step : callable, optional

    Raises
    ------
    EmptyResultError
        When nothing is left to be followed.
    UsageError, InputError
        As of `accelsurf.segment`.
    """
    if refinements:
        config = config.replace(keep_state="yes")
    first, more = channels[0], channels[1:]
    if config.objects is None and objects is None:
        on_record = None if on_step is None else lambda record: on_step(record, 1)
        result = segment(first, channels=more, config=config, energy=energy, on_step=on_record)
    else:
        result = segment_objects(
            first, objects, channels=more, config=config, energy=energy, on_step=on_step
        )
    interrupted = result.stop.reason == "interrupted"
    if refinements and not interrupted:
        refiner = Refiner(result)
        for refinement in refinements:
            refiner.apply(refinement)
        result = refiner.result()
    found = _separated(result) if divide else _as_found(result)
    if not found:
        raise EmptyResultError(
            "no surface is left in the first frame: nothing can be followed",
            "begin in a frame that shows the object (--frame N), or try the settings with accelsurf segment on it",
        )
    return FirstObjects(tuple(found), tuple(result.warnings), interrupted)


def given_objects(
    config: RunConfig, objects: ObjectsLike | None, geometry: Geometry
) -> tuple[tuple[int, Measured], ...] | None:
    """Objects of a frame whose segmentation is given, as they are; None where the start is another one.

    Parameters
    ----------
    config : RunConfig
        With ``objects`` or ``start``.
    objects : str, Volume or ndarray, optional
        In place of the objects in ``config``.
    geometry : Geometry
        Grid of the frame.

    Raises
    ------
    UsageError, InputError
        As of `accelsurf.text.objects.read_objects`.
    """
    given = config.objects if objects is None else objects
    if given is None:
        parsed = read_starts(config.start)
        if len(parsed) != 1 or parsed[0].kind != "label":
            return None
        given = config.start[0].strip().removeprefix("label:")
    if isinstance(given, str) and given.lower().endswith(".csv"):
        return None
    if not isinstance(given, str | Volume | np.ndarray):
        return None  # surfaces may lie between the voxels
    found = read_objects(given, geometry, BAND)
    return tuple((start.id, measured_start(start, geometry)) for start in found)


def _as_found(result: Result) -> list[tuple[int, Measured]]:
    box = whole_box(result.geometry.shape)
    found = [
        (tracked.id, measured(tracked, box)) for tracked in result.objects if tracked.has_surface
    ]
    return [(id, tracked) for id, tracked in found if tracked.surface.psi.size]


def _separated(result: Result) -> list[tuple[int, Measured]]:
    """Each part that is no crumb as an object of its own: the largest has the id, the others new ones."""
    found = _as_found(result)
    out, following = [], max((id for id, _ in found), default=0)
    for id, whole in found:
        pieces = separate_parts(whole.surface)
        for place, piece in enumerate(pieces):
            new_id = id
            if place > 0:
                new_id = following = following + 1
            share = (piece.psi < 0).sum() / sum(int((other.psi < 0).sum()) for other in pieces)
            is_whole = len(pieces) == 1
            volume, area = (1.0, 1.0) if is_whole else (float(share), float(share) ** (2.0 / 3.0))
            out.append(
                (
                    new_id,
                    whole._replace(
                        surface=piece,
                        volume_mm3=volume * whole.volume_mm3,
                        area_mm2=area * whole.area_mm2,
                    ),
                )
            )
    return sorted(out, key=lambda pair: pair[0])
