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
from accelsurf.io.formats.deflate import check_unpacked, inflated_bytes, run_lengths
from accelsurf.io.formats.raster import STORED, TRUNCATED_HINT, RasterHeader
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    EXTRA,
    FILL_ORDER,
    FORMAT,
    HEIGHT,
    MAX_SAMPLES,
    ORIENTATION,
    PHOTOMETRIC,
    PLANAR,
    PREDICTOR,
    ROWS,
    RULES,
    SAMPLES,
    TILE_HEIGHT,
    TILE_WIDTH,
    TILES,
    WIDTH,
    Page,
    TiffForm,
    strips_of,
)
from accelsurf.settings import budgets

_PLAIN_HINT = "save it as plain 8- or 16-bit grey (or RGB), uncompressed or with LZW or deflate"
_MAX_TILE_EDGE = 1 << 12  # along an edge: a tile is held in memory, whatever the size of the image
_DIRECTORY_BYTES = 186  # about

_DEFLATE = (8, 32946)
_LZW, _PACKBITS = 5, 32773
_COMPRESSIONS = (1, _LZW, *_DEFLATE, _PACKBITS)  # the first: none
_NO_PREDICTOR = (1, _PACKBITS)  # packings whose bytes are no differences
_FIRST_BYTE = 8  # after which strips and directories begin
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
    strip_bytes : ndarray (m,) of int64
        Bytes of each of the strips or tiles of a page when unpacked.
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

    strip_bytes: NDArray[np.int64]
    strips: NDArray[np.int64]
    compression: int
    tiled: bool
    directories: NDArray[np.int64]
    stored: np.dtype[Any] | None
    planes: NDArray[np.int64] | None
    ends: NDArray[np.int64]
    decoder: Decoder = "ITK"
    sample: int | None = None

    @property
    def unpacked_bytes(self) -> int:
        """Bytes of all rows when unpacked; of pages in tiles, with what goes beyond the image."""
        return int(self.strip_bytes.sum()) * self.shape[0]

    def of_pages(self, pages: Sequence[int], sample: int | None = None) -> TiffHeader:
        """The header of some of the pages, in an order."""
        starts = np.concatenate([[0], self.ends[:-1]])
        some = [self.strips[starts[page] : self.ends[page]] for page in pages]
        _, ny, nx = self.shape
        return replace(
            self, shape=(len(pages), ny, nx),
            strips=np.concatenate(some), ends=np.cumsum([len(one) for one in some], dtype=np.int64),
            directories=self.directories[list(pages)], sample=sample,
            planes=None if self.planes is None else self.planes[list(pages)],
        )

    def check_complete(self) -> None:
        """Refuse a TIFF whose strips are not all there, or hold other numbers of bytes than its tags announce.

        Raises
        ------
        InputError
            With what is missing.
        """
        self.check_places()
        stored = sum(self.strips[:, 1].tolist())
        if ratio := {_LZW: budgets.LZW, _PACKBITS: budgets.PACKBITS}.get(self.compression):
            ratio.check(self.unpacked_bytes, "the header announces voxels", stored)
        if self.compression not in (1, *_DEFLATE, _PACKBITS):
            return
        if self.planes is not None and stored == self.unpacked_bytes:
            return  # the rows of each page follow one another, however the strips divide them
        present = 0
        with self.data.open("rb") as file:
            for (offset, length), announced in zip(self.strips.tolist(), self._announced(), strict=True):
                file.seek(offset)
                found = length if self.compression == 1 else self._unpacked(file, length, announced)
                present += found
                # A library leaves out what is too much, and fills up what is missing.
                if found > announced or (found < announced and len(self.strips) > 1):
                    raise InputError(
                        f"a strip or tile of the TIFF holds {found} bytes of voxels, its tags announce {announced}",
                        TRUNCATED_HINT,
                    )
        if present < self.unpacked_bytes:
            raise InputError(
                f"the header announces {self.unpacked_bytes} bytes of voxels, the file holds {present}",
                hint=TRUNCATED_HINT,
            )

    def _announced(self) -> list[int]:
        """Bytes of each strip when unpacked."""
        return np.tile(self.strip_bytes, self.shape[0]).tolist()

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
        if (wrong := (offsets < _FIRST_BYTE) | (lengths <= 0) | (offsets > size) | (lengths > size - offsets)).any():
            offset, length = self.strips[int(wrong.argmax())].tolist()
            raise InputError(
                f"the header announces {length} bytes of voxels at byte {offset}, the file has {size} bytes",
                hint=TRUNCATED_HINT,
            )
        stored = sum(lengths.tolist())
        budgets.TIFF_STRIPS.check(stored, "the strips of the TIFF overlap", size + _DIRECTORY_BYTES)

    def _unpacked(self, file: BinaryIO, length: int, announced: int) -> int:
        """Bytes that a strip of a file unpacks to, read no further than is needed to refuse it."""
        if self.compression == _PACKBITS:
            return run_lengths(file.read(length))
        unpack, present = zlib.decompressobj(), 0
        while length > 0 and not unpack.eof and (piece := file.read(min(length, _CHUNK))):
            length -= len(piece)
            present += inflated_bytes(unpack, piece)
            check_unpacked(present, announced)
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
    stored, pixel = _stored_type(page, form.order), 4 if tiled or bits == 1 else bits // 8  # 4: ITK gives colours
    is_plain = stored is not None and len(_bits(page)) == 1 and bits > 1 and compression == 1 and not tiled
    page_bytes = height * width * bits // 8
    planes, places = _planes(strips, page_bytes) if is_plain else None, np.array(list(pages), np.int64)
    if repeats > 1:
        if planes is None:
            raise InputError(f"the TIFF announces {repeats} images and has 1 page", "save a page for each slice")
        if int(planes[0]) + repeats * page_bytes > form.size:
            raise InputError(
                f"the TIFF announces {repeats} images, that is {repeats * page_bytes} bytes of voxels, and has "
                f"{form.size} bytes", TRUNCATED_HINT,
            )
        planes, places = planes[0] + np.arange(repeats, dtype=np.int64) * page_bytes, places.repeat(repeats)
        strips = [np.stack([planes, np.full(repeats, page_bytes)], axis=1)]
    ends = np.cumsum([len(some) for some in strips], dtype=np.int64) if repeats == 1 else np.arange(1, repeats + 1)
    strip_bytes = np.array([page_bytes]) if planes is not None else _strip_bytes(page, width, height, strips)
    return TiffHeader(
        path, (len(places), height, width), spacing, pixel, strip_bytes, np.concatenate(strips), compression, tiled,
        places, stored, planes, ends, decoder,
    )


def _stored_type(page: Page, order: Literal["<", ">"]) -> np.dtype[Any] | None:
    """Type of the values of a grey page; of black and white that which ITK gives. None for a colour."""
    bits = _bits(page)
    if page.get(PHOTOMETRIC, (1,))[0] not in (0, 1):
        return None
    return np.dtype(_KINDS[bits[0], _format(page)]).newbyteorder(order)


def _planes(strips: Sequence[NDArray[np.int64]], page_bytes: int) -> NDArray[np.int64] | None:
    """Where the pages begin, if the strips of each follow one another; None if not."""
    for some in strips:
        if some[:, 1].sum() != page_bytes or (some.sum(axis=1)[:-1] != some[1:, 0]).any():
            return None
    return np.array([some[0, 0] for some in strips], np.int64)


def _strip_bytes(
    page: Page, width: int, height: int, strips: Sequence[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Bytes of each strip or tile of a page when it is unpacked; of a tile, with what goes beyond the image.

    Raises
    ------
    InputError
        When a page has more or fewer of them than its size and theirs give.
    """
    bits = _bits(page)
    planes = len(bits) if page.get(PLANAR, (1,))[0] == 2 else 1
    bits_together = sum(bits) // planes
    wide, high = (width, _rows(page)) if TILES not in page else (int(page[TILE_WIDTH][0]), int(page[TILE_HEIGHT][0]))
    if min(wide, high) < 1:
        raise ValueError
    down, across = -(-height // high), -(-width // wide)
    for some in strips:
        if len(some) != planes * down * across:
            raise InputError(
                f"the TIFF has {len(some)} strips or tiles for {width} x {height} pixels, {planes * down * across} "
                "expected", TRUNCATED_HINT,
            )
    found = np.full((planes, down, across), high * ((wide * bits_together + 7) // 8), np.int64)
    if TILES not in page:
        found[:, -1] = (height - (down - 1) * high) * ((wide * bits_together + 7) // 8)
    return found.ravel()


def _rows(page: Page) -> int:
    """Rows of a strip."""
    return min(int(page.get(ROWS, page[HEIGHT])[0]), int(page[HEIGHT][0]))


def _bits(page: Page) -> tuple[int, ...]:
    """Bits of each value of a pixel."""
    return of_samples(page, BITS)


def _format(page: Page) -> int:
    """Sample format of all values of a pixel; 0 where they have several."""
    found = set(of_samples(page, FORMAT))
    return found.pop() if len(found) == 1 else 0


def of_samples(page: Page, tag: int) -> tuple[int, ...]:
    """Values of a tag that has one for each value of a pixel, or one for all.

    Raises
    ------
    InputError
        When there are other numbers of them.
    """
    samples, values = int(page.get(SAMPLES, (1,))[0]), page.get(tag, (1,))
    if not 0 < samples <= MAX_SAMPLES or len(values) not in (1, samples):
        raise InputError(
            f"the TIFF has {samples} values in a pixel, and {len(values)} values of the tag {RULES[tag].name}",
            TRUNCATED_HINT,
        )
    return tuple(values) if len(values) == samples else (int(values[0]),) * samples


def _page_kind(page: Page) -> tuple[Any, ...]:
    """What the pages of a stack have in common."""
    keys = (COMPRESSION, PHOTOMETRIC, ORIENTATION, PLANAR, PREDICTOR, FILL_ORDER)
    tags = tuple(page.get(key, (1,))[0] for key in keys)
    tile = page.get(TILE_WIDTH), page.get(TILE_HEIGHT), TILES in page
    return page[WIDTH][0], page[HEIGHT][0], _rows(page), _bits(page), _format(page), page.get(EXTRA), *tags, *tile


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
    bits, form, colour = _bits(page), _format(page), page.get(PHOTOMETRIC, (1,))[0]
    tiled, compression, predictor = TILES in page, page.get(COMPRESSION, (1,))[0], page.get(PREDICTOR, (1,))[0]
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
    elif page.get(FILL_ORDER, (1,))[0] != 1:
        wrong = "the bits of each byte in the other order"
    elif predictor not in (1, 2, 3) or predictor > 1 and (
        compression in _NO_PREDICTOR or (predictor == 3 and form != 3)
    ):
        wrong = f"differences (predictor number {predictor}) of {bits[0]}-bit values, packed by number {compression},"
    elif page.get(PLANAR, (1,))[0] not in (1, 2):
        wrong = f"planes of kind {page[PLANAR][0]}"
    elif EXTRA in page and (len(page[EXTRA]) != len(bits) - (1 if grey else 3) or max(page[EXTRA]) > 2):
        wrong = f"{len(bits)} values in a pixel, {len(page[EXTRA])} of them beside grey or colour,"
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
