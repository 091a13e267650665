"""Clicks of a run: on the grid of its region of interest, and on every level as bounds and field."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, corner_of, whole_box, widened
from accelsurf.grid.click_bounds import MARGIN, ClickBounds, click_bounds
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.image.volume import Volume
from accelsurf.run.image_context import ImageContext
from accelsurf.run.start_pyramid import LevelArrays, LevelInputs
from accelsurf.text.clicks import check_contradictions, voxel_named


def placed(
    clicks: Sequence[Click],
    volume: Volume,
    box: Box,
    mask_distance: NDArray[np.float32] | None,
) -> Clicks:
    """Return clicks on the grid of the region of interest.

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

    Raises
    ------
    InputError
        When a click inside an object lies outside of region or mask, or one voxel is clicked on both sides.
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
    return here_clicks


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
