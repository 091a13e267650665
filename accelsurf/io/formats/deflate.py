"""Streams packed by gzip or zlib: read piece by piece; the same content is written as the same bytes."""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from accelsurf.errors import InputError
from accelsurf.settings import budgets

TRUNCATED_HINT = "the file is truncated: copy or export it again"
GZIP_START = b"\x1f\x8b"
#: Packed bytes that are read at a time, first and at most.
_FIRST_CHUNK = 1 << 16
_LAST_CHUNK = 1 << 21
#: Unpacked bytes that are given at a time, at most; beyond the end that a header announces.
_PIECE = 1 << 23
_PIECE_BEYOND = 1 << 20


def inflate(
    file: BinaryIO, limit: int | None = None, claimed: int | None = None
) -> Iterator[bytes]:
    """Decompressed chunks of a gzip (several members allowed) or zlib stream, to its end.

    Parameters
    ----------
    file : binary file
        At the beginning of the stream.
    limit : int, optional
        Bytes of the file that belong to the stream; by default all that follow.
    claimed : int, optional
        Bytes that it should unpack to. It is unpacked no further than `accelsurf.settings.budgets.SLACK` beyond.

    Raises
    ------
    InputError
        When the stream is damaged (its checksum counts), ends early, or holds more than it should.
    """
    stream = zlib.decompressobj(47)  # either kind, recognized by its first bytes
    beyond = -math.inf if claimed is None else -claimed
    try:
        for chunk in _chunks(file, limit):
            while chunk:
                if stream.eof:
                    # Another member may follow the first; padding or anything else is ignored.
                    if chunk[:2] != GZIP_START:
                        return
                    stream = zlib.decompressobj(47)
                # Beyond the announced bytes in small pieces: no more are unpacked than are needed to refuse the file.
                piece = stream.decompress(chunk, int(min(_PIECE, max(-beyond, _PIECE_BEYOND))))
                beyond += len(piece)
                if beyond > 0:
                    announced = (
                        f"the header announces {claimed} bytes, the packed voxels go on beyond them"
                    )
                    budgets.SLACK.check(int(beyond), announced)
                yield piece
                chunk = stream.unconsumed_tail or stream.unused_data
    except zlib.error as error:
        raise InputError(
            f"the compressed voxels are damaged ({error})", hint="copy or export the file again"
        ) from error
    if not stream.eof:
        raise InputError("the compressed voxels end before their end mark", hint=TRUNCATED_HINT)


def _chunks(file: BinaryIO, limit: int | None) -> Iterator[bytes]:
    # Each chunk gives Python's lock back twice, and beside a busy thread waits 5 ms for it each time: a scan shall have
    # few. The first are small, as who reads a header wants no more.
    left, size = math.inf if limit is None else limit, _FIRST_CHUNK
    while left > 0 and (chunk := file.read(int(min(size, left)))):
        left, size = left - len(chunk), min(2 * size, _LAST_CHUNK)
        yield chunk


def first_bytes(file: BinaryIO, count: int) -> bytes:
    """The first bytes of a stream, decompressed; fewer when it ends or is damaged before.

    Raises
    ------
    InputError
        When it is damaged from the start.
    """
    start = b""
    try:
        for chunk in inflate(file):
            start += chunk
            if len(start) >= count:
                break
    except InputError:
        if not start:
            raise
    return start[:count]


@contextmanager
def gzip_writer(path: Path) -> Iterator[gzip.GzipFile]:
    """A file that is compressed to the same bytes every time: no name and no date in the gzip header."""
    with (
        path.open("wb") as out,
        gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=out, mtime=0) as packed,
    ):
        yield packed
