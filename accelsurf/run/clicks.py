"""Clicks and balls of a run after each of its corrections, checks of these, and the contexts that energies see then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.grid.boxes import Box, Corner, corner_of, whole_box, widened
from accelsurf.grid.click_bounds import MARGIN, ClickBounds, click_bounds
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.geometry import Geometry, ball_distance
from accelsurf.grid.pyramid import Level
from accelsurf.image.volume import Volume
from accelsurf.run.image_context import ImageContext
from accelsurf.run.start_pyramid import LevelArrays, LevelInputs
from accelsurf.settings.catalogue import energy_settings
from accelsurf.settings.corrections import Correction
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import check_contradictions, check_left, clicks_of, voxel_named
from accelsurf.text.starts import ball_of, parse_start


class BallEdit(NamedTuple):
    """A ball to be added to an object or removed from it: ``centre`` (z, y, x) as voxel index, ``radius`` in mm."""

    kind: str
    centre: tuple[float, float, float]
    radius: float

    def on_level(self, grid: Level) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Its centre as index of a level's grid, and its radius in voxels of it along each axis."""
        middle = (np.array(self.centre) - grid.first) / grid.factors
        return middle, self.radius / np.array(grid.spacing)

    def extent(self, grid: Level) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel that it may reach on a level's grid, and the one after the last."""
        middle, size = self.on_level(grid)
        low = np.maximum(np.floor(middle - size), 0).astype(np.int64)
        high = np.minimum(np.ceil(middle + size) + 1, grid.shape).astype(np.int64)
        return low, high


def apply_balls(
    psi: NDArray[np.float32], balls: Sequence[BallEdit], grid: Level, corner: Corner, gamma: float
) -> None:
    """Add balls to an object or remove them from it: changes psi near them, in place.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx), float32
        mm, negative inside.
    balls : sequence of BallEdit
    grid : Level
        Of which psi is a box.
    corner : (z, y, x)
        First voxel of that box.
    gamma : float
        How far beyond a ball psi is changed, mm.
    """
    for ball in balls:
        middle = ball.on_level(grid)[0] - corner
        reach = (ball.radius + gamma) / np.array(grid.spacing)
        low = np.maximum(np.floor(middle - reach), 0).astype(int)
        high = np.minimum(np.ceil(middle + reach) + 1, psi.shape).astype(int)
        z, y, x = (slice(int(a), max(int(a), int(b))) for a, b in zip(low, high, strict=True))
        box = z, y, x
        distance = ball_distance(box, grid.spacing, middle, ball.radius)
        near = psi[box]
        if ball.kind == "add":
            np.minimum(near, distance, out=near)
        else:
            np.maximum(near, -distance, out=near)


def placed(
    clicks: Sequence[Click],
    volume: Volume,
    box: Box,
    mask_distance: NDArray[np.float32] | None,
    before: Clicks | None,
) -> Clicks:
    """Return clicks after the clicks of ``before``, on the grid of the region of interest.

    Parameters
    ----------
    clicks : sequence of Click
        On the image's grid.
    volume : Volume
        The image.
    box : tuple of slice
        Voxels of the region of interest.
    mask_distance : ndarray or None
        Signed distance of the mask on it, mm, negative within.
    before : Clicks or None
        On the grid of the region of interest.

    Raises
    ------
    InputError
        When a click inside an object lies outside of region or mask, one voxel is clicked on both sides at once, or
        nothing is left that is clicked inside an object.

    Notes
    -----
    Clicks that are given at once must agree; later ones take the voxels that they contradict from ``before``.
    """
    geometry = volume.geometry
    shape = tuple(s.stop - s.start for s in box)
    for click in clicks:
        if click.side == "outside" or click.id == NO_OBJECT:
            continue  # voxels outside of the mask are outside anyway
        at = np.argwhere(click.mask) + np.array([s.start for s in click.box])
        here = at - np.array([s.start for s in box])
        lost = ((here < 0) | (here >= np.array(shape))).any(axis=1)
        where = "the region of interest"
        if mask_distance is not None and not lost.any():
            lost, where = mask_distance[tuple(here.T)] > 0, "the mask or the box"
        if lost.any():
            voxel = voxel_named(at[int(np.flatnonzero(lost)[0])], geometry)
            raise InputError(
                f"clicks: {voxel} is clicked inside, and lies outside of {where}",
                "make one of them fit",
            )
    here_clicks = Clicks(tuple(clicks), geometry.shape).on_box(box)
    check_contradictions(here_clicks, geometry, (box[0].start, box[1].start, box[2].start))
    if before is None:
        return here_clicks
    whole = before.with_later(here_clicks.clicks)
    check_left(before, whole)
    return whole


class RunClicks:
    """Clicks and contexts of a run's objects, in force after some of its edits.

    Parameters
    ----------
    volume : Volume
        The image; seeds and thresholds of edits look at its own values, without presmoothing.
    box : tuple of slice
        Voxels of the region of interest.
    mask_distance : ndarray or None
        On that region.
    first : Clicks or None
        Before any edit, on that region.
    contexts : sequence of ImageContext
        Of the objects, before any edit.
    ids : sequence of int
        Of the objects; none for a run of one object without an id.
    """

    def __init__(
        self,
        volume: Volume,
        box: Box,
        mask_distance: NDArray[np.float32] | None,
        first: Clicks | None,
        contexts: Sequence[ImageContext],
        ids: Sequence[int],
    ) -> None:
        self._volume = volume
        self._box = box
        self._mask_distance = mask_distance
        self._ids = tuple(ids)
        self._after: dict[tuple[str, ...], Clicks | None] = {(): first}
        self._contexts: dict[tuple[str, ...], tuple[ImageContext, ...]] = {(): tuple(contexts)}

    def after(self, edits: Sequence[Correction]) -> Clicks | None:
        """Return the clicks in force after some edits; None where there are none.

        Raises
        ------
        UsageError, InputError
            When a click of an edit cannot be used; the message names the step.
        """
        key = _key(edits)
        if key not in self._after:
            edits = [edit for edit in edits if edit.has_clicks]
            before, edit = self.after(edits[:-1]), edits[-1]
            try:
                read = clicks_of(
                    edit, self._volume, id=edit.object if self._ids else 1, has_ids=bool(self._ids)
                )
                self._after[key] = placed(
                    read, self._volume, self._box, self._mask_distance, before
                )
            except AccelsurfError as error:
                raise type(error)(
                    f"edit at step {edit.step}: {error.message}", error.hint
                ) from None
        return self._after[key]

    def contexts(self, edits: Sequence[Correction]) -> tuple[ImageContext, ...]:
        """Return the context of each object after some edits; the same objects as long as no click is added."""
        key = _key(edits)
        if key not in self._contexts:
            edits = [edit for edit in edits if edit.has_clicks]
            clicks = self.after(edits)
            assert clicks is not None
            before = self.contexts(edits[:-1])
            ids = self._ids or (1,)
            self._contexts[key] = tuple(
                context.with_clicks(clicks.of(id), context)
                for context, id in zip(before, ids, strict=True)
            )
        return self._contexts[key]


def _key(edits: Sequence[Correction]) -> tuple[str, ...]:
    return tuple(str(edit) for edit in edits if edit.has_clicks)


class LevelClicks:
    """The clicks on an object on every level: bounds of psi, and the field of its model; made when first needed.

    Parameters
    ----------
    context : ImageContext
        Of the object.
    inputs : LevelInputs
        Of the run.
    """

    def __init__(self, context: ImageContext, inputs: LevelInputs) -> None:
        self._context = context
        self._grids = inputs.grids
        self._known = inputs.known_distances
        self._bounds: dict[int, tuple[Box, ClickBounds]] = {}
        self._last: tuple[int, Box, ClickBounds] | None = None
        self._field: LevelArrays | None = None

    def bounds(self, level: int, box: Box | None = None) -> ClickBounds | None:
        """Return the bounds on a box of a level; None without clicks there."""
        clicks, grid = self._context.clicks, self._grids[level]
        if clicks is None:
            return None
        seen = whole_box(grid.shape)
        box = box or whole_box(grid.shape)
        last = self._last
        if last is not None and last[:2] == (level, box):
            return last[2] if last[2].cells.size else None
        if level == 0:  # of the clicks in many other objects most are far away
            seen = widened(box, grid.shape, (MARGIN, MARGIN, MARGIN))
        known = self._bounds.get(level)
        if known is None or known[0] != seen:
            near = clicks.near(seen) if level == 0 else clicks
            known = self._bounds[level] = seen, click_bounds(near, grid, self._known)
        found = known[1].on_box(corner_of(box), tuple(s.stop - s.start for s in box))
        self._last = level, box, found
        return found if found.cells.size else None

    def apply(self, psi: NDArray[np.float32], level: int, box: Box | None = None) -> None:
        """Bring psi on a box of a level within the bounds, in place."""
        bounds = self.bounds(level, box)
        if bounds is not None:
            bounds.apply(psi)

    def extended(
        self, low: NDArray[np.int64], high: NDArray[np.int64], level: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return first voxel and the one after the last of an object on a level, with its clicks inside."""
        clicks = self._context.clicks
        if clicks is None:
            return low, high
        extent = click_bounds(clicks.on_side("inside"), self._grids[level], self._known).extent()
        return (
            (low, high)
            if extent is None
            else (np.minimum(low, extent[0]), np.maximum(high, extent[1]))
        )

    def field(self, level: int, box: Box) -> NDArray[np.float32]:
        """Return the field of the object's model on a box of a level."""
        if level == 0:
            return self._context.click_model().field_on(box)
        if self._field is None:
            self._field = LevelArrays(self._context.model_field(), self._grids)
        return self._field.on(level, box)


def check_edit(
    edit: Correction,
    config: RunConfig,
    context: ImageContext,
    geometry: Geometry,
    ids: Sequence[int],
    energy: Any,
) -> None:
    """Refuse an edit that a run cannot apply: a ball outside the grid, an unknown object, a setting without effect.

    Parameters
    ----------
    edit : Correction
    config : RunConfig
        Of the run.
    context, geometry
        Of its image, on the region of interest.
    ids : sequence of int
        Of its objects; none for a run of one object without an id.
    energy : Energy or callable or str or None
        An energy of the user's own, if the run has one.

    Raises
    ------
    UsageError
        When the edit is not valid for this run.
    InputError
        When a ball lies outside the volume.
    """
    where = f"edit at step {edit.step}"
    terms = EnergyText(str(edit.settings.get("energy", config.energy))).terms
    if context.foreground is None and any(term.settings.get("update") == "no" for term in terms):
        raise UsageError(
            f"{where}: likelihood:update=no was given, and the run has nothing to learn from",
            "give --foreground to the run, or use update=yes",
        )
    try:
        balls_of(edit, geometry)
    except (UsageError, InputError) as error:
        raise type(error)(f"{where}: {error.message}", error.hint) from None
    _check_object(edit, ids, where)
    if energy is not None and not isinstance(energy, str):
        for key in edit.settings:
            if key == "energy" or key in energy_settings():
                raise UsageError(
                    f"{where}: {key} was given, but the energy is one of your own",
                    "it has its own settings, which do not change while it runs",
                )


def _check_object(edit: Correction, ids: Sequence[int], where: str) -> None:
    """Refuse an object that does not exist, and balls or clicks without an object where there are several."""
    allowed = (
        {*ids, NO_OBJECT}
        if ids and edit.inside and not (edit.balls or edit.outside)
        else set(ids or (1,))
    )
    if edit.object is not None and edit.object not in allowed:
        known = ", ".join(str(id) for id in ids[:8]) + (", ..." if len(ids) > 8 else "")
        raise UsageError(
            f"{where}: object {edit.object} was given, expected one of {known or '1'}",
            "as in object=3",
        )
    if edit.object is not None and not (edit.balls or edit.has_clicks):
        raise UsageError(
            f"{where}: object {edit.object} was given without a ball or a click",
            "settings change for all objects",
        )
    if edit.object is None and edit.balls and len(ids) > 1:
        raise UsageError(
            f"{where}: a ball was given without its object",
            "write which one it is added to, as in object=3",
        )
    if edit.object is None and edit.inside and ids:
        raise UsageError(
            f"{where}: a click inside was given without its object",
            "write which one it is in, as in object=3",
        )


def balls_of(edit: Correction, geometry: Geometry) -> tuple[BallEdit, ...]:
    """The balls of an edit on the grid of the region of interest."""
    return tuple(BallEdit(kind, *ball_of(parse_start(text), geometry)) for kind, text in edit.balls)


def balls_for(id: int, edit: Correction, balls: Sequence[BallEdit]) -> tuple[BallEdit, ...]:
    """The balls of an edit for object ``id`` of several: the gain of one object is taken from the others."""
    if edit.object is None or edit.object == id:
        return tuple(balls)
    return tuple(ball._replace(kind="remove") for ball in balls if ball.kind == "add")
