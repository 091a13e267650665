"""Voxels whose slices lie in several files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io.lazy_volume import VoxelSource


class StackedVoxels:
    """Slabs, one after the other along z.

    Parameters
    ----------
    slabs : sequence of VoxelSource
        Of one type.
    depths : sequence of int
        Slices of each.

    Raises
    ------
    InputError
        When their types differ.
    """

    def __init__(self, slabs: Sequence[VoxelSource], depths: Sequence[int]) -> None:
        self._slabs, self.dtype = tuple(slabs), slabs[0].dtype
        if any(slab.dtype != self.dtype for slab in slabs):
            raise InputError("the slices have values of several types", "convert them to one type first")
        self._ends = np.cumsum(depths)

    @property
    def bytes_read(self) -> int:
        """Bytes that were read so far."""
        return sum(slab.bytes_read for slab in self._slabs)

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box; see `accelsurf.io.LazyVolume.read`."""
        values = np.empty([s.stop - s.start for s in box], self.dtype)
        at = box[0].start
        while at < box[0].stop:
            number = int(np.searchsorted(self._ends, at, side="right"))
            begin = int(self._ends[number - 1]) if number else 0
            stop = min(box[0].stop, int(self._ends[number]))
            inside = (slice(at - begin, stop - begin), *box[1:])
            values[at - box[0].start : stop - box[0].start] = self._slabs[number].read(inside)
            at = stop
        return values
