"""What PNG and TIFF have in common: what a header claims, reading, colour to grey.

They keep the size of a pixel and no place in the world: an image starts at the world's origin, along its axes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import SimpleITK as sitk

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.grey import to_grey
from accelsurf.io.memory import check_memory
from accelsurf.io.metadata import WARNING_KEY

STORED = {
    **{"uint8": (8, 1), "uint16": (16, 1), "uint32": (32, 1), "int8": (8, 2), "int16": (16, 2), "int32": (32, 2)},
    "float32": (32, 3),
}
"""Types of values that a TIFF can hold here: bits and sample format (1 unsigned, 2 signed, 3 floating point)."""

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

    @property
    def geometry(self) -> Geometry | None:
        """The grid; None for a PNG whose scale ITK reads."""
        return None if self.spacing is None else Geometry(self.shape, self.spacing)

    @abstractmethod
    def check_complete(self) -> None:
        """Refuse a file that does not hold all its rows.

        Raises
        ------
        InputError
            With what is missing.
        """


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
