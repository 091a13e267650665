"""TIFF stacks that are read a page at a time.

Rows that lie in the file as they are, are read where they lie. A packed page is copied, as it is packed, into a file of
one page, which ITK reads: it gives the same values as for the whole stack, whatever the packing.
"""

from __future__ import annotations

import os
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.chunk_cache import ChunkCache
from accelsurf.io.files import file_version
from accelsurf.io.formats import raster
from accelsurf.io.formats.raster import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import CHANGED, RawLayout, RawVoxels
from accelsurf.io.formats.tiff import MAX_FILE_BYTES, TiffHeader, strips_of
from accelsurf.io.formats.tiff_directories import (
    DESCRIPTION,
    RES_UNIT,
    STRIP_BYTES,
    STRIPS,
    TILE_BYTES,
    TILES,
    X_RES,
    Y_RES,
    Page,
    read_directory,
    read_form,
)
from accelsurf.io.grey import to_grey
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import check_memory

#: What says nothing about the values, and what is written anew.
_LEFT_OUT = frozenset((DESCRIPTION, X_RES, Y_RES, RES_UNIT, STRIPS, STRIP_BYTES, TILES, TILE_BYTES))
_SHORT, _LONG = 3, 4


def open_lazily(path: Path, header: TiffHeader, opening: Opening) -> LazyVolume:
    """Open a grey stack, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : TiffHeader
        What its directories claim.
    opening : Opening
        How many bytes of unpacked pages are held.

    Raises
    ------
    InputError
        When it is a colour image, or is cut short.
    """
    if header.stored is None:
        raise InputError(
            "a colour TIFF given: whether its three colours are the same everywhere is not known before all is read",
            "save it as grey",
        )
    geometry = Geometry(header.shape, header.spacing or (1.0, 1.0, 1.0))
    if header.planes is not None:
        return LazyVolume(RawVoxels(RawLayout(path, 0, header.stored, header.shape, header.planes)), geometry, {}, path)
    header.check_places()
    layout = StoreLayout((geometry,), (1, *header.shape[1:]))
    return LazyVolume(TiffPages(header, opening.cache_bytes), geometry, {}, path, layout)


def read(path: Path, header: TiffHeader, available: int) -> Volume:
    """Read a stack; one with thumbnails among its pages page by page: ITK returns uninitialized memory for it.

    Parameters
    ----------
    path : Path
        The file.
    header : TiffHeader
        What its directories claim.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file is incomplete, larger than the memory, or has colours and thumbnails.
    """
    if not header.thumbnails:
        return raster.read(path, header, available)
    check_memory(header.shape[::-1], header.pixel_bytes, available)
    lazy = open_lazily(path, header, Opening(cache_bytes=0))
    return Volume(lazy.voxels.read(whole_box(lazy.shape)), lazy.geometry, lazy.metadata, path)


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
                found = _values(file, page, form.order)
            except (InputError, RuntimeError) as error:
                reason = error.message if isinstance(error, InputError) else "ITK cannot read it"
                raise InputError(f"page {z + 1} is damaged ({reason})", TRUNCATED_HINT) from error
        if found.shape != (ny, nx) or found.dtype != self.dtype:
            raise InputError(
                f"page {z + 1} is read as {found.dtype} {found.shape}, {self.dtype} {(ny, nx)} expected",
                "save the stack as a plain TIFF",
            )
        return found


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
