"""The directories of a TIFF or BigTIFF: one for each page, with what its tags say."""

from __future__ import annotations

import os
import struct
from typing import Any, BinaryIO, Literal, NamedTuple

from accelsurf.errors import InputError
from accelsurf.io.formats.raster import TRUNCATED_HINT
from accelsurf.settings import budgets

SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, DESCRIPTION = 254, 256, 257, 258, 259, 262, 270
STRIPS, ORIENTATION, SAMPLES, ROWS, STRIP_BYTES, X_RES, Y_RES, PLANAR = 273, 274, 277, 278, 279, 282, 283, 284
RES_UNIT, TILE_WIDTH, TILE_HEIGHT, TILES, TILE_BYTES, FORMAT = 296, 322, 323, 324, 325, 339
FILL_ORDER, PREDICTOR, SUB_PAGES = 266, 317, 330
#: The tags that are read.
USED = frozenset((
    *(SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, DESCRIPTION, STRIPS, ORIENTATION, SAMPLES),
    *(ROWS, STRIP_BYTES, X_RES, Y_RES, PLANAR, RES_UNIT, TILE_WIDTH, TILE_HEIGHT, TILES, TILE_BYTES, FORMAT),
    *(FILL_ORDER, PREDICTOR, SUB_PAGES),
))
_TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 13: "I", 16: "Q", 18: "Q"}
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
    at, spent = form.first, 0
    pages: dict[int, Page] = {}
    while at:
        if at in pages:
            raise InputError("the pages of the TIFF run in a circle", hint=TRUNCATED_HINT)
        pages[at], following, spent = read_directory(file, form, at, spent)
        at = following
    return form, pages


def read_directory(file: BinaryIO, form: TiffForm, at: int, spent: int = 0) -> tuple[Page, int, int]:
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

    Returns
    -------
    dict, int, int
        The values by tag, where the next directory begins (0: there is none), and the bytes with those of this one.

    Raises
    ------
    InputError
        When the values take more bytes than the file has; ValueError or struct.error when it is damaged.
    """
    order, word, entry = form.order, form.word, form.entry_bytes
    file.seek(at)
    (count,) = struct.unpack(order + form.counter, file.read(struct.calcsize(form.counter)))
    if count > _MAX_ENTRIES:
        raise ValueError
    raw = file.read(count * entry)
    (following,) = struct.unpack(order + word, file.read(struct.calcsize(word)))
    page: Page = {}
    for place in range(0, count * entry, entry):
        tag, kind, n = struct.unpack_from(order + "HH" + word, raw, place)
        if tag not in USED:
            continue
        if tag in page:  # libraries do not agree which of the two counts
            raise ValueError
        spent += n * struct.calcsize("=" + _TYPES.get(kind, "B"))
        budgets.TIFF_TAGS.check(spent, "the entries of the TIFF", form.size + (1 << 16))
        field = raw[place + 4 + struct.calcsize(word) : place + entry]
        page[tag] = _values(file, order, kind, n, field)
    return page, following, spent


def _values(file: BinaryIO, order: str, kind: int, count: int, field: bytes) -> tuple[Any, ...]:
    """The values of an entry, in the entry itself or where it points."""
    code = _TYPES.get(kind)
    if code is None:
        return ()  # of a type that no tag used here has
    size = struct.calcsize(order + code) * count
    if size > len(field):
        file.seek(struct.unpack(order + ("Q" if len(field) == 8 else "I"), field)[0])
        field = file.read(size)
    if code == "s":
        return (field[:count].split(b"\0")[0].decode("utf-8", "replace"),)
    return struct.unpack(order + code * count, field[:size])
