"""PNG: what the header claims, whether it is all there, and how it is written.

ITK reads the pixels, from a copy without the parts that say nothing about them: a note, a profile of colours or a
number of significant bits (by which ITK would divide the values) is not unpacked and not heeded. Headers of PNG
and TIFF keep the size of a pixel and no place in the world: an image starts at the world's origin, along its axes.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import itk
from accelsurf.io.channels import to_grey
from accelsurf.io.formats.deflate import check_unpacked, inflated_bytes
from accelsurf.io.headers import with_warnings
from accelsurf.io.memory import check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

STORED = {
    **{"uint8": (8, 1), "uint16": (16, 1), "uint32": (32, 1), "int8": (8, 2), "int16": (16, 2), "int32": (32, 2)},
    "float32": (32, 3),
}
"""Types of values that a TIFF can hold here: bits and sample format (1 unsigned, 2 signed, 3 floating point)."""

TRUNCATED_HINT = "the file is truncated or damaged: copy or export it again"
_START = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 4, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_CHUNK = 1 << 16
_TRANSPARENT_GREY = ("a grey PNG with transparency given, one without expected", "save it without the alpha channel")
_MAX_SCALE_BYTES = 64
#: The parts that say what the pixels are, by colour type: those of a palette, of a colour, of grey.
_PALETTE, _COLOUR, _GREY = ((b"IHDR", b"IDAT", b"IEND", *more) for more in ((b"PLTE", b"tRNS"), (b"tRNS",), ()))


@dataclass(frozen=True)
class PngHeader:
    """Claims of the header of a PNG, and the check that all of it is there.

    Attributes
    ----------
    data : Path
        The file.
    shape : tuple of int
        (1, rows, columns).
    spacing : tuple of float or None
        mm, (z, y, x); None where it was not given: the file says it further on.
    pixel_bytes : int
        Bytes that a pixel takes in memory, with all its colours.
    unpacked_bytes : int
        Bytes of all rows when unpacked.
    colour : int
        Colour type.
    """

    data: Path
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float] | None
    pixel_bytes: int
    unpacked_bytes: int
    colour: int

    @property
    def values(self) -> int:
        """Number of pixels of the image; colours become one value."""
        return math.prod(self.shape)

    @property
    def geometry(self) -> Geometry | None:
        """The grid; None where the file says it further on."""
        return None if self.spacing is None else Geometry(self.shape, self.spacing)

    def copy_checked(self, out: BinaryIO) -> tuple[float, float] | None:
        """Copy the parts that say what the pixels are; refuse a PNG that is cut short or damaged.

        Every checksum counts, and the number of bytes of the rows.

        Returns
        -------
        tuple of float or None
            Size of a pixel (x, y), where it is said.

        Raises
        ------
        InputError
            With what is wrong.
        """
        known = _PALETTE if self.colour == 3 else _COLOUR if self.colour == 2 else _GREY
        unpack, present, name, scale = zlib.decompressobj(), 0, b"", b""
        out.write(_START)
        with self.data.open("rb") as file:
            file.seek(len(_START))
            while name != b"IEND":
                start = file.read(8)
                if len(start) < 8:
                    raise InputError("the PNG ends before its end mark", hint=TRUNCATED_HINT)
                left, name = struct.unpack(">I4s", start)
                is_copied, check = self._is_copied(name, known), zlib.crc32(name)
                out.write(start if is_copied else b"")
                while left and (piece := file.read(min(left, _CHUNK))):
                    left, check = left - len(piece), zlib.crc32(piece, check)
                    if name == b"IDAT":
                        present += inflated_bytes(unpack, piece)
                        check_unpacked(present, self.unpacked_bytes)
                    scale = piece[:_MAX_SCALE_BYTES] if name == b"sCAL" else scale
                    out.write(piece if is_copied else b"")
                found = file.read(4)
                if left or found != struct.pack(">I", check):
                    part = name.decode("ascii", "replace")
                    raise InputError(f"the part {part} of the PNG is cut short or damaged", hint=TRUNCATED_HINT)
                out.write(found if is_copied else b"")
        if present < self.unpacked_bytes:
            raise InputError(
                f"the header announces {self.unpacked_bytes} bytes of rows, the file holds {present}",
                hint=TRUNCATED_HINT,
            )
        return _scale(scale)

    def _is_copied(self, name: bytes, known: tuple[bytes, ...]) -> bool:
        """Test if a part describes the pixels.

        Raises
        ------
        InputError
            When it says so in a way that is not known.
        """
        if self.colour == 0 and name == b"tRNS":
            raise InputError(*_TRANSPARENT_GREY)
        if name[:1].isupper() and name not in (*known, b"PLTE"):
            part = name.decode("ascii", "replace")
            raise InputError(f"the PNG has a part {part}, without which it cannot be read, and which is not known",
                             "save it as a plain PNG")
        return name in known


def _scale(text: bytes) -> tuple[float, float] | None:
    """Size of a pixel (x, y), by the part that ITK writes it into; None where it says none."""
    try:
        x, y = (float(word) for word in text[1:].split(b"\0"))
    except ValueError:
        return None
    return (x, y) if min(x, y) > 0 and math.isfinite(x) and math.isfinite(y) else None


def read_png(path: Path, header: PngHeader, available: int) -> Volume:
    """Read a PNG.

    Parameters
    ----------
    path : Path
        The file.
    header : PngHeader
        What its header claims.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file is incomplete, larger than the memory, or not what its header claims.
    """
    check_memory(header.shape[::-1], header.pixel_bytes, available)
    with itk.copied(".png") as (copy, out):
        scale = header.copy_checked(out)
        out.close()
        array, note = itk.array_of(copy, "PNGImageIO"), ""
    if array.ndim > 2:
        array, note = to_grey(array)
    if array.shape != header.shape[1:]:
        raise InputError(f"the header announces {header.shape[1:]} pixels, ITK reads {array.shape}", "save it again")
    spacing = header.spacing or (1.0, *(scale or (1.0, 1.0))[::-1])
    return Volume(array[None], Geometry(header.shape, spacing), with_warnings({}, note), path)


def parse_png(path: Path, options: ReadOptions = AS_IT_IS) -> PngHeader:
    """Read the header of a PNG.

    Raises
    ------
    InputError
        When it is none, is damaged, or has grey values with transparency, which ITK cannot read.
    """
    with path.open("rb") as file:
        start = file.read(33)
    if start[:8] != _START or start[12:16] != b"IHDR":
        raise InputError("this is not a PNG image: it does not start as one", hint="is it the right file?")
    if len(start) < 33 or zlib.crc32(start[12:29]) != struct.unpack(">I", start[29:])[0]:
        raise InputError("the PNG header is damaged", hint=TRUNCATED_HINT)
    width, height, depth, color, _, _, interlaced = struct.unpack(">IIBBBBB", start[16:29])
    if not (width and height) or depth not in _DEPTHS.get(color, ()) or interlaced > 1:
        raise InputError(
            f"the PNG header is damaged: {width} x {height}, {depth} bits, colour type {color}", hint=TRUNCATED_HINT
        )
    if color == 4:
        raise InputError(*_TRANSPARENT_GREY)
    bits = depth * (_CHANNELS[color] if color != 3 else 1)  # a palette: the colours are looked up later
    unpacked = _row_bytes(width, height, bits, bool(interlaced))
    spacing = None if options.spacing is None else options.spacing[::-1]
    return PngHeader(path, (1, height, width), spacing, _CHANNELS[color] * (2 if depth == 16 else 1), unpacked, color)


def _row_bytes(width: int, height: int, bits: int, interlaced: bool) -> int:
    """Bytes of all rows, each with the byte that names its filter."""
    total = 0
    for x, y, dx, dy in _ADAM7 if interlaced else ((0, 0, 1, 1),):
        columns, rows = -(-(width - x) // dx), -(-(height - y) // dy)
        if columns > 0 and rows > 0:
            total += rows * (1 + (columns * bits + 7) // 8)
    return total


def write_png(volume: Volume, path: Path) -> None:
    """Write a grey PNG; see `png_bytes`."""
    path.write_bytes(png_bytes(volume.array, volume.geometry.spacing))


def png_bytes(array: NDArray[Any], spacing: tuple[float, float, float]) -> bytes:
    """A grey PNG of the one slice of an array, with the size of a pixel where ITK looks for it.

    Parameters
    ----------
    array : ndarray, shape (1, ny, nx), uint8 or uint16
    spacing : tuple of float
        (hz, hy, hx) in mm.
    """
    _, height, width = array.shape
    rows = np.ascontiguousarray(array[0], array.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    rows = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1)  # each row begins with its filter: none
    head = struct.pack(">IIBBBBB", width, height, 8 * array.itemsize, 0, 0, 0, 0)
    # ITK takes this part for mm, whatever unit it names, and writes unit 1.
    scale = b"\x01%s\0%s" % (repr(float(spacing[2])).encode(), repr(float(spacing[1])).encode())
    parts = ((b"IHDR", head), (b"sCAL", scale), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return _START + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in parts
    )
