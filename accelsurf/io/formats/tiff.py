"""The pages of a TIFF: what their directories claim, and whether it is all there.

tifffile returns a stack that was cut short without its last slices, and ignores tags that are damaged. So the
directories are always read here first; tifffile unpacks the pages.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.settings import budgets

SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, DESCRIPTION = (
    254,
    256,
    257,
    258,
    259,
    262,
    270,
)
STRIPS, ORIENTATION, SAMPLES, ROWS, STRIP_BYTES, X_RES, Y_RES, PLANAR = (
    273,
    274,
    277,
    278,
    279,
    282,
    283,
    284,
)
RES_UNIT, TILE_WIDTH, TILE_HEIGHT, TILES, TILE_BYTES, FORMAT = 296, 322, 323, 324, 325, 339
FILL_ORDER, PREDICTOR, SUB_PAGES, EXTRA = 266, 317, 330, 338
_NAMES = {
    1: "BYTE",
    2: "ASCII",
    3: "SHORT",
    4: "LONG",
    5: "RATIONAL",
    7: "UNDEFINED",
    13: "IFD",
    16: "LONG8",
    18: "IFD8",
}
_TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 7: "s", 13: "I", 16: "Q", 18: "Q"}
#: Types of values: whole numbers, of any length, as TIFF 6.0 asks of readers; offsets; texts; fractions.
_WHOLE, _OFFSET, _TEXT, _FRACTION = (1, 3, 4, 16), (3, 4, 13, 16, 18), (1, 2, 7), (5,)
_OF_BIG_TIFF = (16, 18)
MAX_SAMPLES, ANY = (1 << 16) - 1, 1 << 62
_MAX_ENTRIES = 4096
Page = dict[int, tuple[Any, ...]]
_PLAIN_HINT = "save it as plain 8- or 16-bit grey (or RGB), uncompressed or with LZW or deflate"
_PALETTE_HINT = "save it as grey if its numbers are labels or values, as RGB if its colours count"
_MAX_TILE_EDGE = 1 << 12  # along an edge: a tile is held in memory, whatever the size of the image
_DIRECTORY_BYTES = 186  # about
DEFLATE = (8, 32946)
LZW, PACKBITS = 5, 32773
_RATIOS = {LZW: budgets.LZW, PACKBITS: budgets.PACKBITS, **dict.fromkeys(DEFLATE, budgets.DEFLATE)}
_NO_PREDICTOR = (1, PACKBITS)  # packings whose bytes are no differences
_FIRST_BYTE = 8  # after which strips and directories begin
#: Types of values that are written: bits and sample format (1 unsigned, 2 signed, 3 floating point).
STORED = {
    **{
        "uint8": (8, 1),
        "uint16": (16, 1),
        "uint32": (32, 1),
        "int8": (8, 2),
        "int16": (16, 2),
        "int32": (32, 2),
    },
    "float32": (32, 3),
}
#: Types of values by bits and sample format.
_KINDS = {kind: name for name, kind in STORED.items()} | {
    **{(1, 1): "uint8", (64, 1): "uint64", (64, 2): "int64", (16, 3): "float16", (64, 3): "float64"}
}


class TagRule(NamedTuple):
    """Types and number of values that a tag may have: libraries ignore one that they do not understand.

    Attributes
    ----------
    name : str
        Of the tag.
    types : tuple of int
        Of its values, by their numbers in TIFF.
    most : int
        The largest number of values.
    """

    name: str
    types: tuple[int, ...] = _WHOLE
    most: int = 1


#: The description of the first page of a file of ImageJ begins so.
IMAGEJ = "ImageJ="
#: The photometric interpretation of colours that a table in the file has.
_PALETTE = 3
#: The tags that are read.
RULES = {
    SUBFILE: TagRule("NewSubfileType"),
    WIDTH: TagRule("ImageWidth"),
    HEIGHT: TagRule("ImageLength"),
    BITS: TagRule("BitsPerSample", most=MAX_SAMPLES),
    COMPRESSION: TagRule("Compression"),
    PHOTOMETRIC: TagRule("PhotometricInterpretation"),
    FILL_ORDER: TagRule("FillOrder"),
    DESCRIPTION: TagRule("ImageDescription", _TEXT, ANY),
    STRIPS: TagRule("StripOffsets", _OFFSET, ANY),
    ORIENTATION: TagRule("Orientation"),
    SAMPLES: TagRule("SamplesPerPixel"),
    ROWS: TagRule("RowsPerStrip"),
    STRIP_BYTES: TagRule("StripByteCounts", _WHOLE, ANY),
    X_RES: TagRule("XResolution", _FRACTION),
    Y_RES: TagRule("YResolution", _FRACTION),
    PLANAR: TagRule("PlanarConfiguration"),
    RES_UNIT: TagRule("ResolutionUnit"),
    PREDICTOR: TagRule("Predictor"),
    TILE_WIDTH: TagRule("TileWidth"),
    TILE_HEIGHT: TagRule("TileLength"),
    TILES: TagRule("TileOffsets", _OFFSET, ANY),
    TILE_BYTES: TagRule("TileByteCounts", _WHOLE, ANY),
    SUB_PAGES: TagRule("SubIFDs", _OFFSET, 32),
    EXTRA: TagRule("ExtraSamples", most=MAX_SAMPLES),
    FORMAT: TagRule("SampleFormat", most=MAX_SAMPLES),
}


class TiffForm(NamedTuple):
    """Byte order and widths of the numbers of a file.

    Attributes
    ----------
    order : str
        Byte order.
    word, counter : str
        Codes of an offset and of a number of entries, as of `struct`.
    entry_bytes : int
        Length of an entry.
    first : int
        Where the first directory begins.
    size : int
        Bytes of the file.
    """

    order: Literal["<", ">"]
    word: str
    counter: str
    entry_bytes: int
    first: int
    size: int


class Directory(NamedTuple):
    """A directory.

    Attributes
    ----------
    page : Page
        The values by tag.
    following : int
        Where the next directory begins; 0 where there is none.
    spent : int
        Bytes of the values of this one and of those before.
    length : int
        Bytes of the directory itself.
    """

    page: Page
    following: int
    spent: int
    length: int


def read_form(file: BinaryIO) -> TiffForm:
    """Read the first bytes of a file.

    Raises
    ------
    InputError
        When it is no TIFF; struct.error when it ends too early.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    start = file.read(16)
    order: Literal["<", ">"] = "<" if start[:2] == b"II" else ">"
    version = (
        struct.unpack(order + "H", start[2:4])[0]
        if start[:2] in (b"II", b"MM") and len(start) >= 4
        else 0
    )
    if version not in (42, 43):
        raise InputError(
            "this is not a TIFF image: it does not start as one", hint="is it the right file?"
        )
    big = version == 43
    word, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    first = struct.unpack_from(order + word, start, 8 if big else 4)[0]
    return TiffForm(order, word, count, entry, first, size)


class Directories(NamedTuple):
    """Directories of an open file.

    Attributes
    ----------
    file : binary file
    form : TiffForm
        Of its numbers.
    pages : mapping of int to Page
        Where each directory begins, and its tags.
    """

    file: BinaryIO
    form: TiffForm
    pages: Mapping[int, Page]


def read_pages(file: BinaryIO) -> Directories:
    """Read the directories of a file, one after the other.

    Raises
    ------
    InputError
        When it is no TIFF or its pages run in a circle; ValueError or struct.error when it is damaged.
    """
    form = read_form(file)
    at, spent, length = form.first, 0, 0
    pages: dict[int, Page] = {}
    while at:
        if at in pages:
            raise InputError(
                "the TIFF is damaged: its last page points back to an earlier one",
                hint=TRUNCATED_HINT,
            )
        found = read_directory(file, form, at, spent)
        # Directories may not lie upon one another: there could be one for nearly each byte of the file.
        spent, length = found.spent, length + found.length
        budgets.TIFF_TAGS.check(length, "the directories of the TIFF, which overlap", form.size)
        if WIDTH not in found.page or HEIGHT not in found.page:
            raise ValueError
        pages[at] = found.page
        at = found.following
    first: Page = next(iter(pages.values()), {})
    if str(first.get(DESCRIPTION, ("",))[0]).startswith(IMAGEJ):
        pages = {at: _without_colours(page) for at, page in pages.items()}
    return Directories(file, form, pages)


def _without_colours(page: Page) -> Page:
    """A page of ImageJ as grey: its table of colours, or that it shows 0 as white, is for the display alone.

    ImageJ measures the stored numbers whatever table is chosen. Where another program writes a palette, the numbers
    are places in it and say nothing by themselves.
    """
    is_of_numbers = page.get(BITS, (1,))[0] >= 8 and page.get(SAMPLES, (1,))[0] == 1
    is_shown_otherwise = page.get(PHOTOMETRIC, (1,))[0] in (0, _PALETTE)
    return {**page, PHOTOMETRIC: (1,)} if is_of_numbers and is_shown_otherwise else page


def read_directory(file: BinaryIO, form: TiffForm, at: int, spent: int = 0) -> Directory:
    """Read one directory.

    Parameters
    ----------
    file : binary file
    form : TiffForm
        How it is written.
    at : int
        Where the directory begins.
    spent : int
        Bytes of the values of directories before: pages may name the same bytes again and again.

    Raises
    ------
    InputError
        When a tag is not as it has to be, or the values take more bytes than the file has; ValueError or struct.error
        when it is damaged.
    """
    order, word, entry = form.order, form.word, form.entry_bytes
    file.seek(at)
    (count,) = struct.unpack(order + form.counter, file.read(struct.calcsize(form.counter)))
    if count > _MAX_ENTRIES:
        raise ValueError
    raw = file.read(count * entry)
    (following,) = struct.unpack(order + word, file.read(struct.calcsize(word)))
    length = file.tell() - at
    page: Page = {}
    for place in range(0, count * entry, entry):
        tag, kind, n = struct.unpack_from(order + "HH" + word, raw, place)
        if (rule := RULES.get(tag)) is None:
            continue
        if tag in page:  # libraries do not agree which of the two counts
            raise ValueError
        field = raw[place + 4 + struct.calcsize(word) : place + entry]
        _check(rule, kind, n, field)
        spent += n * struct.calcsize("=" + _TYPES[kind])
        budgets.TIFF_TAGS.check(spent, "the entries of the TIFF", form.size + (1 << 16))
        page[tag] = _values(file, order, tag, kind, n, field)
    return Directory(page, following, spent, length)


def _check(rule: TagRule, kind: int, count: int, field: bytes) -> None:
    """Refuse an entry whose type or number of values are not those of its tag, or not those that were written.

    Raises
    ------
    InputError
        With both.
    """
    is_known = (
        kind in rule.types
        and 0 < count <= rule.most
        and (kind not in _OF_BIG_TIFF or len(field) == 8)
    )
    size = struct.calcsize("=" + _TYPES[kind]) * count if is_known else 0
    # What an entry does not fill is zero: other bytes are of a longer value.
    if not is_known or (size < len(field) and rule.types != _TEXT and any(field[size:])):
        most = f"at most {rule.most} " if rule.most < ANY else ""
        raise InputError(
            f"the tag {rule.name} of the TIFF is damaged: {count} value{'s' if count > 1 else ''} of type "
            f"{_NAMES.get(kind, kind)}, {most}of type {' or '.join(_NAMES[known] for known in rule.types)} expected",
            TRUNCATED_HINT,
        )


def _values(
    file: BinaryIO, order: str, tag: int, kind: int, count: int, field: bytes
) -> tuple[Any, ...]:
    """The values of an entry, in the entry itself or where it points; of a text also whether its end mark is there."""
    code = "s" if RULES[tag].types == _TEXT else _TYPES[kind]
    size = struct.calcsize(order + code) * count
    if size > len(field):
        file.seek(struct.unpack(order + ("Q" if len(field) == 8 else "I"), field)[0])
        field = file.read(size)
    if code == "s":
        text, mark, _ = field[:count].partition(b"\0")
        return _decoded(text), bool(mark)
    return struct.unpack(f"{order}{count * len(code)}{code[0]}", field[:size])


def _decoded(text: bytes) -> str:
    """A text in UTF-8; one that is none is in Latin-1, as ImageJ writes it: its micro sign is one byte."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def strips_of(page: Page) -> NDArray[np.int64]:
    """Offset and length of the strips or tiles of a page.

    Raises
    ------
    InputError
        When they overlap.
    """
    offsets, lengths = (TILES, TILE_BYTES) if TILES in page else (STRIPS, STRIP_BYTES)
    strips = np.stack(
        [np.array(page[offsets], np.int64), np.array(page[lengths], np.int64)], axis=1
    )
    ordered = strips[np.argsort(strips[:, 0], kind="stable")]
    if (ordered[1:, 0] - ordered[:-1, 0] < ordered[:-1, 1]).any():
        raise InputError("strips or tiles of a page of the TIFF overlap", TRUNCATED_HINT)
    return strips


@dataclass(frozen=True, eq=False)
class TiffHeader:
    """Claims of the directories of a TIFF, and the check that all of it is there.

    Attributes
    ----------
    data : Path
        The file.
    shape : tuple of int
        (pages, rows, columns).
    pixel_bytes : int
        Bytes that a pixel takes in memory, with all its colours.
    strip_bytes : ndarray (m,) of int64
        Bytes of each of the strips or tiles of a page when unpacked.
    strips : ndarray (n, 2) of int64
        Offset and length of the strips or tiles.
    compression : int
        Compression, by its number.
    directories : ndarray (n,) of int64
        Where the directories of the pages begin.
    stored : numpy.dtype or None
        Of the values of a grey image, with the byte order of the file; None for a colour.
    planes : ndarray (n,) of int64 or None
        Where the rows of each page begin, if they lie one after the other as they are.
    ends : ndarray (n,) of int64
        How many of the strips belong to the pages up to each.
    is_white_zero : bool
        Of black and white.
    sample : int or None
        Which value of each pixel is read, where it has several that are no colour.
    """

    data: Path
    shape: tuple[int, int, int]
    pixel_bytes: int
    strip_bytes: NDArray[np.int64]
    strips: NDArray[np.int64]
    compression: int
    directories: NDArray[np.int64]
    stored: np.dtype[Any] | None
    planes: NDArray[np.int64] | None
    ends: NDArray[np.int64]
    is_white_zero: bool = False
    sample: int | None = None

    @property
    def unpacked_bytes(self) -> int:
        """Bytes of all rows when unpacked; of pages in tiles, with what goes beyond the image."""
        return int(self.strip_bytes.sum()) * self.shape[0]

    def select_pages(self, pages: Sequence[int], sample: int | None = None) -> TiffHeader:
        """Return the header of some of the pages, in an order."""
        starts = np.concatenate([[0], self.ends[:-1]])
        strips = [self.strips[starts[page] : self.ends[page]] for page in pages]
        _, ny, nx = self.shape
        return replace(
            self,
            shape=(len(pages), ny, nx),
            strips=np.concatenate(strips),
            ends=np.cumsum([len(places) for places in strips], dtype=np.int64),
            directories=self.directories[list(pages)],
            sample=sample,
            planes=None if self.planes is None else self.planes[list(pages)],
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
        if (
            wrong := (offsets < _FIRST_BYTE)
            | (lengths <= 0)
            | (offsets > size)
            | (lengths > size - offsets)
        ).any():
            offset, length = self.strips[int(wrong.argmax())].tolist()
            raise InputError(
                f"the header announces {length} bytes of voxels at byte {offset}, the file has {size} bytes",
                hint=TRUNCATED_HINT,
            )
        stored = sum(lengths.tolist())
        budgets.TIFF_STRIPS.check(stored, "the strips of the TIFF overlap", size + _DIRECTORY_BYTES)
        if ratio := _RATIOS.get(self.compression):
            ratio.check(self.unpacked_bytes, "the header announces voxels", stored)
        if self.compression == 1 and (lengths != np.tile(self.strip_bytes, self.shape[0])).any():
            raise InputError(
                f"the header announces {self.unpacked_bytes} bytes of voxels, the file holds {stored}",
                TRUNCATED_HINT,
            )


def header_of(
    path: Path, form: TiffForm, pages: Mapping[int, Page], repeats: int = 1
) -> TiffHeader:
    """Collect the claims of the directories of like pages.

    Parameters
    ----------
    path : Path
        The file.
    form : TiffForm
        How it is written.
    pages : mapping of int to Page
        Where each begins, and its tags.
    repeats : int
        How many pages follow the rows of the only directory, its own among them.

    Raises
    ------
    InputError
        When the pages differ, or are of a kind that is not read; LookupError, ValueError and others when the tags are
        damaged.
    """
    listed = list(pages.values())
    first = _page_kind(listed[0])
    _check_kind(listed[0])
    for number, page in enumerate(listed[1:], 2):
        if _page_kind(page) != first:
            raise InputError(
                f"page {number} of the TIFF differs from the first in size or type, like slices expected",
                hint="extract the page, or the pages of one size, first",
            )
    page = listed[0]
    width, height, bits = int(page[WIDTH][0]), int(page[HEIGHT][0]), sum(_bits(page))
    compression = int(page.get(COMPRESSION, (1,))[0])
    strips = [strips_of(page) for page in listed]
    stored, pixel = _stored_type(page, form.order), max(1, bits // 8)
    is_plain = (
        stored is not None
        and len(_bits(page)) == 1
        and bits > 1
        and compression == 1
        and TILES not in page
    )
    page_bytes = height * width * bits // 8
    planes, places = (
        _planes(strips, page_bytes) if is_plain else None,
        np.array(list(pages), np.int64),
    )
    if repeats > 1:
        if planes is None:
            raise InputError(
                f"the TIFF announces {repeats} images and has 1 page", "save a page for each slice"
            )
        if int(planes[0]) + repeats * page_bytes > form.size:
            raise InputError(
                f"the TIFF announces {repeats} images, that is {repeats * page_bytes} bytes of voxels, and has "
                f"{form.size} bytes",
                TRUNCATED_HINT,
            )
        planes, places = (
            planes[0] + np.arange(repeats, dtype=np.int64) * page_bytes,
            places.repeat(repeats),
        )
        strips = [np.stack([planes, np.full(repeats, page_bytes)], axis=1)]
    ends = (
        np.cumsum([len(some) for some in strips], dtype=np.int64)
        if repeats == 1
        else np.arange(1, repeats + 1)
    )
    strip_bytes = (
        np.array([page_bytes]) if planes is not None else _strip_bytes(page, width, height, strips)
    )
    return TiffHeader(
        path,
        (len(places), height, width),
        pixel,
        strip_bytes,
        np.concatenate(strips),
        compression,
        places,
        stored,
        planes,
        ends,
        page.get(PHOTOMETRIC, (1,))[0] == 0,
    )


def _stored_type(page: Page, order: Literal["<", ">"]) -> np.dtype[Any] | None:
    """Type of the values of a grey page; of black and white that which ITK gives. None for a colour."""
    bits = _bits(page)
    if page.get(PHOTOMETRIC, (1,))[0] not in (0, 1):
        return None
    return np.dtype(_KINDS[bits[0], _format(page)]).newbyteorder(order)


def _planes(strips: Sequence[NDArray[np.int64]], page_bytes: int) -> NDArray[np.int64] | None:
    """Bytes at which the pages begin, if the strips of each follow one another; None if not."""
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
    wide, high = (
        (width, _rows(page))
        if TILES not in page
        else (int(page[TILE_WIDTH][0]), int(page[TILE_HEIGHT][0]))
    )
    if min(wide, high) < 1:
        raise ValueError
    down, across = -(-height // high), -(-width // wide)
    for some in strips:
        if len(some) != planes * down * across:
            raise InputError(
                f"the TIFF has {len(some)} strips or tiles for {width} x {height} pixels, {planes * down * across} "
                "expected",
                TRUNCATED_HINT,
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
    return sample_values(page, BITS)


def _format(page: Page) -> int:
    """Sample format of all values of a pixel; 0 where they have several."""
    found = set(sample_values(page, FORMAT))
    return found.pop() if len(found) == 1 else 0


def sample_values(page: Page, tag: int) -> tuple[int, ...]:
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
    """Key that the pages of a stack share."""
    keys = (COMPRESSION, PHOTOMETRIC, ORIENTATION, PLANAR, PREDICTOR, FILL_ORDER)
    tags = tuple(page.get(key, (1,))[0] for key in keys)
    tile = page.get(TILE_WIDTH), page.get(TILE_HEIGHT), TILES in page
    return (
        page[WIDTH][0],
        page[HEIGHT][0],
        _rows(page),
        _bits(page),
        _format(page),
        page.get(EXTRA),
        *tags,
        *tile,
    )


def samples_of(page: Page) -> int:
    """Number of values of a pixel that are channels: 1 for a colour."""
    return len(_bits(page)) if page.get(PHOTOMETRIC, (1,))[0] in (0, 1) else 1


def _check_kind(page: Page) -> None:
    """Refuse pages that do not give one number for each value of a pixel.

    Raises
    ------
    InputError
        With what they hold.
    """
    bits, form, colour = _bits(page), _format(page), page.get(PHOTOMETRIC, (1,))[0]
    tiled, compression, predictor = (
        TILES in page,
        page.get(COMPRESSION, (1,))[0],
        page.get(PREDICTOR, (1,))[0],
    )
    grey = colour in (0, 1)
    wrong = ""
    if not (page[WIDTH][0] and page[HEIGHT][0]):
        raise ValueError
    if PHOTOMETRIC not in page:
        wrong = "no word on whether 0 is black or white"
    elif colour == _PALETTE:
        wrong = "colours from a palette"
    elif not grey and (colour != 2 or len(bits) not in (3, 4)):
        wrong = f"{len(bits)} channels of colour kind {colour}"
    elif (
        len(set(bits)) > 1
        or (bits[0], form) not in _KINDS
        or (not grey and (form != 1 or bits[0] not in (8, 16)))
    ):
        wrong = f"{bits[0]}-bit {({1: 'unsigned', 2: 'signed', 3: 'floating-point'}).get(form, 'complex')} values"
    elif colour == 0 and bits != (1,):
        wrong = "values that grow towards black"
    elif page.get(ORIENTATION, (1,))[0] != 1:
        wrong = "rows and columns turned by its orientation tag"
    elif page.get(FILL_ORDER, (1,))[0] != 1:
        wrong = "the bits of each byte in the other order"
    elif predictor not in (1, 2) or (predictor == 2 and compression in _NO_PREDICTOR):
        wrong = f"differences (predictor number {predictor}) of {bits[0]}-bit values, packed by number {compression},"
    elif page.get(PLANAR, (1,))[0] not in (1, 2):
        wrong = f"planes of kind {page[PLANAR][0]}"
    elif EXTRA in page and (
        len(page[EXTRA]) != len(bits) - (1 if grey else 3) or max(page[EXTRA]) > 2
    ):
        wrong = f"{len(bits)} values in a pixel, {len(page[EXTRA])} of them beside grey or colour,"
    elif page.get(PLANAR, (1,))[0] != 1 and not grey:
        wrong = "colour channels one after the other"
    elif tiled and max(page[TILE_WIDTH][0], page[TILE_HEIGHT][0]) > _MAX_TILE_EDGE:
        wrong = f"tiles of {page[TILE_WIDTH][0]} x {page[TILE_HEIGHT][0]}"
    if wrong:
        raise InputError(
            f"a TIFF with {wrong} given, which cannot be read faithfully",
            _PALETTE_HINT if colour == _PALETTE else _PLAIN_HINT,
        )
