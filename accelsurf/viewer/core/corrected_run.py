"""Corrections of a session: each as `accelsurf refine` makes it, at once and near the click, once the run has ended."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import on_image
from accelsurf.errors import AccelsurfError
from accelsurf.evolution import StepRecord, Stop
from accelsurf.grid.boxes import (
    Box,
    Corner,
    bounding_box,
    box_at,
    corner_of,
    counted_from,
    enclosing,
    placed_at,
)
from accelsurf.interact import Change, Refiner, changes_text, result_of, state_at_end
from accelsurf.output import marks_of
from accelsurf.run import BoxMask, Result, Run, overall_stop
from accelsurf.settings.corrections import Correction
from accelsurf.text.clicks import first_place
from accelsurf.viewer.core.frame import (
    Frame,
    SurfaceFrame,
    VolumeEstimate,
    histories_of_run,
    volume_estimate,
)
from accelsurf.viewer.core.saving import present_result

#: Voxels around an object that a frame has.
AROUND = 2


class MadeAgain(NamedTuple):
    """Corrections that were made again: a ``line`` about the last of them, and whether that ``failed``."""

    line: str
    failed: bool


class Corrections:
    """Corrections of a run; made again when the run has gone on and ends once more.

    Parameters
    ----------
    wanted : tuple of Correction
        Those to be made when the run ends.
    on_progress : callable, optional
        Called with a line while a correction is made; it must return soon.
    """

    def __init__(
        self, wanted: tuple[Correction, ...], on_progress: Callable[[str], None] | None = None
    ) -> None:
        self._wanted = wanted
        self._progress = on_progress or (lambda message: None)
        self._refiner: Refiner | None = None
        #: Where each object has been inside, on the grid of the region of interest; before each correction too.
        self._boxes: dict[int, Box | None] = {}
        self._before: list[dict[int, Box | None]] = []
        self._last_step = 0
        #: The step after which the volume was estimated, and that.
        self._measured_at: StepRecord | None = None
        self._estimated: VolumeEstimate | None = None

    @property
    def wanted(self) -> tuple[Correction, ...]:
        """Corrections that are made, or will be when the run ends."""
        return self._wanted

    def want(self, corrections: tuple[Correction, ...]) -> None:
        """Have other corrections made when the run ends."""
        self._wanted = corrections

    def _begun(self, run: Run) -> Refiner:
        """Return the refiner of a run that has ended."""
        if self._refiner is None:
            result = dataclasses.replace(present_result(run), state=state_at_end(run))
            self._refiner, self._before = Refiner(result), []
            surfaces = self._refiner.surfaces
            self._last_step = max(surface.history[-1].step for surface in surfaces)
            self._boxes = {
                surface.id: _box_of_inside(surface.psi < 0, surface.corner) for surface in surfaces
            }
        return self._refiner

    def correct(self, run: Run, correction: Correction, said: str) -> str:
        """Make a correction of a run that has ended; return a line about its effect.

        Raises
        ------
        AccelsurfError
            When it cannot be made; then nothing has changed.
        """
        self._progress(f"{said}: correcting")
        refiner = self._begun(run)
        changes = refiner.apply(
            correction,
            on_step=lambda record, id: self._progress(f"{said}: correcting, step {record.step}"),
        )
        self._follow(refiner, correction, changes)
        self._wanted = refiner.config.refine
        return f"{said}: {changes_text(changes)}"

    def reach_of(self, run: Run, correction: Correction) -> float | None:
        """Return how far from its clicks a correction may change an object, mm; None while the run goes on."""
        return None if run.stop is None else self._begun(run).reach_of(correction)

    def _follow(
        self, refiner: Refiner, correction: Correction, changes: tuple[Change, ...]
    ) -> None:
        """Note where the objects are after a correction."""
        self._before.append(self._boxes)
        moved = [
            change.box for change in changes if change.voxels
        ]  # the object gained or lost, others lost there
        changed = {change.object_id for change in changes}
        boxes = {}
        for surface in refiner.surfaces:
            if correction.kind == "clicks":
                boxes[surface.id] = functools.reduce(_around, moved, self._boxes[surface.id])
            elif surface.id in changed:
                boxes[surface.id] = _box_of_inside(surface.psi < 0, surface.corner)
            else:
                boxes[surface.id] = self._boxes.get(surface.id)
        self._boxes = boxes

    def correct_again(self, run: Run) -> MadeAgain:
        """Make those that are wanted of a run that has ended; the first that does not fit ends them."""
        wanted = self._wanted
        self._wanted = ()
        line = ""
        for number, correction in enumerate(wanted, 1):
            said = f"correction {number} of {len(wanted)}"
            try:
                line = self.correct(run, correction, said)
            except AccelsurfError as error:
                return MadeAgain(f"{said} cannot be made again: {error.message}", True)
        return MadeAgain(line, False)

    def go_to(self, run: Run, wanted: tuple[Correction, ...]) -> bool:
        """Take back corrections and make others, so that these are made; False where it takes another run."""
        now = self._wanted
        if run.stop is None or now == wanted or (self._refiner is None and now):
            return False
        pairs = enumerate(zip(now, wanted, strict=False))
        common = next((n for n, (a, b) in pairs if a != b), min(len(now), len(wanted)))
        for _ in now[common:]:
            assert self._refiner is not None
            self._refiner.undo()
            self._boxes = self._before.pop()
        self._wanted = now[:common]
        for number, correction in enumerate(wanted[common:], 1):
            self.correct(run, correction, f"made again, {number} of {len(wanted) - common}")
        return True

    def leave(self) -> None:
        """Let the run go on: corrections are made again when it ends."""
        self._refiner = None

    # -- present state ------------------------------------------------------------------------------------

    def stops(self, run: Run) -> dict[int, Stop | None]:
        """Return why each object, or its last correction, ended."""
        return {
            each.id: each.stop
            for each in (run.objects if self._refiner is None else self._refiner.surfaces)
        }

    def stop(self, run: Run) -> Stop | None:
        """Return why the run, or the last correction, ended; None while it goes on."""
        if self._refiner is None:
            return run.stop
        stops = [surface.stop for surface in self._refiner.surfaces]
        return overall_stop(stops) if self._refiner.has_ids else stops[0]

    @property
    def ids(self) -> tuple[int, ...] | None:
        """Ids of the objects after the corrections; None where none was made."""
        return (
            None
            if self._refiner is None
            else tuple(surface.id for surface in self._refiner.surfaces)
        )

    def nearest(self, run: Run, place: str) -> int | None:
        """Return the object nearest to a place, or that contains it; None where there is one without an id.

        Raises
        ------
        UsageError, InputError
            When there are ids and the place is none, or lies outside.
        """
        refiner, distances = self._refiner, dict[int, float]()
        if not (run.has_ids if refiner is None else refiner.has_ids):
            return None
        at = first_place(place, run.geometry).centre
        centre, spacing = np.array(at, float), run.geometry.spacing
        if refiner is None:
            for evolving, (corner, psi) in zip(run.objects, run.separated(), strict=True):
                whole = box_at(corner, psi.shape)
                distances[evolving.id] = _distance_of(psi, corner, whole, centre, spacing)
        else:
            for each in refiner.surfaces:
                box = self._boxes[each.id]
                distances[each.id] = _distance_of(each.psi, each.corner, box, centre, spacing)
        return min(distances, key=lambda id: distances[id])

    def taken(self, run: Run, ball: str, object_id: int) -> BoxMask | None:
        """Return the voxels of the other objects, which an object that is pressed at a ball may not have.

        The other in which the ball lies loses them to it, as `Refiner.taken` says; None where there is none.
        """
        if run.stop is None:
            return None
        if self._refiner is None and not run.has_ids and object_id == run.objects[0].id:
            return None
        centre = np.array(first_place(ball, run.geometry).centre, float)
        return self._begun(run).taken(centre, object_id)

    def result(self) -> Result | None:
        """Return the corrected result, whose settings repeat run and corrections; None where none was made."""
        return None if self._refiner is None else self._refiner.result()

    def picture(
        self, run: Run, max_voxels: int | None
    ) -> tuple[Frame, tuple[tuple[StepRecord, ...], ...]]:
        """Return the frame to draw, see `Frame.of_run`, and each object's records up to it."""
        if self._refiner is not None:
            return self._frame(run, self._refiner), tuple(
                tuple(each.history) for each in self._refiner.surfaces
            )
        records = [step.record for step in run.current()]
        frame = Frame.of_run(run, records, max_voxels)
        if run.stop is not None and not run.has_ids:
            if self._measured_at != records[0]:  # once, not for each picture
                self._measured_at, self._estimated = records[0], volume_estimate(result_of(run))
            frame = dataclasses.replace(frame, estimated=self._estimated)
        return frame, histories_of_run(run, records)

    def _frame(self, run: Run, refiner: Refiner) -> Frame:
        """Return the frame to draw: of each object a copy of the box in which it is."""
        prepared, surfaces = run.prepared, []
        for surface in refiner.surfaces:
            box = self._boxes[surface.id]
            corner = surface.corner
            shape = surface.psi.shape
            part = None if box is None else _within(counted_from(box, corner), shape)
            psi = (
                surface.psi[:0, :0, :0] if part is None or not surface.inside else surface.psi[part]
            )
            z, y, x = (
                corner
                if part is None
                else (a + b for a, b in zip(corner, corner_of(part), strict=True))
            )
            surfaces.append(
                SurfaceFrame(
                    surface.id,
                    surface.history[-1],
                    run.grid,
                    psi.copy(),
                    (z, y, x),
                    1,
                    corner,
                    shape,
                    {},
                    prepared.first,
                )
            )
        clicks = on_image(refiner.clicks, prepared.first, prepared.volumes[0].geometry.shape)
        marks = () if clicks is None else marks_of(clicks.clicks, run.geometry.spacing)
        if refiner.config.refine:
            return Frame(tuple(surfaces), marks, corrected_at=self._last_step)
        return Frame(tuple(surfaces), marks, estimated=self._estimated)


def _box_of_inside(inside: NDArray[np.bool_], corner: Corner) -> Box | None:
    """Return the box around the inside, on the grid of the region of interest."""
    box = bounding_box(inside)
    return None if box is None else placed_at(box, corner)


def _around(box: Box | None, other: Box) -> Box:
    """Return the smallest box that holds two, or the one that there is."""
    return other if box is None else enclosing(box, other)


def _within(box: Box, shape: tuple[int, ...]) -> Box:
    """Return a box with some voxels around it, as far as an array goes."""
    z, y, x = (
        slice(max(s.start - AROUND, 0), max(min(s.stop + AROUND, n), 0))
        for s, n in zip(box, shape, strict=True)
    )
    return z, y, x


def _distance_of(
    psi: NDArray[np.float32],
    corner: Corner,
    box: Box | None,
    place: NDArray[np.float64],
    spacing: tuple[float, float, float],
) -> float:
    """Distance, mm, of an index (z, y, x) from an object; below 0 in it; inf where it has no voxel.

    Its psi begins at voxel ``corner``; it may be inside in ``box`` alone, which is counted as ``place``.
    """
    if box is None:
        return float("inf")
    z, y, x = (
        slice(max(s.start - c, 0), max(s.stop - c, 0)) for s, c in zip(box, corner, strict=True)
    )
    part = psi[z, y, x]
    at = place - np.array(corner) - np.array([z.start, y.start, x.start])
    voxel = np.rint(at).astype(int)
    if (voxel >= 0).all() and (voxel < part.shape).all() and part[tuple(voxel)] < 0:
        return float(part[tuple(voxel)])
    away = (np.argwhere(part < 0) - at) * spacing
    return float(np.linalg.norm(away, axis=1).min(initial=np.inf))
