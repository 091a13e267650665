"""Refiner: goes on from a finished run, correction after correction, each at the cost of its neighbourhood."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.constraints.mask import MaskConstraint
from accelsurf.errors import UsageError
from accelsurf.evolution.records import StepRecord, Stop
from accelsurf.grid.boxes import Box, box_at, corner_of, shared
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.pyramid import Level
from accelsurf.initialization.clicks import check_left
from accelsurf.io.memory import available_cores
from accelsurf.levelset import Workers
from accelsurf.segmentation.clicked_voxels import clicked_voxels, on_image
from accelsurf.segmentation.corrected_surface import (
    CorrectedSurface,
    box_around,
    count_inside,
    counted_from,
    frozen_settings,
    part_of_image,
    stop_of_whole,
    surface_of,
    wrong_part,
)
from accelsurf.segmentation.local_evolution import LocalProblem, evolve_near, measures_of
from accelsurf.segmentation.local_model import ModelChange, basin_of, local_models, sureness_from
from accelsurf.segmentation.near_region import NearRegion, around_clicks, automatic_near, rim_width
from accelsurf.segmentation.new_clicks import check_object, clicks_of, clicks_on, placed_clicks, refuse_contradictions
from accelsurf.segmentation.region_of_interest import closed_on, cropped
from accelsurf.segmentation.region_totals import RegionTotals
from accelsurf.segmentation.rest_points import on_larger_box
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run_setup import energy_maker, setup_of, window_reach
from accelsurf.segmentation.solver_setup import correction_rule, half_width, is_maker
from accelsurf.settings.refinements import Refinement
from accelsurf.settings.run_config import RunConfig

#: What is called with each record and the id of its object; a true value ends the correction.
OnObjectStep = Callable[[StepRecord, int], bool | None]
#: The surface and its stencils see so many voxels of the largest spacing beyond the region, where they are held.
MARGIN = 5.0


class Change(NamedTuple):
    """What a correction did: voxels of the grid that changed sides, in a ``box`` of it; seconds of the solver."""

    object_id: int
    box: Box
    voxels: int
    seconds: float
    stop: Stop


class _Before(NamedTuple):
    """What `Refiner.undo` puts back: a surface, and its psi in the ``box`` of its array that was changed."""

    place: int
    surface: CorrectedSurface
    box: Box
    psi: NDArray[np.float32]
    totals: dict[str, NDArray[np.float64]]


class _Correction(NamedTuple):
    """What `Refiner.undo` needs of a correction: settings and clicks before it, and what it changed, in order."""

    config: RunConfig
    clicks: Clicks
    surfaces: list[_Before]
    models: list[tuple[int, ModelChange]]


class Refiner:
    """A finished run that is corrected, click by click.

    Parameters
    ----------
    result : Result
        Of `accelsurf.segment` or of a refinement; it is not changed.

    Attributes
    ----------
    config : RunConfig
        That of the run, with the corrections so far.

    Raises
    ------
    UsageError
        When the result has no state, or its energy is one of the user's own that belongs to one grid.
    """

    def __init__(self, result: Result) -> None:
        state = result.state
        if state is None:
            raise UsageError("refine: the result has no state to go on from", "run with keep_state=yes")
        if state.energy is not None and not isinstance(state.energy, str) and not is_maker(state.energy):
            raise UsageError(
                "refine: the energy has one image, and a correction needs it on a box",
                "give a class or function that makes the energy of (image, spacing)",
            )
        self._result, self._state, self.config = result, state, result.config
        self._settings = frozen_settings(result)
        self._images = state.prepared.images
        self._shape, self._spacing = state.prepared.geometry.shape, state.prepared.geometry.spacing
        self._reach = window_reach(self._settings, state.prepared.geometry)
        self._surfaces = [surface_of(one, state.prepared.box) for one in result.objects]
        self._regional = RegionTotals(self._images, self._surfaces[0].psi, state.totals)
        self._clicks = state.clicks or Clicks((), self._shape)
        self._models = local_models(state, self._settings, [one.id for one in self._surfaces])
        self._undo: list[_Correction] = []
        self._seconds = 0.0

    @property
    def surfaces(self) -> tuple[CorrectedSurface, ...]:
        """The surfaces as they are, in order of their ids; not to be changed."""
        return tuple(self._surfaces)

    @property
    def clicks(self) -> Clicks:
        """All clicks so far, on the grid of the region of interest."""
        return self._clicks

    # -- corrections ---------------------------------------------------------------------------------------

    def apply(
        self, refinement: Refinement, clicks: Sequence[Click] | None = None, on_step: OnObjectStep | None = None
    ) -> tuple[Change, ...]:
        """Correct the objects that new clicks are about, each in a region around them.

        Parameters
        ----------
        refinement : Refinement
        clicks : sequence of Click, optional
            Those of the refinement, on the image's grid; by default they are read from its texts.
        on_step : callable, optional
            Called with each record and the id of its object; a true value ends the correction.

        Returns
        -------
        tuple of Change
            One for each object whose surface was looked at.

        Raises
        ------
        UsageError
            When no object has the id.
        InputError
            When a voxel is clicked on both sides, or a click lies outside of region or mask, or takes all that was
            clicked inside.

        Notes
        -----
        Clicks take the voxels that they contradict from earlier ones.
        All or nothing: of a correction that raises, whatever it raises, nothing stays, and it is none for `undo`.
        """
        ids = [one.id for one in self._surfaces]
        check_object(refinement, ids if self._result.has_ids else None)
        prepared = self._state.prepared
        new = placed_clicks(clicks_of(refinement, self._result) if clicks is None else clicks, prepared)
        refuse_contradictions(new, self._shape, ids, prepared.geometry, prepared.first)
        everything = self._clicks.with_later(new)
        check_left(self._clicks, everything)
        self._undo.append(_Correction(self.config, self._clicks, [], []))
        self.config = self.config.replace(refine=(*self.config.refine, refinement))
        self._clicks = everything
        try:
            return self._correct_all(new, refinement.near, on_step)
        except BaseException:  # Ctrl-C too
            self.undo()
            raise

    def _correct_all(self, new: Sequence[Click], near: float | str, on_step: OnObjectStep | None) -> tuple[Change, ...]:
        """Correct each object that ``new`` clicks, on the grid of the region of interest, are about."""
        began = time.perf_counter()
        changes = []
        with Workers(available_cores() if self.config.threads == "auto" else self.config.threads) as workers:
            for place, one in enumerate(self._surfaces):
                if mine := clicks_on(new, one.id):
                    changes.append(self._correct(place, mine, near, workers, on_step))
        self._seconds += time.perf_counter() - began
        return tuple(changes)

    def undo(self) -> None:
        """Go back to the state before the last correction that was made; with none nothing happens."""
        if not self._undo:
            return
        last = self._undo.pop()
        self.config, self._clicks = last.config, last.clicks
        for id, change in reversed(last.models):
            self._models[id].undo(change)
        for place, before, box, psi, totals in reversed(last.surfaces):
            before.psi[box] = psi
            self._surfaces[place] = before
            self._regional.totals = totals

    def _correct(
        self, place: int, new: Sequence[Click], near: float | str, workers: Workers, on_step: OnObjectStep | None
    ) -> Change:
        """Correct one object, of which ``new`` are clicks on the grid of the region of interest."""
        began = time.perf_counter()
        one = self._grown(place, box_around(new))
        won = self._won(one, new)
        if not won:
            return Change(one.id, box_at((0, 0, 0), (0, 0, 0)), 0, time.perf_counter() - began, one.stop)
        takes = frozenset(self._holders(new)) - {place}
        region = self._region(one, new, won, near)
        one = self._grown(place, region.box)
        box = counted_from(region.box, one.corner)
        psi = one.psi[box].copy()
        totals = self._regional
        if self._result.has_ids:
            domain = box_at(one.corner, one.psi.shape)
            totals = RegionTotals([image[domain] for image in self._images], one.psi)
        problem = self._problem(one, region, psi, totals, takes)._replace(
            won=[(click.side, click.mask_on(region.box)) for click in won], sides=frozenset(click.side for click in new)
        )
        outcome = evolve_near(problem, workers, None if on_step is None else lambda record: on_step(record, one.id))
        inside = one.inside + count_inside(outcome.psi) - count_inside(psi)
        stop = stop_of_whole(outcome.stop, inside, math.prod(self._shape))
        self._put(place, box, outcome.psi, one._replace(inside=inside, history=outcome.history, stop=stop))
        for other in sorted(takes):
            self._take_from(other, region, outcome.psi, workers)
        changed = int(np.count_nonzero((outcome.psi < 0) != (psi < 0)))
        return Change(one.id, region.box, changed, time.perf_counter() - began, stop)

    def _put(self, place: int, box: Box, psi: NDArray[np.float32], after: CorrectedSurface) -> None:
        """Put a changed part of a surface in its place, so that `undo` can take it back."""
        one = self._surfaces[place]
        before = one.psi[box].copy()
        self._undo[-1].surfaces.append(_Before(place, one, box, before, dict(self._regional.totals)))
        one.psi[box] = psi
        if not self._result.has_ids:
            self._regional.change(box, before < 0, psi < 0)
        self._surfaces[place] = after

    def _won(self, one: CorrectedSurface, new: Sequence[Click]) -> list[Click]:
        """What new clicks win of an object: their own voxels and those of their basins, where a side is wrong.

        Nothing where all are on their sides already, and the model gives them nothing else.
        """
        won = list(new)
        if one.id in self._models:
            won = []
            for click in new:
                change = self._models[one.id].add(click)
                self._undo[-1].models.append((one.id, change))
                won.append(basin_of(click, change, self._models[one.id], one))
        wrong = [wrong_part(click, one) for click in won]
        return [click for click in wrong if click is not None]

    def _region(
        self, one: CorrectedSurface, new: Sequence[Click], won: Sequence[Click], near: float | str
    ) -> NearRegion:
        """Where the surface may move for new clicks: within ``near``, or where they win, or by their depth."""
        rim = rim_width(self._shape, self._spacing)
        margin = max(MARGIN * max(h for h, n in zip(self._spacing, self._shape, strict=True) if n > 1), self._reach)
        if not isinstance(near, str):
            return around_clicks(new, near, min(rim, 0.5 * near), self._shape, self._spacing, margin)
        if one.id in self._models:
            return around_clicks([*new, *won], rim, rim, self._shape, self._spacing, margin)
        placed = Clicks(tuple(new), self._shape).on_box(box_at(one.corner, one.psi.shape)).clicks
        near = automatic_near(one.psi, placed, self._spacing) + rim
        return around_clicks(new, near, rim, self._shape, self._spacing, margin)

    def _problem(
        self,
        one: CorrectedSurface,
        region: NearRegion,
        psi: NDArray[np.float32],
        totals: RegionTotals,
        takes: frozenset[int],
    ) -> LocalProblem:
        """What is evolved for a region: energy and clicks on its box."""
        state = self._state
        settings = self._settings.replace(seed=None if self.config.seed is None else self.config.seed + one.id)
        context = state.contexts[one.id].seeing_elsewhere(totals, counted_from(region.box, one.corner))
        images = [np.ascontiguousarray(image[region.box]) for image in self._images]
        make = energy_maker(state.energy, settings, 1, self._result.has_ids)
        model = self._models.get(one.id)
        field = None if model is None else lambda: model.field_on(region.box)
        energy = make(images[0], self._spacing, context.with_channels(images[1:], field)).energy
        distance = self._bounding(one, region, takes)
        if distance is not None:
            energy = MaskConstraint(energy, distance)
        clicks = self._clicks.of(one.id).on_box(region.box)
        bounds = click_bounds(clicks, Level(0, (1, 1, 1), psi.shape, self._spacing))
        setup = setup_of(settings, 0, 1, state.prepared.geometry)._replace(rule=correction_rule(settings))
        return LocalProblem(
            psi, self._spacing, region, bounds, [], frozenset(), energy, setup, self.config.max_steps, one.history
        )

    # -- several objects -----------------------------------------------------------------------------------

    def _holders(self, new: Sequence[Click]) -> list[int]:
        """Places of the objects that have voxels of new inside clicks."""
        out = []
        for place, one in enumerate(self._surfaces):
            placed = Clicks(tuple(new), self._shape).on_box(box_at(one.corner, one.psi.shape))
            if any((one.psi[c.box] < 0)[c.mask].any() for c in placed.clicks if c.side == "inside"):
                out.append(place)
        return out

    def _bounding(self, one: CorrectedSurface, region: NearRegion, takes: frozenset[int]) -> NDArray[np.float32] | None:
        """Signed distance, mm, that bounds an object: that of the mask, and those to others it takes nothing from."""
        mask = self._state.prepared.mask_distance
        distance = None if mask is None else mask[region.box]
        for place, other in enumerate(self._surfaces):
            if other.id == one.id or place in takes:
                continue
            mine, theirs = shared(
                corner_of(region.box), [s.stop - s.start for s in region.box], other.corner, other.psi.shape
            )
            if any(s.start >= s.stop for s in mine):
                continue
            if distance is None:
                distance = np.full(tuple(s.stop - s.start for s in region.box), -1e6, np.float32)
            distance = distance.copy()
            distance[mine] = np.maximum(distance[mine], -other.psi[theirs])
        return distance

    def _take_from(self, place: int, region: NearRegion, winner: NDArray[np.float32], workers: Workers) -> None:
        """Take from an object what another has gained in a region."""
        one = self._surfaces[place]
        mine, theirs = shared(corner_of(region.box), winner.shape, one.corner, one.psi.shape)
        psi = one.psi[theirs].copy()
        after = np.where(region.mask[mine], np.maximum(psi, -winner[mine]), psi)
        if not ((after < 0) != (psi < 0)).any():
            return
        width = half_width(self._settings)
        volume, area = (measures_of(part, self._spacing, width, workers) for part in (psi, after))
        last = one.history[-1]
        last = last._replace(
            volume_mm3=last.volume_mm3 + area[0] - volume[0], area_mm2=last.area_mm2 + area[1] - volume[1]
        )
        inside = one.inside + count_inside(after) - count_inside(psi)
        stop = stop_of_whole(one.stop, inside, math.prod(self._shape))
        self._put(place, theirs, after, one._replace(inside=inside, history=[*one.history[:-1], last], stop=stop))

    def _grown(self, place: int, box: Box) -> CorrectedSurface:
        """A surface on an array that has a box of the grid."""
        one = self._surfaces[place]
        low = np.minimum(one.corner, corner_of(box))
        high = np.maximum(np.add(one.corner, one.psi.shape), [s.stop for s in box])
        shape = tuple(int(n) for n in high - low)
        if shape == one.psi.shape:
            return one
        psi = np.full(shape, np.abs(one.psi).max(), np.float32)
        corner = (int(low[0]), int(low[1]), int(low[2]))
        psi[counted_from(box_at(one.corner, one.psi.shape), corner)] = one.psi
        self._surfaces[place] = one._replace(corner=corner, psi=psi)
        return self._surfaces[place]

    # -- result --------------------------------------------------------------------------------------------

    def result(self) -> Result:
        """The present state as a result; later corrections do not change it."""
        base = self._result
        objects = tuple(self._object(one, now) for one, now in zip(base.objects, self._surfaces, strict=True))
        models = {id: model.state for id, model in self._models.items()}
        state = dataclasses.replace(
            self._state, totals=dict(self._regional.totals), clicks=self._clicks, models=models
        )
        seconds = {**base.seconds, "refine": base.seconds.get("refine", 0.0) + self._seconds}
        clicks = on_image(self._clicks, self._state.prepared.first, base.geometry.shape)
        return dataclasses.replace(
            base, objects=objects, config=self.config, state=state, seconds=seconds, clicks=clicks
        )

    def _object(self, one: SegmentedObject, now: CorrectedSurface) -> SegmentedObject:
        prepared, whole = self._state.prepared, self._result.geometry
        is_same = now.history is one.history
        z, y, x = (c + first for c, first in zip(now.corner, prepared.first, strict=True))
        box = one.box if is_same or not self._result.has_ids else part_of_image(one.box, (z, y, x), now, prepared)
        clicked = clicked_voxels(self._clicks, one.id, prepared.first, box) if len(self._clicks) else None
        if one.id in self._models:
            one = dataclasses.replace(one, sureness=sureness_from(self._models[one.id].state))
        if is_same:
            unchanged = clicked is None or (one.clicked is not None and np.array_equal(clicked, one.clicked))
            return one if unchanged else dataclasses.replace(one, clicked=clicked)
        if not self._result.has_ids:
            psi = prepared.on_whole_grid(now.psi)
            psi = psi.copy() if psi is now.psi else psi
            return dataclasses.replace(one, psi=psi, history=now.history, stop=now.stop, clicked=clicked)
        return dataclasses.replace(
            one, box=box, psi=closed_on(now.psi, (z, y, x), box), image=self._result.image[box],
            geometry=cropped(whole, box), history=now.history, stop=now.stop, clicked=clicked,
            rests=on_larger_box(one.rests, one.box, box),
        )
