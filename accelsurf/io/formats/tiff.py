"""TIFF images: stacks, hyperstacks of ImageJ, OME-TIFF also of several files, pyramids; one or more channels at a time.

tifffile reads and unpacks the pages. It drops a tag that is damaged with a line in a log, ends a stack where the next
page is damaged, cuts off the surplus of a strip and fills up missing bytes. So its log is read, the chain of pages is
followed here, and strips are compared with the file before and after they are unpacked.
"""

from __future__ import annotations

import itertools
import logging
import math
import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from threading import get_ident
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL.TiffImagePlugin import TiffImageFile

from accelsurf.errors import InputError
from accelsurf.grid.arrays import Spacing
from accelsurf.grid.boxes import Box, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import headers, itk
from accelsurf.io.channels import selected, single, to_grey
from accelsurf.io.files import library_named, one_line
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels
from accelsurf.io.formats.tiff_stack import IMAGEJ, TiffStack, description_of, stack_of
from accelsurf.io.headers import FRAME_KEY, UNIT_KEY, FrameTimes, with_given_unit, with_warnings
from accelsurf.io.lazy_volume import (
    LazyVolume,
    Opening,
    PackedVoxels,
    StackedVoxels,
    StoreLayout,
    VoxelSource,
    checked_level,
)
from accelsurf.io.memory import check_memory
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_WIDTH = 256
_HEIGHT = 257
_PHOTOMETRIC = 262
_ORIENTATION = 274
_BITS = 258
_EXTRA = 338
_FORMAT = 339
_STRIPS = 273
_STRIP_BYTES = 279
_TILES = 324
_TILE_BYTES = 325
#: Tags that describe the voxels and their places: beside the named ones kind of page, packing, order of bits,
#: description, values of a pixel, rows of a strip, resolution (2), planes, its unit, predictor, tiles (2), levels.
_DESCRIBING = frozenset((254, 259, 266, 270, 277, 278, 282, 283, 284, 296, 317, 322, 323, 330)) | {
    *(_WIDTH, _HEIGHT, _PHOTOMETRIC, _ORIENTATION, _BITS, _EXTRA, _FORMAT),
    *(_STRIPS, _STRIP_BYTES, _TILES, _TILE_BYTES),
}
#: Types of values that are bytes: the rest of their field is not zero.
_TEXT = (1, 2, 7)
#: A line of tifffile's log about a tag that it drops, or has no value of.
_DROPPED = re.compile(r"TiffTag (\d+) @\d+> (invalid|could not)")
_DAMAGED = ("the TIFF header is cut short or damaged", TRUNCATED_HINT)
_PALETTE = 3
_RGB = 2
_PLAIN_HINT = "save it as plain 8- or 16-bit grey (or RGB), uncompressed or with LZW or deflate"
_PALETTE_HINT = "save it as grey if its numbers are labels or values, as RGB if its colours count"
#: Along an edge: a tile is held in memory, whatever the size of the image.
_MAX_TILE_EDGE = 1 << 12
#: Bytes of the entries of a small file: they may be more than its voxels.
_SLACK = 1 << 16
_NONE = 1
_LZW = 5
_PACKBITS = 32773
_DEFLATE = (8, 32946)
_RATIOS = {
    _LZW: budgets.LZW,
    _PACKBITS: budgets.PACKBITS,
    **dict.fromkeys(_DEFLATE, budgets.DEFLATE),
}
#: Packings of bytes, whose length tells nothing of the image: LZMA and Zstandard by both numbers among them.
_STREAMS = (_NONE, _LZW, _PACKBITS, *_DEFLATE, 34925, 34926, 50000)
#: The first byte that is no part of the head of the file.
_FIRST_BYTE = 8
_BEGINNINGS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


# ------------------------------------------------------------------------------------------------ pages of a file


class PageKind(NamedTuple):
    """Properties that the pages of a stack share.

    Attributes
    ----------
    height, width : int
    stored : numpy.dtype or None
        Of the values of a grey page, with the byte order of the file; None for a colour.
    samples : int
        Values of a pixel.
    pixel_bytes : int
        Bytes that a pixel takes in memory, with all its values.
    layout : tuple of int
        Numbers of the packing, and of the order of rows, planes and values.
    """

    height: int
    width: int
    stored: np.dtype[Any] | None
    samples: int
    pixel_bytes: int
    layout: tuple[int, ...]


class TiffReader:
    """The pages of an open file, compared with its bytes.

    Parameters
    ----------
    file : binary file

    Raises
    ------
    InputError
        When it is no TIFF; struct.error when it ends too early.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)
        file.seek(0)
        if file.read(4) not in _BEGINNINGS:
            raise InputError(
                "this is not a TIFF image: it does not start as one", hint="is it the right file?"
            )
        file.seek(0)
        with messages_of_tifffile(), library_named(*_DAMAGED):
            # Without pages of other files, and without arrangements that single makers mean.
            self._library = tifffile.TiffFile(
                file, _multifile=False, is_lsm=False, is_ndpi=False, is_scanimage=False
            )
            self._first = self._library.pages.first.offset
        self._form = self._library.tiff
        self._spent = self._stored = 0
        self._known: set[int] = set()

    @cached_property
    def is_imagej(self) -> bool:
        """Test if ImageJ has written the file: its table of colours, or 0 shown as white, is for the display alone.

        ImageJ measures the stored numbers whatever table is selected. Where another program writes a palette, the
        numbers are places in it and say nothing by themselves.
        """
        return description_of(self._library.pages.first).text.startswith(IMAGEJ)

    @cached_property
    def pages(self) -> list[tifffile.TiffPage]:
        """All of the chain.

        Raises
        ------
        InputError
            When the chain is a circle, or tags are damaged; struct.error when it is cut short.
        """
        found: dict[int, tifffile.TiffPage] = {}
        at = self._first
        while at:
            if at in found:
                raise InputError(
                    "the TIFF is damaged: its last page points back to an earlier one",
                    hint=TRUNCATED_HINT,
                )
            found[at] = self.page(at)
            self._file.seek(at)
            entries = self._unpacked(self._form.tagnoformat)
            self._file.seek(entries * self._form.tagsize, os.SEEK_CUR)
            at = self._unpacked(self._form.offsetformat)
        return list(found.values())

    def _unpacked(self, code: str) -> int:
        """The next number of the file."""
        return int(struct.unpack(code, self._file.read(struct.calcsize(code)))[0])

    def page(self, at: int) -> tifffile.TiffPage:
        """The page whose directory begins at a byte, as tifffile reads it.

        Raises
        ------
        InputError
            When tifffile cannot read it, a tag is damaged, or the values of tags take more bytes than the file has:
            pages may name the same bytes again and again, and tifffile loads them all.
        """
        with library_named(*_DAMAGED):
            with messages_of_tifffile() as said:
                self._library.filehandle.seek(at)
                page = tifffile.TiffPage(self._library, index=0)
            dropped = (int(found[1]) for line in said if (found := _DROPPED.search(line)))
            short = (tag.code for tag in page.tags if self._is_cut(tag))
            if damaged := sorted(_DESCRIBING.intersection([*dropped, *short])):
                raise ValueError(f"tag {tifffile.TIFF.TAGS[damaged[0]]}")
            if not {_HEIGHT, _WIDTH} <= {tag.code for tag in page.tags}:
                raise ValueError("a page has no size")
        if at not in self._known:
            self._known.add(at)
            loaded = (tag for tag in page.tags if tag.code in tifffile.TIFF.TAG_LOAD)
            self._spent += sum(tag.valuebytecount for tag in loaded)
            self._spent += len(page.tags) * self._form.tagsize
            budgets.TIFF_TAGS.check(self._spent, "the entries of the TIFF", self._size + _SLACK)
        return page

    def _is_cut(self, tag: tifffile.TiffTag) -> bool:
        """Test if the field of a short value has more than it: it is of a longer one, whose type is damaged."""
        left = tag.offset + self._form.tagsize - tag.valueoffset - tag.valuebytecount
        if tag.dtype in _TEXT or not 0 < left < self._form.tagoffsetthreshold:
            return False
        self._file.seek(tag.valueoffset + tag.valuebytecount)
        return any(self._file.read(left))

    def kind_of(self, page: tifffile.TiffPage) -> PageKind:
        """The properties of a page that can be read.

        Raises
        ------
        InputError
            When it does not give one number for each value of a pixel.
        """
        colour = int(page.photometric)
        if self.is_imagej and page.bitspersample >= 8 and page.samplesperpixel == 1:
            colour = 1 if colour in (0, _PALETTE) else colour
        if wrong := _unfaithful(page, colour):
            raise InputError(
                f"a TIFF with {wrong} given, which cannot be read faithfully",
                _PALETTE_HINT if colour == _PALETTE else _PLAIN_HINT,
            )
        _check_packing(page)
        bits, samples = int(page.bitspersample), page.samplesperpixel
        is_grey = colour != _RGB
        stored = np.dtype("u1" if bits == 1 else page.dtype).newbyteorder(self._form.byteorder)
        layout = (
            page.rowsperstrip,
            page.tilelength,
            page.tilewidth,
            page.compression,
            page.predictor,
            page.planarconfig,
            colour,
            *page.extrasamples,
        )
        return PageKind(
            page.imagelength,
            page.imagewidth,
            stored if is_grey else None,
            samples if is_grey else 1,
            max(1, bits * samples // 8),
            tuple(map(int, layout)),
        )

    def check_places(self, page: tifffile.TiffPage) -> None:
        """Refuse a page whose strips or tiles lie beyond the file, upon one another, or hold other numbers of bytes.

        Raises
        ------
        InputError
            With the numbers found and expected.
        """
        expected = math.prod(page.chunked)
        for tile, strip in ((_TILES, _STRIPS), (_TILE_BYTES, _STRIP_BYTES)):
            tag = page.tags.get(tile) or page.tags[strip]
            if tag.count != expected:
                raise InputError(
                    f"the TIFF has {tag.count} strips or tiles for {page.imagewidth} x {page.imagelength} pixels, "
                    f"{expected} expected",
                    TRUNCATED_HINT,
                )
        offsets, lengths = np.array([page.dataoffsets, page.databytecounts], np.int64)
        # No sum of the two is taken that 64 bits do not hold.
        is_wrong = (offsets < _FIRST_BYTE) | (offsets > self._size) | (lengths <= 0)
        is_wrong |= lengths > self._size - offsets
        if is_wrong.any():
            first = int(is_wrong.argmax())
            raise InputError(
                f"the header announces {lengths[first]} bytes of voxels at byte {offsets[first]}, the file has "
                f"{self._size} bytes",
                TRUNCATED_HINT,
            )
        order = offsets.argsort(kind="stable")
        if (np.diff(offsets[order]) < lengths[order][:-1]).any():
            raise InputError("strips or tiles of a page of the TIFF overlap", TRUNCATED_HINT)
        stored, announced = int(lengths.sum()), _announced_bytes(page)
        self._stored += stored
        budgets.TIFF_STRIPS.check(self._stored, "the strips of the TIFF overlap", self._size)
        if ratio := _RATIOS.get(page.compression):
            ratio.check(int(announced.sum()), "the header announces voxels", stored)
        if page.compression == _NONE and (lengths != announced).any():
            raise InputError(
                f"the header announces {announced.sum()} bytes of voxels, the file holds {stored}",
                TRUNCATED_HINT,
            )


def _unfaithful(page: tifffile.TiffPage, colour: int) -> str:
    """Name the property of a page by which its numbers are not the image's values; empty where there is none."""
    bits = page.bitspersample
    form = page.sampleformat
    samples = page.samplesperpixel
    packing, extra = page.compression, page.extrasamples
    is_grey = colour in (0, 1)
    counts = {page.tags[tag].count for tag in (_BITS, _FORMAT) if tag in page.tags}
    is_number = page.dtype is not None and (form in (1, 2, 3) if bits in (8, 16, 32, 64) else False)
    form_name = {1: "unsigned", 2: "signed", 3: "floating-point"}.get(form, "complex")
    is_difference = page.predictor == 2 and packing not in (_NONE, _PACKBITS)
    kinds = (
        (_PHOTOMETRIC not in page.tags, "no word on whether 0 is black or white"),
        (samples < 1, "no value in a pixel"),
        (colour == _PALETTE, "colours from a palette"),
        (
            not is_grey and (colour != _RGB or samples not in (3, 4)),
            f"{samples} channels of colour kind {colour}",
        ),
        (not counts <= {1, samples}, f"{samples} values in a pixel, and other numbers of types"),
        (not is_number and (bits, form) != (1, 1), f"{bits}-bit {form_name} values"),
        (not is_grey and (form != 1 or bits not in (8, 16)), f"{bits}-bit {form_name} colours"),
        (colour == 0 and (bits, samples) != (1, 1), "values that grow towards black"),
        (
            page.tags.valueof(_ORIENTATION, 1) != 1,
            "rows and columns turned by its orientation tag",
        ),
        (page.fillorder != 1, "the bits of each byte in the other order"),
        (
            page.predictor != 1 and not is_difference,
            f"differences (predictor number {page.predictor}) of {bits}-bit values, packed by number {packing},",
        ),
        (page.planarconfig not in (1, 2), f"planes of kind {page.planarconfig}"),
        (
            _EXTRA in page.tags
            and (len(extra) != samples - (1 if is_grey else 3) or max(extra) > 2),
            f"{samples} values in a pixel, {len(extra)} of them beside grey or colour,",
        ),
        (page.planarconfig != 1 and not is_grey, "colour channels one after the other"),
        (page.imagedepth != 1 or page.tiledepth != 1, "several slices in a page"),
        (
            max(page.tilewidth, page.tilelength) > _MAX_TILE_EDGE,
            f"tiles of {page.tilewidth} x {page.tilelength}",
        ),
    )
    return next((text for is_so, text in kinds if is_so), "")


def _check_packing(page: tifffile.TiffPage) -> None:
    """Refuse a packing that is not known here.

    Raises
    ------
    InputError
        With the package that has it, perhaps.
    """
    try:
        if page.compression != _LZW:
            tifffile.TIFF.DECOMPRESSORS[page.compression]
    except KeyError as error:
        raise InputError(
            f"this packing of a TIFF is not known without the package imagecodecs ({error.args[0]})",
            'install it: pip install "accelsurf[tiff]"',
        ) from None


def _announced_bytes(page: tifffile.TiffPage) -> NDArray[np.int64]:
    """Bytes of each strip or tile of a page when it is unpacked; of a tile, with its part beyond the image."""
    wide, high = page.tilewidth, page.tilelength
    if not page.is_tiled:
        wide, high = page.imagewidth, page.rowsperstrip
    is_together = page.planarconfig == 1
    bits = page.bitspersample * (page.samplesperpixel if is_together else 1)
    row = (wide * bits + 7) // 8
    planes = 1 if is_together else page.samplesperpixel
    down, across = -(-page.imagelength // high), -(-page.imagewidth // wide)
    found = np.full((planes, down, across), high * row, np.int64)
    if not page.is_tiled:
        found[:, -1] = (page.imagelength - (down - 1) * high) * row
    return found.ravel()


@contextmanager
def messages_of_tifffile() -> Iterator[list[str]]:
    """Take the lines that tifffile logs in this thread; they go nowhere else."""
    said: list[str] = []

    def collect(record: logging.LogRecord) -> bool:
        if record.thread != get_ident():
            return True
        said.append(" ".join(record.getMessage().split())[:200])
        return False

    logger = logging.getLogger("tifffile")
    logger.addFilter(collect)
    try:
        yield said
    finally:
        logger.removeFilter(collect)


# ------------------------------------------------------------------------------------------------ voxels of pages


@dataclass(frozen=True, eq=False)
class TiffPart:
    """Like pages of a file.

    Attributes
    ----------
    data : Path
        The file.
    kind : PageKind
    directories : ndarray (n,) of int64
        Where the directories of the pages begin.
    planes : ndarray (n,) of int64 or None
        Where the rows of each page begin, if they lie one after the other as they are.
    faults : dict of int to InputError
        Why pages, by their places among these, cannot be read; the others can.
    sample : int
        Which value of each pixel is read, where it has several that are no colour.
    """

    data: Path
    kind: PageKind
    directories: NDArray[np.int64]
    planes: NDArray[np.int64] | None
    faults: Mapping[int, InputError]
    sample: int = 0

    @property
    def shape(self) -> tuple[int, int, int]:
        """(pages, rows, columns)."""
        return len(self.directories), self.kind.height, self.kind.width

    def select_pages(self, pages: Sequence[int], sample: int = 0) -> TiffPart:
        """Return some of the pages, in an order.

        Raises
        ------
        InputError
            When the strips of one are not all there.
        """
        for page in pages:
            if page in self.faults:
                raise self.faults[page]
        planes = None if self.planes is None else self.planes[list(pages)]
        directories = self.directories[list(pages)]
        return replace(self, directories=directories, planes=planes, faults={}, sample=sample)


class TiffPages(PackedVoxels):
    """The pages of a stack, unpacked one by one.

    Parameters
    ----------
    part : TiffPart
    cache_bytes : int
        Of unpacked pages that are held.
    """

    def __init__(self, part: TiffPart, cache_bytes: int) -> None:
        super().__init__(part.data, cache_bytes)
        self._part = part
        stored = part.kind.stored
        self.dtype = np.dtype(np.uint8) if stored is None else stored.newbyteorder("=")

    def _values_in(self, box: Box) -> NDArray[Any]:
        """Return the values in a box, of colours with these along a last axis."""
        values: NDArray[Any] | None = None
        with self._part.data.open("rb") as file:
            reader = TiffReader(file)
            for z in range(box[0].start, box[0].stop):
                page = self._piece(z, partial(self._values, reader, z))[box[1:]]
                if values is None:
                    values = np.empty([box[0].stop - box[0].start, *page.shape], page.dtype)
                values[z - box[0].start] = page
        assert values is not None
        return values

    def _values(self, reader: TiffReader, z: int) -> NDArray[Any]:
        """Return the values of a page: (ny, nx), of a colour (ny, nx, 3 or 4).

        Raises
        ------
        InputError
            When it cannot be unpacked, or holds other numbers of bytes than its tags announce.
        """
        kind = self._part.kind
        with library_named(f"page {z + 1} is damaged", TRUNCATED_HINT):
            page = reader.page(int(self._part.directories[z]))
            with messages_of_tifffile() as said:
                found = _unpacked_page(page)
            if said:
                raise ValueError(said[0])
            if found.dtype == bool:  # black and white, by the lowest and the highest grey
                found = np.where(found == (page.photometric == 0), np.uint8(0), np.uint8(255))
            if found.ndim == 3 and kind.stored is not None:
                # Values of a pixel lie together, or each has a plane of its own.
                found = np.moveaxis(found, -1, 0) if page.planarconfig == 1 else found
                found = found[self._part.sample]
            found = found.astype(found.dtype.newbyteorder("="), copy=False)
            is_expected = kind.stored is None or (found.dtype, found.ndim) == (self.dtype, 2)
            if not is_expected or found.shape[:2] != self._part.shape[1:]:
                raise ValueError(f"it is read as {found.dtype} {found.shape}")
        return found


def _unpacked_page(page: tifffile.TiffPage) -> NDArray[Any]:
    """The values of a page, as tifffile shapes them."""
    if page.compression not in _STREAMS:
        return page.asarray(maxworkers=1)
    contents = []
    for offset, length in zip(page.dataoffsets, page.databytecounts, strict=True):
        page.parent.filehandle.seek(offset)
        contents.append(page.parent.filehandle.read(length))
    if page.compression != _LZW:
        return _joined(page, contents)
    # libtiff prints about damages, and goes on. It unpacks the announced bytes and does not tell whether more follow:
    # of the first and the last strip it is asked for one byte more.
    ends = {contents[n]: int(_announced_bytes(page)[n]) for n in (0, -1)}
    longer = partial(_longer_lzw, ends)
    if itk.listened(longer, refuses=False):
        raise ValueError("a strip holds more bytes of voxels than its tags announce")
    return itk.listened(partial(_joined, page, contents))


def _joined(page: tifffile.TiffPage, contents: list[bytes]) -> NDArray[Any]:
    """Unpack the strips or tiles of a page one by one, and join them."""
    compression, announced = page.compression, _announced_bytes(page).tolist()
    page.compression = tifffile.COMPRESSION.NONE  # tifffile shall place bytes already unpacked
    out = np.zeros(page.shaped, page.dtype)
    for number, (packed, count) in enumerate(zip(contents, announced, strict=True)):
        values, index, shape = page.decode(_unpacked(compression, packed, count), number)
        assert values is not None
        sample, z, y, x, _ = index
        some = out[sample, z : z + shape[0], y : y + shape[1], x : x + shape[2]]
        some[...] = values[: some.shape[0], : some.shape[1], : some.shape[2]]
    return out.reshape(page.shape)


def _unpacked(compression: int, content: bytes, announced: int) -> bytes:
    """Unpack a strip or tile to the bytes that the tags announce.

    Raises
    ------
    ValueError
        When it holds other numbers of them; zlib.error and others when it is damaged.
    """
    if compression in _DEFLATE:
        found = zlib.decompressobj().decompress(content, announced + 1)
    elif compression == _LZW:
        found = _unpacked_lzw(content, announced)
    else:
        found = tifffile.TIFF.DECOMPRESSORS[compression](content)
    if len(found) != announced:
        raise ValueError(
            f"a strip or tile holds {len(found)} bytes of voxels or more, its tags announce {announced}"
        )
    return found


def _unpacked_lzw(content: bytes, announced: int) -> bytes:
    """Unpack LZW by way of libtiff, which Pillow has, as a grey image of one row: tifffile needs imagecodecs for it."""
    # 1 word each: width, height, bits, compression, 0 is black, place, values of a pixel, rows, length.
    tags = {256: announced, 257: 1, 258: 8, 259: _LZW, 262: 1, 273: 8, 277: 1, 278: 1}
    tags[279] = len(content)
    start = 8 + len(content) + len(content) % 2
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    head = struct.pack("<2sHI", b"II", 42, start) + content.ljust(start - 8, b"\0")
    try:
        with TiffImageFile(BytesIO(head + directory)) as image:
            return image.tobytes()
    except OSError as error:
        raise ValueError(
            f"the LZW codes of a strip or tile are damaged, or end before {announced} bytes of voxels"
        ) from error


def _longer_lzw(ends: dict[bytes, int]) -> bool:
    """Test if one of some strips holds more bytes than announced."""
    for packed, announced in ends.items():
        try:
            _unpacked_lzw(packed, announced + 1)
        except ValueError:
            continue
        return True
    return False


# ---------------------------------------------------------------------------------------------------- the image


@dataclass(frozen=True, eq=False)
class TiffImage:
    """Claims of a TIFF.

    Attributes
    ----------
    data : Path
        The file.
    stack : TiffStack
        Arrangement of the pages; it numbers them as ``parts`` does.
    parts : tuple of TiffPart
        Of each file, the pages that are used, at the level that is read.
    grids : tuple of Geometry
        Of the levels, finest first.
    level : int
        Which of them is read.
    metadata : dict of str to str
        As in `Volume`.
    options : ReadOptions
        Which channel and time point is read.
    """

    data: Path
    stack: TiffStack
    parts: tuple[TiffPart, ...]
    grids: tuple[Geometry, ...]
    level: int
    metadata: dict[str, str]
    options: ReadOptions

    @property
    def channels(self) -> int:
        """Number of them."""
        return self.stack.channels * self.parts[0].kind.samples

    @property
    def time_points(self) -> int:
        """Number of them."""
        return self.stack.time_points

    @property
    def frame_times(self) -> FrameTimes | None:
        """When they are; None where the file does not say it."""
        return self.stack.frame_times

    @property
    def geometry(self) -> Geometry:
        """The grid of the level that is read."""
        return self.grids[self.level]


def parse_tiff(path: Path, options: ReadOptions = AS_IT_IS) -> TiffImage:
    """Read the directories of a TIFF (also BigTIFF), and of the files that belong to it.

    Raises
    ------
    InputError
        When it is none, is damaged, its pages differ, or it is of a kind that is not read.
    UsageError
        When the level does not exist.
    """
    try:
        with path.open("rb") as file:
            reader = TiffReader(file)
            shown = _without_thumbnails(reader.pages)
            first = shown[0]
            stack = stack_of(first, len(shown), reader.kind_of(first).samples)
            sizes = _level_sizes(reader, first)
            level = checked_level(options.level, sizes)
            counted = reader.pages if stack.counts_all else shown
            parts, stack = _pages_of_files(path, reader, counted, stack, level)
        spacing, metadata = _spacing(stack, options)
        grids = _grids(stack, sizes, spacing)
    except (ArithmeticError, LookupError, TypeError, ValueError, struct.error) as error:
        reason, hint = _DAMAGED
        raise InputError(f"{reason} ({one_line(error)})", hint) from error
    return TiffImage(path, stack, parts, grids, level, metadata, options)


def _without_thumbnails(pages: Sequence[tifffile.TiffPage]) -> list[tifffile.TiffPage]:
    """The pages that are not smaller versions of others.

    Raises
    ------
    InputError
        When there is none, or one is called smaller and is not.
    """
    shown = [page for page in pages if not page.is_reduced]
    if not shown:
        raise InputError("the TIFF holds no page", hint=TRUNCATED_HINT)
    full = shown[0].imagelength * shown[0].imagewidth
    for number, page in enumerate(pages, 1):
        if page.is_reduced and page.imagelength * page.imagewidth >= full:
            raise InputError(
                f"page {number} of the TIFF is marked as a reduced copy of another, but is as large as the first page",
                "save the stack again, without this mark (NewSubfileType)",
            )
    return shown


def _level_sizes(reader: TiffReader, first: tifffile.TiffPage) -> list[tuple[int, int]]:
    """Rows and columns of the levels, by the directories below that of the first page."""
    sizes = [(first.imagelength, first.imagewidth)]
    for at in first.subifds or ():
        page = reader.page(int(at))
        height, width = page.imagelength, page.imagewidth
        if not (0 < height <= sizes[-1][0] and 0 < width <= sizes[-1][1]):
            return sizes[:1]  # it is no pyramid
        sizes.append((height, width))
    return sizes


def _pages_of_files(
    path: Path,
    reader: TiffReader,
    counted: Sequence[tifffile.TiffPage],
    stack: TiffStack,
    level: int,
) -> tuple[tuple[TiffPart, ...], TiffStack]:
    """The pages of each file at a level, and the stack with their numbers."""
    numbers = np.zeros_like(stack.pages) if stack.file_numbers is None else stack.file_numbers
    new_pages, new_files = np.empty_like(stack.pages), np.empty_like(stack.pages)
    parts: list[TiffPart] = []
    for number, name in enumerate(stack.files):
        mine = numbers == number
        if not mine.any():
            continue
        wanted, places = np.unique(stack.pages[mine], return_inverse=True)
        if number:
            other = path.parent / name
            headers.check_data_file(path, other)
            with other.open("rb") as file:
                further = TiffReader(file)
                part = _pages_of_file(other, further, further.pages, wanted.tolist(), level)
        elif len(counted) == 1 < len(wanted) and not stack.counts_all:
            part = _pages_of_file(path, reader, counted, [0], level)
            part = _repeated(part, len(wanted), path.stat().st_size)
        else:
            part = _pages_of_file(path, reader, counted, wanted.tolist(), level)
        new_pages[mine], new_files[mine] = places, len(parts)
        parts.append(part)
    if len({(part.shape[1:], part.kind.stored) for part in parts}) > 1:
        raise InputError("the files of the OME-TIFF differ in size or type", "export them again")
    return tuple(parts), replace(stack, pages=new_pages, file_numbers=new_files)


def _pages_of_file(
    path: Path,
    reader: TiffReader,
    counted: Sequence[tifffile.TiffPage],
    wanted: list[int],
    level: int,
) -> TiffPart:
    """Some pages of a file.

    Raises
    ------
    InputError
        When they are not there, or differ.
    """
    if wanted[-1] >= len(counted):
        raise InputError(
            f"page {wanted[-1] + 1} of the TIFF is announced, and it has {len(counted)}",
            TRUNCATED_HINT,
        )
    first: PageKind | None = None
    directories, planes = [], []
    faults: dict[int, InputError] = {}
    for place, number in enumerate(wanted):
        page = counted[number]
        if level:
            page = reader.page(int((page.subifds or ())[level - 1]))
        kind = reader.kind_of(page)
        if first is None:
            first = kind
        if kind != first:
            raise InputError(
                f"page {number + 1} of the TIFF differs from the first in size or type, like slices expected",
                hint="extract the page, or the pages of one size, first",
            )
        try:
            reader.check_places(page)
        except InputError as error:
            faults[place] = error.with_traceback(None)
        directories.append(page.offset)
        if page.is_final and kind.samples == 1 and kind.stored is not None:
            planes.append(page.dataoffsets[0])
    assert first is not None
    if len(set(directories)) < len(wanted):
        raise InputError("pages of the TIFF share a directory of a level", TRUNCATED_HINT)
    is_plain = len(planes) == len(wanted)
    places = np.array(planes, np.int64) if is_plain else None
    return TiffPart(path, first, np.array(directories, np.int64), places, faults)


def _repeated(part: TiffPart, count: int, size: int) -> TiffPart:
    """The pages of ImageJ that follow the rows of the only directory of a file of a size.

    Raises
    ------
    InputError
        When they are not there.
    """
    if part.planes is None:
        raise InputError(
            f"the TIFF announces {count} images and has 1 page", "save a page for each slice"
        )
    first = int(part.planes[0])
    page_bytes = part.kind.height * part.kind.width * part.kind.pixel_bytes
    if first + count * page_bytes > size:
        raise InputError(
            f"the TIFF announces {count} images, that is {count * page_bytes} bytes of voxels, and has {size} bytes",
            TRUNCATED_HINT,
        )
    planes = first + np.arange(count, dtype=np.int64) * page_bytes
    directories = part.directories.repeat(count)
    return replace(part, directories=directories, planes=planes)


def _spacing(stack: TiffStack, options: ReadOptions) -> tuple[Spacing, dict[str, str]]:
    """The size of a voxel (z, y, x), mm, and metadata of the image."""
    notes = []
    said = stack.lengths
    spacing, reason = said.spacing, f" ({said.reason})" if said.reason else ""
    text = " x ".join(f"{h:.6g}" for h in spacing[::-1])
    if options.spacing is not None:
        x, y, z = options.spacing
        known = (spacing[0] if said.is_depth_known else z, *spacing[1:])
        if said.unit and not np.allclose(known, (z, y, x), rtol=1e-4, atol=0):
            found = " x ".join(f"{h:.6g}" for h in known[::-1])
            notes.append(
                f"the voxels are {x:.6g} x {y:.6g} x {z:.6g} mm, as given; the file says {found} mm"
            )
        spacing = (z, y, x)
    elif stack.pages.shape[2] > 1 and not said.is_depth_known:
        lacking = "how far apart its slices are" if said.unit else "how large a voxel is"
        notes.append(f"the TIFF does not say {lacking}{reason}: 1 mm is taken; give --spacing")
    elif reason:
        notes.append(
            f"a length in the TIFF is negative, zero or unknown{reason}: voxels of {text} mm are taken; if that is "
            "wrong, give --spacing"
        )
    metadata = with_warnings({}, *notes)
    if said.unit in ("nm", "um"):
        metadata[UNIT_KEY] = said.unit
    metadata = with_given_unit(metadata, options)
    if stack.seconds is not None:
        metadata[FRAME_KEY] = repr(stack.seconds)
    return spacing, metadata


def _grids(
    stack: TiffStack, sizes: Sequence[tuple[int, int]], spacing: Spacing
) -> tuple[Geometry, ...]:
    """The grids of the levels, which all cover the same rectangle."""
    depth, (height, width) = stack.pages.shape[2], sizes[0]
    hz, hy, hx = spacing
    out = []
    for rows, columns in sizes:
        fy, fx = height / rows, width / columns
        origin = (0.5 * (fx - 1) * hx, 0.5 * (fy - 1) * hy, 0.0)
        out.append(Geometry((depth, rows, columns), (hz, hy * fy, hx * fx), origin))
    return tuple(out)


def open_tiff(path: Path, header: TiffImage, opening: Opening) -> LazyVolume:
    """Open one channel of a grey image, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : TiffImage
        Its claims.
    opening : Opening
        How many bytes of unpacked pages are held.

    Raises
    ------
    InputError
        When it is a colour image, or has several channels or time points of which none was named.
    """
    place = single(header.channels, header.time_points, header.options)
    return _opened(path, header, *place, opening.cache_bytes)


def _opened(path: Path, image: TiffImage, t: int, c: int, cache_bytes: int) -> LazyVolume:
    """A channel at a time point."""
    channel, sample = divmod(c, image.parts[0].kind.samples)
    pages = image.stack.pages[t, channel].tolist()
    assert image.stack.file_numbers is not None
    numbers = image.stack.file_numbers[t, channel].tolist()
    sources = []
    depths = []
    is_packed = False
    for number, group in itertools.groupby(
        zip(numbers, pages, strict=True), key=lambda pair: pair[0]
    ):
        part = image.parts[number].select_pages([page for _, page in group], sample)
        sources.append(_source(part, cache_bytes))
        depths.append(part.shape[0])
        is_packed = is_packed or part.planes is None
    voxels: VoxelSource = sources[0] if len(sources) == 1 else StackedVoxels(sources, depths)
    chunks = (1, *image.geometry.shape[1:]) if is_packed else None
    layout = StoreLayout(image.grids, chunks, image.channels, image.time_points, image.level)
    return LazyVolume(voxels, image.geometry, dict(image.metadata), path, layout)


def _source(part: TiffPart, cache_bytes: int) -> VoxelSource:
    """The voxels of some pages of a file.

    Raises
    ------
    InputError
        When they have colours.
    """
    if part.kind.stored is None:
        raise InputError(
            "a colour TIFF given: whether its three colours are the same everywhere is not known before all is read",
            "save it as grey",
        )
    if part.planes is not None:
        return RawVoxels(RawLayout(part.data, 0, part.kind.stored, part.shape, part.planes))
    return TiffPages(part, cache_bytes)


def read_tiff(path: Path, header: TiffImage, available: int) -> Volume:
    """Read an image of one channel, or the channel that was asked for.

    Raises
    ------
    InputError
        When the file is larger than the memory, or has several channels or time points.
    """
    place = single(header.channels, header.time_points, header.options)
    return _read(path, header, place, available, 1)


def read_tiff_channels(path: Path, header: TiffImage, available: int) -> list[Volume]:
    """Read the channels of an image, or the one that was asked for.

    Raises
    ------
    InputError
        As `read_tiff`, and for more than `accelsurf.io.channels.MAX_CHANNELS` channels.
    """
    places = selected(header.channels, header.time_points, header.options)
    return [_read(path, header, place, available, len(places)) for place in places]


def _read(
    path: Path, image: TiffImage, place: tuple[int, int], available: int, count: int
) -> Volume:
    """A channel at a time point, whole."""
    part, grid = image.parts[0], image.geometry
    check_memory(grid.shape[::-1], part.kind.pixel_bytes * count, available)
    if part.kind.stored is None and len(image.parts) == 1:
        t, c = place
        pages = TiffPages(part.select_pages(image.stack.pages[t, c].tolist()), 0)
        array, note = to_grey(pages.read(whole_box(grid.shape)))
        return Volume(array, grid, with_warnings(image.metadata, note), path)
    lazy = _opened(path, image, *place, 0)
    return Volume(lazy.voxels.read(whole_box(lazy.shape)), lazy.geometry, lazy.metadata, path)
