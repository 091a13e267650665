"""Arrival times from inside and from outside, and which of them is earlier."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.kernels.arrival import Medium, Tissue, march
from accelsurf.kernels.grid import Grid

Times = NDArray[np.float32]
Mask = NDArray[np.bool_]
Order = NDArray[np.int64]
_NO_CAP = np.zeros(0, np.float32)


class Field(NamedTuple):
    """What marches need: the channels in one array, where nothing passes, the grid."""

    medium: Medium
    grid: Grid

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.grid.nz * self.grid.ny * self.grid.nx


def field_of(images: Sequence[NDArray[np.float32]], spacing: Sequence[float], mask: Mask | None) -> Field:
    """The channels for marches on their grid."""
    nz, ny, nx = images[0].shape
    values = np.stack([image.ravel() for image in images])
    passes = np.zeros(0, np.bool_) if mask is None else np.ascontiguousarray(mask).ravel()
    return Field(Medium(values, passes), Grid(nz, ny, nx, *(float(h) for h in spacing)))


def arrival(
    field: Field, tissue: Tissue, seeds: NDArray[np.int64], cap: Times | None = None, max_count: int | None = None
) -> tuple[Times, Order]:
    """Times from seeds (each at 0), inf where the march does not come, and the voxels in their order."""
    times = np.full(field.size, np.inf, np.float32)
    times[seeds] = 0.0
    limit = field.size if max_count is None else max(max_count, len(seeds))
    order = march(times, field.medium, tissue, field.grid, seeds, _NO_CAP if cap is None else cap, np.inf, limit)
    return times, order


def from_beyond(field: Field, tissue: Tissue, times: Times, order: Order, beyond: int) -> Times:
    """Times from all that arrived after the first ``beyond`` voxels, inwards; 0 there.

    Parameters
    ----------
    tissue : Tissue
        What the march back goes through.
    times : ndarray (n,) float32
    order : ndarray (m,) int64
    beyond : int
    """
    back = np.zeros(field.size, np.float32)
    back[order[:beyond]] = np.inf
    shape = (field.grid.nz, field.grid.ny, field.grid.nx)
    unknown = np.isinf(back).reshape(shape)
    near = np.zeros(shape, np.bool_)
    for axis in range(3):
        one, other = [slice(None)] * 3, [slice(None)] * 3
        one[axis], other[axis] = slice(1, None), slice(None, -1)
        near[tuple(one)] |= unknown[tuple(other)]
        near[tuple(other)] |= unknown[tuple(one)]
    seeds = np.flatnonzero(near & ~unknown)
    march(back, field.medium, tissue, field.grid, seeds, _NO_CAP, np.inf, field.size)
    return back


def balance(inside: Times, outside: Times) -> NDArray[np.float32]:
    """(T_in - T_out)/(T_in + T_out): -1 at the inside clicks, 1 outside; 0 where both are 0 or neither comes."""
    with np.errstate(invalid="ignore"):
        both = inside + outside
        out = (inside - outside) / both
    out[np.isinf(inside)] = 1.0
    out[np.isinf(outside) & ~np.isinf(inside)] = -1.0
    out[(both == 0.0) | (np.isinf(inside) & np.isinf(outside))] = 0.0
    return out
