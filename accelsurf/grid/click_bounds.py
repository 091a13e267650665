"""Bounds of psi that clicks set: every clicked voxel is on its side, on the grid of any level."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Corner, box_at, corner_of, widened
from accelsurf.grid.clicks import SIDES, Click, Clicks
from accelsurf.grid.geometry import axis_steps
from accelsurf.grid.pyramid import Level

#: Voxels around a click in which psi is bounded; beyond them a distance that keeps the bounds here keeps them too.
MARGIN = 3


class ClickBounds(NamedTuple):
    """Bounds of psi on a grid of ``shape``: psi <= d_inside and psi >= -d_outside, the signed distances to the clicks.

    Attributes
    ----------
    shape : (nz, ny, nx)
    cells : ndarray (m,), int64
        Raveled cells within `MARGIN` voxels of a click, in rising order.
    low, high : ndarray (m,), float32
        Bounds of psi there, mm; infinite where there is none.
    """

    shape: tuple[int, int, int]
    cells: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]

    @property
    def held(self) -> NDArray[np.int64]:
        """The clicked cells themselves, in rising order."""
        return self.cells[(self.high < 0) | (self.low > 0)]

    def extent(self) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """First voxel clicked inside and the one after the last; None where there is none."""
        inside = self.cells[self.high < 0]
        if not inside.size:
            return None
        index = np.stack(np.unravel_index(inside, self.shape))
        return index.min(axis=1), index.max(axis=1) + 1

    def on_box(self, corner: Corner, shape: tuple[int, ...]) -> ClickBounds:
        """The bounds on a box of the grid."""
        index = np.stack(np.unravel_index(self.cells, self.shape)) - np.array(corner)[:, None]
        within = ((index >= 0) & (index < np.array(shape)[:, None])).all(axis=0)
        cells = np.ravel_multi_index(tuple(index[:, within]), shape).astype(np.int64)
        return ClickBounds(
            (shape[0], shape[1], shape[2]), cells, self.low[within], self.high[within]
        )

    def apply(self, psi: NDArray[np.float32]) -> None:
        """Bring psi (nz, ny, nx), mm, within the bounds, in place."""
        flat = psi.reshape(-1)
        flat[self.cells] = np.minimum(np.maximum(flat[self.cells], self.low), self.high)

    def is_met_by(self, psi: NDArray[np.float32]) -> bool:
        """Test if every clicked voxel is on its side."""
        values = psi.reshape(-1)[self.cells]
        return bool((values[self.high < 0] < 0).all() and (values[self.low > 0] >= 0).all())


class Distances(NamedTuple):
    """Signed distance in ``mm`` of raveled ``cells`` to a click."""

    cells: NDArray[np.int64]
    mm: NDArray[np.float32]


#: Distances to clicks on the finest level, by the identity of their masks, which live as long as the clicks here.
KnownDistances = dict[int, tuple[Click, Distances | None]]


def click_bounds(clicks: Clicks, grid: Level, known: KnownDistances | None = None) -> ClickBounds:
    """Return the bounds that the clicks on one object set on a level.

    Parameters
    ----------
    clicks : Clicks
        On the grid of level 0, as `Clicks.of` returns them.
    grid : Level
        Whole. A voxel of a coarser level is on the side of the clicks that it holds; one with clicks of both is free.
    known : dict, optional
        Distances to clicks that other objects are near to as well; missing ones are added.

    Examples
    --------
    >>> click = Click("inside", (slice(0, 1), slice(0, 1), slice(2, 3)), np.ones((1, 1, 1), bool))
    >>> bounds = click_bounds(Clicks((click,), (1, 1, 4)), Level(0, (1, 1, 1), (1, 1, 4), (1.0, 1.0, 1.0)))
    >>> bounds.cells, bounds.high, bounds.held
    (array([0, 1, 2, 3]), array([ 1.5,  0.5, -0.5,  0.5], dtype=float32), array([2]))
    """
    placed = [_on_level(click, grid) for click in clicks.clicks]
    clicked = [
        _cells_of((click for click in placed if click.side == side), grid.shape) for side in SIDES
    ]
    free = np.intersect1d(clicked[0], clicked[1])
    if known is None or grid.number > 0 or free.size:
        known = {}
    for click in placed:
        if id(click.mask) not in known:
            known[id(click.mask)] = click, _distances(click, free, grid)
    found = ((known[id(click.mask)][1], click.side == "inside") for click in placed)
    parts = [(part, is_inside) for part, is_inside in found if part is not None]
    if not parts:
        none = np.empty(0, np.float32)
        return ClickBounds(grid.shape, np.empty(0, np.int64), none, none)
    cells, place = np.unique(np.concatenate([part.cells for part, _ in parts]), return_inverse=True)
    low, high = np.full(cells.size, -np.inf, np.float32), np.full(cells.size, np.inf, np.float32)
    distance = np.concatenate([part.mm for part, _ in parts])
    inside = np.concatenate([np.full(part.mm.size, is_inside) for part, is_inside in parts])
    np.minimum.at(high, place[inside], distance[inside])
    np.maximum.at(low, place[~inside], -distance[~inside])
    return ClickBounds(grid.shape, cells, low, high)


def _on_level(click: Click, grid: Level) -> Click:
    """A click on a level's grid: the voxels that hold one of its own."""
    if grid.number == 0:
        return click
    index = np.argwhere(click.mask) + np.array(corner_of(click.box))
    place = np.floor((index - np.array(grid.first)) / np.array(grid.factors) + 0.5).astype(np.int64)
    place = np.clip(place, 0, np.array(grid.shape) - 1)
    low, high = place.min(axis=0), place.max(axis=0) + 1
    mask = np.zeros(tuple(high - low), np.bool_)
    mask[tuple((place - low).T)] = True
    return click._replace(
        box=box_at((int(low[0]), int(low[1]), int(low[2])), mask.shape), mask=mask
    )


def _cells_of(clicks: Iterable[Click], shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """Raveled cells of clicks."""
    cells = [
        _raveled(np.argwhere(click.mask) + np.array(corner_of(click.box)), shape)
        for click in clicks
    ]
    return np.unique(np.concatenate(cells)) if cells else np.empty(0, np.int64)


def _raveled(index: NDArray[np.int64], shape: tuple[int, int, int]) -> NDArray[np.int64]:
    return np.ravel_multi_index(tuple(index.T), shape).astype(np.int64)


def _distances(click: Click, free: NDArray[np.int64], grid: Level) -> Distances | None:
    """Distances around a click on a level; None where all of its cells are ``free``."""
    box = widened(click.box, grid.shape, (MARGIN, MARGIN, MARGIN))
    mask = click.mask_on(box)
    cells = _raveled(np.argwhere(np.ones_like(mask)) + np.array(corner_of(box)), grid.shape)
    if free.size:
        mask &= ~np.isin(cells, free).reshape(mask.shape)
    if not mask.any():
        return None
    half = 0.5 * min(axis_steps(grid.shape, grid.spacing))
    distance = ndimage.distance_transform_edt(~mask, grid.spacing) - half
    if not mask.all():
        distance[mask] = half - ndimage.distance_transform_edt(mask, grid.spacing)[mask]
    near = ndimage.maximum_filter(mask, 2 * MARGIN + 1, mode="constant").reshape(-1)
    return Distances(cells[near], distance.reshape(-1)[near].astype(np.float32))
