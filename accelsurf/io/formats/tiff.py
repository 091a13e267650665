"""The pages of a TIFF: what their directories claim, whether it is all there, and what unpacks them.

ITK returns something for nearly every TIFF: the high bytes of 16-bit tiles, half floats as integers, grey values and
opacity in turns; tifffile returns a stack that was cut short without its last slices. So the directories are always
read here first. ITK unpacks the pages that it gives back unchanged, tifffile all others.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.deflate import check_unpacked, inflated_bytes
from accelsurf.io.formats.raster import STORED, TRUNCATED_HINT, RasterHeader
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    FILL_ORDER,
    FORMAT,
    HEIGHT,
    ORIENTATION,
    PHOTOMETRIC,
    PLANAR,
    SAMPLES,
    STRIP_BYTES,
    STRIPS,
    TILE_BYTES,
    TILE_HEIGHT,
    TILE_WIDTH,
    TILES,
    WIDTH,
    Page,
    TiffForm,
)
from accelsurf.settings import budgets

_PLAIN_HINT = "save it as plain 8- or 16-bit grey (or RGB), uncompressed or with LZW or deflate"
_MAX_TILE_EDGE = 1 << 12  # along an edge: a tile is held in memory, whatever the size of the image
_DIRECTORY_BYTES = 186  # about

_DEFLATE = (8, 32946)
_LZW, _PACKBITS = 5, 32773
_COMPRESSIONS = (1, _LZW, *_DEFLATE, _PACKBITS)  # the first: none
_CHUNK = 1 << 16
#: Types of values by bits and sample format.
_KINDS = {kind: name for name, kind in STORED.items()} | {
    **{(1, 1): "uint8", (64, 1): "uint64", (64, 2): "int64", (16, 3): "float16", (64, 3): "float64"}
}
Decoder = Literal["ITK", "tifffile"]

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
    selected : bool
        Whether the file has pages that are none of these.
    planes : ndarray (n,) of int64 or None
        Where the rows of each page begin, if they lie one after the other as they are.
    ends : ndarray (n,) of int64
        How many of the strips belong to the pages up to each.
    decoder : str
        What the pages are unpacked by.
    sample : int or None
        Which value of each pixel is read, where it has several that are no colour.
    """

    itk_name: ClassVar[str] = "TIFFImageIO"

    unpacked_bytes: int
    strips: NDArray[np.int64]
    compression: int
    tiled: bool
    directories: NDArray[np.int64]
    stored: np.dtype[Any] | None
    selected: bool
    planes: NDArray[np.int64] | None
    ends: NDArray[np.int64]
    decoder: Decoder = "ITK"
    sample: int | None = None

    def of_pages(self, pages: Sequence[int], sample: int | None = None) -> TiffHeader:
        """The header of some of the pages, in an order."""
        starts = np.concatenate([[0], self.ends[:-1]])
        some = [self.strips[starts[page] : self.ends[page]] for page in pages]
        _, ny, nx = self.shape
        return replace(
            self, shape=(len(pages), ny, nx), unpacked_bytes=self.unpacked_bytes // self.shape[0] * len(pages),
            strips=np.concatenate(some), ends=np.cumsum([len(one) for one in some], dtype=np.int64),
            directories=self.directories[list(pages)], selected=True, sample=sample,
            planes=None if self.planes is None else self.planes[list(pages)],
        )

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
        if self.compression in (1, *_DEFLATE, _PACKBITS) and present < self.unpacked_bytes:
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


def header_of(
    path: Path, form: TiffForm, pages: Mapping[int, Page], spacing: tuple[float, float, float], repeats: int = 1
) -> TiffHeader:
    """What the directories of like pages claim.

    Parameters
    ----------
    path : Path
        The file.
    form : TiffForm
        How it is written.
    pages : mapping of int to Page
        Where each begins, and its tags.
    spacing : tuple of float
        (z, y, x) in mm.
    repeats : int
        How many pages follow the rows of the only directory, its own among them.

    Raises
    ------
    InputError
        When the pages differ, or are of a kind that is not read; LookupError, ValueError and others when the tags are
        damaged.
    """
    listed = list(pages.values())
    first, decoder = _page_kind(listed[0]), _decoder(listed[0])
    for number, page in enumerate(listed[1:], 2):
        if _page_kind(page) != first:
            raise InputError(
                f"page {number} of the TIFF differs from the first in size or type, like slices expected",
                hint="extract the page, or the pages of one size, first",
            )
    page, tiled = listed[0], TILES in listed[0]
    width, height, bits = int(page[WIDTH][0]), int(page[HEIGHT][0]), sum(_bits(page))
    compression = int(page.get(COMPRESSION, (1,))[0])
    strips = [strips_of(one) for one in listed]
    stored, page_bytes = _stored_type(page, form.order), _page_bytes(page, width, height, bits)
    pixel = 4 if tiled or bits == 1 else bits // 8  # those ITK reads as colours with opacity
    is_plain = stored is not None and len(_bits(page)) == 1 and bits > 1 and compression == 1 and not tiled
    planes, places = _planes(listed, strips, page_bytes) if is_plain else None, list(pages)
    if repeats > 1:
        if planes is None:
            raise InputError(f"the TIFF announces {repeats} images and has 1 page", "save a page for each slice")
        planes, places = planes[0] + np.arange(repeats, dtype=np.int64) * page_bytes, places * repeats
        strips = [np.array([[at, page_bytes]], np.int64) for at in planes.tolist()]
    return TiffHeader(
        path, (len(places), height, width), spacing, pixel, len(places) * page_bytes, np.concatenate(strips),
        compression, tiled, np.array(places, np.int64), stored, False, planes,
        np.cumsum([len(some) for some in strips], dtype=np.int64), decoder,
    )


def _stored_type(page: Page, order: Literal["<", ">"]) -> np.dtype[Any] | None:
    """Type of the values of a grey page; of black and white that which ITK gives. None for a colour."""
    bits = _bits(page)
    if page.get(PHOTOMETRIC, (1,))[0] not in (0, 1):
        return None
    return np.dtype(_KINDS[bits[0], page.get(FORMAT, (1,))[0]]).newbyteorder(order)


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
    tile = page.get(TILE_WIDTH), page.get(TILE_HEIGHT)  # of other lengths than one libtiff dies
    return page[WIDTH][0], page[HEIGHT][0], _bits(page), page.get(FORMAT, (1,))[0], *tags, *tile


def strips_of(page: Page) -> NDArray[np.int64]:
    """Offset and length of the strips or tiles of a page."""
    offsets, lengths = (TILES, TILE_BYTES) if TILES in page else (STRIPS, STRIP_BYTES)
    return np.stack([np.array(page[offsets], np.int64), np.array(page[lengths], np.int64)], axis=1)


def _page_bytes(page: Page, width: int, height: int, bits: int) -> int:
    """Bytes of a page when it is unpacked; of one in tiles, with what goes beyond the image."""
    if TILES not in page:
        return height * ((width * bits + 7) // 8)
    (wide,), (high,) = page[TILE_WIDTH], page[TILE_HEIGHT]
    if min(wide, high) < 1:
        raise ValueError
    return -(-width // wide) * -(-height // high) * high * ((wide * bits + 7) // 8)


def samples_of(page: Page) -> int:
    """How many values a pixel has that are channels: 1 for a colour."""
    return len(_bits(page)) if page.get(PHOTOMETRIC, (1,))[0] in (0, 1) else 1


def _decoder(page: Page) -> Decoder:
    """What unpacks the pages: ITK, where it gives the values as they are, else tifffile.

    Raises
    ------
    InputError
        For what neither gives as one number for each pixel.
    """
    bits, form, colour = _bits(page), page.get(FORMAT, (1,))[0], page.get(PHOTOMETRIC, (1,))[0]
    tiled, compression = TILES in page, page.get(COMPRESSION, (1,))[0]
    grey = colour in (0, 1)
    wrong = ""
    if not (page[WIDTH][0] and page[HEIGHT][0]):
        raise ValueError
    if PHOTOMETRIC not in page:
        wrong = "no word on whether 0 is black or white"
    elif colour == 3:
        wrong = "colours from a palette"
    elif not grey and (colour != 2 or len(bits) not in (3, 4)):
        wrong = f"{len(bits)} channels of colour kind {colour}"
    elif len(set(bits)) > 1 or (bits[0], form) not in _KINDS or (not grey and (form != 1 or bits[0] not in (8, 16))):
        wrong = f"{bits[0]}-bit {({1: 'unsigned', 2: 'signed', 3: 'floating-point'}).get(form, 'complex')} values"
    elif colour == 0 and bits != (1,):
        wrong = "values that grow towards black"
    elif page.get(ORIENTATION, (1,))[0] != 1:
        wrong = "rows and columns turned by its orientation tag"
    elif page.get(PLANAR, (1,))[0] != 1 and not grey:
        wrong = "colour channels one after the other"
    elif tiled and max(page[TILE_WIDTH][0], page[TILE_HEIGHT][0]) > _MAX_TILE_EDGE:
        wrong = f"tiles of {page[TILE_WIDTH][0]} x {page[TILE_HEIGHT][0]}"
    elif not grey and (compression not in _COMPRESSIONS or (tiled and bits[0] != 8)):
        wrong = f"colours in tiles, or packed by compression number {compression},"
    if wrong:
        raise InputError(f"a TIFF with {wrong} given, which cannot be read faithfully", hint=_PLAIN_HINT)
    if bits == (1,):
        if tiled or compression not in _COMPRESSIONS:
            raise InputError("a TIFF of packed or tiled black and white given", hint=_PLAIN_HINT)
        return "ITK"
    plain = (bits[0], form) in STORED.values() and compression in _COMPRESSIONS and (len(bits) == 1 or not grey)
    return "ITK" if plain and (not tiled or (bits[0], form) == (8, 1)) else "tifffile"
