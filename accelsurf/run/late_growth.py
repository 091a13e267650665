"""Late leakage: where surfaces grew in the last part of a run, the first place to look at.

An observer of the run: it reads the speeds of each step, and changes nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution import Step
from accelsurf.grid.boxes import Box, Corner, as_corner, box_at, enclosing, widened
from accelsurf.grid.pyramid import Level
from accelsurf.grid.window import Window
from accelsurf.kernels.statistics import sums_by_cube

#: A place (z, y, x), in voxels.
Place = tuple[float, float, float]
#: The last part of the growth, as a share of the volume that the object gained.
_LAST_SHARE = 0.25
#: Side of the cubes over which growth is summed, voxels; they are larger than single bumps of noise.
BLOCK = 6


class _Growth(NamedTuple):
    """Growth of an object in a step: its volume before, mm3, and the sum of each cube where it moved."""

    volume: float
    cubes: NDArray[np.int64]
    sums: NDArray[np.float32]


class GrowthState(NamedTuple):
    """All growth so far, in the order of steps: id of the object, volume before, and number of cubes of each.

    ``cubes`` and ``sums`` are all steps' together, one after another.
    """

    ids: NDArray[np.int64]
    volumes: NDArray[np.float64]
    counts: NDArray[np.int64]
    cubes: NDArray[np.int64]
    sums: NDArray[np.float32]


class LateLeakage:
    """Sums up growth, step by step.

    The cubes are counted from the first voxel of the whole image, so that they are the same in any window of it.

    Parameters
    ----------
    window : Window
        The part of the image that the run is on.
    """

    def __init__(self, window: Window) -> None:
        self._shape, self._corner = window.geometry.shape, window.corner
        # Cubes before the window's first are not counted; its first begins these numbers of voxels before the window.
        self._before = tuple(c % BLOCK for c in window.corner)
        self._cubes = tuple(
            -(-(n + b) // BLOCK) for n, b in zip(window.shape, self._before, strict=True)
        )
        self._growth: defaultdict[int, list[_Growth]] = defaultdict(list)

    def watch(self, step: Step, level: Level, corner: Corner, first: Corner) -> None:
        """Read the growth of a step.

        Parameters
        ----------
        step : Step
        level : Level
            The grid that it was made on.
        corner : (int, int, int)
            Index (z, y, x) on that grid of the first voxel of the surface's grid.
        first : (int, int, int)
            Index (z, y, x) in the window of the first voxel of the region of interest.
        """
        fields = step.fields
        if fields is None or not fields.cells.size:
            return
        # The speed is along the inward normal: below 0 the surface grows. Swings back and forth cancel.
        area = float(np.prod(level.factors)) ** (2 / 3)
        # The cube of each index along an axis, by a table.
        along = []
        for axis, size in enumerate(step.surface.shape):
            places = (np.arange(size) + corner[axis]) * level.factors[axis] + level.first[axis]
            cubes = (places + first[axis] + self._before[axis]).astype(np.int64) // BLOCK
            along.append(np.clip(cubes, 0, self._cubes[axis] - 1))
        _, ny, nx = self._cubes
        planes, rows = along[0] * (ny * nx), along[1] * nx
        # Cells are in raster order, so that the first and the last tell which planes of cubes they lie in.
        row_size = step.surface.shape[1] * step.surface.shape[2]
        lowest, last = planes[fields.cells[[0, -1]] // row_size]
        reached = np.zeros(last + ny * nx - lowest, np.bool_)
        sums = np.zeros(reached.size)
        row_cubes = np.add.outer(planes - lowest, rows).ravel()
        sums_by_cube(
            fields.cells,
            fields.speed,
            np.float32(-step.record.dt * area),
            row_cubes,
            along[2],
            reached,
            sums,
        )
        names = np.flatnonzero(reached)
        grown = _Growth(step.record.volume_mm3, names + lowest, sums[names].astype(np.float32))
        self._growth[step.object_id].append(grown)

    def state(self) -> GrowthState:
        """Return all growth so far."""
        rows = [(id, grown) for id, growth in self._growth.items() for grown in growth]
        cubes = [grown.cubes for _, grown in rows]
        return GrowthState(
            np.array([id for id, _ in rows], np.int64),
            np.array([grown.volume for _, grown in rows], np.float64),
            np.array([grown.size for grown in cubes], np.int64),
            np.concatenate([np.zeros(0, np.int64), *cubes]),
            np.concatenate([np.zeros(0, np.float32), *(grown.sums for _, grown in rows)]),
        )

    def restore(self, state: GrowthState) -> None:
        """Go back to the growth of a state."""
        self._growth.clear()
        ends = np.cumsum(state.counts)
        for id, volume, begin, end in zip(
            state.ids.tolist(),
            state.volumes.tolist(),
            (ends - state.counts).tolist(),
            ends.tolist(),
            strict=True,
        ):
            self._growth[id].append(_Growth(volume, state.cubes[begin:end], state.sums[begin:end]))

    def place(self) -> tuple[float, float, float] | None:
        """Index (z, y, x) in the window of the middle of the cube that grew most in the last part.

        None when no object grew.
        """
        late = []
        for growth in self._growth.values():
            volumes = np.array([growth_step.volume for growth_step in growth])
            gained = float(volumes[-1] - volumes[0])
            if gained > 0:
                below = np.flatnonzero(volumes <= volumes[-1] - _LAST_SHARE * gained)
                late += growth[int(below[-1]) :]
        if not late:
            return None
        cubes, which = np.unique(
            np.concatenate([growth_step.cubes for growth_step in late]), return_inverse=True
        )
        totals = np.bincount(which, np.concatenate([growth_step.sums for growth_step in late]))
        if totals.max() <= 0.0:
            return None
        largest = cubes[int(np.argmax(totals))]
        cube = np.array(np.unravel_index(largest, self._cubes))
        middle = cube * BLOCK - self._before + 0.5 * (BLOCK - 1)
        z, y, x = np.minimum(middle, np.subtract(self._shape, self._corner) - 1.0).tolist()
        return z, y, x


def nearest_inside(
    place: Place | None,
    inside: Callable[[Box], NDArray[np.bool_]],
    shape: Sequence[int],
    spacing: Sequence[float],
) -> Place | None:
    """Return the voxel of an object nearest to where it grew: the middle of a cube may lie beside its surface.

    Parameters
    ----------
    place : (z, y, x) or None
        Index in the grid.
    inside : callable
        Returns the voxels of a box of the grid that are in an object.
    shape : sequence of int
        (nz, ny, nx) of the grid.
    spacing : sequence of float
        (hz, hy, hx) in mm.

    Returns
    -------
    (z, y, x) or None
        None where the object is more than a cube away: it has left the place again.

    Examples
    --------
    >>> nearest_inside((0.0, 2.5, 7.5), (np.arange(40).reshape(1, 5, 8) == 22).__getitem__, (1, 5, 8), (1.0, 1.0, 1.0))
    (0.0, 2.0, 6.0)
    """
    if place is None:
        return None
    low, high = as_corner(np.floor(place)), as_corner(np.ceil(place))
    box = widened(enclosing(box_at(low, (1, 1, 1)), box_at(high, (1, 1, 1))), shape, [BLOCK] * 3)
    found = np.argwhere(inside(box)) + [part.start for part in box]
    if not found.size:
        return None
    away = (((found - place) * np.asarray(spacing)) ** 2).sum(axis=1)
    z, y, x = (float(i) for i in found[int(np.argmin(away))])
    return z, y, x
