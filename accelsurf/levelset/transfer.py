"""Transfer of fields from a band to that of the same surface on another grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Corner, corner_of, widened
from accelsurf.grid.pyramid import Level
from accelsurf.kernels import transport
from accelsurf.kernels.grid import Grid
from accelsurf.levelset.level_set import LevelSet


def slots_of(surface: LevelSet, level: Level) -> tuple[NDArray[np.int32], Level]:
    """Slots of a band without its surface: raveled, in a box around the band, and that box of ``level``, its grid."""
    low, high = surface.extent()
    # A place between two cells is read from no further than the voxel beside the band.
    z, y, x = (slice(int(first), int(last)) for first, last in zip(low, high, strict=True))
    box = widened((z, y, x), surface.shape, (1, 1, 1))
    slots = surface.dense.slot.reshape(surface.shape)[box]
    return slots.flatten(), level.on_box(corner_of(box), slots.shape)


def transfer_fields(
    fields: Sequence[NDArray[np.float32]],
    fill_values: Sequence[float],
    slot: NDArray[np.int32],
    coarse: Level,
    new: LevelSet,
    fine: Level,
) -> list[NDArray[np.float32]]:
    """Return fields (n,) of a band of level ``coarse``, its ``slot`` per voxel, on that of ``new``, level ``fine``.

    Each cell gets the value at its closest point on the surface: the mean of the coarse band cells around it, weighted
    as in linear interpolation; cells that are not in the band do not count. Where there are none, as on surface that
    was not there before, it is the field's ``fill_values``.
    """
    if not fields:
        return []
    out = np.empty((len(fields), new.size), np.float32)
    values = np.stack([np.asarray(field, np.float32) for field in fields])
    place = fine.places_in(coarse)
    on, missing = (slot, Grid(*coarse.shape, *coarse.spacing)), np.array(fill_values, np.float32)
    new.workers.parallel(
        transport.fields_between, new.size, on, new.band, new.grid, place, (values, missing), out
    )
    return list(out)


def shift_fields(
    fields: Sequence[NDArray[np.float32]], old: LevelSet, at: Corner, new: LevelSet, corner: Corner
) -> list[NDArray[np.float32]]:
    """Fields (n,) of a band on the band of the same surface on another grid, whose first voxels are ``at``, ``corner``.

    New cells get the value of the front along the normal.
    """
    index = np.unravel_index(new.band.cells, new.shape)
    place = np.stack([i + (c - a) for i, a, c in zip(index, at, corner, strict=True)])
    there = ((place >= 0) & (place < np.array(old.shape)[:, None])).all(axis=0)
    cells = np.ravel_multi_index(tuple(np.where(there, place, 0)), old.shape)
    slot = np.minimum(np.searchsorted(old.band.cells, cells), max(old.size - 1, 0))
    there &= old.band.cells[slot] == cells
    out = []
    for field in fields:
        values = np.where(there, field[slot], np.float32(0.0))
        known = np.where(there, np.float32(1.0), np.float32(0.0))
        spread = values.copy()
        new.extend_outwards(spread, new.front())
        out.append(np.where(known > 0, values, spread).astype(np.float32))
    return out
