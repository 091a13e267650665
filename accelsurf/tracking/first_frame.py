"""The first frame of a tracking: segmented as a single image, by the user's start, clicks or objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from accelsurf.errors import EmptyResultError
from accelsurf.evolution.records import StepRecord
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.volume import Volume
from accelsurf.segmentation.api import segment, segment_objects
from accelsurf.segmentation.refiner import Refiner
from accelsurf.segmentation.result import Result
from accelsurf.segmentation.run_setup import EnergyLike, ObjectsLike
from accelsurf.settings.edits import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.tracking.frame_run import Measured, measured
from accelsurf.tracking.parts import separate_parts

#: Called with each step and the id of its object; a true value ends the run.
OnStep = Callable[[StepRecord, int], bool | None]


class FirstObjects(NamedTuple):
    """What the first frame shows: ids and surfaces, and what was said of the run."""

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
        First voxels of several objects, in place of those of ``config``.
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
        one = None if on_step is None else lambda record: on_step(record, 1)
        result = segment(first, channels=more, config=config, energy=energy, on_step=one)
    else:
        result = segment_objects(first, objects, channels=more, config=config, energy=energy, on_step=on_step)
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
            "try the settings with accelsurf segment on that frame (--time-index)",
        )
    return FirstObjects(tuple(found), tuple(result.warnings), interrupted)


def _as_found(result: Result) -> list[tuple[int, Measured]]:
    box = whole_box(result.geometry.shape)
    found = [(one.id, measured(one, box)) for one in result.objects if one.has_surface]
    return [(id, one) for id, one in found if one.surface.psi.size]


def _separated(result: Result) -> list[tuple[int, Measured]]:
    """Each part that is no crumb as an object of its own: the largest has the id, the others new ones."""
    found = _as_found(result)
    out, following = [], max((id for id, _ in found), default=0)
    for id, one in found:
        pieces = separate_parts(one.surface)
        for place, piece in enumerate(pieces):
            own = id
            if place > 0:
                own = following = following + 1
            share = (piece.psi < 0).sum() / sum(int((other.psi < 0).sum()) for other in pieces)
            whole = len(pieces) == 1
            volume, area = (1.0, 1.0) if whole else (float(share), float(share) ** (2.0 / 3.0))
            out.append((own, one._replace(
                surface=piece, volume_mm3=volume * one.volume_mm3, area_mm2=area * one.area_mm2
            )))
    return sorted(out, key=lambda pair: pair[0])
