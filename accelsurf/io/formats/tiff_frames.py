"""Sequences written as OME-TIFF: a page for each slice of each frame, times in the XML of the first."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from accelsurf.errors import UsageError
from accelsurf.io.formats.raster import STORED
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    DESCRIPTION,
    FORMAT,
    HEIGHT,
    ORIENTATION,
    PHOTOMETRIC,
    ROWS,
    SAMPLES,
    STRIP_BYTES,
    STRIPS,
    WIDTH,
)
from accelsurf.io.formats.tiff_file import MAX_FILE_BYTES
from accelsurf.io.frame_times import TIMES_KEY

if TYPE_CHECKING:
    from accelsurf.io.sequence_writing import FrameStack

_OME_TYPES = {"float32": "float"}
_LEVEL = 6
#: Version, endianness, place of the first directory.
_HEADER = struct.Struct("<2sHI")


def write(path: Path, frames: FrameStack) -> None:
    """Write the pages, deflated.

    Raises
    ------
    UsageError
        When the file would pass 4 GiB, which a TIFF cannot hold.
    """
    text = _xml(frames).encode() + b"\0"
    depth = frames.geometry.shape[0]
    last = len(frames) * depth - 1
    with path.open("wb") as file:
        first = _HEADER.size + len(text) + len(text) % 2
        file.write(_HEADER.pack(b"II", 42, first))
        file.write(text.ljust(first - _HEADER.size, b"\0"))
        at = first
        for number, array in enumerate(frames):
            for z in range(depth):
                page = zlib.compress(array[z].tobytes(), _LEVEL)
                is_first = number == z == 0
                entries = _entries(frames, len(page), (len(text), _HEADER.size) if is_first else None, at)
                page += b"\0" * (len(page) % 2)  # directories begin at even bytes
                end = at + _directory_bytes(len(entries)) + len(page)
                if end > MAX_FILE_BYTES:
                    raise UsageError(
                        "the file would pass 4 GiB, which a .tif cannot hold", "write an .ome.zarr, or a file for each "
                        "frame: frame*.tif"
                    )
                file.write(struct.pack("<H", len(entries)))
                file.write(b"".join(struct.pack("<HHII", *entry) for entry in entries))
                file.write(struct.pack("<I", 0 if number * depth + z == last else end))
                file.write(page)
                at = end


def _directory_bytes(entries: int) -> int:
    return 2 + 12 * entries + 4


def _entries(
    frames: FrameStack, page_bytes: int, text: tuple[int, int] | None, at: int
) -> list[tuple[int, int, int, int]]:
    """The tags of a page whose directory begins at a byte; of the first with the length and place of the text."""
    height, width = frames.geometry.shape[1:]
    bits, form = STORED[frames.dtype.name]
    described = [] if text is None else [(DESCRIPTION, 2, *text)]
    count = 11 + len(described)
    return [
        *((WIDTH, 4, 1, width), (HEIGHT, 4, 1, height), (BITS, 3, 1, bits), (COMPRESSION, 3, 1, 8)),
        *((PHOTOMETRIC, 3, 1, 1), *described, (STRIPS, 4, 1, at + _directory_bytes(count)), (ORIENTATION, 3, 1, 1)),
        *((SAMPLES, 3, 1, 1), (ROWS, 4, 1, height), (STRIP_BYTES, 4, 1, page_bytes), (FORMAT, 3, 1, form)),
    ]


def _xml(frames: FrameStack) -> str:
    """The OME-XML."""
    geometry, times = frames.geometry, frames.times
    (depth, height, width), (hz, hy, hx) = geometry.shape, geometry.spacing
    said: dict[str, Any] = {
        "ID": "Pixels:0", "DimensionOrder": "XYZCT", "Type": _OME_TYPES.get(frames.dtype.name, frames.dtype.name),
        "SizeX": width, "SizeY": height, "SizeZ": depth, "SizeC": 1, "SizeT": len(frames),
        "PhysicalSizeX": repr(hx), "PhysicalSizeXUnit": "mm", "PhysicalSizeY": repr(hy), "PhysicalSizeYUnit": "mm",
        "PhysicalSizeZ": repr(hz), "PhysicalSizeZUnit": "mm",
    }  # fmt: skip
    if times.seconds:
        said |= {"TimeIncrement": repr(times.seconds), "TimeIncrementUnit": "s"}
    pixels = " ".join(f"{key}={quoteattr(str(value))}" for key, value in said.items())
    planes = notes = ""
    if times.unit == "s":
        planes = "".join(
            f'<Plane TheC="0" TheT="{t}" TheZ="{z}" DeltaT="{time!r}" DeltaTUnit="s"/>'
            for t, time in enumerate(times.values) for z in range(depth)
        )
    elif not times.is_count:
        notes = (
            f'<StructuredAnnotations><CommentAnnotation ID="Annotation:0" Namespace="{TIMES_KEY}">'
            f"<Value>{times.text}</Value></CommentAnnotation></StructuredAnnotations>"
        )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
        f'<Image ID="Image:0"><Pixels {pixels}><Channel ID="Channel:0:0" SamplesPerPixel="1"/>'
        f'<TiffData IFD="0" PlaneCount="{len(frames) * depth}"/>{planes}</Pixels></Image>{notes}</OME>'
    )
