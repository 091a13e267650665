"""PNG, read and written by Pillow, which verifies the checksum of every part, and leaves rows that are missing black.

Headers of PNG and TIFF keep the size of a pixel and no place in the world: an image starts at the world's origin, along
its axes.
"""

from __future__ import annotations

import io
import math
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.channels import to_grey
from accelsurf.io.files import library_named
from accelsurf.io.formats.deflate import inflate
from accelsurf.io.headers import with_given_unit, with_warnings
from accelsurf.io.memory import check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

TRUNCATED_HINT = "the file is truncated or damaged: copy or export it again"
_START = b"\x89PNG\r\n\x1a\n"
#: Values of a pixel as it is stored, by the kind of colour.
_STORED = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DAMAGED = "the PNG is damaged", TRUNCATED_HINT


@dataclass(frozen=True)
class PngHeader:
    """Claims of the header of a PNG.

    Attributes
    ----------
    data : Path
        The file.
    shape : tuple of int
        (1, rows, columns).
    spacing : tuple of float
        mm, (z, y, x): as it was given, else as the file says it, else 1.
    pixel_bytes : int
        Bytes of a pixel in memory while it is read.
    row_bytes : int
        Bytes of all rows, each with the one that names its filter.
    options : ReadOptions
        As given.
    """

    data: Path
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    pixel_bytes: int
    row_bytes: int
    options: ReadOptions = AS_IT_IS

    @property
    def geometry(self) -> Geometry:
        """The grid."""
        return Geometry(self.shape, self.spacing)


def parse_png(path: Path, options: ReadOptions = AS_IT_IS) -> PngHeader:
    """Read the header of a PNG.

    Raises
    ------
    InputError
        When it is no PNG, or a kind of PNG that cannot be read faithfully.
    """
    with path.open("rb") as file:
        start = file.read(29)
    if not start.startswith(_START):
        raise InputError(
            "this is not a PNG image: it does not start as one", hint="is it the right file?"
        )
    with library_named(*_DAMAGED), PngImageFile(path) as image:
        (width, height), mode = image.size, image.mode
        is_grey, depth = mode in ("1", "L", "I;16", "LA"), start[24]
        if is_grey and (mode == "LA" or "transparency" in image.info):
            raise InputError(
                "a grey PNG with transparency given, one without expected",
                "save it without transparency",
            )
        if start[28]:
            raise InputError(
                "an interlaced PNG given, row after row expected", "save it again, not interlaced"
            )
        if depth == 16 and not is_grey:
            raise InputError(
                "a colour PNG of 16 bits given, of which 8 would be left",
                "save it as grey, or as TIFF",
            )
        rows = height * (1 + (width * depth * _STORED[start[25]] + 7) // 8)
    spacing = (1.0, *_pixel(path)[::-1]) if options.spacing is None else options.spacing[::-1]
    return PngHeader(
        path,
        (1, height, width),
        spacing,
        depth // 8 or 1 if is_grey else 3 + (mode != "RGB"),
        rows,
        options,
    )


def read_png(path: Path, header: PngHeader, available: int) -> Volume:
    """Read a PNG.

    Raises
    ------
    InputError
        When it is damaged, or larger than the memory.
    """
    check_memory(header.shape[::-1], header.pixel_bytes, available)
    with library_named(*_DAMAGED):
        _check_rows(header)
        with PngImageFile(path) as image:
            if image.mode in ("1", "P", "RGB", "RGBA"):
                is_seen_through = "transparency" in image.info or image.mode == "RGBA"
                kind = "L" if image.mode == "1" else "RGBA" if is_seen_through else "RGB"
                array, note = np.asarray(image.convert(kind)), ""
            else:
                array, note = np.array(image), ""
    if array.ndim > 2:
        array, note = to_grey(array)
    metadata = with_given_unit(with_warnings({}, note), header.options)
    return Volume(array[None], header.geometry, metadata, path)


def _contents(path: Path, wanted: bytes, end: bytes = b"IEND") -> Iterator[bytes]:
    """Yield the contents of a PNG's chunks of one name before a chunk that ends it; bytes beyond are no chunks."""
    most = path.stat().st_size
    with path.open("rb") as file:
        file.seek(len(_START))
        while len(start := file.read(8)) == 8 and start[4:] not in (b"IEND", end):
            length = int.from_bytes(start[:4], "big")
            if start[4:] == wanted:
                yield file.read(min(length, most))
                length = 0
            file.seek(length + 4, os.SEEK_CUR)


def _pixel(path: Path) -> tuple[float, float]:
    """The size of a pixel (x, y), mm, where ITK writes it, before the rows; else 1."""
    scales = list(_contents(path, b"sCAL", b"IDAT"))
    try:
        x, y = (float(word) for word in scales[-1][1:].split(b"\0"))
    except (ValueError, IndexError):
        return 1.0, 1.0
    return (x, y) if min(x, y) > 0 and math.isfinite(x) and math.isfinite(y) else (1.0, 1.0)


def _check_rows(header: PngHeader) -> None:
    """Refuse a PNG of fewer rows than its header announces."""
    packed = b"".join(_contents(header.data, b"IDAT"))
    present = sum(map(len, inflate(io.BytesIO(packed), None, header.row_bytes)))
    if present != header.row_bytes:
        raise InputError(
            f"the header announces {header.row_bytes} bytes of rows, {present} are there",
            TRUNCATED_HINT,
        )


def write_png(volume: Volume, path: Path) -> None:
    """Write a grey PNG; see `png_bytes`."""
    path.write_bytes(png_bytes(volume.array, volume.geometry.spacing))


def png_bytes(array: NDArray[Any], spacing: tuple[float, float, float]) -> bytes:
    """A grey PNG of the one slice of an array, with the size of a pixel where ITK looks for it.

    Parameters
    ----------
    array : ndarray (1, ny, nx) of uint8 or uint16
    spacing : tuple of float
        mm, (z, y, x).
    """
    stream = io.BytesIO()
    Image.fromarray(array[0]).save(stream, "png", compress_level=6)
    content = stream.getvalue()
    # ITK takes this part for mm, whatever unit it names, and writes unit 1.
    scale = b"sCAL\x01%s\0%s" % (repr(float(spacing[2])).encode(), repr(float(spacing[1])).encode())
    part = struct.pack(">I", len(scale) - 4) + scale + struct.pack(">I", zlib.crc32(scale))
    end = len(_START) + 25  # of the header
    return content[:end] + part + content[end:]
