"""What PNG and TIFF have in common: what a header claims, reading, colour to grey.

They keep the size of a pixel and no place in the world: an image starts at the world's origin, along its axes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.memory import check_memory
from accelsurf.io.metadata import WARNING_KEY

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
        mm, (z, y, x); None for a PNG whose scale ITK reads.
    pixel_bytes : int
        Bytes that a pixel takes in memory, with all its colours.
    """

    itk_name: ClassVar[str]
    """The format, as ITK names the class that reads it."""

    data: Path
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float] | None
    pixel_bytes: int

    @property
    def values(self) -> int:
        """How many pixels the image has; colours become one value."""
        return math.prod(self.shape)

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


def read(path: Path, header: RasterHeader, available: int) -> Volume:
    """Read a PNG or TIFF. ITK opens it last, because it prints messages about damaged files.

    Parameters
    ----------
    path : Path
        The file.
    header : RasterHeader
        What its header claims.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file is incomplete, larger than the memory, or not what its header claims.
    """
    check_memory(header.shape[::-1], header.pixel_bytes, available)
    header.check_complete()
    image = itk.execute(itk.open_reader(path, header.itk_name))
    array = sitk.GetArrayFromImage(image)
    note = ""
    if image.GetNumberOfComponentsPerPixel() > 1:
        array, note = to_grey(array)
    if array.size != np.prod(header.shape):
        size = " x ".join(map(str, reversed(header.shape)))
        raise InputError(
            f"the header announces {size} pixels, ITK reads {image.GetSize()}", hint="save it as a plain TIFF or PNG"
        )
    spacing = header.spacing or (1.0, *image.GetSpacing()[1::-1])
    metadata = {WARNING_KEY: note} if note else {}
    return Volume(array.reshape(header.shape), Geometry(header.shape, spacing), metadata, path)
