"""Chunks of a Zarr, unpacked: what each codec announces is compared with the bytes that are there.

numcodecs believes what a chunk says of itself: of a Blosc chunk that is cut short it returns what lies in the memory
behind it, or what was there before; tails are left unread; sizes are allocated as they are claimed. So the bytes are
checked here before and after a codec. Codecs that are not in the list below are refused by name.
"""

from __future__ import annotations

import bz2
import lzma
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError

#: Beyond the values of a chunk: check sums, and the heads of packed streams.
_SLACK = 4096
#: How many times as large as the values the data of a filter may be: a byte may be stored as a float of 8.
_FILTERED = 8
#: Memory of the dictionary of LZMA.
_LZMA_BYTES = 1 << 30
_PREFIX = "numcodecs."
#: Codecs of numcodecs that keep each value, or check their bytes by themselves.
_FILTERS = (
    *("shuffle", "delta", "fixedscaleoffset", "quantize", "bitround", "astype", "packbits"),
    *("crc32", "adler32", "fletcher32", "jenkins_lookup3"),
)
Config = Mapping[str, Any]


@dataclass(frozen=True)
class ChunkFormat:
    """Packing of a chunk of an array.

    Attributes
    ----------
    shape : tuple of int
        Of the chunk, all axes.
    dtype : numpy.dtype
        Of the values as they are stored.
    steps : tuple of (name, configuration)
        Codecs in the order of unpacking, without those of the other attributes.
    order : tuple of int
        Which axis of the chunk each stored axis is.
    by_columns : bool
        Whether the first stored axis varies fastest.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    steps: tuple[tuple[str, Config], ...]
    order: tuple[int, ...]
    by_columns: bool = False

    @property
    def value_bytes(self) -> int:
        """Bytes of the values."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def limit(self) -> int:
        """Bytes that a codec may unpack to, or a packed chunk may have."""
        filtered = any(name in _FILTERS for name, _ in self.steps)
        return self.value_bytes * (_FILTERED if filtered else 1) + _SLACK

    def decode(self, packed: bytes) -> NDArray[Any]:
        """Return the values of a chunk, of its whole shape.

        Raises
        ------
        ValueError
            When the bytes are not those of a chunk of this format, with what differs. Codecs raise errors of further
            kinds.
        """
        data: Any = packed
        for name, config in self.steps:
            data = _UNPACKED.get(name, _filtered)(data, self.limit, {"id": name, **config})
        values = np.frombuffer(data, np.uint8)
        if values.size != self.value_bytes:
            raise ValueError(f"{values.size} bytes of values are in it, {self.value_bytes} expected")
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
    steps, order, filtered = [], list(range(len(shape))), False
    for codec in codecs:
        name, config = str(codec["name"]).removeprefix(_PREFIX), codec.get("configuration") or {}
        if name == "bytes":
            dtype = dtype.newbyteorder("<" if config.get("endian", "little") == "little" else ">")
        elif name == "transpose" and not filtered:
            order = [order[axis] for axis in config["order"]]
        else:
            filtered = filtered or name in _FILTERS
            steps.append((_known(name), config))
    return ChunkFormat(tuple(shape), dtype, tuple(steps[::-1]), tuple(order))


def format_of_v2(shape: Sequence[int], dtype: np.dtype[Any], codecs: Sequence[Config], by_columns: bool) -> ChunkFormat:
    """The format of chunks by the filters and the compressor of Zarr 2, in this order; as `format_of`."""
    steps = [(_known(str(codec["id"])), codec) for codec in codecs]
    return ChunkFormat(tuple(shape), dtype, tuple(steps[::-1]), tuple(range(len(shape))), by_columns)


def _known(name: str) -> str:
    if name not in _UNPACKED and name not in _FILTERS:
        known = ", ".join([*_UNPACKED, *_FILTERS])
        raise InputError(
            f"chunks packed with the codec {name[:40]} given, one of {known} expected",
            "save the image again with the codec zstd or blosc",
        )
    return name


def _filtered(data: Any, limit: int, config: Config) -> Any:
    """The data before a filter of numcodecs; a check sum says by itself whether the bytes are right."""
    return _by_numcodecs(data, config)


def _by_numcodecs(data: Any, config: Config) -> NDArray[np.uint8]:
    import numcodecs

    found = np.asarray(numcodecs.get_codec(dict(config)).decode(data))
    if found.dtype.hasobject:
        raise ValueError(f"the codec {config['id']} gives no numbers")
    return np.ascontiguousarray(found).reshape(-1).view(np.uint8)


def _checked_size(announced: int, limit: int) -> None:
    if announced > limit:
        raise ValueError(f"{announced} bytes of values are announced, at most {limit} expected")


def _blosc(data: Any, limit: int, config: Config) -> Any:
    head = memoryview(data)[:16].tobytes()
    size = int.from_bytes(head[12:16], "little") if len(head) == 16 else 16
    if len(data) != size or size < 16:
        raise ValueError(f"Blosc announces {size} bytes, {len(data)} are there")
    announced = int.from_bytes(head[4:8], "little")
    _checked_size(announced, limit)
    if head[2] & 2 and announced + 16 != size:
        raise ValueError(f"Blosc announces {announced} bytes of values that are not packed, {size - 16} are there")
    return _by_numcodecs(data, {"id": "blosc"})


def _zstd(data: Any, limit: int, config: Config) -> Any:
    _checked_size(_zstd_size(memoryview(data)[:18].tobytes()), limit)
    return _by_numcodecs(data, {"id": "zstd"})


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


def _lz4(data: Any, limit: int, config: Config) -> Any:
    if len(data) < 4:
        raise ValueError(f"{len(data)} bytes are there")
    _checked_size(int.from_bytes(memoryview(data)[:4].tobytes(), "little"), limit)
    return _by_numcodecs(data, {"id": "lz4"})


def _inflated(make: Callable[[Config], Any]) -> Callable[[Any, int, Config], bytes]:
    """Unpacking of one stream or several, one behind the other, to their ends."""

    def unpacked(data: Any, limit: int, config: Config) -> bytes:
        found, rest = b"", bytes(data)
        while rest or not found:
            stream = make(config)
            found += stream.decompress(rest, limit + 1 - len(found))
            _checked_size(len(found), limit)
            if not stream.eof:
                raise ValueError("it ends within its packed values")
            rest = stream.unused_data
        return found

    return unpacked


def _lzma(config: Config) -> Any:
    form = config.get("format", lzma.FORMAT_XZ)
    if form == lzma.FORMAT_RAW:
        return lzma.LZMADecompressor(form, filters=config.get("filters"))
    return lzma.LZMADecompressor(form, _LZMA_BYTES)


def _crc32c(data: Any, limit: int, config: Config) -> Any:
    from google_crc32c import value

    content, stored = bytes(data)[:-4], bytes(data)[-4:]
    if len(stored) < 4 or value(content).to_bytes(4, "little") != stored:
        raise ValueError("its check sum (crc32c) is of other bytes")
    return content


_UNPACKED: dict[str, Callable[[Any, int, Config], Any]] = {
    "blosc": _blosc,
    "zstd": _zstd,
    "lz4": _lz4,
    "gzip": _inflated(lambda config: zlib.decompressobj(31)),
    "zlib": _inflated(lambda config: zlib.decompressobj(15)),
    "bz2": _inflated(lambda config: bz2.BZ2Decompressor()),
    "lzma": _inflated(_lzma),
    "crc32c": _crc32c,
}
