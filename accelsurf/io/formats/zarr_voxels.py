"""Arrays of a Zarr, read chunk by chunk. The only place that imports zarr for reading; it is an extra.

A chunk that is not in the store has the fill value: so says Zarr, and stores of label maps consist of little else. So a
store that has gone would read as zeros. The metadata of the array are therefore looked for after each reading.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io.chunk_cache import ChunkCache
from accelsurf.io.files import file_version
from accelsurf.io.headers import check_within_store, is_outside_data_allowed, outside_data_allowed
from accelsurf.settings import budgets

#: Voxels along an axis: beyond that the numbers of the header are damaged.
_MAX_AXIS = 1 << 48
#: What a group or an array of a Zarr has, one of them.
MARKS = ("zarr.json", ".zattrs", ".zgroup", ".zarray")


def library() -> ModuleType:
    """The package zarr.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise InputError("OME-Zarr needs the package zarr", 'install it: pip install "accelsurf[zarr]"') from error
    return zarr


def open_array(folder: Path, path: str) -> Any:
    """Open an array of a group, and check that its chunks can be read.

    Parameters
    ----------
    folder : Path
        The group.
    path : str
        Of the array within it.

    Raises
    ------
    InputError
        When there is no such array, or none of real numbers, or a link to it leads out of the group.
    """
    zarr = library()
    for part in (path, *(f"{path}/{mark}" for mark in MARKS)):
        check_within_store(folder, folder / part)
    try:
        array = zarr.open_array(folder / path, mode="r")
        dtype, chunks = np.dtype(array.dtype), tuple(array.chunks)
        if not all(0 < n <= _MAX_AXIS for n in (*array.shape, *chunks)):
            raise ValueError(f"its shape is {array.shape}, in chunks of {chunks}")
    except (PermissionError, MemoryError):
        raise
    except Exception as error:  # its metadata may be anything, and each part of zarr raises errors of its own
        raise InputError(
            f"the array {path} is missing or damaged ({_short(error)})", "is the store complete? copy it again"
        ) from error
    if dtype.kind not in "buif":
        raise InputError(f"values of type {dtype} given, one real number per voxel expected", "convert them first")
    budgets.ZARR_CHUNK.check(math.prod(chunks) * dtype.itemsize, "a chunk of the Zarr")
    return array


class ZarrVoxels:
    """The voxels of an array with more axes than those of space, perhaps.

    Parameters
    ----------
    folder : Path
        The group.
    path : str
        Of the array within it.
    index : sequence of int or None
        For each axis of the array: a place along it, or None for an axis of space.
    order : sequence of int
        Which axes of the array are z, y, x, or y, x for one slice.
    cache_bytes : int
        Of unpacked chunks that are held.
    """

    def __init__(
        self, folder: Path, path: str, index: Sequence[int | None], order: Sequence[int], cache_bytes: int
    ) -> None:
        self._array = open_array(folder, path)
        self._name, self._folder, self._outside_allowed = path, folder, is_outside_data_allowed()
        # A file of a store has a chunk, or with sharding several.
        self._file_shape = tuple(self._array.shards or self._array.chunks)
        self._index, self._order = tuple(index), tuple(order)
        self._flat = 3 - len(self._order)
        nz, ny, nx = (*[1] * self._flat, *(int(self._array.chunks[axis]) for axis in self._order))
        self.chunk_shape = (nz, ny, nx)
        self.dtype = np.dtype(self._array.dtype).newbyteorder("=")
        self._cache = ChunkCache(cache_bytes)
        mark = "zarr.json" if self._array.metadata.zarr_format == 3 else ".zarray"
        self._mark = folder / path / mark
        self._version = file_version(self._mark.stat())

    @property
    def bytes_read(self) -> int:
        """Bytes of the chunks that were read so far, unpacked."""
        return self._cache.bytes_made

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box; see `accelsurf.io.LazyVolume.read`.

        Raises
        ------
        InputError
            When a chunk is damaged, or the store has changed since it was opened; OSError when it is gone.
        """
        values = np.empty([s.stop - s.start for s in box], self.dtype)
        for place in self._chunks(box):
            chunk = self._cache.get(place, lambda place=place: self._chunk(place))  # type: ignore[misc]
            inside, into = [], []
            for along, at, width in zip(box, place, self.chunk_shape, strict=True):
                first, last = max(along.start, at * width), min(along.stop, (at + 1) * width)
                inside.append(slice(first - at * width, last - at * width))
                into.append(slice(first - along.start, last - along.start))
            values[tuple(into)] = chunk[tuple(inside)]
        if file_version(self._mark.stat()) != self._version:
            raise InputError("the store has changed while it was read", "let no program write it; then start again")
        return values

    def _chunks(self, box: Box) -> Iterator[tuple[int, ...]]:
        """The places of the chunks that have voxels of a box."""
        widths = zip(box, self.chunk_shape, strict=True)
        return itertools.product(*(range(s.start // width, -(-s.stop // width)) for s, width in widths))

    def _chunk(self, place: tuple[int, ...]) -> NDArray[Any]:
        """The voxels of a chunk, as far as the grid goes."""
        selection: list[Any] = list(self._index)
        for axis, at in zip(self._order, place[self._flat :], strict=True):
            width = int(self._array.chunks[axis])
            selection[axis] = slice(at * width, min((at + 1) * width, int(self._array.shape[axis])))
        self._check_links(selection)
        try:
            found = np.asarray(self._array[tuple(selection)])
        except (OSError, MemoryError):
            raise
        except Exception as error:  # each codec raises errors of its own
            where = ", ".join(map(str, place))
            raise InputError(
                f"chunk ({where}) of the array {self._name} is damaged ({_short(error)})",
                "copy the store again, or write this chunk anew from its source",
            ) from error
        # The axes of the selection are those of space in the order of the array.
        found = found.transpose(np.argsort(np.argsort(self._order)))
        return np.ascontiguousarray(found.reshape((1,) * self._flat + found.shape), self.dtype)

    def _check_links(self, selection: Sequence[int | slice]) -> None:
        """Refuse a chunk whose file lies, with links followed, outside of the store: its bytes would be shown."""
        first = [one.start if isinstance(one, slice) else one for one in selection]
        place = tuple(n // width for n, width in zip(first, self._file_shape, strict=True))
        file = self._array.metadata.encode_chunk_key(place)
        with outside_data_allowed(self._outside_allowed):
            check_within_store(self._folder, self._folder / self._name / file)


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
