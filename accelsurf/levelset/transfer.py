"""Fields of a band on the band of the same surface on another grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.pyramid import Level
from accelsurf.kernels import transport
from accelsurf.kernels.grid import Grid
from accelsurf.levelset.level_set import LevelSet


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
    ratio = np.array([f / c for c, f in zip(coarse.factors, fine.factors, strict=True)])
    place = np.stack([ratio, 0.5 * (ratio - 1.0)])
    on, missing = (slot, Grid(*coarse.shape, *coarse.spacing)), np.array(fill_values, np.float32)
    new.workers.parallel(transport.fields_between, new.size, on, new.band, new.grid, place, (values, missing), out)
    return list(out)
