"""TIFF stacks that are read a page at a time.

A packed page is copied, as it is packed, into a file of one page, which ITK reads: it gives the same values as for the
whole stack, whatever the packing. Pages that ITK would change are unpacked by tifffile.
"""

from __future__ import annotations

import logging
import os
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from threading import Lock
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.io import itk
from accelsurf.io.chunk_cache import ChunkCache
from accelsurf.io.files import file_version
from accelsurf.io.formats.raster import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import CHANGED
from accelsurf.io.formats.tiff import TiffHeader, strips_of
from accelsurf.io.formats.tiff_directories import (
    DESCRIPTION,
    RES_UNIT,
    STRIP_BYTES,
    STRIPS,
    SUB_PAGES,
    TILE_BYTES,
    TILES,
    X_RES,
    Y_RES,
    Page,
    read_directory,
    read_form,
)
from accelsurf.io.formats.tiff_file import MAX_FILE_BYTES
from accelsurf.io.grey import to_grey

#: What says nothing about the values, and what is written anew.
_LEFT_OUT = frozenset((SUB_PAGES, DESCRIPTION, X_RES, Y_RES, RES_UNIT, STRIPS, STRIP_BYTES, TILES, TILE_BYTES))
_SHORT, _LONG = 3, 4
_SILENCE = logging.NullHandler()


class TiffPages:
    """The pages of a grey stack, unpacked one by one.

    Parameters
    ----------
    header : TiffHeader
        What its directories claim.
    cache_bytes : int
        Of unpacked pages that are held.
    """

    def __init__(self, header: TiffHeader, cache_bytes: int) -> None:
        assert header.stored is not None
        # The strips of all pages take more space than all else together; those of one are read again with it.
        self._header = replace(header, strips=header.strips[:0])
        self.dtype = header.stored.newbyteorder("=")
        self._cache = ChunkCache(cache_bytes)
        self._version = file_version(header.data.stat())
        self._lock = Lock()  # ITK's warnings are switched off for all threads

    @property
    def bytes_read(self) -> int:
        """Bytes of the pages that were read so far, unpacked."""
        return self._cache.bytes_made

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box; see `accelsurf.io.LazyVolume.read`.

        Raises
        ------
        InputError
            When a page is damaged, or the file has changed since it was opened; OSError when it is gone.
        """
        values = np.empty([s.stop - s.start for s in box], self.dtype)
        for z in range(box[0].start, box[0].stop):
            page = self._cache.get(z, lambda z=z: self._page(z))  # type: ignore[misc]
            values[z - box[0].start] = page[box[1:]]
        return values

    def _page(self, z: int) -> NDArray[Any]:
        """The values of a page."""
        header = self._header
        with self._lock, header.data.open("rb") as file:
            if file_version(os.fstat(file.fileno())) != self._version:
                raise InputError(*CHANGED)
            form = read_form(file)
            page = read_directory(file, form, int(header.directories[z]))[0]
            _, ny, nx = header.shape
            unpacked = header.unpacked_bytes // header.shape[0]
            try:
                replace(header, shape=(1, ny, nx), strips=strips_of(page), unpacked_bytes=unpacked).check_complete()
                found = self._unpacked(file, page, form.order, z)
            except (InputError, RuntimeError) as error:
                reason = error.message if isinstance(error, InputError) else "ITK cannot read it"
                raise InputError(f"page {z + 1} is damaged ({reason})", TRUNCATED_HINT) from error
        if found.shape != (ny, nx) or found.dtype != self.dtype:
            raise InputError(
                f"page {z + 1} is read as {found.dtype} {found.shape}, {self.dtype} {(ny, nx)} expected",
                "save the stack as a plain TIFF",
            )
        return found


    def _unpacked(self, file: BinaryIO, page: Page, order: str, z: int) -> NDArray[Any]:
        """The values of a page, (ny, nx)."""
        if self._header.decoder == "ITK":
            return _values(file, page, order)
        found = _values_by_tifffile(file, int(self._header.directories[z]))
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
    logging.getLogger("tifffile").addHandler(_SILENCE)  # what is wrong with a file is an error here, or harmless
    return tifffile


def _values_by_tifffile(file: BinaryIO, at: int) -> NDArray[Any]:
    """The values of the page whose directory begins at a byte.

    Raises
    ------
    InputError
        When tifffile cannot unpack it.
    """
    tifffile = library()
    try:
        file.seek(0)
        with tifffile.TiffFile(file, _multifile=False) as stack:
            stack.filehandle.seek(at)
            found = tifffile.TiffPage(stack, index=0).asarray(maxworkers=1)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # each codec raises errors of its own
        message = " ".join(str(error).split())[:200] or type(error).__name__
        if "imagecodecs" in message:
            raise InputError(
                f"this packing of a TIFF needs the package imagecodecs ({message})",
                'install it: pip install "accelsurf[tiff]"',
            ) from error
        raise InputError(f"tifffile: {message}", TRUNCATED_HINT) from error
    return np.asarray(found)


def _values(file: BinaryIO, page: Page, order: str) -> NDArray[Any]:
    """The values of a page, (ny, nx), by way of a file of its own."""
    with tempfile.TemporaryDirectory(prefix="accelsurf-") as folder:
        path = Path(folder) / "page.tif"
        with path.open("wb") as out:
            _write_page(out, file, page, order)
        image = itk.execute(itk.open_reader(path, TiffHeader.itk_name))
    found: NDArray[Any] = sitk.GetArrayFromImage(image)
    if image.GetNumberOfComponentsPerPixel() > 1:  # so ITK gives tiles, and black and white
        found, _ = to_grey(found)
    return found.reshape(found.shape[-2:])


def _write_page(out: BinaryIO, file: BinaryIO, page: Page, order: str) -> None:
    """Write a TIFF of one page, with the strips or tiles of another file as they are there."""
    strips = strips_of(page)
    count = len(strips)
    tags = {tag: values for tag, values in page.items() if tag not in _LEFT_OUT and values}
    where, lengths = (TILES, TILE_BYTES) if TILES in page else (STRIPS, STRIP_BYTES)
    directory = 8 + 2 + 12 * (len(tags) + 2) + 4
    far = {tag: values for tag, values in tags.items() if len(_packed(values, order)[2]) > 4}
    lists = directory + sum(len(_packed(values, order)[2]) for values in far.values())
    first = lists + 8 * count
    if first + int(strips[:, 1].sum()) > MAX_FILE_BYTES:
        raise InputError("a page of more than 4 GiB", "save the stack as OME-Zarr")
    starts = (first + np.cumsum(strips[:, 1]) - strips[:, 1]).tolist()
    entries, beyond, at = [], [], directory
    for tag, values in tags.items():
        kind, n, raw = _packed(values, order)
        entries.append((tag, kind, n, struct.pack(order + "I", at) if tag in far else raw.ljust(4, b"\0")))
        if tag in far:
            beyond.append(raw)
            at += len(raw)
    for tag, values, place in ((where, starts, lists), (lengths, strips[:, 1].tolist(), lists + 4 * count)):
        entries.append((tag, _LONG, count, struct.pack(order + "I", values[0] if count == 1 else place)))
        beyond.append(struct.pack(f"{order}{count}I", *values))
    out.write(struct.pack(order + "2sHIH", b"II" if order == "<" else b"MM", 42, 8, len(entries)))
    out.write(b"".join(struct.pack(order + "HHI", *entry[:3]) + entry[3] for entry in sorted(entries)))
    out.write(struct.pack(order + "I", 0) + b"".join(beyond))
    for offset, length in strips.tolist():
        file.seek(offset)
        out.write(file.read(length))


def _packed(values: tuple[Any, ...], order: str) -> tuple[int, int, bytes]:
    """Type, number and bytes of whole numbers, as they are written into a directory."""
    kind, code = (_SHORT, "H") if max(values) < 1 << 16 else (_LONG, "I")
    return kind, len(values), struct.pack(f"{order}{len(values)}{code}", *values)
