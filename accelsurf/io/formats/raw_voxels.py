"""Voxels that lie in a file as they are, one after the other: any box of them is read by itself.

They are read, not mapped into memory: a map counts against limits of the address space (``ulimit -v``), and a file that
is cut short, or a network drive that goes away, would end the process by a signal instead of an error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io.files import CHANGED
from accelsurf.io.formats.deflate import TRUNCATED_HINT
from accelsurf.io.lazy_volume import FileVoxels


@dataclass(frozen=True, eq=False)
class RawLayout:
    """Place of voxels in a file.

    Attributes
    ----------
    path : Path
        The file.
    offset : int
        Bytes before the first voxel.
    stored : numpy.dtype
        Of a voxel in the file, with its byte order.
    shape : tuple of int
        (nz, ny, nx); x runs fastest.
    planes : ndarray (nz,) of int64, optional
        Bytes before each plane, where they do not follow one another; the offset then counts for nothing.
    """

    path: Path
    offset: int
    stored: np.dtype[Any]
    shape: tuple[int, int, int]
    planes: NDArray[np.int64] | None = None

    @property
    def end(self) -> int:
        """Bytes from the start of the file to the end of the voxels."""
        last = self.plane(self.shape[0] - 1) if self.planes is None else int(self.planes.max())
        return last + math.prod(self.shape[1:]) * self.stored.itemsize

    def plane(self, z: int) -> int:
        """Bytes before a plane."""
        if self.planes is not None:
            return int(self.planes[z])
        return self.offset + z * math.prod(self.shape[1:]) * self.stored.itemsize


class RawVoxels(FileVoxels):
    """The voxels of a file, read where they lie.

    Parameters
    ----------
    layout : RawLayout
        Where they are.
    values : callable, optional
        Makes of an array of stored numbers the values that they stand for, in a new array or the same.

    Attributes
    ----------
    dtype : numpy.dtype
        Of the values.

    Raises
    ------
    InputError
        When the file ends before the last voxel.
    """

    def __init__(
        self, layout: RawLayout, values: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    ) -> None:
        super().__init__(layout.path)
        self.layout = layout
        self._values = values or native
        self.dtype = self._values(np.zeros(1, layout.stored)).dtype
        size = layout.path.stat().st_size
        if size < layout.end:
            raise InputError(
                f"the header announces {layout.end - layout.offset} bytes of voxels, the file holds "
                f"{max(size - layout.offset, 0)}",
                TRUNCATED_HINT,
            )

    def _values_in(self, box: Box) -> NDArray[Any]:
        stored = np.empty([s.stop - s.start for s in box], self.layout.stored)
        with self.layout.path.open("rb") as file:
            for piece in _pieces(self.layout, box, stored):
                file.seek(piece.offset)
                if file.readinto(piece.raw) < len(piece.raw):
                    raise InputError(*CHANGED)
        with self._lock:
            self.bytes_read += stored.nbytes
        return np.ascontiguousarray(self._values(stored))


def write_box(layout: RawLayout, box: Box, array: NDArray[Any]) -> None:
    """Write the values of a box into a file that is long enough.

    Parameters
    ----------
    layout : RawLayout
        Where voxels lie.
    box : three slices
        (z, y, x), within the grid.
    array : ndarray, shape of the box
        Of the type of the layout.
    """
    with layout.path.open("r+b") as file:
        for piece in _pieces(layout, box, np.ascontiguousarray(array, layout.stored)):
            file.seek(piece.offset)
            file.write(piece.raw)


class _Piece(NamedTuple):
    """Bytes of an array that lie together in the file, and where."""

    offset: int
    raw: memoryview


def _pieces(layout: RawLayout, box: Box, array: NDArray[Any]) -> Iterator[_Piece]:
    """Yield the pieces of the contiguous array of a box: planes of whole rows, else rows."""
    nx, item = layout.shape[2], layout.stored.itemsize
    for plane, z in zip(array, range(box[0].start, box[0].stop), strict=True):
        at = layout.plane(z) + (box[1].start * nx + box[2].start) * item
        for row, values in enumerate([plane] if plane.shape[1] == nx else plane):
            raw = memoryview(values.reshape(-1).view(np.uint8).data)
            yield _Piece(at + row * nx * item, raw)


def native(stored: NDArray[Any]) -> NDArray[Any]:
    """The same numbers in this machine's byte order."""
    return stored.astype(stored.dtype.newbyteorder("="), copy=False)
