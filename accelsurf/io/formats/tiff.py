"""TIFF: what the directories claim, whether it is all there, and how it is written. ITK reads the voxels.

ITK returns something for nearly every TIFF: the high bytes of 16-bit tiles, half floats as integers, grey values and
opacity in turns. So the directories are read here first, and what ITK would not give back unchanged is refused.
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.volume import Volume
from accelsurf.io.formats.deflate import check_unpacked, inflated_bytes
from accelsurf.io.formats.raster import STORED, TRUNCATED_HINT, RasterHeader
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    DESCRIPTION,
    FILL_ORDER,
    FORMAT,
    HEIGHT,
    ORIENTATION,
    PHOTOMETRIC,
    PLANAR,
    RES_UNIT,
    ROWS,
    SAMPLES,
    STRIP_BYTES,
    STRIPS,
    SUBFILE,
    TILE_BYTES,
    TILE_HEIGHT,
    TILE_WIDTH,
    TILES,
    WIDTH,
    X_RES,
    Y_RES,
    Page,
    read_pages,
)
from accelsurf.settings import budgets

_PLAIN_HINT = "save it as plain 8- or 16-bit grey (or RGB), uncompressed or with LZW or deflate"
MAX_FILE_BYTES = 0xFFFFFFFF
_MAX_TILE_EDGE = 1 << 12  # along an edge: a tile is held in memory, whatever the size of the image
_DIRECTORY_BYTES = 2 + 15 * 12 + 4  # of a page written here: 15 entries

_DEFLATE = (8, 32946)
_LZW, _PACKBITS = 5, 32773
_COMPRESSIONS = (1, _LZW, *_DEFLATE, _PACKBITS)  # the first: none
_CHUNK = 1 << 16
_MM = {
    **dict.fromkeys(("micron", "microns", "um", "\u00b5m", "\u03bcm", "\\u00b5m"), 1e-3),
    **{"nm": 1e-6, "mm": 1.0, "cm": 10.0, "m": 1000.0},
}

@dataclass(frozen=True)
class TiffHeader(RasterHeader):
    """What the directories of a TIFF claim, and whether all of it is there.

    Attributes
    ----------
    unpacked_bytes : int
        Bytes of all rows when unpacked.
    strips : ndarray (n, 2) of int64
        Offset and length of the strips or tiles.
    compression : int
        Compression, by its number.
    tiled : bool
        Whether the voxels are in tiles, which may go beyond the image.
    directories : ndarray (n,) of int64
        Where the directories of the pages begin.
    stored : numpy.dtype or None
        Of the values of a grey image, with the byte order of the file; None for a colour.
    thumbnails : bool
        Whether there are pages that are none of the stack.
    planes : ndarray (n,) of int64 or None
        Where the rows of each page begin, if they lie one after the other as they are.
    """

    itk_name: ClassVar[str] = "TIFFImageIO"

    unpacked_bytes: int
    strips: NDArray[np.int64]
    compression: int
    tiled: bool
    directories: NDArray[np.int64]
    stored: np.dtype[Any] | None
    thumbnails: bool
    planes: NDArray[np.int64] | None

    def check_complete(self) -> None:
        """Refuse a TIFF whose strips are not all there.

        Raises
        ------
        InputError
            With what is missing.
        """
        self.check_places()
        present = stored = sum(self.strips[:, 1].tolist())
        if ratio := {_LZW: budgets.LZW, _PACKBITS: budgets.PACKBITS}.get(self.compression):
            ratio.check(self.unpacked_bytes, "the header announces voxels", stored)
        if self.compression in _DEFLATE:
            present = 0
            with self.data.open("rb") as file:
                for offset, length in self.strips.tolist():
                    file.seek(offset)
                    present += self._unpacked(file, length, present)
        elif self.compression == _PACKBITS and not self.tiled:
            present = self._run_lengths()
            if present > self.unpacked_bytes:
                raise InputError("the runs of the TIFF go on beyond its rows", hint=TRUNCATED_HINT)
        if self.compression != _LZW and present < self.unpacked_bytes:
            raise InputError(
                f"the header announces {self.unpacked_bytes} bytes of voxels, the file holds {present}",
                hint=TRUNCATED_HINT,
            )

    def check_places(self) -> None:
        """Refuse a TIFF whose strips lie beyond its end, or upon one another.

        Raises
        ------
        InputError
            With what is missing.
        """
        size = self.data.stat().st_size
        offsets, lengths = self.strips[:, 0], self.strips[:, 1]
        # No sum of the two is taken that 64 bits do not hold.
        if (wrong := (offsets < 0) | (lengths <= 0) | (offsets > size) | (lengths > size - offsets)).any():
            offset, length = self.strips[int(wrong.argmax())].tolist()
            raise InputError(
                f"the header announces {length} bytes of voxels at byte {offset}, the file has {size} bytes",
                hint=TRUNCATED_HINT,
            )
        stored = sum(lengths.tolist())
        budgets.TIFF_STRIPS.check(stored, "the strips of the TIFF overlap", size + _DIRECTORY_BYTES)

    def _run_lengths(self) -> int:
        """Bytes that the runs of PackBits strips unpack to."""
        total = 0
        with self.data.open("rb") as file:
            for offset, length in self.strips.tolist():
                file.seek(offset)
                packed, at = file.read(length), 0
                while at < length:
                    run = packed[at]  # up to 127: so many bytes and one follow; from 129: one byte, 257 - run times
                    total += run + 1 if run < 128 else 257 - run if run > 128 else 0
                    at += run + 2 if run < 128 else 2 if run > 128 else 1
        return total

    def _unpacked(self, file: BinaryIO, length: int, before: int) -> int:
        """Bytes that a deflated strip unpacks to."""
        unpack, present = zlib.decompressobj(), 0
        while length > 0 and not unpack.eof and (piece := file.read(min(length, _CHUNK))):
            length -= len(piece)
            present += inflated_bytes(unpack, piece)
            check_unpacked(before + present, self.unpacked_bytes)
        return present


def parse(path: Path) -> TiffHeader:
    """Read the directories of a TIFF (also BigTIFF): a page is a slice.

    Raises
    ------
    InputError
        When it is none, is damaged, its pages differ, or it is of a kind that ITK does not read faithfully.
    """
    try:
        with path.open("rb") as file:
            form, all_pages = read_pages(file)
        found = {at: page for at, page in all_pages.items() if not page.get(SUBFILE, (0,))[0] & 1}  # no thumbnails
        pages = list(found.values())
        if not pages:
            raise InputError("the TIFF holds no page", hint=TRUNCATED_HINT)
        first = _page_kind(pages[0])
        _check_faithful(pages[0])
        for number, page in enumerate(pages[1:], 2):
            if _page_kind(page) != first:
                raise InputError(
                    f"page {number} of the TIFF differs from the first in size or type, like slices expected",
                    hint="extract the page, or the pages of one size, first",
                )
        width, height, bits = int(pages[0][WIDTH][0]), int(pages[0][HEIGHT][0]), sum(_bits(pages[0]))
        spacing = _spacing(pages[0], len(pages))
        compression = int(pages[0].get(COMPRESSION, (1,))[0])
        strips = [strips_of(page) for page in pages]
    except (LookupError, TypeError, ValueError, OverflowError, struct.error):
        raise InputError("the TIFF header is cut short or damaged", hint=TRUNCATED_HINT) from None
    page_bytes = height * ((width * bits + 7) // 8)
    pixel = 4 if TILES in pages[0] or bits == 1 else bits // 8  # those ITK reads as colours with opacity
    shape, tiled = (len(pages), height, width), TILES in pages[0]
    places, stored = np.array(list(found), np.int64), _stored_type(pages[0], form.order)
    is_plain = stored is not None and bits > 1 and compression == 1 and not tiled
    planes = _planes(pages, strips, page_bytes) if is_plain else None
    unpacked, together, more = len(pages) * page_bytes, np.concatenate(strips), len(found) < len(all_pages)
    return TiffHeader(path, shape, spacing, pixel, unpacked, together, compression, tiled, places, stored, more, planes)


def _stored_type(page: Page, order: Literal["<", ">"]) -> np.dtype[Any] | None:
    """Type of the values of a grey page; of black and white that which ITK gives. None for a colour."""
    bits = _bits(page)
    kinds = {kind: name for name, kind in STORED.items()} | {(1, 1): "uint8"}
    return np.dtype(kinds[bits[0], page.get(FORMAT, (1,))[0]]).newbyteorder(order) if len(bits) == 1 else None


def _planes(
    pages: Sequence[Page], strips: Sequence[NDArray[np.int64]], page_bytes: int
) -> NDArray[np.int64] | None:
    """Where the pages begin, if the strips of each follow one another; None if not."""
    for page, some in zip(pages, strips, strict=True):
        ends = some.sum(axis=1)
        if page.get(FILL_ORDER, (1,))[0] != 1 or some[:, 1].sum() != page_bytes or (ends[:-1] != some[1:, 0]).any():
            return None
    return np.array([some[0, 0] for some in strips], np.int64)


def _bits(page: Page) -> tuple[int, ...]:
    samples = int(page.get(SAMPLES, (1,))[0])
    bits = page.get(BITS, (1,))
    return tuple(bits) if len(bits) == samples else (int(bits[0]),) * samples


def _page_kind(page: Page) -> tuple[Any, ...]:
    """What the pages of a stack have in common."""
    keys = (COMPRESSION, PHOTOMETRIC, ORIENTATION, PLANAR)
    tags = tuple(page.get(key, (1,))[0] for key in keys)
    return page[WIDTH][0], page[HEIGHT][0], _bits(page), page.get(FORMAT, (1,))[0], *tags


def strips_of(page: Page) -> NDArray[np.int64]:
    """Offset and length of the strips or tiles of a page."""
    offsets, lengths = (TILES, TILE_BYTES) if TILES in page else (STRIPS, STRIP_BYTES)
    return np.stack([np.array(page[offsets], np.int64), np.array(page[lengths], np.int64)], axis=1)


def _check_faithful(page: Page) -> None:
    """Refuse what ITK's reader changes on the way, or mixes up."""
    bits, form, colour = _bits(page), page.get(FORMAT, (1,))[0], page.get(PHOTOMETRIC, (1,))[0]
    tiled, compression = TILES in page, page.get(COMPRESSION, (1,))[0]
    grey = len(bits) == 1 and colour in (0, 1)
    plain = (bits[0], form) in STORED.values() and len(set(bits)) == 1
    wrong = ""
    if not (page[WIDTH][0] and page[HEIGHT][0]):
        raise ValueError
    if compression not in _COMPRESSIONS:
        wrong = f"compression number {compression}"
    elif PHOTOMETRIC not in page:
        wrong = "no word on whether 0 is black or white"
    elif colour == 3:
        wrong = "colours from a palette"
    elif not grey and (colour != 2 or len(bits) not in (3, 4)):
        wrong = f"{len(bits)} channels of colour kind {colour}"
    elif bits != (1,) and not plain or (not grey and (form != 1 or bits[0] > 16)):
        wrong = f"{bits[0]}-bit {({1: 'unsigned', 2: 'signed', 3: 'floating-point'}).get(form, 'complex')} values"
    elif colour == 0 and bits != (1,):
        wrong = "values that grow towards black"
    elif page.get(ORIENTATION, (1,))[0] != 1:
        wrong = "rows and columns turned by its orientation tag"
    elif page.get(PLANAR, (1,))[0] != 1 and not grey:
        wrong = "colour channels one after the other"
    elif tiled and (bits[0] != 8 or form != 1):
        wrong = "tiles"
    elif tiled and max(page[TILE_WIDTH][0], page[TILE_HEIGHT][0]) > _MAX_TILE_EDGE:
        wrong = f"tiles of {page[TILE_WIDTH][0]} x {page[TILE_HEIGHT][0]}"
    if wrong:
        raise InputError(f"a TIFF with {wrong} given, which cannot be read faithfully", hint=_PLAIN_HINT)


def _spacing(page: Page, pages: int) -> tuple[float, float, float]:
    """Spacing (z, y, x) in mm where the file gives it in a unit of length, else 1.

    Inches are dots per inch, of a screen or a printer: they say nothing about the object.
    """
    text = str(page.get(DESCRIPTION, ("",))[0])
    if "<OME" in text:
        return _ome_spacing(text)
    fields = dict(line.split("=", 1) for line in text.splitlines() if "=" in line) if text.startswith("ImageJ=") else {}
    _refuse_channels(int(fields.get("channels", 1)), int(fields.get("frames", 1)))
    if int(fields.get("images", pages)) > pages:
        raise InputError(
            f"the TIFF announces {fields['images']} images and has {pages} page{'s' if pages > 1 else ''}",
            hint="save the stack with a page for each slice",
        )
    unit = _MM.get(fields.get("unit", "").lower(), 10.0 if page.get(RES_UNIT, (2,))[0] == 3 else 0.0)
    (xn, xd), (yn, yd) = page.get(X_RES, (0, 0))[:2], page.get(Y_RES, (0, 0))[:2]
    if not unit or not all((xn, xd, yn, yd)):
        return 1.0, 1.0, 1.0
    depth = float(fields.get("spacing", 1.0 / unit)) * unit
    return depth if math.isfinite(depth) and depth > 0 else 1.0, unit * yd / yn, unit * xd / xn


def _ome_spacing(text: str) -> tuple[float, float, float]:
    """Spacing by the XML of an OME-TIFF, in which the unit is the micrometre unless another is named."""
    head = text[text.find("<Pixels") :].partition(">")[0]
    fields = dict(re.findall(r'\b(\w{1,40})="([^"]{0,40})"', head))
    _refuse_channels(int(fields.get("SizeC", 1)), int(fields.get("SizeT", 1)))
    z, y, x = (
        float(fields.get(f"PhysicalSize{a}", 0)) * _MM.get(fields.get(f"PhysicalSize{a}Unit", "um").lower(), 0.0)
        for a in "ZYX"
    )
    return (z or 1.0, y, x) if min(x, y) > 0 and z >= 0 else (1.0, 1.0, 1.0)


def _refuse_channels(channels: int, times: int) -> None:
    for count, name in ((channels, "channel"), (times, "time point")):
        if count > 1:
            raise InputError(f"a TIFF stack of {count} {name}s given, one expected", hint=f"extract one {name} first")


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
