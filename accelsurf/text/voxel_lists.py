"""Clicks of any voxels as texts: how an array, a painted stroke or a lasso is written into settings and read again."""

from __future__ import annotations

import base64
import binascii
import math
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import box_at
from accelsurf.grid.clicks import Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.settings import budgets
from accelsurf.settings.wording import shown

#: The first voxel of a box, its size, and its mask as bits, packed by zlib and written in base64.
FORM = "voxels:X,Y,Z;NX,NY,NZ;BITS"
#: zlib's level: bits of masks become no smaller by more work.
_LEVEL = 6


class _Voxels(NamedTuple):
    """The numbers of a text: ``first`` voxel and ``size`` of the box (x, y, z), and the packed ``bits``."""

    first: tuple[int, int, int]
    size: tuple[int, int, int]
    bits: bytes


def voxels_text(click: Click) -> str:
    """Return the text of a click of any voxels; `click_of_voxels_text` reads it.

    Examples
    --------
    >>> mask = np.array([[[True, False, True]]])
    >>> text = voxels_text(Click("inside", (slice(4, 5), slice(2, 3), slice(7, 10)), mask))
    >>> text
    'voxels:7,2,4;3,1,1;eJxbAAAAoQCh'
    >>> bool((click_of_voxels_text(text, "inside", Geometry((9, 9, 12), (1, 1, 1))).mask == mask).all())
    True
    """
    first = ",".join(str(part.start) for part in reversed(click.box))
    size = ",".join(str(n) for n in reversed(click.mask.shape))
    bits = zlib.compress(np.packbits(click.mask).tobytes(), _LEVEL)
    return f"voxels:{first};{size};{base64.urlsafe_b64encode(bits).decode('ascii')}"


def click_of_voxels_text(text: str, side: Side, geometry: Geometry, id: int = 1) -> Click:
    """Return the click that a text of voxels says.

    Raises
    ------
    UsageError
        When it is not of the form `FORM`.
    InputError
        When its box goes beyond the image, or no voxel is in it.
    """
    found = _parsed(text)
    shape = geometry.shape
    corner = tuple(reversed(found.first))
    size = tuple(reversed(found.size))
    if any(at + n > most for at, n, most in zip(corner, size, shape, strict=True)):
        raise InputError(
            f"{side} {shown(text)!r}: its box goes beyond the image, whose shape is "
            f"{', '.join(str(n) for n in reversed(shape))} (x,y,z)",
            "was it made for another image?",
        )
    mask = _unpacked(text, found.bits, size)
    if not mask.any():
        raise InputError(f"{side} {shown(text)!r}: no voxel is in it", "name at least one")
    return Click(side, box_at((corner[0], corner[1], corner[2]), mask.shape), mask, id)


def _parsed(text: str) -> _Voxels:
    budgets.PATH.check(len(text), "a click of voxels", kind=UsageError)
    parts = text.strip().removeprefix("voxels:").split(";")
    try:
        first, size, bits = parts
        x, y, z = (int(number) for number in first.split(","))
        nx, ny, nz = (int(number) for number in size.split(","))
        if min(x, y, z) < 0 or min(nx, ny, nz) < 1:
            raise ValueError("no such box")
        return _Voxels((x, y, z), (nx, ny, nz), base64.b64decode(bits, b"-_", validate=True))
    except (ValueError, binascii.Error):
        raise _unreadable(text) from None


def _unpacked(text: str, bits: bytes, size: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the mask of packed bits; they may not be more than its box has."""
    count = math.prod(size)
    wanted = (count + 7) // 8
    reader = zlib.decompressobj()
    try:
        raw = reader.decompress(bits, wanted + 1)
    except zlib.error:
        raise _unreadable(text) from None
    if len(raw) != wanted or not reader.eof or reader.unused_data:
        raise _unreadable(text)
    return np.unpackbits(np.frombuffer(raw, np.uint8), count=count).reshape(size).astype(np.bool_)


def _unreadable(text: str) -> UsageError:
    return UsageError(
        f"click {shown(text)!r}: a box of voxels and their bits expected",
        f"accelsurf writes them, as {FORM}; paint a stroke:FILE instead",
    )
