"""Arrival times from inside and from outside, and which of them is earlier."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box
from accelsurf.grid.window import Window
from accelsurf.kernels.arrival import Medium, Tissue, march
from accelsurf.kernels.grid import Grid

Times = NDArray[np.float32]
Mask = NDArray[np.bool_]
Order = NDArray[np.int64]
_NO_CAP, _ALL_OPEN = np.zeros(0, np.float32), np.zeros(0, np.bool_)
_NEVER_LATE = (0, np.inf)


class Field(NamedTuple):
    """Field of a march: the channels in one array, where nothing passes, the grid, and of what it is a window.

    A voxel of the grid is a block of ``steps`` voxels of the window.
    """

    medium: Medium
    grid: Grid
    window: Window | None = None
    steps: tuple[int, int, int] = (1, 1, 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return self.grid.nz, self.grid.ny, self.grid.nx

    @property
    def size(self) -> int:
        """Number of voxels of the whole grid."""
        return self.grid.nz * self.grid.ny * self.grid.nx if self.window is None else self.window.voxels

    def images_on(self, box: Box) -> list[NDArray[np.float32]]:
        """The channels on a box."""
        return [image.reshape(self.shape)[box] for image in self.medium.values]

    def on_box(self, box: Box) -> Field:
        """The same on a box, where all is open."""
        values = np.stack([image.ravel() for image in self.images_on(box)])
        nz, ny, nx = (s.stop - s.start for s in box)
        return Field(Medium(values, _ALL_OPEN), self.grid._replace(nz=nz, ny=ny, nx=nx))


def field_of(
    images: Sequence[NDArray[np.float32]],
    spacing: Sequence[float],
    mask: Mask | None,
    window: Window | None = None,
    steps: tuple[int, int, int] = (1, 1, 1),
) -> Field:
    """The channels for marches on their grid; a single one is not copied."""
    nz, ny, nx = images[0].shape
    channels = [np.ravel(image) for image in images]
    values = channels[0][None] if len(channels) == 1 else np.stack(channels)
    passes = np.zeros(0, np.bool_) if mask is None else np.ascontiguousarray(mask).ravel()
    return Field(Medium(values, passes), Grid(nz, ny, nx, *(float(h) for h in spacing)), window, steps)


def arrival(
    field: Field,
    tissue: Tissue,
    seeds: NDArray[np.int64],
    max_count: int,
    cap: Times = _NO_CAP,
    late: tuple[int, float] = _NEVER_LATE,
) -> tuple[Times, Order]:
    """Times from seeds (each at 0), inf where the march does not come, and its voxels in the order of their times.

    See `reached`.
    """
    times, cells = reached(field, tissue, seeds, max_count, cap, late)
    return times, cells[np.argsort(times[cells], kind="stable")]


def reached(
    field: Field,
    tissue: Tissue,
    seeds: NDArray[np.int64],
    max_count: int,
    cap: Times = _NO_CAP,
    late: tuple[int, float] = _NEVER_LATE,
) -> tuple[Times, Order]:
    """Times from seeds (each at 0), inf where the march does not come, and its voxels in no order.

    It does not come where its time is not below ``cap`` (n,) float32, nor, with ``late`` = (count, factor), to times
    later than a bucket after ``factor`` times that of the voxel number ``count``.

    Raises
    ------
    LeavesWindow
        When it comes near an open face of the field's window.
    """
    times = np.full(field.medium.values.shape[1], np.inf, np.float32)
    times[seeds] = 0.0
    order = march(times, field.medium, tissue, field.grid, seeds, cap, late, max(max_count, len(seeds)))
    if field.window is not None:
        field.window.check_cells(order, field.shape, field.steps)
    return times, order


def from_beyond(field: Field, tissue: Tissue, beyond: Mask) -> NDArray[np.float32]:
    """Times from the voxels ``beyond`` to the others, on the field's grid; all inf where there are none.

    Edges alone slow this march: the values of the surroundings are not known.
    """
    times = np.where(beyond, np.float32(0.0), np.float32(np.inf))
    seeds = beyond & ndimage.binary_dilation(~beyond, ndimage.generate_binary_structure(3, 1))
    edges = tissue._replace(weights=tissue.weights * np.array((1, 1, 1, 0, 1, 1)))
    return times_from(field, edges, times, seeds)


def times_from(field: Field, tissue: Tissue, times: NDArray[np.float32], seeds: Mask) -> NDArray[np.float32]:
    """Times, on the field's grid, also where they are inf, from ``seeds``, where they are not; ``times`` is used up."""
    times = np.ravel(times)
    march(times, field.medium, tissue, field.grid, np.flatnonzero(seeds), _NO_CAP, _NEVER_LATE, times.size)
    return times.reshape(seeds.shape)


def balance(inside: Times, outside: Times) -> Times:
    """(T_in - T_out)/(T_in + T_out): -1 at the inside clicks, 1 outside; 1 where T_in is inf, 0 where both are 0.

    Examples
    --------
    >>> balance(np.array([0, 1, 3, 0, np.inf], np.float32), np.array([1, 3, 1, 0, 2], np.float32)).tolist()
    [-1.0, -0.5, 0.5, 0.0, 1.0]
    """
    with np.errstate(invalid="ignore"):
        out = (inside - outside) / (inside + outside)
    out[np.isinf(outside)] = -1.0
    out[np.isinf(inside)] = 1.0
    out[inside + outside == 0.0] = 0.0
    return out
