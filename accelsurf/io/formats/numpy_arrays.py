"""Arrays of numpy: .npy. They keep no grid.

numpy reads the header, and no objects, which it would unpickle. It does not compare the header's claims with the size
of the file; that is done here.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.files import library_named
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.headers import with_given_unit, with_warnings
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
    (
        3,
        0,
    ): np.lib.format.read_array_header_2_0,  # differs in the names of fields, which no image has
}
_NOTE = "an array of numpy does not say how large a voxel is: 1 mm is taken; give --spacing"


@dataclass(frozen=True, kw_only=True)
class ArrayHeader(RawHeader):
    """Claims of the header of an array.

    Attributes
    ----------
    is_fortran : bool
        Whether the first index runs fastest.
    """

    is_fortran: bool = False

    @property
    def has_boxes(self) -> bool:
        """True if any box of a volume can be read by itself."""
        return not self.is_fortran

    def volumes(self, numbers: Sequence[int]) -> list[NDArray[Any]]:
        """Read some of the volumes, as they are stored; of those whose first index runs fastest there is one."""
        arrays = super().volumes(numbers)
        if not self.is_fortran:
            return arrays
        return [array.ravel().reshape(array.shape, order="F") for array in arrays]


def parse_npy(path: Path, options: ReadOptions = AS_IT_IS) -> ArrayHeader:
    """Read the header of an .npy.

    Raises
    ------
    InputError
        When it is none, or holds no image of real numbers.
    """
    with (
        library_named(
            "this is not a NumPy array of numbers, or damaged", "save it with numpy.save"
        ),
        warnings.catch_warnings(action="error"),
        path.open("rb") as file,
    ):
        version = np.lib.format.read_magic(file)
        shape, is_fortran, stored = _READERS[version](file)
        offset = file.tell()
    if stored.kind not in "buif":
        raise InputError(
            f"values of type {stored} given, one real number per voxel expected",
            "save one field of it",
        )
    most = 3 if is_fortran else 4
    if not 2 <= len(shape) <= most or min(shape) < 1:
        raise InputError(
            f"an array of shape {shape} given, (z, y, x) or (y, x) expected"
            + ", or (t, z, y, x)" * (most == 4),
            "save one channel, with its axes in the order z, y, x; of a sequence (t, z, y, x) as an .npy in C order",
        )
    budgets.AXIS.check(max(shape), "an axis of the array")
    x, y, z = options.spacing or (1.0, 1.0, 1.0)
    nz, ny, nx = (*[1] * (3 - len(shape)), *shape[-3:])
    return ArrayHeader(
        data=path,
        geometry=Geometry((nz, ny, nx), (z, y, x)),
        stored=stored,
        offset=offset,
        metadata=with_given_unit(with_warnings({}, "" if options.spacing else _NOTE), options),
        time_points=shape[0] if len(shape) == 4 else 1,
        asked=options,
        is_fortran=is_fortran,
    )


def write_npy(volume: Volume, path: Path) -> None:
    """Write an .npy."""
    with path.open("wb") as file:
        np.lib.format.write_array(file, volume.array, allow_pickle=False)
