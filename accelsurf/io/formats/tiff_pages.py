"""TIFF stacks that are read some pages at a time.

Packed pages are copied, as they are packed, into a file of their own, which ITK reads. It has only tags that were
checked: what libtiff says of it is no remark about a private tag, but a damage. Pages that ITK would change are
unpacked by tifffile.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from threading import get_ident
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io import itk
from accelsurf.io.chunk_cache import ChunkCache
from accelsurf.io.files import file_version, one_line
from accelsurf.io.formats.raster import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import CHANGED
from accelsurf.io.formats.tiff import TiffHeader, of_samples
from accelsurf.io.formats.tiff_directories import (
    BITS,
    COMPRESSION,
    EXTRA,
    FORMAT,
    HEIGHT,
    PHOTOMETRIC,
    PLANAR,
    PREDICTOR,
    ROWS,
    SAMPLES,
    STRIP_BYTES,
    STRIPS,
    TILE_BYTES,
    TILE_HEIGHT,
    TILE_WIDTH,
    TILES,
    WIDTH,
    Page,
    read_directory,
    read_form,
    strips_of,
)
from accelsurf.io.formats.tiff_file import MAX_FILE_BYTES
from accelsurf.io.grey import to_grey

#: The tags that ITK gets beside those of strips and tiles: all that say how voxels are stored.
_GIVEN = (
    WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, ROWS, PLANAR, PREDICTOR, TILE_WIDTH, TILE_HEIGHT, EXTRA,
    FORMAT,
)
_SHORT, _LONG = 3, 4
_LZW = 5
#: Packings that tifffile unpacks to bytes: LZW, LZMA, Zstandard by both numbers.
_STREAMS = (_LZW, 34925, 34926, 50000)
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
        self.dtype = np.dtype(np.uint8) if header.stored is None else header.stored.newbyteorder("=")
        self._cache = ChunkCache(cache_bytes)
        self._version = file_version(header.data.stat())
        _, ny, nx = header.shape
        self._step = 1 if cache_bytes else max(1, _GROUP_BYTES // (ny * nx * header.pixel_bytes))
        self._is_checked = False

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

    def _pages(self, some: range) -> NDArray[Any]:
        """The values of some pages."""
        header = self._header
        with header.data.open("rb") as file:
            if file_version(os.fstat(file.fileno())) != self._version:
                raise InputError(*CHANGED)
            form = read_form(file)
            pages = [read_directory(file, form, int(header.directories[z])).page for z in some]
            strips = [strips_of(page) for page in pages]
            part = replace(header, shape=(len(some), *header.shape[1:]), strips=np.concatenate(strips))
            where = f"page {some[0] + 1}" if len(some) == 1 else f"one of the pages {some[0] + 1} to {some[-1] + 1}"
            try:
                part.check_complete()
                found = self._unpacked(file, pages, form.order, some)
            except (InputError, RuntimeError) as error:
                reason = error.message if isinstance(error, InputError) else "ITK cannot read it"
                raise InputError(f"{where} is damaged ({reason})", TRUNCATED_HINT) from error
        is_grey = header.stored is not None
        if found.shape[:3] != part.shape or (is_grey and (found.dtype, found.ndim) != (self.dtype, 3)):
            raise InputError(
                f"{where} is read as {found.dtype} {found.shape}, {self.dtype} {part.shape} expected",
                "save the stack as a plain TIFF",
            )
        return found

    def _unpacked(self, file: BinaryIO, pages: Sequence[Page], order: str, some: range) -> NDArray[Any]:
        """The values of pages, (n, ny, nx), with colours along a fourth axis."""
        header = self._header
        if header.decoder == "ITK":
            if header.compression == _LZW and not self._is_checked:
                _check_ends(file, pages[0], header.strip_bytes, order)
                self._is_checked = True
            found = _values(file, pages, order)
            return to_grey(found)[0] if found.ndim > 3 and header.stored is not None else found  # tiles; 1 bit
        return np.stack([self._by_tifffile(file, int(header.directories[z])) for z in some])

    def _by_tifffile(self, file: BinaryIO, at: int) -> NDArray[Any]:
        """The values of the page whose directory begins at a byte, (ny, nx)."""
        found = _values_by_tifffile(file, at, self._header)
        ny, nx = self._header.shape[1:]
        if found.ndim == 3:  # values of a pixel lie together, or each has a plane of its own
            found = np.moveaxis(found, -1, 0) if found.shape[:2] == (ny, nx) else found
            found = found[self._header.sample or 0]
        return found.astype(found.dtype.newbyteorder("="), copy=False)


def library() -> ModuleType:
    """The package tifffile.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        import tifffile
    except ImportError as error:
        raise InputError(
            "this kind of TIFF (tiles, packing or type of values) needs the package tifffile",
            'install it: pip install "accelsurf[tiff]"',
        ) from error
    return tifffile


def _values_by_tifffile(file: BinaryIO, at: int, header: TiffHeader) -> NDArray[Any]:
    """The values of the page whose directory begins at a byte.

    Raises
    ------
    InputError
        When tifffile cannot unpack it.
    """
    tifffile = library()
    try:
        file.seek(0)
        with _listened() as said, tifffile.TiffFile(file, _multifile=False) as stack:
            stack.filehandle.seek(at)
            page = tifffile.TiffPage(stack, index=0)
            if header.compression in _STREAMS:  # tifffile cuts off what is too much, and fills up what is missing
                unpack = tifffile.TIFF.DECOMPRESSORS[header.compression]
                pieces = zip(page.dataoffsets, page.databytecounts, header.strip_bytes.tolist(), strict=True)
                for offset, length, announced in pieces:
                    file.seek(offset)
                    if len(unpack(file.read(length))) != announced:
                        raise InputError(f"a strip or tile does not hold {announced} bytes of voxels", TRUNCATED_HINT)
            said.clear()  # of tags, also of such that do not count
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
    return np.asarray(found)


@contextmanager
def _listened() -> Iterator[list[str]]:
    """What tifffile logs in this thread, which goes nowhere else."""
    said: list[str] = []

    def heard(record: logging.LogRecord) -> bool:
        if record.thread != get_ident():
            return True
        said.append(" ".join(record.getMessage().split())[:200])
        return False

    logger = logging.getLogger("tifffile")
    logger.addFilter(heard)
    try:
        yield said
    finally:
        logger.removeFilter(heard)


def _values(file: BinaryIO, pages: Sequence[Page], order: str) -> NDArray[Any]:
    """The values of pages, (n, ny, nx), or with colours along a fourth axis, by way of a file of their own."""
    with itk.copied(".tif") as (path, out):
        _write_pages(out, file, pages, order)
        out.close()
        found = itk.array_of(path, TiffHeader.itk_name)
    ny, nx = pages[0][HEIGHT][0], pages[0][WIDTH][0]
    return found.reshape(len(pages), ny, nx, *([-1] if found.size > len(pages) * ny * nx else []))


def _check_ends(file: BinaryIO, page: Page, strip_bytes: NDArray[np.int64], order: str) -> None:
    """Refuse a page whose first or last strip holds more bytes than its tags announce.

    libtiff unpacks what is announced and does not tell whether more follows: it is asked for one byte more.

    Raises
    ------
    InputError
        When it is there.
    """
    strips = strips_of(page)
    for strip, announced in ((strips[0], int(strip_bytes[0])), (strips[-1], int(strip_bytes[-1]))):
        row = {WIDTH: (announced + 1,), HEIGHT: (1,), BITS: (8,), PHOTOMETRIC: (1,), COMPRESSION: (_LZW,)}
        try:
            _values(file, [row | {STRIPS: (int(strip[0]),), STRIP_BYTES: (int(strip[1]),)}], order)
        except (InputError, RuntimeError):
            continue
        raise InputError(f"a strip of the TIFF holds more than the {announced} bytes of voxels that its tags announce",
                         TRUNCATED_HINT)


def _write_pages(out: BinaryIO, file: BinaryIO, pages: Sequence[Page], order: str) -> None:
    """Write a TIFF of some pages, with the strips or tiles of another file as they are there."""
    out.write(struct.pack(order + "2sHI", b"II" if order == "<" else b"MM", 42, 8))
    for number, page in enumerate(pages, 1):
        _write_page(out, file, page, order, number == len(pages))


def _write_page(out: BinaryIO, file: BinaryIO, page: Page, order: str, is_last: bool) -> None:
    """Write a directory with its strips or tiles at the end of a file."""
    strips = strips_of(page)
    tags = {tag: page[tag] for tag in _GIVEN if tag in page}
    tags |= {tag: of_samples(page, tag) for tag in (BITS, FORMAT)}
    if (alphas := len(tags[BITS]) - 3) > 0:
        tags.setdefault(EXTRA, (0,) * alphas)
    where, lengths = (TILES, TILE_BYTES) if TILES in page else (STRIPS, STRIP_BYTES)
    tags |= {where: (0,) * len(strips), lengths: tuple(strips[:, 1].tolist())}
    directory = out.tell()
    beyond = directory + 2 + 12 * len(tags) + 4
    first = beyond + sum(4 * len(values) for values in tags.values())  # at most
    tags[where] = tuple((first + np.cumsum(strips[:, 1]) - strips[:, 1]).tolist())
    end = first + int(strips[:, 1].sum())
    end += end % 2  # directories begin at even bytes
    if end > MAX_FILE_BYTES:
        raise InputError("a page of more than 4 GiB", "save the stack as OME-Zarr")
    entries, far = [], b""
    for tag in sorted(tags):
        kind, n, raw = _packed(tags[tag], order)
        if len(raw) > 4:
            raw, far = struct.pack(order + "I", beyond + len(far)), far + raw
        entries.append(struct.pack(order + "HHI", tag, kind, n) + raw.ljust(4, b"\0"))
    out.write(struct.pack(order + "H", len(tags)) + b"".join(entries) + struct.pack(order + "I", 0 if is_last else end))
    out.write(far.ljust(first - beyond, b"\0"))
    for offset, length in strips.tolist():
        file.seek(offset)
        out.write(file.read(length))
    out.write(b"\0" * (end - out.tell()))


def _packed(values: tuple[Any, ...], order: str) -> tuple[int, int, bytes]:
    """Type, number and bytes of whole numbers, as they are written into a directory."""
    kind, code = (_SHORT, "H") if max(values) < 1 << 16 else (_LONG, "I")
    return kind, len(values), struct.pack(f"{order}{len(values)}{code}", *values)
