"""What the headers of PNG and TIFF have in common.

They keep the size of a pixel and no place in the world: an image starts at the world's origin, along its axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from accelsurf.grid.geometry import Geometry

STORED = {
    **{"uint8": (8, 1), "uint16": (16, 1), "uint32": (32, 1), "int8": (8, 2), "int16": (16, 2), "int32": (32, 2)},
    "float32": (32, 3),
}
"""Types of values that a TIFF can hold here: bits and sample format (1 unsigned, 2 signed, 3 floating point)."""

TRUNCATED_HINT = "the file is truncated or damaged: copy or export it again"


@dataclass(frozen=True)
class RasterHeader:
    """What the header of a PNG or TIFF claims.

    Attributes
    ----------
    data : Path
        The file.
    shape : tuple of int
        (pages, rows, columns).
    spacing : tuple of float or None
        mm, (z, y, x); None for a PNG, which says it further on.
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
        """The grid; None for a PNG, which says it further on."""
        return None if self.spacing is None else Geometry(self.shape, self.spacing)
