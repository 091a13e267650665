"""Arrays as the protocol packs them: a header, and chunks of blosc2. A header's claims are checked before memory is.

An array is ``NNIA``, a version, a codec, the numbers of axes and of letters of the type's name, that name, the shape
as int64, and a number of chunks as uint32. Each chunk has its size unpacked and packed as uint64, and is a frame of
blosc2, which says both sizes again. All numbers are little-endian.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import blosc2
import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError

MAGIC = b"NNIA"
VERSION = 1
#: Number of a codec -> the codec.
CODECS = {1: blosc2.Codec.ZSTD, 2: blosc2.Codec.LZ4}
#: Types that are read, by name.
_NAMES = "bool int8 uint8 int16 uint16 int32 uint32 int64 uint64 float16 float32 float64"
TYPES = {name: np.dtype(name) for name in _NAMES.split()}
MAX_AXES = 4
#: Bytes of a chunk that is written, and the most of one that is read: blosc2 counts with 31 bits.
CHUNK = 1 << 30
MAX_CHUNK = (1 << 31) - 1
#: A header, and the sizes before each chunk.
_HEADER = struct.Struct("<4sBBBB")
_SIZES = struct.Struct("<QQ")
#: The header of a frame: sizes unpacked, of a block, and packed.
_FRAME = struct.Struct("<4x3I")


class TooLargeError(InputError):
    """An array or a body that is larger than this server takes."""

    kind = "too-large"


class Header(NamedTuple):
    """The header of a packed array.

    Attributes
    ----------
    dtype : numpy.dtype
    shape : tuple of int
    end : int
        Bytes of the header.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    end: int

    @property
    def nbytes(self) -> int:
        """Bytes of the array."""
        return math.prod(self.shape) * self.dtype.itemsize


def header_of(body: bytes | bytearray | memoryview) -> Header:
    """Read the header of a packed array.

    Raises
    ------
    InputError
        When it is none.
    """
    if len(body) < _HEADER.size:
        raise InputError("array: a body without a header was sent", "send a packed array")
    magic, version, codec, axes, letters = _HEADER.unpack_from(body)
    if magic != MAGIC or version != VERSION or codec not in CODECS:
        raise InputError(
            "array: a body of another form was sent", f"send version {VERSION} of the packing"
        )
    name = bytes(body[_HEADER.size : _HEADER.size + letters])
    dtype = TYPES.get(name.decode("ascii", "replace"))
    end = _HEADER.size + letters + 8 * axes
    if dtype is None or not 0 < axes <= MAX_AXES or len(body) < end:
        raise InputError(
            f"array: {axes} axes of {name[:20]!r} were sent, 1 to {MAX_AXES} axes of numbers expected"
        )
    shape = struct.unpack_from(f"<{axes}q", body, end - 8 * axes)
    if min(shape) < 1:
        raise InputError(
            f"array: the shape {shape} was sent, at least one place along each axis expected"
        )
    return Header(dtype, shape, end)


def unpack(body: bytes | bytearray, max_bytes: int) -> NDArray[Any]:
    """Return a packed array.

    Parameters
    ----------
    body : bytes
    max_bytes : int
        The most that the array may have.

    Raises
    ------
    InputError
        When the body is damaged; TooLargeError when the array has more bytes.
    """
    header = header_of(body)
    if header.nbytes > max_bytes:
        raise TooLargeError(
            f"array: {header.nbytes} bytes, at most {max_bytes} expected",
            "send a part of the image, or fewer bits",
        )
    view = memoryview(body)
    chunks = list(_chunks(view, header))
    out = np.empty(header.shape, header.dtype.newbyteorder("<"))
    flat, first = out.reshape(-1).view(np.uint8), 0
    for frame, size in chunks:
        try:
            blosc2.decompress2(frame, dst=flat[first : first + size])
        except (ValueError, RuntimeError, TypeError):
            raise InputError(
                "array: a chunk cannot be unpacked", "it is damaged: send it again"
            ) from None
        first += size
    return out


def _chunks(view: memoryview, header: Header) -> Iterator[tuple[bytes, int]]:
    """Frames of a packed array and their sizes unpacked, all of them checked before one is unpacked."""
    damaged = InputError("array: its chunks do not fit its header", "it is damaged: send it again")
    place, left = header.end + 4, header.nbytes
    if len(view) < place:
        raise damaged
    (count,) = struct.unpack_from("<I", view, header.end)
    for _ in range(count):
        if len(view) < place + _SIZES.size:
            raise damaged
        size, packed = _SIZES.unpack_from(view, place)
        place += _SIZES.size
        frame = bytes(view[place : place + packed])
        if not 0 < size <= min(left, MAX_CHUNK) or len(frame) != packed or packed < 32:
            raise damaged
        # blosc2 allocates by these numbers.
        unpacked, block, length = _FRAME.unpack_from(frame)
        if (unpacked, length) != (size, packed) or not 0 < block <= unpacked:
            raise damaged
        yield frame, size
        place, left = place + packed, left - size
    if left or place != len(view):
        raise damaged


def pack(array: NDArray[Any]) -> bytes:
    """Return an array, packed.

    Examples
    --------
    >>> unpack(pack(np.arange(6, dtype=np.uint8).reshape(1, 2, 3)), 6).tolist()
    [[[0, 1, 2], [3, 4, 5]]]
    """
    array = np.ascontiguousarray(array)
    name = array.dtype.name.encode()
    flat = array.reshape(-1).view(np.uint8)
    starts = range(0, flat.size, CHUNK)
    parts = [
        _HEADER.pack(MAGIC, VERSION, 2, array.ndim, len(name)),
        name,
        struct.pack(f"<{array.ndim}q", *array.shape),
        struct.pack("<I", len(starts)),
    ]
    for first in starts:
        piece = flat[first : first + CHUNK]
        frame = blosc2.compress2(
            piece,
            typesize=array.dtype.itemsize,
            codec=blosc2.Codec.LZ4,
            clevel=3,
            filters=[blosc2.Filter.NOFILTER],
        )
        parts += [_SIZES.pack(piece.size, len(frame)), frame]
    return b"".join(parts)
