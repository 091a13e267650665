"""The files of the chunks of an array: one for each chunk, or shards with many.

What is missing is told apart from what is damaged, and from what a shard itself says was left out.

numcodecs believes what a chunk says of itself: of a Blosc chunk that is cut short it returns what lies in the memory
behind it, or what was there before; tails are left unread; sizes are allocated as they are claimed. So the bytes are
checked here before and after a codec. Codecs that are not in the list below are refused by name.
"""

from __future__ import annotations

import bisect
import functools
import math
import os
import stat
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.headers import check_within_store
from accelsurf.io.lazy_volume import ChunkCache
from accelsurf.settings import budgets

#: Beyond the values of a chunk: check sums, and the heads of packed streams.
_SLACK = 4096
_PREFIX = "numcodecs."
Config = Mapping[str, Any]
#: In the attribute of accelsurf of a group: for each array that it wrote, the files of the chunks, as `runs_of`.
STORED_KEY = "stored"
_SHARDS = "sharding_indexed"
#: What the index of a shard has, twice, for a chunk that was left out.
_LEFT_OUT = 2**64 - 1
#: Bytes of indices of shards that are held.
_INDEX_BYTES = 1 << 25


@dataclass(frozen=True)
class ChunkFormat:
    """Packing of a chunk of an array.

    Attributes
    ----------
    shape : tuple of int
        Of the chunk, all axes.
    dtype : numpy.dtype
        Of the values as they are stored.
    steps : tuple of str
        Codecs in the order of unpacking, without those of the other attributes.
    order : tuple of int
        Which axis of the chunk each stored axis is.
    by_columns : bool
        Whether the first stored axis varies fastest.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    steps: tuple[str, ...]
    order: tuple[int, ...]
    by_columns: bool = False

    @property
    def value_bytes(self) -> int:
        """Bytes of the values."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def limit(self) -> int:
        """Bytes that a codec may unpack to, or a packed chunk may have."""
        return self.value_bytes + _SLACK

    def decode(self, packed: bytes) -> NDArray[Any]:
        """Return the values of a chunk, of its whole shape.

        Raises
        ------
        ValueError
            When the bytes are not those of a chunk of this format, with what differs. Codecs raise errors of further
            kinds.
        """
        data: Any = packed
        for name in self.steps:
            data = _UNPACKED[name](data, self.limit)
        values = np.frombuffer(data, np.uint8)
        if values.size != self.value_bytes:
            raise ValueError(
                f"{values.size} bytes of values are in it, {self.value_bytes} expected"
            )
        stored = values.view(self.dtype).reshape(
            [self.shape[axis] for axis in self.order], order="F" if self.by_columns else "C"
        )
        return stored.transpose(np.argsort(self.order))


def format_of(shape: Sequence[int], dtype: np.dtype[Any], codecs: Sequence[Config]) -> ChunkFormat:
    """The format of chunks by the codecs of Zarr 3.

    Parameters
    ----------
    shape : sequence of int
        Of a chunk.
    dtype : numpy.dtype
        Of the values.
    codecs : sequence of dict
        With name and configuration, in the order of packing.

    Raises
    ------
    InputError
        When one of them is not known here.
    """
    steps, order = list[str](), list(range(len(shape)))
    for codec in codecs:
        name, config = str(codec["name"]).removeprefix(_PREFIX), codec.get("configuration") or {}
        if name == "bytes":
            dtype = dtype.newbyteorder("<" if config.get("endian", "little") == "little" else ">")
        elif name == "transpose":
            order = [order[axis] for axis in config["order"]]
        else:
            steps.append(_known(name))
    return ChunkFormat(tuple(shape), dtype, tuple(steps[::-1]), tuple(order))


def format_of_v2(
    shape: Sequence[int], dtype: np.dtype[Any], codecs: Sequence[Config], by_columns: bool
) -> ChunkFormat:
    """The format of chunks by the filters and the compressor of Zarr 2, in this order; as `format_of`."""
    steps = [_known(str(codec["id"])) for codec in codecs]
    return ChunkFormat(
        tuple(shape), dtype, tuple(steps[::-1]), tuple(range(len(shape))), by_columns
    )


def _known(name: str) -> str:
    if name not in _UNPACKED:
        raise InputError(
            f"chunks packed with the codec {name[:40]} given, one of {', '.join(_UNPACKED)} expected",
            "save the image again with the codec zstd or blosc",
        )
    return name


def _by_numcodecs(data: Any, name: str) -> NDArray[np.uint8]:
    import numcodecs

    return (
        np.ascontiguousarray(numcodecs.get_codec({"id": name}).decode(data))
        .reshape(-1)
        .view(np.uint8)
    )


def _checked_size(announced: int, limit: int) -> None:
    if announced > limit:
        raise ValueError(f"{announced} bytes of values are announced, at most {limit} expected")


def _blosc(data: Any, limit: int) -> Any:
    head = memoryview(data)[:16].tobytes()
    size = int.from_bytes(head[12:16], "little") if len(head) == 16 else 16
    if len(data) != size or size < 16:
        raise ValueError(f"Blosc announces {size} bytes, {len(data)} are there")
    announced = int.from_bytes(head[4:8], "little")
    _checked_size(announced, limit)
    if head[2] & 2 and announced + 16 != size:
        raise ValueError(
            f"Blosc announces {announced} bytes of values that are not packed, {size - 16} are there"
        )
    return _by_numcodecs(data, "blosc")


def _zstd(data: Any, limit: int) -> Any:
    _checked_size(_zstd_size(memoryview(data)[:18].tobytes()), limit)
    return _by_numcodecs(data, "zstd")


def _zstd_size(head: bytes) -> int:
    """The size that the first frame announces; 0 where it announces none."""
    if len(head) < 6 or head[:4] != b"\x28\xb5\x2f\xfd":
        raise ValueError("it does not begin as zstd does")
    flags = head[4]
    single = flags >> 5 & 1
    at = 5 + (0 if single else 1) + (0, 1, 2, 4)[flags & 3]
    width = (single, 2, 4, 8)[flags >> 6]
    size = int.from_bytes(head[at : at + width], "little")
    return size + 256 if width == 2 else size


def _inflated(data: Any, limit: int) -> bytes:
    """Unpacking of one stream of gzip or zlib or several, one behind the other, to their ends."""
    found, rest = b"", bytes(data)
    while rest or not found:
        stream = zlib.decompressobj(47)
        found += stream.decompress(rest, limit + 1 - len(found))
        _checked_size(len(found), limit)
        if not stream.eof:
            raise ValueError("it ends within its packed values")
        rest = stream.unused_data
    return found


def _crc32c(data: Any, limit: int) -> Any:
    from google_crc32c import value

    content, stored = bytes(data)[:-4], bytes(data)[-4:]
    if len(stored) < 4 or value(content).to_bytes(4, "little") != stored:
        raise ValueError("its check sum (crc32c) is of other bytes")
    return content


_UNPACKED: dict[str, Callable[[Any, int], Any]] = {
    "blosc": _blosc,
    "zstd": _zstd,
    "gzip": _inflated,
    "zlib": _inflated,
    "crc32c": _crc32c,
}


class ChunkFiles:
    """The packed chunks of an array.

    Parameters
    ----------
    folder : Path
        The group.
    name : str
        Path of the array within it.
    array : zarr.Array
        Its metadata.

    Attributes
    ----------
    chunk : ChunkFormat
        Of the chunks.
    file_shape : tuple of int
        Voxels of a file along each axis.
    grid : tuple of int
        Files along each axis.

    Raises
    ------
    InputError
        When the chunks are packed in a way that is not known here.
    """

    def __init__(self, folder: Path, name: str, array: Any) -> None:
        self._folder, self._name = folder, name
        self._metadata = array.metadata
        self.file_shape = tuple(map(int, array.shards or array.chunks))
        self.grid = tuple(
            -(-int(n) // width) for n, width in zip(array.shape, self.file_shape, strict=True)
        )
        self._in_shard: tuple[int, ...] | None = None
        self.chunk = self._format(array)
        self._indices = ChunkCache(_INDEX_BYTES)

    def _format(self, array: Any) -> ChunkFormat:
        said, dtype = self._metadata, np.dtype(array.dtype)
        if said.zarr_format == 2:
            codecs = [
                codec.get_config()
                for codec in (*(said.filters or ()), said.compressor)
                if codec is not None
            ]
            return format_of_v2(array.chunks, dtype, codecs, said.order == "F")
        codecs = [codec.to_dict() for codec in said.codecs]
        if codecs[0]["name"] != _SHARDS or len(codecs) > 1:
            return format_of(array.chunks, dtype, codecs)
        sharding = codecs[0]["configuration"]
        parts = self._in_shard = tuple(
            a // b for a, b in zip(self.file_shape, array.chunks, strict=True)
        )
        index = [codec["name"] for codec in sharding["index_codecs"]]
        if index not in (["bytes"], ["bytes", "crc32c"]):
            what = f"shards with an index packed with {', '.join(index)[:80]} given"
            raise InputError(what, "save the image again without shards")
        self._index = format_of((*parts, 2), np.dtype("u8"), sharding["index_codecs"])
        self._index_bytes = self._index.value_bytes + 4 * (len(index) - 1)
        budgets.ZARR_CHUNK.check(self._index_bytes, "the index of a shard of the Zarr")
        self._checked, self._at_start = len(index) > 1, sharding["index_location"] == "start"
        return format_of(array.chunks, dtype, sharding["codecs"])

    def file_of(self, place: Sequence[int]) -> tuple[int, ...]:
        """The place of the file of a chunk."""
        widths = zip(self.file_shape, self.chunk.shape, strict=True)
        return tuple(n // (whole // part) for n, (whole, part) in zip(place, widths, strict=True))

    def read(self, place: Sequence[int]) -> bytes | None:
        """Return the bytes of a chunk; None where its shard says that it was left out.

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
            When the file is of another size than it announces.
        """
        path = self._path(self.file_of(place))
        check_within_store(self._folder, path)
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise ValueError("it is no file")
        with path.open("rb") as file:
            if self._in_shard is None:
                return _exactly(file, 0, found.st_size, 2 * self.chunk.limit)
            entry = self._entry(file, found, place)
            return None if entry is None else _exactly(file, *entry, 2 * self.chunk.limit)

    def _path(self, place: tuple[int, ...]) -> Path:
        return self._folder / self._name / self._metadata.encode_chunk_key(place)

    def _entry(
        self, file: Any, found: os.stat_result, place: Sequence[int]
    ) -> tuple[int, int] | None:
        """First byte of a chunk in a shard, and its number of bytes."""
        key = found.st_ino, found.st_size, found.st_mtime_ns
        index = self._indices.get(key, lambda: self._read_index(file, found.st_size))
        assert self._in_shard is not None
        first, size = map(
            int, index[tuple(n % parts for n, parts in zip(place, self._in_shard, strict=True))]
        )
        if first == size == _LEFT_OUT:
            return None
        low, high = self._bounds(found.st_size)
        if not (low <= first and 0 < size and first + size <= high):
            raise ValueError(
                f"its shard has it at {first} to {first + size}, of bytes {low} to {high} of chunks"
            )
        return first, size

    def _bounds(self, file_bytes: int) -> tuple[int, int]:
        """First byte and end of the chunks of a shard."""
        return (
            (self._index_bytes, file_bytes)
            if self._at_start
            else (0, file_bytes - self._index_bytes)
        )

    def _read_index(self, file: Any, file_bytes: int) -> NDArray[Any]:
        low, high = self._bounds(file_bytes)
        if high < low:
            raise ValueError(
                f"its shard has {file_bytes} bytes, its index alone {self._index_bytes}"
            )
        begin = 0 if self._at_start else high
        index = self._index.decode(_exactly(file, begin, self._index_bytes, file_bytes))
        if not self._checked and not self._at_start:
            # Only the place of the index says that it is one: behind the last chunk, without a gap.
            ends = [
                int(a) + int(b)
                for a, b in index.reshape(-1, 2).tolist()
                if (a, b) != (_LEFT_OUT, _LEFT_OUT)
            ]
            if max(ends, default=0) != high:
                raise ValueError(
                    f"its shard has {high} bytes of chunks, its index announces {max(ends, default=0)}"
                )
        return np.array(index)

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
        root, start, split = self._folder / self._name, "", "."
        if self._metadata.zarr_format == 2:
            split = self._metadata.dimension_separator
        else:
            split = self._metadata.chunk_key_encoding.separator
            start = f"c{split}" if self._metadata.chunk_key_encoding.name == "default" else ""
        if split == "/":
            yield from self._walk(root / start, (), wanted)
            return
        for name in _names(root):
            parts = name.removeprefix(start).split(split) if name.startswith(start) else []
            if len(parts) == len(wanted) and all(
                map(self._is_place, range(len(parts)), parts, wanted)
            ):
                yield tuple(map(int, parts))

    def _walk(
        self, folder: Path, place: tuple[int, ...], wanted: Sequence[int | None]
    ) -> Iterator[tuple[int, ...]]:
        """Walk the files below a folder, as `places` does."""
        axis = len(place)
        is_last = axis == len(wanted) - 1
        for name in _names(folder) if is_last or wanted[axis] is None else (str(wanted[axis]),):
            if self._is_place(axis, name, wanted[axis]):
                below = (*place, int(name))
                yield from (below,) if is_last else self._walk(folder / name, below, wanted)

    def _is_place(self, axis: int, name: str, only: int | None) -> bool:
        if not name.isdecimal() or str(int(name)) != name:
            return False
        return int(name) < self.grid[axis] and only in (None, int(name))

    def number(self, place: Sequence[int]) -> int:
        """The number of a file in the order of the array."""
        return functools.reduce(
            lambda number, axis: number * axis[1] + axis[0], zip(place, self.grid, strict=True), 0
        )


def _names(folder: Path) -> Iterator[str]:
    """The names in a folder; none where there is no folder."""
    try:
        with os.scandir(folder) as entries:
            yield from (entry.name for entry in entries)
    except FileNotFoundError:
        return


def _exactly(file: Any, begin: int, size: int, limit: int) -> bytes:
    """Bytes of a file."""
    if size > limit:
        raise ValueError(f"{size} bytes are there, at most {limit} expected")
    file.seek(begin)
    found: bytes = file.read(size)
    if len(found) != size:
        raise ValueError(f"{size} bytes expected, {len(found)} are there")
    return found


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
