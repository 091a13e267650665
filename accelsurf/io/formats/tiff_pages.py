"""TIFF stacks that are read some pages at a time, unpacked by tifffile.

tifffile cuts off what is too much in a strip and fills up what is missing, so the packings that have no length of their
own are unpacked here first, to exactly the bytes that the tags announce; tifffile undoes the differences and puts the
strips or tiles in their places. Without the package imagecodecs it has no LZW: Pillow unpacks that.
"""

from __future__ import annotations

import logging
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from io import BytesIO
from threading import get_ident
from typing import Any, BinaryIO

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL.TiffImagePlugin import TiffImageFile

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io import itk
from accelsurf.io.files import file_version, one_line
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import CHANGED
from accelsurf.io.formats.tiff import (
    DEFLATE,
    LZW,
    PACKBITS,
    TiffHeader,
    read_directory,
    read_form,
    strips_of,
)
from accelsurf.io.lazy_volume import ChunkCache

#: Packings of bytes, whose length tells nothing of the image: LZMA and Zstandard by both numbers among them.
_STREAMS = (1, LZW, PACKBITS, *DEFLATE, 34925, 34926, 50000)
_GROUP_BYTES = 1 << 26  # of pages that are unpacked at once where none is held


class TiffPages:
    """The pages of a stack, unpacked one by one, or some at once where none is held.

    Parameters
    ----------
    header : TiffHeader
        What its directories claim.
    cache_bytes : int
        Of unpacked pages that are held.
    """

    def __init__(self, header: TiffHeader, cache_bytes: int) -> None:
        # The strips of all pages take more space than all else together; those of one are read again with it.
        self._header = replace(header, strips=header.strips[:0])
        self.dtype = (
            np.dtype(np.uint8) if header.stored is None else header.stored.newbyteorder("=")
        )
        self._cache = ChunkCache(cache_bytes)
        self._version = file_version(header.data.stat())
        _, ny, nx = header.shape
        self._is_checked = False
        self._step = 1 if cache_bytes else max(1, _GROUP_BYTES // (ny * nx * header.pixel_bytes))

    @property
    def bytes_read(self) -> int:
        """Bytes of the pages that were read so far, unpacked."""
        return self._cache.bytes_made

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box, of colours with these along a last axis; see `accelsurf.io.LazyVolume.read`.

        Raises
        ------
        InputError
            When a page is damaged, or the file has changed since it was opened; OSError when it is gone.
        """
        values: NDArray[Any] | None = None
        for z in range(box[0].start, box[0].stop, self._step):
            some = range(z, min(z + self._step, box[0].stop))
            pages = self._cache.get(some, lambda some=some: self._pages(some))  # type: ignore[misc]
            if values is None:
                values = np.empty([*(s.stop - s.start for s in box), *pages.shape[3:]], pages.dtype)
            values[z - box[0].start : some.stop - box[0].start] = pages[(slice(None), *box[1:])]
        return np.empty([s.stop - s.start for s in box], self.dtype) if values is None else values

    def _pages(self, numbers: range) -> NDArray[Any]:
        """Return the values of some pages."""
        header = self._header
        with header.data.open("rb") as file:
            if file_version(os.fstat(file.fileno())) != self._version:
                raise InputError(*CHANGED)
            form = read_form(file)
            directories = [int(header.directories[z]) for z in numbers]
            strips = [strips_of(read_directory(file, form, at).page) for at in directories]
            first, last = numbers[0] + 1, numbers[-1] + 1
            where = f"page {first}" if first == last else f"one of the pages {first} to {last}"
            try:
                replace(
                    header, shape=(len(numbers), *header.shape[1:]), strips=np.concatenate(strips)
                ).check_places()
                if header.compression == LZW and not self._is_checked:
                    ends, announced = (
                        _contents(file, strips[0][[0, -1]]),
                        header.strip_bytes[[0, -1]].tolist(),
                    )
                    itk.listened(lambda: _check_lzw_ends(ends, announced), refuses=False)
                    self._is_checked = True
                found = [
                    _page(file, at, places, header)
                    for at, places in zip(directories, strips, strict=True)
                ]
            except InputError as error:
                raise InputError(f"{where} is damaged ({error.message})", error.hint) from error
        for page in found:
            is_expected = header.stored is None or (page.dtype, page.ndim) == (self.dtype, 2)
            if (
                not is_expected
                or page.shape[:2] != header.shape[1:]
                or page.shape != found[0].shape
            ):
                raise InputError(
                    f"{where} is read as {page.dtype} {page.shape}, {self.dtype} {header.shape[1:]} expected",
                    "save the stack as a plain TIFF",
                )
        return np.stack(found)


def _page(file: BinaryIO, at: int, strips: NDArray[np.int64], header: TiffHeader) -> NDArray[Any]:
    """Return the values of the page whose directory begins at a byte: (ny, nx), of a colour (ny, nx, 3 or 4).

    Raises
    ------
    InputError
        When it cannot be unpacked, or holds other numbers of bytes than its tags announce.
    """
    try:
        file.seek(0)
        with _heard() as said, tifffile.TiffFile(file, _multifile=False) as stack:
            stack.filehandle.seek(at)
            page = tifffile.TiffPage(stack, index=0)
            said.clear()  # of tags, also of those that do not count
            if header.compression in _STREAMS:
                contents = _contents(
                    file, strips
                )  # here: a library that is listened to has files of its own
                joined = partial(_joined, page, contents, header)
                # libtiff prints about damages, and goes on.
                found = itk.listened(joined) if header.compression == LZW else joined()
            else:
                found = page.asarray(maxworkers=1)
            if said:
                raise InputError(f"tifffile: {said[0]}", TRUNCATED_HINT)
    except (OSError, MemoryError, InputError):
        raise
    except Exception as error:  # each codec raises errors of its own
        message = one_line(error)
        if "imagecodecs" in message:
            raise InputError(
                f"this packing of a TIFF needs the package imagecodecs ({message})",
                'install it: pip install "accelsurf[tiff]"',
            ) from error
        raise InputError(f"tifffile: {message}", TRUNCATED_HINT) from error
    ny, nx = header.shape[1:]
    if found.dtype == bool:  # black and white, by the lowest and the highest grey
        found = np.where(found == header.is_white_zero, np.uint8(0), np.uint8(255))
    if (
        found.ndim == 3 and header.stored is not None
    ):  # values of a pixel lie together, or each has a plane of its own
        found = np.moveaxis(found, -1, 0) if found.shape[:2] == (ny, nx) else found
        found = found[header.sample or 0]
    return found.astype(found.dtype.newbyteorder("="), copy=False)


def _contents(file: BinaryIO, places: NDArray[np.int64]) -> list[bytes]:
    """Read strips or tiles, by their offsets and lengths."""
    contents = []
    for offset, length in places.tolist():
        file.seek(offset)
        contents.append(file.read(length))
    return contents


def _joined(page: tifffile.TiffPage, contents: list[bytes], header: TiffHeader) -> NDArray[Any]:
    """Unpack the strips or tiles of a page one by one, and join them."""
    page.compression = tifffile.COMPRESSION.NONE  # tifffile shall place what is unpacked already
    out = np.zeros(page.shaped, page.dtype)
    for number, (packed, announced) in enumerate(
        zip(contents, header.strip_bytes.tolist(), strict=True)
    ):
        content = _unpacked(header.compression, packed, announced)
        values, (sample, z, y, x, _), shape = page.decode(content, number)
        assert values is not None
        some = out[sample, z : z + shape[0], y : y + shape[1], x : x + shape[2]]
        some[...] = values[: some.shape[0], : some.shape[1], : some.shape[2]]
    return out.reshape(page.shape)


def _unpacked(compression: int, content: bytes, announced: int) -> bytes:
    """Unpack a strip or tile to the bytes that the tags announce.

    Raises
    ------
    InputError
        When it holds other numbers of them; zlib.error and others when it is damaged.
    """
    if compression in DEFLATE:
        found = zlib.decompressobj().decompress(content, announced + 1)
    elif compression == LZW:
        found = _unpacked_lzw(content, announced)
    else:
        found = tifffile.TIFF.DECOMPRESSORS[compression](content)
    if len(found) != announced:
        raise InputError(
            f"a strip or tile of the TIFF holds {len(found)} bytes of voxels or more, its tags announce {announced}",
            TRUNCATED_HINT,
        )
    return found


def _unpacked_lzw(content: bytes, announced: int) -> bytes:
    """Unpack LZW by way of libtiff, which Pillow has: as a grey image of one row."""
    # 1 word each: width, height, bits, compression, 0 is black, place, values of a pixel, rows, length.
    tags = {
        256: announced,
        257: 1,
        258: 8,
        259: LZW,
        262: 1,
        273: 8,
        277: 1,
        278: 1,
        279: len(content),
    }
    start = 8 + len(content) + len(content) % 2
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    stream = BytesIO(
        struct.pack("<2sHI", b"II", 42, start) + content.ljust(start - 8, b"\0") + directory
    )
    try:
        with TiffImageFile(stream) as image:
            return image.tobytes()
    except OSError as error:
        raise InputError(
            f"the LZW codes of a strip or tile are damaged, or end before {announced} bytes of voxels",
            TRUNCATED_HINT,
        ) from error


def _check_lzw_ends(ends: list[bytes], announced: list[int]) -> None:
    """Refuse a page whose first or last strip holds more bytes than its tags announce.

    libtiff unpacks what is announced and does not tell whether more follows: it is asked for one byte more.

    Raises
    ------
    InputError
        When it is there.
    """
    for packed, count in zip(ends, announced, strict=True):
        try:
            _unpacked_lzw(packed, count + 1)
        except InputError:
            continue
        raise InputError(
            f"a strip of the TIFF holds more than the {count} bytes of voxels that its tags announce",
            TRUNCATED_HINT,
        )


@contextmanager
def _heard() -> Iterator[list[str]]:
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
