"""The grid of an object: a box of the level's, psi on it, and the constraints of its energy there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.energies.constraints.clicks import ClickConstraint
from accelsurf.energies.constraints.mask import MaskConstraint
from accelsurf.grid.boxes import Box, Corner, corner_of, shared, widened
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.grid.geometry import farthest
from accelsurf.grid.pyramid import Level

#: Margin of an object's box around the object: at least `ROOM` voxels and the fraction `ROOM_PART` of its extent; the
#: box is made larger when the band comes within `GUARD` voxels of its edge.
ROOM, ROOM_PART, GUARD = 10, 0.5, 3


def roomy_box(low: NDArray[np.int64], high: NDArray[np.int64], reach: float, grid: Level) -> Box:
    """Return the box for an object between two voxels: its energy sees there what it sees on the whole grid.

    Parameters
    ----------
    low, high : ndarray (3,) of int
        First voxel of the object, and the one after its last.
    reach : float
        How far beyond the object its energy sees the image, mm.
    grid : Level
    """
    a, b, c = (slice(int(i), int(j)) for i, j in zip(low, high, strict=True))
    needed = [max(ROOM, math.ceil(reach / h) + GUARD) for h in grid.spacing]
    room = [max(m, math.ceil(ROOM_PART * (j - i))) for m, i, j in zip(needed, low, high, strict=True)]
    return widened((a, b, c), grid.shape, (room[0], room[1], room[2]))


def larger_box(low: NDArray[np.int64], high: NDArray[np.int64], box: Box, reach: float, grid: Level) -> Box | None:
    """Return a larger box for an object between two voxels that come near the edge of its box; None where they do not.

    Parameters
    ----------
    low, high, reach, grid
        As for `roomy_box`.
    box : tuple of slice
        The box now.
    """
    first, end = np.array([s.start for s in box]), np.array([s.stop for s in box])
    near = ((low - first < GUARD) & (first > 0)) | ((end - high < GUARD) & (end < np.array(grid.shape)))
    if not near.any():
        return None
    return roomy_box(np.minimum(low, first + GUARD), np.maximum(high, end - GUARD), reach, grid)


def psi_on_box(known: NDArray[np.float32], at: Corner, box: Box) -> NDArray[np.float32]:
    """Return psi on a box, known from voxel ``at`` on; beyond the known values everything is outside."""
    psi = np.full(tuple(s.stop - s.start for s in box), farthest(known), np.float32)
    mine, theirs = shared(corner_of(box), psi.shape, at, known.shape)
    psi[mine] = np.minimum(known[theirs], psi[mine])
    return psi


def constrained(energy: Energy, mask_distance: NDArray[np.float32] | None, bounds: ClickBounds | None) -> Energy:
    """Return an energy within a mask and the bounds of clicks, where there are any."""
    if mask_distance is not None:
        energy = MaskConstraint(energy, mask_distance)
    return energy if bounds is None else ClickConstraint(energy, bounds)
