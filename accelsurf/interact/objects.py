"""Objects of a finished run as corrections change them: their surfaces, and how each correction is undone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import ClickModel, clicked_voxels
from accelsurf.grid.boxes import Box, box_at, corner_of, counted_from, shared
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.interact.corrected_surface import (
    CorrectedSurface,
    count_inside,
    part_of_image,
    stop_of_whole,
    surface_of,
)
from accelsurf.interact.local_evolution import measures_of
from accelsurf.interact.local_model import LocalModel, ModelChange
from accelsurf.interact.models import ObjectModels
from accelsurf.interact.region import NearRegion
from accelsurf.levelset import Workers
from accelsurf.run import (
    RegionTotals,
    Result,
    RunState,
    SegmentedObject,
    closed_on,
    cropped,
    earlier_probability,
    half_width,
)
from accelsurf.settings.run_config import RunConfig


class _SurfaceBefore(NamedTuple):
    """A surface, and its psi in the ``box`` of its array that was changed."""

    surface: CorrectedSurface
    box: Box
    psi: NDArray[np.float32]
    totals: dict[str, NDArray[np.float64]]


class _CorrectionBefore(NamedTuple):
    """The state before a correction, and its changes in place, in order, to take it back."""

    has_ids: bool
    objects: tuple[CorrectedSurface, ...]
    known: dict[int, SegmentedObject]
    models: dict[str, Any]
    surfaces: list[_SurfaceBefore]
    clicked: list[tuple[LocalModel, ModelChange]]


class _Shown(NamedTuple):
    """An entry in results, and the surface and the model of clicks that it is of."""

    surface: CorrectedSurface
    model: ClickModel | None
    segmented: SegmentedObject


class CorrectedObjects:
    """The objects of a finished run, correction by correction.

    Parameters
    ----------
    result : Result
        With a state; it is not changed.
    state : RunState
        Its state.
    settings : RunConfig
        In force at the run's end.

    Attributes
    ----------
    surfaces : list of CorrectedSurface
        In order of their ids; on the grid of the region of interest.
    has_ids : bool
        Whether labels are ids.
    models : ObjectModels
    images : list of ndarray (nz, ny, nx)
        The channels on that grid.
    """

    def __init__(self, result: Result, state: RunState, settings: RunConfig) -> None:
        self._base = result
        self._settings = settings
        self.prepared = state.prepared
        self.images = state.prepared.images
        self.shape, self.spacing = state.prepared.geometry.shape, state.prepared.geometry.spacing
        self.surfaces = [surface_of(segmented, state.prepared.box) for segmented in result.objects]
        self.has_ids, self.models = result.has_ids, ObjectModels(state, settings)
        self._known = dict(result.by_id)
        self._regional = RegionTotals(self.images, self.surfaces[0].psi, state.totals)
        self._shown = {
            surface.id: _Shown(surface, self.models.made.get(surface.id), segmented)
            for surface, segmented in zip(self.surfaces, result.objects, strict=True)
        }
        self._undo: list[_CorrectionBefore] = []

    @property
    def ids(self) -> list[int]:
        """Ids, in order."""
        return [surface.id for surface in self.surfaces]

    @property
    def state(self) -> RunState:
        """The state from which a later correction continues."""
        return self.models.state(self._regional.totals)

    def set_ids(self, has_ids: bool) -> None:
        """Set whether the objects have ids from now on."""
        self.has_ids = has_ids

    def place_of(self, id: int) -> int:
        """Position of an object."""
        return self.ids.index(id)

    # -- corrections, and how they are taken back ----------------------------------------------------------

    def begin_correction(self) -> None:
        """Begin a correction: all that follows is taken back at once."""
        self._undo.append(
            _CorrectionBefore(
                self.has_ids,
                tuple(self.surfaces),
                dict(self._known),
                self.models.snapshot(),
                [],
                [],
            )
        )

    def undo(self) -> bool:
        """Go back to before the last correction; False where there is none."""
        if not self._undo:
            return False
        last = self._undo.pop()
        for model, change in reversed(last.clicked):
            model.undo(change)
        for before, box, psi, totals in reversed(last.surfaces):
            before.psi[box] = psi
            self._regional.totals = totals
        self.surfaces = list(last.objects)
        self._known = last.known
        self.has_ids = last.has_ids
        self.models.restore(last.models)
        return True

    def note_click(self, model: LocalModel, change: ModelChange) -> None:
        """A click has changed a model."""
        self._undo[-1].clicked.append((model, change))

    def put(self, place: int, box: Box, psi: NDArray[np.float32], after: CorrectedSurface) -> None:
        """Put a changed part of a surface in its place."""
        surface = self.surfaces[place]
        before = surface.psi[box].copy()
        self._undo[-1].surfaces.append(
            _SurfaceBefore(surface, box, before, dict(self._regional.totals))
        )
        surface.psi[box] = psi
        if not self.has_ids:
            self._regional.change(box, before < 0, psi < 0)
        self.surfaces[place] = after

    def replace(
        self, surfaces: Sequence[CorrectedSurface], known: dict[int, SegmentedObject]
    ) -> None:
        """Have other objects from now on; ``known`` has the entries in results of those that are new."""
        self.surfaces = sorted(surfaces, key=lambda surface: surface.id)
        self._known = {id: known.get(id) or self._known[id] for id in self.ids}

    def known(self, id: int) -> SegmentedObject:
        """Return the entry in results of an object, before its corrections."""
        return self._known[id]

    # -- other objects -----------------------------------------------------------------------------------

    def totals_of(self, surface: CorrectedSurface) -> RegionTotals:
        """Sums over an object: of several, on its own part of the grid."""
        if not self.has_ids:
            return self._regional
        domain = box_at(surface.corner, surface.psi.shape)
        return RegionTotals([image[domain] for image in self.images], surface.psi)

    def holders(self, new: Sequence[Click]) -> list[int]:
        """Places of the objects that have voxels of new inside clicks."""
        out = []
        for place, surface in enumerate(self.surfaces):
            placed = Clicks(tuple(new), self.shape).on_box(
                box_at(surface.corner, surface.psi.shape)
            )
            if any(
                (surface.psi[c.box] < 0)[c.mask].any() for c in placed.clicks if c.side == "inside"
            ):
                out.append(place)
        return out

    def bounding(self, id: int, box: Box, takes: frozenset[int]) -> NDArray[np.float32] | None:
        """Signed distance, mm, that bounds an object on a box: that of the mask, and those to others it takes nothing
        from.
        """
        distance = self.prepared.distance_on(box)
        for place, other in enumerate(self.surfaces):
            if other.id == id or place in takes:
                continue
            mine, theirs = shared(
                corner_of(box), [s.stop - s.start for s in box], other.corner, other.psi.shape
            )
            if any(s.start >= s.stop for s in mine):
                continue
            if distance is None:
                distance = np.full(tuple(s.stop - s.start for s in box), -1e6, np.float32)
            distance = distance.copy()
            distance[mine] = np.maximum(distance[mine], -other.psi[theirs])
        return distance

    def take_from(
        self, place: int, region: NearRegion, winner: NDArray[np.float32], workers: Workers
    ) -> None:
        """Take from an object the voxels that another has gained in a region."""
        surface = self.surfaces[place]
        mine, theirs = shared(
            corner_of(region.box), winner.shape, surface.corner, surface.psi.shape
        )
        psi = surface.psi[theirs].copy()
        after = np.where(region.mask[mine], np.maximum(psi, -winner[mine]), psi)
        if not ((after < 0) != (psi < 0)).any():
            return
        before = earlier_probability(self.shown(surface))
        width = half_width(self._settings)
        volume, area = (measures_of(part, self.spacing, width, workers) for part in (psi, after))
        last = surface.history[-1]
        last = last._replace(
            volume_mm3=last.volume_mm3 + area[0] - volume[0],
            area_mm2=last.area_mm2 + area[1] - volume[1],
        )
        inside = surface.inside + count_inside(after) - count_inside(psi)
        stop = stop_of_whole(surface.stop, inside, math.prod(self.shape))
        self.put(
            place,
            theirs,
            after,
            surface._replace(
                inside=inside,
                history=[*surface.history[:-1], last],
                stop=stop,
                before=before,
            ),
        )

    def grown(self, place: int, box: Box) -> CorrectedSurface:
        """A surface on an array that has a box of the grid; it stays on it."""
        self.surfaces[place] = self.seen_on(place, box)
        return self.surfaces[place]

    def seen_on(self, place: int, box: Box) -> CorrectedSurface:
        """The same, and the object keeps its array: sums over an object go over its part of the grid."""
        surface = self.surfaces[place]
        low = np.minimum(surface.corner, corner_of(box))
        high = np.maximum(np.add(surface.corner, surface.psi.shape), [s.stop for s in box])
        shape = tuple(int(n) for n in high - low)
        if shape == surface.psi.shape:
            return surface
        psi = np.full(shape, np.abs(surface.psi).max(), np.float32)
        corner = (int(low[0]), int(low[1]), int(low[2]))
        psi[counted_from(box_at(surface.corner, surface.psi.shape), corner)] = surface.psi
        return surface._replace(corner=corner, psi=psi)

    # -- result --------------------------------------------------------------------------------------------

    def shown(self, now: CorrectedSurface) -> SegmentedObject:
        """Return the last entry in results of an object as it is: its probability may be known already."""
        last = self._shown.get(now.id)
        if last is not None and last.surface is now and last.model is self.models.made.get(now.id):
            return last.segmented
        return self.segmented(now)

    def segmented(self, now: CorrectedSurface) -> SegmentedObject:
        """An object as results have it; later corrections do not change it."""
        made = self._segmented(now)
        self._shown[now.id] = _Shown(now, self.models.made.get(now.id), made)
        return made

    def _segmented(self, now: CorrectedSurface) -> SegmentedObject:
        segmented = self._known[now.id]
        prepared = self.prepared
        base = self._base
        models = self.models
        is_same = now.history is segmented.history
        corner = prepared.corner_on_image(now.corner)
        box = (
            segmented.box
            if is_same or not self.has_ids
            else part_of_image(segmented.box, corner, now, prepared)
        )
        clicked = (
            clicked_voxels(models.clicks, segmented.id, prepared.first, box)
            if len(models.clicks)
            else None
        )
        if segmented.id in models.made:
            confidence = models.contexts[segmented.id].confidence(models.made[segmented.id])
            segmented = dataclasses.replace(segmented, confidence=confidence)
        if is_same:
            unchanged = clicked is None or (
                segmented.clicked is not None and np.array_equal(clicked, segmented.clicked)
            )
            return segmented if unchanged else dataclasses.replace(segmented, clicked=clicked)
        if not self.has_ids:
            psi = prepared.on_whole_grid(now.psi)
            psi = psi.copy() if psi is now.psi else psi
            return dataclasses.replace(
                segmented,
                psi=psi,
                history=now.history,
                stop=now.stop,
                clicked=clicked,
                before=now.before,
            )
        return dataclasses.replace(
            segmented,
            box=box,
            psi=closed_on(now.psi, corner, box),
            image=base.image[box],
            geometry=cropped(base.geometry, box),
            history=now.history,
            stop=now.stop,
            clicked=clicked,
            before=now.before,
        )
