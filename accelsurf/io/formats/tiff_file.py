"""TIFF, written: grey, a page for each slice."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.volume import Volume
from accelsurf.io.formats.raster import STORED
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    DESCRIPTION,
    FORMAT,
    HEIGHT,
    ORIENTATION,
    PHOTOMETRIC,
    RES_UNIT,
    ROWS,
    SAMPLES,
    STRIP_BYTES,
    STRIPS,
    WIDTH,
    X_RES,
    Y_RES,
)

MAX_FILE_BYTES = 0xFFFFFFFF
_DIRECTORY_BYTES = 2 + 15 * 12 + 4  # of a page written here: 15 entries


def write(volume: Volume, path: Path) -> None:
    """Write a grey TIFF; see `encode`."""
    path.write_bytes(encode(volume.array, volume.geometry.spacing))


def encode(array: NDArray[Any], spacing: tuple[float, float, float]) -> bytes:
    """A TIFF with a page for each slice, deflated, its sizes per cm; ImageJ finds the distance of the slices as well.

    Parameters
    ----------
    array : ndarray, shape (nz, ny, nx)
        Of a type in `STORED`.
    spacing : tuple of float
        (hz, hy, hx) in mm.

    Raises
    ------
    UsageError
        When the file would pass 4 GiB, which a TIFF cannot hold.
    """
    depth, height, width = array.shape
    bits, form = STORED[array.dtype.name]
    fields = f"ImageJ=1.53\nimages={depth}\nslices={depth}\nunit=cm\nspacing={float(spacing[0]) / 10.0!r}\n"
    text = fields.encode() + b"\0"
    resolutions = b"".join(struct.pack("<II", *_per_cm(h)) for h in (spacing[2], spacing[1]))
    shared = 8 + len(text) + len(text) % 2
    out = [struct.pack("<2sHI", b"II", 42, shared + len(resolutions)), text.ljust(shared - 8, b"\0"), resolutions]
    at = shared + len(resolutions)
    for z in range(depth):
        page = zlib.compress(np.ascontiguousarray(array[z], array.dtype.newbyteorder("<")).tobytes(), 6)
        entries = (
            *((WIDTH, 4, 1, width), (HEIGHT, 4, 1, height), (BITS, 3, 1, bits), (COMPRESSION, 3, 1, 8)),
            *((PHOTOMETRIC, 3, 1, 1), (DESCRIPTION, 2, len(text), 8), (STRIPS, 4, 1, at + _DIRECTORY_BYTES)),
            *((ORIENTATION, 3, 1, 1), (SAMPLES, 3, 1, 1), (ROWS, 4, 1, height), (STRIP_BYTES, 4, 1, len(page))),
            *((X_RES, 5, 1, shared), (Y_RES, 5, 1, shared + 8), (RES_UNIT, 3, 1, 3), (FORMAT, 3, 1, form)),
        )
        page += b"\0" * (len(page) % 2)  # directories begin at even bytes
        end = at + _DIRECTORY_BYTES + len(page)
        if end > MAX_FILE_BYTES:
            raise UsageError("the file would pass 4 GiB, which a .tif cannot hold", "write a volume format instead")
        out.append(struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries))
        out += [struct.pack("<I", end if z + 1 < depth else 0), page]
        at = end
    return b"".join(out)


def _per_cm(spacing: float) -> tuple[int, int]:
    """Pixels per cm as a fraction of 32-bit numbers; denominators are kept small so that it reads back as itself."""
    value = 10.0 / spacing
    ratio = Fraction(value).limit_denominator(max(1, min(10**6, int(0xFFFFFFFF / value))))
    return max(1, ratio.numerator), ratio.denominator
