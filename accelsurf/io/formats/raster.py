"""What PNG and TIFF have in common: what a header claims, colour to grey, what these formats can hold.

They keep the size of a pixel and no place in the world: an image starts at the world's origin, along its axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry

SUFFIXES = (".png", ".tif", ".tiff")
"""Endings of these formats."""

STORED = {
    **{"uint8": (8, 1), "uint16": (16, 1), "uint32": (32, 1), "int8": (8, 2), "int16": (16, 2), "int32": (32, 2)},
    "float32": (32, 3),
}
"""Types of values that a TIFF can hold here: bits and sample format (1 unsigned, 2 signed, 3 floating point)."""

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Parts of red, green and blue in the brightness of a colour (ITU-R BT.709)."""

TRUNCATED_HINT = "the file is truncated or damaged: copy or export it again"


@dataclass(frozen=True)
class RasterHeader(ABC):
    """What the header of a PNG or TIFF claims.

    Attributes
    ----------
    data : Path
        The file.
    shape : tuple of int
        (pages, rows, columns).
    spacing : tuple of float or None
        mm, (z, y, x); None for a PNG, whose scale ITK reads.
    pixel_bytes : int
        Bytes that a pixel takes in memory, with all its colours.
    """

    data: Path
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float] | None
    pixel_bytes: int

    @abstractmethod
    def check_complete(self) -> None:
        """Refuse a file that does not hold all its rows.

        Raises
        ------
        InputError
            With what is missing.
        """


def to_grey(array: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """One value per pixel from red, green, blue (and alpha), and what a person should know about that.

    Parameters
    ----------
    array : ndarray, shape (..., 3) or (..., 4)
        Colours of an unsigned type; the fourth is the opacity.

    Returns
    -------
    ndarray, str
        Where the three are equal everywhere, that value, unchanged; else the luminance as float32. The note is empty
        when nothing was decided.

    Examples
    --------
    >>> import numpy as np
    >>> to_grey(np.array([[[7, 7, 7], [9, 9, 9]]], dtype=np.uint8))
    (array([[7, 9]], dtype=uint8), '')
    """
    notes = []
    red, green, blue = array[..., 0], array[..., 1], array[..., 2]
    if np.array_equal(red, green) and np.array_equal(red, blue):
        grey = np.ascontiguousarray(red)
    else:
        grey = np.zeros(red.shape, np.float32)
        for part, channel in zip(LUMINANCE, (red, green, blue), strict=True):
            grey += np.float32(part) * channel
        notes.append(
            "a colour image: its luminance (0.2126 R + 0.7152 G + 0.0722 B) is used; "
            "extract a channel first if the object differs in colour more than in brightness"
        )
    if array.shape[-1] == 4 and (array[..., 3] != np.iinfo(array.dtype).max).any():
        notes.append("the image is transparent in places, which is ignored")
    return grey, "; ".join(notes)


def check_writable(array: NDArray[Any], suffix: str) -> None:
    """Refuse what a format cannot hold.

    Raises
    ------
    UsageError
        With what it does hold.
    """
    if suffix == ".png" and array.shape[0] > 1:
        raise UsageError(
            f"a volume of {array.shape[0]} slices given, a .png holds one", "write a .tif stack, or a volume format"
        )
    kinds = ("uint8", "uint16") if suffix == ".png" else tuple(STORED)
    if array.dtype.name not in kinds:
        raise UsageError(
            f"values of type {array.dtype} given, a {suffix} holds {', '.join(kinds)}",
            "convert them first, or write a volume format",
        )


def preserves(geometry: Geometry, suffix: str) -> bool:
    """Whether a file gives the same grid back when it is read; all formats but PNG and TIFF do.

    Parameters
    ----------
    geometry : Geometry
        The grid to be written.
    suffix : str
        Of the file.
    """
    return suffix not in SUFFIXES or stored_grid(geometry, suffix).matches(geometry)


def stored_grid(geometry: Geometry, suffix: str) -> Geometry:
    """The grid that is read back from a PNG or TIFF: its pixel size, and of a TIFF its slice distance.

    Parameters
    ----------
    geometry : Geometry
        The grid to be written.
    suffix : str
        One of `SUFFIXES`.
    """
    depth = 1.0 if suffix == ".png" else geometry.spacing[0]
    return Geometry(geometry.shape, (depth, *geometry.spacing[1:]))
