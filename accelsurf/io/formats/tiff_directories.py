"""The directories of a TIFF or BigTIFF: one for each page, with what its tags say."""

from __future__ import annotations

import os
import struct
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.raster import TRUNCATED_HINT
from accelsurf.settings import budgets

SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, DESCRIPTION = 254, 256, 257, 258, 259, 262, 270
STRIPS, ORIENTATION, SAMPLES, ROWS, STRIP_BYTES, X_RES, Y_RES, PLANAR = 273, 274, 277, 278, 279, 282, 283, 284
RES_UNIT, TILE_WIDTH, TILE_HEIGHT, TILES, TILE_BYTES, FORMAT = 296, 322, 323, 324, 325, 339
FILL_ORDER, PREDICTOR, SUB_PAGES, EXTRA = 266, 317, 330, 338
_NAMES = {
    1: "BYTE", 2: "ASCII", 3: "SHORT", 4: "LONG", 5: "RATIONAL", 7: "UNDEFINED", 13: "IFD", 16: "LONG8", 18: "IFD8"
}
_TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 7: "s", 13: "I", 16: "Q", 18: "Q"}
#: Types of values: whole numbers, of any length, as TIFF 6.0 asks of readers; offsets; texts; fractions.
_WHOLE, _OFFSET, _TEXT, _FRACTION = (1, 3, 4, 16), (3, 4, 13, 16, 18), (1, 2, 7), (5,)
_OF_BIG_TIFF = (16, 18)
MAX_SAMPLES, ANY = (1 << 16) - 1, 1 << 62


class TagRule(NamedTuple):
    """What a tag that is read may be: libraries ignore one that they do not understand, and give other voxels then.

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


#: The tags that are read.
RULES = {
    SUBFILE: TagRule("NewSubfileType"), WIDTH: TagRule("ImageWidth"), HEIGHT: TagRule("ImageLength"),
    BITS: TagRule("BitsPerSample", most=MAX_SAMPLES), COMPRESSION: TagRule("Compression"),
    PHOTOMETRIC: TagRule("PhotometricInterpretation"), FILL_ORDER: TagRule("FillOrder"),
    DESCRIPTION: TagRule("ImageDescription", _TEXT, ANY), STRIPS: TagRule("StripOffsets", _OFFSET, ANY),
    ORIENTATION: TagRule("Orientation"), SAMPLES: TagRule("SamplesPerPixel"), ROWS: TagRule("RowsPerStrip"),
    STRIP_BYTES: TagRule("StripByteCounts", _WHOLE, ANY), X_RES: TagRule("XResolution", _FRACTION),
    Y_RES: TagRule("YResolution", _FRACTION), PLANAR: TagRule("PlanarConfiguration"),
    RES_UNIT: TagRule("ResolutionUnit"), PREDICTOR: TagRule("Predictor"), TILE_WIDTH: TagRule("TileWidth"),
    TILE_HEIGHT: TagRule("TileLength"), TILES: TagRule("TileOffsets", _OFFSET, ANY),
    TILE_BYTES: TagRule("TileByteCounts", _WHOLE, ANY), SUB_PAGES: TagRule("SubIFDs", _OFFSET, 32),
    EXTRA: TagRule("ExtraSamples", most=MAX_SAMPLES), FORMAT: TagRule("SampleFormat", most=MAX_SAMPLES),
}
_MAX_ENTRIES = 4096

Page = dict[int, tuple[Any, ...]]


class TiffForm(NamedTuple):
    """How the numbers of a file are written.

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
    version = struct.unpack(order + "H", start[2:4])[0] if start[:2] in (b"II", b"MM") and len(start) >= 4 else 0
    if version not in (42, 43):
        raise InputError("this is not a TIFF image: it does not start as one", hint="is it the right file?")
    big = version == 43
    word, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    first = struct.unpack_from(order + word, start, 8 if big else 4)[0]
    return TiffForm(order, word, count, entry, first, size)


def read_pages(file: BinaryIO) -> tuple[TiffForm, dict[int, Page]]:
    """Read the directories of a file, one after the other: where each begins, and its tags.

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
            raise InputError("the pages of the TIFF run in a circle", hint=TRUNCATED_HINT)
        found = read_directory(file, form, at, spent)
        # Directories may not lie upon one another: there could be one for nearly each byte of the file.
        spent, length = found.spent, length + found.length
        budgets.TIFF_TAGS.check(length, "the directories of the TIFF, which overlap", form.size)
        if WIDTH not in found.page or HEIGHT not in found.page:
            raise ValueError
        pages[at] = found.page
        at = found.following
    return form, pages


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
    is_known = kind in rule.types and 0 < count <= rule.most and (kind not in _OF_BIG_TIFF or len(field) == 8)
    size = struct.calcsize("=" + _TYPES[kind]) * count if is_known else 0
    # What an entry does not fill is zero: other bytes are of a longer value.
    if not is_known or (size < len(field) and rule.types != _TEXT and any(field[size:])):
        most = f"at most {rule.most} " if rule.most < ANY else ""
        raise InputError(
            f"the tag {rule.name} of the TIFF is damaged: {count} value{'s' if count > 1 else ''} of type "
            f"{_NAMES.get(kind, kind)}, {most}of type {' or '.join(_NAMES[known] for known in rule.types)} expected",
            TRUNCATED_HINT,
        )


def _values(file: BinaryIO, order: str, tag: int, kind: int, count: int, field: bytes) -> tuple[Any, ...]:
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
    strips = np.stack([np.array(page[offsets], np.int64), np.array(page[lengths], np.int64)], axis=1)
    ordered = strips[np.argsort(strips[:, 0], kind="stable")]
    if (ordered[1:, 0] - ordered[:-1, 0] < ordered[:-1, 1]).any():
        raise InputError("strips or tiles of a page of the TIFF overlap", TRUNCATED_HINT)
    return strips
