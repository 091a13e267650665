"""TIFF, written: grey, a page for each slice."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import tifffile
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.image.volume import Volume

MAX_FILE_BYTES = 0xFFFFFFFF


def write_tiff(volume: Volume, path: Path) -> None:
    """Write a grey TIFF; see `tiff_bytes`."""
    path.write_bytes(tiff_bytes(volume.array, volume.geometry.spacing))


def tiff_bytes(array: NDArray[Any], spacing: tuple[float, float, float]) -> bytes:
    """Return a TIFF with a page for each slice, its sizes per cm; ImageJ finds the distance of the slices as well.

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
    depth = len(array)
    text = f"ImageJ=1.53\nimages={depth}\nslices={depth}\nunit=cm\nspacing={float(spacing[0]) / 10.0!r}\n"
    out = BytesIO()
    resolution = (_per_cm(spacing[2]), _per_cm(spacing[1]))
    write_pages(
        out,
        array,
        text,
        "write a volume format instead",
        resolution=resolution,
        resolutionunit="CENTIMETER",
    )
    return out.getvalue()


def write_pages(
    out: BinaryIO, pages: Iterable[NDArray[Any]], description: str, remedy: str, **tags: Any
) -> None:
    """Write grey pages, each deflated as one strip, with a description in the first.

    Parameters
    ----------
    out : binary file
    pages : iterable of ndarray (ny, nx)
        Of a type in `STORED`.
    description : str
    remedy : str
        Other output to recommend where the file is too large.
    **tags
        Of all pages, as of `tifffile.TiffWriter.write`.

    Raises
    ------
    UsageError
        When the file would pass 4 GiB, which a TIFF cannot hold.
    """
    text: bytes | None = description.encode()
    with tifffile.TiffWriter(out, byteorder="<") as file:
        for page in pages:
            file.write(
                page.astype(page.dtype.newbyteorder("<"), copy=False),
                photometric="minisblack",
                compression="zlib",
                compressionargs={"level": 6},
                rowsperstrip=len(page),
                description=text,
                metadata=None,
                contiguous=False,
                software=False,
                **tags,
            )
            text = None
            if out.tell() > MAX_FILE_BYTES:
                raise UsageError("the file would pass 4 GiB, which a .tif cannot hold", remedy)


def _per_cm(spacing: float) -> tuple[int, int]:
    """Return the pixels per cm as a fraction of 32-bit numbers, with a small denominator: it reads back as itself."""
    value = 10.0 / spacing
    ratio = Fraction(value).limit_denominator(max(1, min(10**6, int(0xFFFFFFFF / value))))
    return max(1, ratio.numerator), ratio.denominator
