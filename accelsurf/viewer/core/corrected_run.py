"""A run that has ended and is corrected: each click as `accelsurf refine` makes it, at once and near the click."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution.records import StepRecord, Stop
from accelsurf.grid.boxes import Box, Corner, bounding_box, corner_of, counted_from, enclosing, placed_at
from accelsurf.report.preview_content import marks_of
from accelsurf.segmentation.clicked_voxels import on_image
from accelsurf.segmentation.ensemble import overall_stop
from accelsurf.segmentation.refine import state_at_end
from accelsurf.segmentation.refiner import Change, Refiner
from accelsurf.segmentation.result import Result
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_result import result_of
from accelsurf.segmentation.run_state import BoxMask
from accelsurf.settings.edits import Correction
from accelsurf.viewer.core.frame import Frame, SurfaceFrame
from accelsurf.viewer.core.nearest_object import distance_of, place_of
from accelsurf.viewer.core.saving import repeating

#: Voxels around an object that a frame has.
AROUND = 2


class CorrectedRun:
    """A run that has ended, as it is after its corrections.

    Parameters
    ----------
    run : Run
        It has ended, and makes no step while this is in use.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        result = dataclasses.replace(result_of(run), config=repeating(run), state=state_at_end(run))
        self._refiner = Refiner(result)
        #: What the slider over the steps says, too.
        self._step = max(one.history[-1].step for one in self._refiner.surfaces)
        #: Where each object has been inside, on the grid of the region of interest; looked for once.
        self._boxes = {one.id: _box_of_inside(one.psi < 0, one.corner) for one in self._refiner.surfaces}
        self._before: list[dict[int, Box | None]] = []

    @property
    def made(self) -> tuple[Correction, ...]:
        """The corrections so far, in order."""
        return self._refiner.config.refine

    @property
    def stop(self) -> Stop:
        """Why the last correction of each object ended."""
        stops = list(self.stops.values())
        return overall_stop(stops) if self.has_ids else stops[0]

    @property
    def stops(self) -> dict[int, Stop]:
        """Why the last correction of each object ended."""
        return {one.id: one.stop for one in self._refiner.surfaces}

    @property
    def has_ids(self) -> bool:
        """Whether labels are ids."""
        return self._refiner.has_ids

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of the objects."""
        return tuple(self.stops)

    def nearest(self, place: str) -> int:
        """The object that is nearest to a place; the one that contains it, if there is one.

        Raises
        ------
        UsageError, InputError
            When it is no such place or lies outside.
        """
        geometry = self._run.geometry
        centre = place_of(place, geometry)
        distances = {
            one.id: distance_of(one.psi, one.corner, self._boxes[one.id], centre, geometry.spacing)
            for one in self._refiner.surfaces
        }
        return min(distances, key=lambda own: distances[own])

    def taken(self, ball: str, object_id: int) -> BoxMask | None:
        """Voxels that an object which is pressed at a ball may not have: those of the others, but for one in which the
        ball lies.
        """
        return self._refiner.taken(place_of(ball, self._run.geometry), object_id)

    @property
    def histories(self) -> tuple[tuple[StepRecord, ...], ...]:
        """The records of each object, of the run and of its corrections."""
        return tuple(tuple(one.history) for one in self._refiner.surfaces)

    def apply(self, refinement: Correction, on_step: Callable[[int], None]) -> tuple[Change, ...]:
        """Make a correction; ``on_step`` is called with the number of each of its steps.

        Raises
        ------
        UsageError, InputError
            As of `accelsurf.segmentation.refiner.Refiner.apply`; nothing is changed then.
        """
        changes = self._refiner.apply(refinement, on_step=lambda record, own: on_step(record.step))
        self._before.append(self._boxes)
        moved = [change.box for change in changes if change.voxels]  # the object gained or lost, others lost there
        is_click = refinement.kind == "clicks"
        self._boxes = {
            one.id: functools.reduce(_around, moved, self._boxes[one.id])
            if is_click
            else self._boxes.get(one.id) if one.id not in [change.object_id for change in changes]
            else _box_of_inside(one.psi < 0, one.corner)
            for one in self._refiner.surfaces
        }
        return changes

    def undo(self) -> None:
        """Take back the last correction."""
        self._refiner.undo()
        self._boxes = self._before.pop()

    def result(self) -> Result:
        """The corrected result; its settings repeat run and corrections."""
        return self._refiner.result()

    def frame(self) -> Frame:
        """What is drawn: of each object a copy of the box in which it is."""
        prepared, surfaces = self._run.prepared, []
        for one in self._refiner.surfaces:
            box = self._boxes[one.id]
            record, corner = one.history[-1], one.corner
            part = None if box is None else _within(counted_from(box, corner), one.psi.shape)
            psi = one.psi[:0, :0, :0].copy() if part is None or not one.inside else one.psi[part].copy()
            z, y, x = corner if part is None else (a + b for a, b in zip(corner, corner_of(part), strict=True))
            grid, shape = self._run.grid, one.psi.shape
            surfaces.append(
                SurfaceFrame(one.id, record, grid, psi, (z, y, x), 1, corner, shape, {}, prepared.first)
            )
        clicks = on_image(self._refiner.clicks, prepared.first, prepared.volumes[0].geometry.shape)
        marks = () if clicks is None else marks_of(clicks.clicks, self._run.geometry.spacing)
        return Frame(tuple(surfaces), marks, corrected_at=self._step if self.made else None)


def _box_of_inside(inside: NDArray[np.bool_], corner: Corner) -> Box | None:
    """The box around what is inside, on the grid of the region of interest."""
    box = bounding_box(inside)
    return None if box is None else placed_at(box, corner)


def _around(box: Box | None, other: Box) -> Box:
    """The smallest box that holds two, or the one that there is."""
    return other if box is None else enclosing(box, other)


def _within(box: Box, shape: tuple[int, ...]) -> Box:
    """A box with some voxels around it, as far as an array goes."""
    z, y, x = (
        slice(max(s.start - AROUND, 0), max(min(s.stop + AROUND, n), 0)) for s, n in zip(box, shape, strict=True)
    )
    return z, y, x
