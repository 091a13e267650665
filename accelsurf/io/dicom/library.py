"""The packages pydicom and highdicom, which are an extra, and reading one file.

A file is read as one that somebody may have cut, damaged or made up: no read asks for more bytes than there are, and a
deflated one unpacks to no more than `accelsurf.settings.budgets.DICOM_DEFLATED`.
"""

from __future__ import annotations

import io
import logging
import os
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any, BinaryIO

from accelsurf.errors import InputError
from accelsurf.io.dicom.sources import DicomFile, Member
from accelsurf.io.files import library_named
from accelsurf.settings.budgets import DICOM_DEFLATED

HEADER_HINT = "the header is damaged: copy the file again, or export it again"

#: Those that send lines to stderr where nobody asked for logs.
_LOGGERS = ("pydicom", "highdicom")
_DEFLATED = "1.2.840.10008.1.2.1.99"
_SERIES_UID = 0x0020_000E
_PIXELS = (0x7FE0_0008, 0x7FE0_0009, 0x7FE0_0010)
_UNDEFINED = 0xFFFF_FFFF
_ITEM, _END = (0xFFFE, 0xE000), (0xFFFE, 0xE0DD)
#: A read of more bytes is compared with what is left of the file before they are allocated.
_LARGE = 1 << 16
#: Pieces of packed pixels that are counted.
_MAX_PIECES = 1 << 20


@dataclass(frozen=True)
class PixelBytes:
    """The pixels of a file, as far as its lengths tell of them.

    Attributes
    ----------
    announced : int or None
        Bytes; None where they are packed, piece by piece.
    present : int
        Bytes that the file has of them.
    pieces : int
        Of packed pixels, without the table of offsets.
    is_whole : bool
        Whether packed pixels end as they should.
    """

    announced: int | None
    present: int
    pieces: int = 0
    is_whole: bool = True


def library(name: str = "pydicom") -> ModuleType:
    """One of the packages, or a module of it.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        with quiet():
            return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise InputError(f"DICOM needs the package {package}", 'install it: pip install "accelsurf[dicom]"') from error


@contextmanager
def quiet() -> Iterator[None]:
    """Without the packages' warnings and log lines about values that break the standard: what matters is checked here,
    and told.
    """
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.setLevel(logging.CRITICAL + 1)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


@contextmanager
def damage_of(file: DicomFile, what: str) -> Iterator[None]:
    """Turn what the packages raise about damaged files, of which there is no end, into an InputError.

    Parameters
    ----------
    file : Path or Member
    what : str
        What is wrong, as "the header is damaged".
    """
    with quiet(), library_named(f"{file.name}: {what}", "copy it again"):
        yield


def read_dataset(file: DicomFile, tags: Sequence[str | int] | None = None) -> Any:
    """Read a file: with ``tags`` those elements alone and no pixels, else all.

    Raises
    ------
    InputError
        When it is no DICOM, or damaged.
    """
    return _read(file, tags, _PIXELS if tags is not None else ())[0]


def read_header(file: DicomFile, tags: Sequence[str | int]) -> tuple[Any, PixelBytes | None]:
    """Read elements of a file, and find how much of its pixels is there; None: it has none.

    Raises
    ------
    InputError
        When it is no DICOM, or damaged.
    """
    return _read(file, tags, _PIXELS)


def series_of(file: DicomFile) -> tuple[str, bool]:
    """The UID of the series that a damaged file says it is of, and whether the file ends within it.

    Empty where it cannot be read.
    """
    try:
        found = _read(file, ["SeriesInstanceUID"], (_SERIES_UID + 1,), True)[0].get_item(_SERIES_UID)
        return found.value.decode("ascii").strip("\0 "), len(found.value) < found.length
    except Exception:  # it is damaged, in whatever way
        return "", False


def _read(
    file: DicomFile, tags: Sequence[str | int] | None, stops: tuple[int, ...], is_damaged: bool = False
) -> tuple[Any, PixelBytes | None]:
    """The elements, and where reading stopped at pixels what there is of them; the first of ``stops`` ends it, or what
    comes after.
    """
    pydicom = library()
    seen: list[tuple[int, int]] = []

    def stop(tag: int, vr: str | None, length: int) -> bool:
        if tag in stops or (len(stops) == 1 and tag >= stops[0]):
            seen.append((length, data.tell()))
            return True
        return False

    wanted = None if tags is None else [pydicom.tag.Tag(tag) for tag in tags]
    damage = damage_of(file, "no DICOM, or damaged")
    with damage, _opened(file, is_damaged) as stream, _inflated(stream) as (data, meta):
        dataset = pydicom.filereader.read_partial(data, stop if stops else None, force=True, specific_tags=wanted)
        if meta is not None:
            dataset.file_meta = meta
        return dataset, _pixel_bytes(data, *seen[0]) if seen else None


class _Bounded(io.BufferedReader):
    """A file of which no more is asked for than there is: bytes are allocated before they are read."""

    def __init__(self, path: os.PathLike[str]) -> None:
        super().__init__(io.FileIO(path))
        self._end = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _LARGE:
            size = min(size, max(self._end - self.tell(), 0))
        return super().read(size)


def _opened(file: DicomFile, is_damaged: bool) -> BinaryIO:
    if isinstance(file, Member):
        return io.BytesIO(file.remains() if is_damaged else file.content())
    return _Bounded(file)


@contextmanager
def _inflated(stream: BinaryIO) -> Iterator[tuple[BinaryIO, Any]]:
    """The stream, or what a deflated one unpacks to, with the file's meta information."""
    if _DEFLATED.encode() not in stream.read(1024):
        stream.seek(0)
        yield stream, None
        return
    stream.seek(0)
    reader = library("pydicom.filereader")
    reader.read_preamble(stream, True)
    meta = library("pydicom.dataset").FileMetaDataset(
        reader.read_dataset(stream, False, True, stop_when=lambda tag, vr, length: tag >> 16 != 2)
    )
    if meta.get("TransferSyntaxUID") != _DEFLATED:
        stream.seek(0)
        yield stream, None
        return
    packed = stream.read()
    limit = DICOM_DEFLATED.limit * (len(packed) + (1 << 20))
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
    content = unpacker.decompress(packed, limit + 1)
    DICOM_DEFLATED.check(len(content), factor=len(packed) + (1 << 20))
    if not unpacker.eof:
        raise InputError("its deflated content ends early", "copy it again")
    yield io.BytesIO(content), meta


def _pixel_bytes(data: BinaryIO, length: int, start: int) -> PixelBytes:
    """Describe the pixels that begin at a byte of a file."""
    end = data.seek(0, os.SEEK_END)
    if length != _UNDEFINED:
        return PixelBytes(length, min(length, end - start))
    place, pieces = start, -1  # the first item has the offsets
    while place + 8 <= end and pieces < _MAX_PIECES:
        data.seek(place)
        head = data.read(8)
        tag, size = (int.from_bytes(head[:2], "little"), int.from_bytes(head[2:4], "little")), int.from_bytes(
            head[4:], "little"
        )
        if tag == _END:
            return PixelBytes(None, place - start, max(pieces, 0))
        if tag != _ITEM:
            break
        pieces, place = pieces + 1, place + 8 + size
    return PixelBytes(None, min(place, end) - start, max(pieces, 0), False)
