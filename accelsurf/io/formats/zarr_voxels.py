"""Arrays of a Zarr, read chunk by chunk. The only place that imports zarr for reading; it is an extra.

zarr reads and checks the metadata, and unpacks the chunks one by one, after `zarr_files` has compared them with
their announced sizes.

A chunk that is not in the store has the fill value: so says Zarr, and stores of label maps consist of little else. A
store that accelsurf has written says which chunks it had, so that one that is missing is a fault. In others those that
are missing are counted, and a warning names the value in their place. A store that has gone would read as nothing but
missing chunks: the metadata of the array are therefore looked for after each reading.
"""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io.files import one_line
from accelsurf.io.formats.zarr_files import ChunkFiles, is_in_runs
from accelsurf.io.headers import check_within_store
from accelsurf.io.lazy_volume import PackedVoxels
from accelsurf.settings import budgets

#: Voxels along an axis: beyond that the numbers of the header are damaged.
_MAX_AXIS = 1 << 48
#: Lists in the metadata of an array, and their largest number of entries.
_LISTS = ("shape", "chunks", "codecs", "filters")
_MAX_LISTED = 16
#: Files of metadata; a group or an array of a Zarr has one of them.
MARKS = ("zarr.json", ".zattrs", ".zgroup", ".zarray")


def zarr_library() -> ModuleType:
    """The package zarr.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise InputError(
            "OME-Zarr needs the package zarr", 'install it: pip install "accelsurf[zarr]"'
        ) from error
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
        When the array does not exist, is none of real numbers, or a link to it leads out of the group.
    """
    zarr = zarr_library()
    check_within_store(folder, folder / path)
    try:
        for mark in MARKS:
            _check_claims(read_mark(folder, folder / path / mark))
        with warnings.catch_warnings(action="ignore"):  # codecs that are not in Zarr 3
            array = zarr.open_array(folder / path, mode="r")
        dtype, chunks = np.dtype(array.dtype), tuple(array.chunks)
        if not all(0 < n <= _MAX_AXIS for n in (*array.shape, *chunks)):
            raise ValueError(f"its shape is {array.shape}, in chunks of {chunks}")
    except (PermissionError, MemoryError, InputError):
        raise
    except (
        Exception
    ) as error:  # its metadata may be anything, and each part of zarr raises errors of its own
        raise InputError(
            f"the array {path} is missing or damaged ({one_line(error)})",
            "is the store complete? copy it again",
        ) from error
    if dtype.kind not in "buif":
        raise InputError(
            f"values of type {dtype} given, one real number per voxel expected",
            "convert them first",
        )
    budgets.ZARR_CHUNK.check(math.prod(chunks) * dtype.itemsize, "a chunk of the Zarr")
    return array


def read_mark(folder: Path, mark: Path) -> Any:
    """Read a file of metadata in a group; None where there is none.

    Raises
    ------
    InputError
        When it is too large, or a link out of the group; ValueError or RecursionError when it is no JSON.
    """
    check_within_store(folder, mark)
    if not mark.is_file():
        return None
    budgets.ZARR_METADATA.check(mark.stat().st_size)
    return json.loads(mark.read_bytes())


def _check_claims(said: Any) -> None:
    """Refuse an array with too many axes or codecs: zarr would be busy with them alone."""
    for key, given in said.items() if isinstance(said, dict) else ():
        if key in _LISTS and isinstance(given, list) and len(given) > _MAX_LISTED:
            raise ValueError(f"its {key} has {len(given)} entries, at most {_MAX_LISTED} expected")


class ZarrVoxels(PackedVoxels):
    """The voxels of an array that may have further axes than space.

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
    stored : sequence of int, optional
        Which files the store had when accelsurf wrote it, as `zarr_files.runs_of` says it.
    """

    def __init__(
        self,
        folder: Path,
        path: str,
        index: Sequence[int | None],
        order: Sequence[int],
        cache_bytes: int,
        stored: Sequence[int] | None = None,
    ) -> None:
        self._array = open_array(folder, path)
        mark = "zarr.json" if self._array.metadata.zarr_format == 3 else ".zarray"
        super().__init__(folder / path / mark, cache_bytes)
        self._name, self._stored = path, stored
        self._files = ChunkFiles(folder, path, self._array)
        self._missing: set[tuple[int, ...]] = set()
        self._index, self._order = tuple(index), tuple(order)
        self._flat = 3 - len(self._order)
        nz, ny, nx = (*[1] * self._flat, *(int(self._array.chunks[axis]) for axis in self._order))
        self.chunk_shape = (nz, ny, nx)
        self.dtype = np.dtype(self._array.dtype).newbyteorder("=")

    def _values_in(self, box: Box) -> NDArray[Any]:
        values = np.empty([s.stop - s.start for s in box], self.dtype)
        for place in self._chunks(box):
            chunk = self._piece(place, lambda place=place: self._chunk(place))  # type: ignore[misc]
            inside, into = [], []
            for along, at, width in zip(box, place, self.chunk_shape, strict=True):
                first, last = max(along.start, at * width), min(along.stop, (at + 1) * width)
                inside.append(slice(first - at * width, last - at * width))
                into.append(slice(first - along.start, last - along.start))
            values[tuple(into)] = chunk[tuple(inside)]
        return values

    def _chunks(self, box: Box) -> Iterator[tuple[int, ...]]:
        """The places of the chunks that have voxels of a box."""
        widths = zip(box, self.chunk_shape, strict=True)
        return itertools.product(
            *(range(s.start // width, -(-s.stop // width)) for s, width in widths)
        )

    def _chunk(self, place: tuple[int, ...]) -> NDArray[Any]:
        """The voxels of a chunk, as far as the grid goes."""
        widths, shape = self._files.chunk_shape, self._array.shape
        index = zip(self._index, widths, strict=True)
        whole = [0 if n is None else n // width for n, width in index]
        inside: list[Any] = list(self._index)
        for axis, at in zip(self._order, place[self._flat :], strict=True):
            whole[axis] = at
            inside[axis] = slice(at * widths[axis], min((at + 1) * widths[axis], int(shape[axis])))
        found = self._unpacked(tuple(whole), tuple(inside))
        # The axes that are left are the spatial ones in the order of the array.
        found = found.transpose(np.argsort(np.argsort(self._order)))
        return np.array(found.reshape((1,) * self._flat + found.shape), self.dtype, order="C")

    def _unpacked(self, place: tuple[int, ...], inside: tuple[Any, ...]) -> NDArray[Any]:
        """The values of a part of a chunk; the fill value where the store has none."""
        try:
            self._files.check(place)
        except FileNotFoundError:
            self._check_missing(place)
        except ValueError as error:
            raise self._damage(place, error) from error
        try:
            return np.asarray(self._array[inside])
        except MemoryError:
            raise
        except Exception as error:  # each codec raises errors of its own, bz2 the system's
            raise self._damage(place, error) from error

    def _damage(self, place: tuple[int, ...], error: Exception) -> InputError:
        return InputError(
            f"{self._named(place)} is damaged ({one_line(error)})",
            "copy the store again, or write this chunk anew from its source",
        )

    def _check_missing(self, place: tuple[int, ...]) -> None:
        """Note that a file is missing, or refuse it where the store says that it had one."""
        self._path.stat()  # raises where the whole store has gone
        file = self._files.file_of(place)
        self._missing.add(file)
        if self._stored is not None and is_in_runs(self._files.number(file), self._stored):
            raise InputError(
                f"{self._named(place)} is missing: it was there when the store was written",
                "copy the store again; or, if another program has emptied the chunk, "
                'remove "stored" of "accelsurf" from zarr.json',
            )

    def _named(self, place: tuple[int, ...]) -> str:
        return f"chunk ({', '.join(map(str, place))}) of the array {self._name}"

    @property
    def _fill_value(self) -> Any:
        """Value of voxels whose chunk is missing; Zarr 2 may not say it."""
        value = self._array.metadata.fill_value
        return np.asarray(0 if value is None else value, self.dtype)

    def missing(self, listed: bool = True) -> str:
        """A warning with the number of files of chunks that are missing; empty where none is, or the store says why.

        Parameters
        ----------
        listed : bool, optional
            Whether to look into the folders of the array; otherwise those count that were met while it was read.

        Raises
        ------
        OSError
            When a folder cannot be read.
        """
        if self._stored is not None:
            return ""
        places = zip(self._index, self._files.file_shape, strict=True)
        wanted = [None if n is None else n // width for n, width in places]
        count = math.prod(
            n for n, only in zip(self._files.grid, wanted, strict=True) if only is None
        )
        absent = (
            count - sum(1 for _ in self._files.places(wanted)) if listed else len(self._missing)
        )
        if absent == 0:
            return ""
        return (
            f"{absent} of {count} chunks of the array {self._name} are not in the store, and {self._fill_value} stands "
            "there: programs leave out chunks that hold only this value; if the image has blocks of it where it should "
            "not, copy the store again"
        )
