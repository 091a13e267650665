"""The files of the chunks of an array: one for each chunk, or shards with many. zarr unpacks them.

For a Blosc chunk that is cut short numcodecs returns the memory behind it, or earlier content. So the head of such a
chunk is compared with its file before zarr reads it. Missing chunks are told apart from damaged ones, and from chunks
that a shard itself marks as left out.
"""

from __future__ import annotations

import bisect
import functools
import math
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from accelsurf.errors import InputError
from accelsurf.io.headers import check_within_store
from accelsurf.settings import budgets

#: In the attribute of accelsurf of a group: for each array that it wrote, the files of the chunks, as `runs_of`.
STORED_KEY = "stored"
_SHARDS = "sharding_indexed"
#: Codecs that cannot run code of a store, as pickle does, and whose damaged chunks are refused: tests cut all of them.
_KNOWN = frozenset(
    (
        "bytes",
        "transpose",
        "shuffle",
        "blosc",
        "zstd",
        "gzip",
        "zlib",
        "lz4",
        "lzma",
        "bz2",
        "crc32c",
    )
)
#: A check sum behind the packed values, and its bytes.
_CRC = "crc32c"
_CRC_BYTES = 4
#: In the index of a shard, twice, for a chunk that was left out.
_LEFT_OUT = 2**64 - 1
#: Bytes of a Blosc chunk that say how long it is.
_BLOSC_HEAD = 16


class _Shards(NamedTuple):
    """Index of the shards of an array: chunks along each axis, type of its numbers, and where it is."""

    parts: tuple[int, ...]
    dtype: np.dtype[Any]
    is_checked: bool
    at_start: bool

    @property
    def length(self) -> int:
        """Numbers in the index: first byte and length of each chunk."""
        return 2 * math.prod(self.parts)

    @property
    def index_bytes(self) -> int:
        """Bytes of the index with its check sum."""
        return 8 * self.length + (_CRC_BYTES if self.is_checked else 0)


class _Range(NamedTuple):
    """Bytes of a file."""

    begin: int
    size: int


class ChunkFiles:
    """The files of the chunks of an array.

    Parameters
    ----------
    folder : Path
        The group.
    name : str
        Path of the array within it.
    array : zarr.Array

    Attributes
    ----------
    chunk_shape : tuple of int
        Voxels of a chunk along each axis.
    file_shape : tuple of int
        Voxels of a file along each axis.
    grid : tuple of int
        Files along each axis.

    Raises
    ------
    InputError
        When its chunks, or the index of its shards, are packed in a way that is not known here.
    """

    def __init__(self, folder: Path, name: str, array: Any) -> None:
        self._folder, self._root = folder, folder / name
        self._metadata = array.metadata
        self.chunk_shape = tuple(map(int, array.chunks))
        self.file_shape = tuple(map(int, array.shards or array.chunks))
        widths = zip(array.shape, self.file_shape, strict=True)
        self.grid = tuple(-(-int(n) // width) for n, width in widths)
        codecs = self._codecs()
        self._shards: _Shards | None = None
        if codecs == [_SHARDS]:
            sharding = self._metadata.codecs[0].to_dict()["configuration"]
            self._shards = self._index_of(sharding["index_codecs"], sharding["index_location"])
            codecs = [codec["name"] for codec in sharding["codecs"]]
        names = [name.removeprefix("numcodecs.") for name in codecs]
        if unknown := [name for name in names if name not in _KNOWN]:
            raise InputError(
                f"chunks packed with the codec {unknown[0][:40]} given, one of {', '.join(sorted(_KNOWN))} expected",
                "save the image again with the codec zstd or blosc",
            )
        self._checksum_bytes = _CRC_BYTES * names.count(_CRC)
        self._is_blosc = "blosc" in names

    def _codecs(self) -> list[str]:
        """Names of the codecs in the order of packing."""
        if self._metadata.zarr_format == 3:
            return [codec.to_dict()["name"] for codec in self._metadata.codecs]
        codecs = (*(self._metadata.filters or ()), self._metadata.compressor)
        return [codec.get_config()["id"] for codec in codecs if codec is not None]

    def _index_of(self, codecs: Sequence[Mapping[str, Any]], location: Any) -> _Shards:
        """The index of the shards, by its codecs."""
        names = [codec["name"] for codec in codecs]
        if names not in (["bytes"], ["bytes", _CRC]):
            raise InputError(
                f"shards with an index packed with {', '.join(names)[:80]} given",
                "save the image again without shards",
            )
        is_big = (codecs[0].get("configuration") or {}).get("endian") == "big"
        widths = zip(self.file_shape, self.chunk_shape, strict=True)
        parts = tuple(whole // part for whole, part in widths)
        dtype = np.dtype(">u8" if is_big else "<u8")
        shards = _Shards(parts, dtype, len(names) > 1, str(location).endswith("start"))
        budgets.ZARR_CHUNK.check(shards.index_bytes, "the index of a shard of the Zarr")
        return shards

    def file_of(self, place: Sequence[int]) -> tuple[int, ...]:
        """The place of the file of a chunk."""
        widths = zip(self.file_shape, self.chunk_shape, strict=True)
        return tuple(n // (whole // part) for n, (whole, part) in zip(place, widths, strict=True))

    def check(self, place: Sequence[int]) -> None:
        """Compare a chunk with its file.

        Parameters
        ----------
        place : sequence of int
            Of the chunk, all axes.

        Raises
        ------
        FileNotFoundError
            When there is no file of it; OSError when it cannot be read.
        InputError
            When a link to it leads out of the store.
        ValueError
            When the chunk announces other numbers of bytes than are there.
        """
        path = self._root / self._metadata.encode_chunk_key(self.file_of(place))
        check_within_store(self._folder, path)
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise ValueError("it is no file")
        with path.open("rb") as file:
            part: _Range | None = _Range(0, found.st_size)
            if self._shards is not None:
                part = self._entry(file, found.st_size, self._shards, place)
            if part is None:
                return
            if self._is_blosc:
                file.seek(part.begin)
                _check_blosc(file.read(_BLOSC_HEAD), part.size - self._checksum_bytes)

    def _entry(
        self, file: BinaryIO, file_bytes: int, shards: _Shards, place: Sequence[int]
    ) -> _Range | None:
        """Bytes of a chunk in a shard; None where the shard says that it was left out."""
        low, high = 0, file_bytes - shards.index_bytes
        if high < low:
            raise ValueError(
                f"its shard has {file_bytes} bytes, its index alone {shards.index_bytes}"
            )
        file.seek(0 if shards.at_start else high)
        if shards.at_start:
            low, high = shards.index_bytes, file_bytes
        index = np.frombuffer(file.read(8 * shards.length), shards.dtype).reshape(-1, 2)
        is_there = (index != _LEFT_OUT).any(axis=1)
        # Without a check sum only its place says that it is the index: behind the last chunk, without a gap.
        end = int((index[is_there, 0] + index[is_there, 1]).max(initial=0))
        if not shards.is_checked and not shards.at_start and end != high:
            raise ValueError(f"its shard has {high} bytes of chunks, its index announces {end}")
        within = tuple(n % parts for n, parts in zip(place, shards.parts, strict=True))
        number = int(np.ravel_multi_index(within, shards.parts))
        if not is_there[number]:
            return None
        begin, size = (int(n) for n in index[number])
        if not (low <= begin and 0 < size and begin + size <= high):
            raise ValueError(
                f"its shard has it at {begin} to {begin + size}, of bytes {low} to {high} of chunks"
            )
        return _Range(begin, size)

    def places(self, wanted: Sequence[int | None]) -> Iterator[tuple[int, ...]]:
        """The places of the files that are there, by the names in the folders of the array.

        Parameters
        ----------
        wanted : sequence of int or None
            For each axis the place of the files along it; None: all.

        Raises
        ------
        OSError
            When a folder cannot be read.
        """
        for folder, _, names in os.walk(self._root, onerror=_raise):
            for name in names:
                key = Path(folder, name).relative_to(self._root).as_posix()
                place = tuple(map(int, re.findall("[0-9]+", key)))
                if len(place) != len(wanted) or self._metadata.encode_chunk_key(place) != key:
                    continue
                axes = zip(place, wanted, self.grid, strict=True)
                if all(n < count and only in (None, n) for n, only, count in axes):
                    yield place

    def number(self, place: Sequence[int]) -> int:
        """The number of a file in the order of the array."""
        return functools.reduce(
            lambda number, axis: number * axis[1] + axis[0], zip(place, self.grid, strict=True), 0
        )


def _raise(error: OSError) -> None:
    """Pass on why a folder cannot be read."""
    raise error


def _check_blosc(head: bytes, size: int) -> None:
    """Compare the first bytes of a Blosc chunk with its number of bytes.

    Raises
    ------
    ValueError
        With the numbers of bytes.
    """
    there = int.from_bytes(head[12:16], "little")
    if there != size or size < _BLOSC_HEAD:
        raise ValueError(f"Blosc announces {there} bytes, {size} are there")
    announced = int.from_bytes(head[4:8], "little")
    if head[2] & 2 and announced + _BLOSC_HEAD != size:
        raise ValueError(f"Blosc announces {announced} bytes that are not packed")


def runs_of(numbers: Iterable[int]) -> list[int]:
    """Numbers as runs: a first number, that behind the last that follows it without a gap, the next first, and so on.

    Examples
    --------
    >>> runs_of([5, 3, 4, 9])
    [3, 6, 9, 10]
    """
    edges: list[int] = []
    for number in sorted(numbers):
        if edges and edges[-1] == number:
            edges[-1] = number + 1
        else:
            edges += [number, number + 1]
    return edges


def is_in_runs(number: int, runs: Sequence[int]) -> bool:
    """Test if a number is in runs of `runs_of`.

    Examples
    --------
    >>> [is_in_runs(n, [3, 6, 9, 10]) for n in (2, 3, 5, 6, 9, 10)]
    [False, True, True, False, True, False]
    """
    return bisect.bisect_right(runs, number) % 2 == 1


def with_record(attributes: Mapping[str, Any], folder: Path, group: Any) -> dict[str, Any]:
    """The attribute of accelsurf of a group that was written, with the files of the chunks of its arrays.

    A chunk of zeros is left out; so one that is missing later is known to have been lost, or to have never been there.
    """
    stored = {}
    for name, array in sorted(group.arrays()):
        files = ChunkFiles(folder, name, array)
        stored[name] = runs_of(map(files.number, files.places([None] * array.ndim)))
    return {**attributes, STORED_KEY: stored}
