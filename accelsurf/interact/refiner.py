"""Refiner: a finished run is corrected, each correction at the cost of its neighbourhood."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import ClickReach, farthest_from, is_right, largest_reach, on_image, reach_of
from accelsurf.energies import MaskConstraint
from accelsurf.errors import UsageError
from accelsurf.evolution import Stop
from accelsurf.grid.boxes import Box, Corner, box_at, counted_from, on_box, tightened
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Click, Clicks, Side
from accelsurf.grid.pyramid import Level
from accelsurf.interact import object_changes
from accelsurf.interact.corrected_surface import (
    CorrectedSurface,
    count_inside,
    frozen_settings,
    stop_of_whole,
)
from accelsurf.interact.finished import OnObjectStep
from accelsurf.interact.local_evolution import LocalProblem, Stepping, evolve_near
from accelsurf.interact.local_model import basin_of
from accelsurf.interact.mending import mend
from accelsurf.interact.models import (
    check_object,
    clicks_on,
    placed_clicks,
    point_click,
    refuse_contradictions,
)
from accelsurf.interact.objects import CorrectedObjects
from accelsurf.interact.region import (
    NearRegion,
    around_clicks,
    automatic_near,
    box_around,
    rim_width,
    within_reaches,
)
from accelsurf.io import available_cores
from accelsurf.levelset import Workers
from accelsurf.run import (
    BoxMask,
    Place,
    RegionTotals,
    Result,
    SegmentedObject,
    correction_rule,
    earlier_probability,
    is_maker,
    setup_of,
    window_reach,
)
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import check_left, clicks_of

#: Voxels of the largest spacing beyond the region that the surface and its stencils see; there they do not move.
MARGIN = 5.0
#: The voxels that a click left are told from this share on of all that it would have changed.
NAMED_FROM = 0.1


class Change(NamedTuple):
    """The effect of a correction on an object.

    Attributes
    ----------
    object_id : int
    box : tuple of slice
        Part of the grid in which it could change.
    voxels : int
        Number of voxels that changed sides.
    seconds : float
        Of the solver.
    stop : Stop
    reach : ClickReach or None
        How far from the clicks it could change, and the changes without a bound; None where all
        clicks were on their sides already, and of a change without clicks.
    side : {"inside", "outside"} or None
        On which all clicks were already; None where they were not.
    rim : float
        Width of the rim of the region, mm, in which the surface may leave its place by less and less.
    moved_mm : float
        How far from the clicks the farthest voxel is that changed sides.
    """

    object_id: int
    box: Box
    voxels: int
    seconds: float
    stop: Stop
    reach: ClickReach | None = None
    side: Side | None = None
    rim: float = 0.0
    moved_mm: float = 0.0

    @property
    def is_bounded(self) -> bool:
        """True if the clicks would have changed more than they reached, and not only single voxels."""
        reach = self.reach
        return (
            reach is not None
            and reach.farthest_mm > reach.mm
            and reach.left > NAMED_FROM * reach.wanted
        )

    @property
    def text(self) -> str:
        """The effect in words: how many voxels moved, how far from the click, and the voxels left as they were."""
        if not self.voxels:
            return f"nothing changed{f': it is already {self.side}' if self.side else ''}"
        moved = f"moved {self.voxels} voxels in {self.seconds:.2f} s"
        if self.reach is None:
            return moved
        farthest, bound = f"{self.moved_mm:.3g}", f"{self.reach.mm:.3g}"
        moved += f", up to {farthest} mm from the click"
        moved += f" (reach {bound} mm)" if farthest != bound else ""
        if not self.is_bounded:
            return moved
        left = f"{self.reach.left} more look alike, up to {self.reach.farthest_mm:.3g} mm away"
        return f"{moved}; {left}: click there too, or add --near {self.near_for_all:g}"

    @property
    def near_for_all(self) -> float:
        """The value of ``near``, mm, with which the clicks change all that they would change without a bound."""
        return 0.0 if self.reach is None else float(math.ceil(self.reach.farthest_mm + self.rim))


class Extent(NamedTuple):
    """Distances from its clicks, mm: how far a correction could change an object, and how far it did."""

    reach_mm: float
    moved_mm: float


def changes_text(changes: Sequence[Change]) -> str:
    """Return the effect of a correction on all objects in words."""
    moved = [change for change in changes if change.voxels] or list(changes[:1])
    if len(moved) == 1:
        return moved[0].text
    return "; ".join(f"object {change.object_id}: {change.text}" for change in moved)


class Refiner:
    """A finished run that is corrected, click by click.

    Parameters
    ----------
    result : Result
        Of `accelsurf.segment` or of a correction; it is not changed.

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
            raise UsageError(
                "refine: the result has no state to go on from", "run with keep_state=yes"
            )
        if (
            state.energy is not None
            and not isinstance(state.energy, str)
            and not is_maker(state.energy)
        ):
            raise UsageError(
                "refine: the energy has one image, and a correction needs it on a box",
                "give a class or function that makes the energy of (image, spacing)",
            )
        self._result = result
        self._state = state
        self.config = result.config
        self._settings = frozen_settings(result)
        self._objects = CorrectedObjects(result, state, self._settings)
        self._images, self._shape, self._spacing = (
            self._objects.images,
            self._objects.shape,
            self._objects.spacing,
        )
        self._reach = window_reach(self._settings, state.prepared.geometry)
        self._undo: list[RunConfig] = []
        self._seconds = 0.0
        #: Of each correction by clicks, by its number; of those before this one it is not known.
        self._extents: dict[int, Extent] = {}

    @property
    def surfaces(self) -> tuple[CorrectedSurface, ...]:
        """The surfaces as they are, in order of their ids; not to be changed."""
        return tuple(self._objects.surfaces)

    @property
    def clicks(self) -> Clicks:
        """All clicks so far, on the grid of the region of interest."""
        return self._objects.models.clicks

    @property
    def first(self) -> Corner:
        """First voxel of the region of interest on the image's grid."""
        return self._state.prepared.first

    @property
    def has_ids(self) -> bool:
        """True if labels are ids of objects."""
        return self._objects.has_ids

    def taken(self, place: NDArray[np.float64], id: int) -> BoxMask | None:
        """Voxels that an object which begins at a place, an index (z, y, x) of the region, may not have.

        The voxels of the others, but for the object ``id``, which begins anew, and for one in which the place lies.
        """
        ids, click = self._objects.ids, point_click(np.rint(place).astype(int).tolist(), id)
        takes = {*self._objects.holders([click]), *([ids.index(id)] if id in ids else [])}
        return object_changes.taken_voxels(self._objects, frozenset(takes))

    def reach_of(self, correction: Correction) -> float:
        """Return how far from its clicks a correction may change an object at most, mm, before it is made.

        Raises
        ------
        UsageError, InputError
            As of `apply`.
        """
        new, found = self._new_clicks(self._of_the_one(correction)), 0.0
        for surface in self._objects.surfaces:
            for click in clicks_on(new, surface.id):
                model = self._objects.models.model(surface.id)
                if click.near is not None:
                    mm = click.near
                elif model is None:
                    mm = self._region(surface, [click], [], "auto", []).reach
                elif is_right(model.state, click):
                    mm = self._reach_on(surface, click).mm
                else:
                    mm = largest_reach(click, model.state, self._spacing)
                found = max(found, mm)
        return found

    # -- corrections ---------------------------------------------------------------------------------------

    def apply(
        self, correction: Correction, on_step: OnObjectStep | None = None
    ) -> tuple[Change, ...]:
        """Correct the objects of new clicks, each in a region around them; or begin, merge, split or remove objects.

        Parameters
        ----------
        correction : Correction
        on_step : callable, optional
            Called with each record and the id of its object; a true value ends the correction.

        Returns
        -------
        tuple of Change
            One for each click and object whose surface was looked at, in their order.

        Raises
        ------
        UsageError
            When no object has the id.
        InputError
            When a voxel is clicked on both sides, or a click lies outside of region or mask, or takes all that was
            clicked inside.

        Notes
        -----
        Clicks take the voxels that they contradict from earlier ones. Clicks of one correction are made one after the
        other, inside ones first: the surface is the same as after a correction for each.
        All or nothing: of a correction that raises, whatever it raises, nothing stays, and it is none for `undo`.
        """
        objects, number = self._objects, len(self.config.refine)
        others = self._result.other_labels
        correction = self._of_the_one(correction)
        if correction.split is not None:
            correction = object_changes.completed(objects, correction, self._result)
        if others is not None and correction.new is not None and (others == correction.new).any():
            raise UsageError(
                f"refine: new {correction.new} was given, which is a label that is not to change",
                "take another id",
            )
        self._undo.append(self.config)
        objects.begin_correction()
        try:
            self.config = self.config.replace(refine=(*self.config.refine, correction))
            if correction.kind in ("clicks", "new"):
                new = self._new_clicks(correction)
            objects.set_ids(self._result.has_ids or self.config.has_ids)
            began = time.perf_counter()
            threads = self.config.threads
            with Workers(available_cores() if threads == "auto" else threads) as workers:
                stepping = Stepping(workers, self.config.max_steps, on_step)
                if correction.kind == "clicks":
                    changes = self._correct_in_order(new, correction.near, stepping)
                elif correction.kind == "new":
                    changes = self._begin_object(number, correction, new, stepping)
                elif correction.kind == "mend":
                    changes = self._mend(number, correction, stepping)
                else:
                    changes = self._rearrange(number, correction, workers)
            reaches = [change.reach.mm for change in changes if change.reach is not None]
            if reaches:
                moved = max(change.moved_mm for change in changes)
                self._extents[number] = Extent(max(reaches), moved)
            self._seconds += time.perf_counter() - began
            return changes
        except BaseException:  # Ctrl-C too
            self.undo()
            raise

    def _of_the_one(self, correction: Correction) -> Correction:
        """Return a correction with the id of the object where that is the only one of a label map."""
        ids = self._objects.ids
        is_known = self._result.other_labels is None or len(ids) > 1 or not correction.is_of_one
        if is_known or correction.object is not None:
            return correction
        return correction.model_copy(update={"object": ids[0]})

    def _new_clicks(self, correction: Correction) -> tuple[Click, ...]:
        """The clicks of a correction on the grid of the region of interest.

        Raises
        ------
        UsageError, InputError
            As of `apply`.
        """
        objects, prepared = self._objects, self._state.prepared
        ids = objects.ids
        if correction.kind == "clicks":
            check_object(correction, ids if objects.has_ids else None)
        base = self._result
        read = clicks_of(correction, base.volume, base.image, correction.target, objects.has_ids)
        new = placed_clicks(read, prepared, correction.near)
        before = objects.models.clicks
        if correction.new in ids:  # it begins anew
            before = Clicks(
                tuple(click for click in before.clicks if click.id != correction.new), before.shape
            )
        known = sorted({*ids, correction.new or ids[0]})
        refuse_contradictions(new, self._shape, known, prepared.geometry, prepared.first)
        check_left(before, before.with_later(new))
        return new

    def _correct_in_order(
        self, new: Sequence[Click], near: float | str, stepping: Stepping
    ) -> tuple[Change, ...]:
        """Correct each object that a click, on the grid of the region of interest, is about: one click after the other.

        Each finds the surface as the one before it has left it, as if each were a correction of its own.
        """
        changes: list[Change] = []
        for click in new:
            self._objects.models.add((click,))
            for place, id in enumerate(self._objects.ids):
                if mine := clicks_on((click,), id):
                    changes.append(self._correct(place, mine, near, stepping))
            if changes and changes[-1].stop.reason == "interrupted":
                break
        return tuple(changes)

    def _begin_object(
        self, number: int, correction: Correction, new: Sequence[Click], stepping: Stepping
    ) -> tuple[Change, ...]:
        """Begin an object beside the others."""
        began, id = time.perf_counter(), correction.new or 0
        evolving, box, voxels = object_changes.begin_object(
            self._objects, number, correction, new, self._result, stepping
        )
        return (Change(id, box, voxels, time.perf_counter() - began, evolving.stop),)

    def _mend(self, number: int, correction: Correction, stepping: Stepping) -> tuple[Change, ...]:
        """Bring an object to edges, or take islands and holes from it."""
        began = time.perf_counter()
        check_object(correction, self._objects.ids if self._objects.has_ids else None)
        surface, box, voxels = mend(self._objects, number, correction, stepping)
        return (Change(surface.id, box, voxels, time.perf_counter() - began, surface.stop),)

    def _rearrange(
        self, number: int, correction: Correction, workers: Workers
    ) -> tuple[Change, ...]:
        """Merge objects, split one, or remove one: no surface moves."""
        began = time.perf_counter()
        objects = self._objects
        voxels = 0
        if correction.remove is not None:
            voxels = object_changes.remove(objects, correction.remove)
            surface = objects.surfaces[0]
        elif correction.merge:
            sizes = {before.id: before.inside for before in objects.surfaces}
            surface = object_changes.merge(objects, correction.merge, workers)
            voxels = surface.inside - sizes[surface.id]
        else:
            surface = object_changes.split(objects, number, correction, self._result, workers)[1]
            voxels = surface.inside
        id = surface.id if correction.remove is None else correction.remove
        return (
            Change(
                id,
                box_at(surface.corner, surface.psi.shape),
                voxels,
                time.perf_counter() - began,
                surface.stop,
            ),
        )

    def undo(self) -> None:
        """Go back to the state before the last correction that was made; with none nothing happens."""
        if self._objects.undo():
            self.config = self._undo.pop()
            self._extents.pop(len(self.config.refine), None)

    def _correct(
        self, place: int, new: Sequence[Click], near: float | str, stepping: Stepping
    ) -> Change:
        """Correct one object, of which ``new`` are clicks on the grid of the region of interest."""
        began = time.perf_counter()
        # Where nothing is wrong its part of the grid stays too, as in the result.
        shown = self._objects.shown(self._objects.surfaces[place])
        surface = self._objects.seen_on(place, box_around(new))
        relabelled, reaches = self._relabelled(surface, new)
        if not relabelled:
            sides = {click.side for click in new}
            return Change(
                surface.id,
                box_at((0, 0, 0), (0, 0, 0)),
                0,
                time.perf_counter() - began,
                surface.stop,
                side=sides.pop() if len(sides) == 1 else None,
            )
        takes = frozenset(self._objects.holders(new)) - {place}
        region = self._region(surface, new, relabelled, near, reaches)
        surface = self._objects.grown(place, region.box)
        box = counted_from(region.box, surface.corner)
        psi = surface.psi[box].copy()
        totals = self._objects.totals_of(surface)
        problem = self._problem(surface, region, psi, totals, takes)._replace(
            relabelled=[(click.side, click.mask_on(region.box)) for click in relabelled],
            sides=frozenset(click.side for click in new),
        )
        outcome = evolve_near(problem, surface.id, stepping)
        inside = surface.inside + count_inside(outcome.psi) - count_inside(psi)
        stop = stop_of_whole(outcome.stop, inside, math.prod(self._shape))
        self._objects.put(
            place,
            box,
            outcome.psi,
            surface._replace(
                inside=inside, history=outcome.history, stop=stop, before=earlier_probability(shown)
            ),
        )
        for other in sorted(takes):
            self._objects.take_from(other, region, outcome.psi, stepping.workers)
        changed = (outcome.psi < 0) != (psi < 0)
        seconds = time.perf_counter() - began
        reach = ClickReach(
            region.reach,
            sum(each.wanted for each in reaches),
            sum(each.left for each in reaches),
            max((each.farthest_mm for each in reaches), default=0.0),
        )
        return Change(
            surface.id,
            region.box,
            int(np.count_nonzero(changed)),
            seconds,
            stop,
            reach,
            rim=region.rim,
            moved_mm=farthest_from(new, region.box, changed, self._spacing),
        )

    def _relabelled(
        self, surface: CorrectedSurface, new: Sequence[Click]
    ) -> tuple[list[Click], list[ClickReach]]:
        """Return the voxels that new clicks relabel: their own and their basins', where a side is wrong.

        And how far each click reaches, where there is a model. Nothing where all are on their sides already, and the
        model gives them nothing else.
        """
        relabelled = list(new)
        model = self._objects.models.model(surface.id)
        reaches = []
        if model is not None:
            relabelled = []
            for click in new:
                change = model.add(click)
                self._objects.note_click(model, change)
                relabelled.append(basin_of(click, change, model, surface))
                reaches.append(model.state.reach or self._reach_on(surface, click))
        wrong = [_wrong_part(click, surface) for click in relabelled]
        return [click for click in wrong if click is not None], reaches

    def _reach_on(self, surface: CorrectedSurface, click: Click) -> ClickReach:
        """Return how far a click reaches that is right for the model, and wrong on the surface."""
        if click.near is not None:
            return ClickReach(click.near)
        domain = box_at(surface.corner, surface.psi.shape)
        mm = reach_of(
            click,
            lambda box: on_box(surface.psi, domain, box, 1.0) < 0,
            self._shape,
            self._spacing,
        )
        return ClickReach(mm)

    def _region(
        self,
        surface: CorrectedSurface,
        new: Sequence[Click],
        relabelled: Sequence[Click],
        near: float | str,
        reaches: Sequence[ClickReach],
    ) -> NearRegion:
        """Return the region of motion for new clicks.

        Within ``near``; or where they relabel, as far as they reach; or by their depth.
        """
        rim = rim_width(self._shape, self._spacing)
        margin = max(
            MARGIN * max(h for h, n in zip(self._spacing, self._shape, strict=True) if n > 1),
            self._reach,
        )
        if not isinstance(near, str):
            return around_clicks(
                new, near, min(rim, 0.5 * near), self._shape, self._spacing, margin
            )
        if reaches:
            region = around_clicks(
                [*new, *relabelled], rim, rim, self._shape, self._spacing, margin
            )
            return within_reaches(region, new, [reach.mm for reach in reaches], self._spacing)
        placed = (
            Clicks(tuple(new), self._shape).on_box(box_at(surface.corner, surface.psi.shape)).clicks
        )
        near = automatic_near(surface.psi, placed, self._spacing) + rim
        return around_clicks(new, near, rim, self._shape, self._spacing, margin)

    def _problem(
        self,
        surface: CorrectedSurface,
        region: NearRegion,
        psi: NDArray[np.float32],
        totals: RegionTotals,
        takes: frozenset[int],
    ) -> LocalProblem:
        """Return the evolution of a region: energy and clicks on its box."""
        models = self._objects.models
        settings = models.settings_of(surface.id)
        settings = settings.replace(
            seed=None if self.config.seed is None else self.config.seed + surface.id
        )
        context = models.contexts[surface.id].seeing_elsewhere(
            totals, counted_from(region.box, surface.corner)
        )
        energy = models.energy_on(surface.id, region.box, context, self._images).energy
        distance = self._objects.bounding(surface.id, region.box, takes)
        if distance is not None:
            energy = MaskConstraint(energy, distance)
        clicks = models.clicks.of(surface.id).on_box(region.box)
        bounds = click_bounds(clicks, Level(0, (1, 1, 1), psi.shape, self._spacing))
        setup = setup_of(settings, 0, 1, self._state.prepared.geometry)._replace(
            rule=correction_rule(settings)
        )
        return LocalProblem(
            psi, self._spacing, region, bounds, [], frozenset(), energy, setup, surface.history
        )

    # -- result --------------------------------------------------------------------------------------------

    def result(self) -> Result:
        """The present state as a result; later corrections do not change it."""
        base, models = self._result, self._objects.models
        objects = tuple(self._objects.segmented(surface) for surface in self._objects.surfaces)
        seconds = {**base.seconds, "refine": base.seconds.get("refine", 0.0) + self._seconds}
        extents = [self._extents.get(number) for number in range(len(self.config.refine))]
        clicks = on_image(models.clicks, self._state.prepared.first, base.geometry.shape)
        return dataclasses.replace(
            base,
            objects=objects,
            has_ids=self.has_ids,
            config=self.config,
            state=self._objects.state,
            resolved_settings={
                **base.resolved_settings,
                "reach_mm": [None if each is None else each.reach_mm for each in extents],
                "moved_mm": [None if each is None else each.moved_mm for each in extents],
            },
            seconds=seconds,
            clicks=clicks,
            late_leakage=_still_inside(base.late_leakage, objects),
        )


def _still_inside(place: Place | None, objects: Iterable[SegmentedObject]) -> Place | None:
    """Return a place where an object is there, after corrections; else None."""
    if place is None:
        return None
    voxel = [round(at) for at in place]
    for segmented in objects:
        index = tuple(at - part.start for at, part in zip(voxel, segmented.box, strict=True))
        if (
            all(0 <= at < n for at, n in zip(index, segmented.psi.shape, strict=True))
            and segmented.psi[index] < 0
        ):
            return place
    return None


def _wrong_part(click: Click, surface: CorrectedSurface) -> Click | None:
    """Return the voxels of a click that are not on its side, or None; beyond its array nothing is inside."""
    inside = on_box(surface.psi, box_at(surface.corner, surface.psi.shape), click.box, 1.0) < 0
    wrong = tightened(click.box, click.mask & (inside != (click.side == "inside")))
    return None if wrong is None else click._replace(box=wrong[0], mask=wrong[1])
