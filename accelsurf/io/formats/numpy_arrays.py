"""Arrays of numpy: .npy. They keep no grid.

The header of an array is parsed here: numpy's own reader would unpickle objects where it is asked to, and does not
compare what a header claims with the size of its file.
"""

from __future__ import annotations

import ast
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.channels import single
from accelsurf.io.formats.deflate import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels
from accelsurf.io.headers import with_given_unit, with_warnings
from accelsurf.io.lazy_volume import LazyVolume, Opening
from accelsurf.io.memory import check_memory
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_MAGIC = b"\x93NUMPY"
_MAX_HEADER_BYTES = 1 << 16
_NOTE = "an array of numpy does not say how large a voxel is: 1 mm is taken; give --spacing"


@dataclass(frozen=True, eq=False)
class ArrayHeader:
    """Claims of the header of an array.

    Attributes
    ----------
    data : Path
        The file.
    offset : int
        Bytes before the values.
    stored : numpy.dtype
        Of the values.
    shape : tuple of int
        As it is stored: (ny, nx), (nz, ny, nx), or in an .npy also (nt, nz, ny, nx).
    is_fortran : bool
        Whether the first index runs fastest.
    geometry : Geometry
    metadata : dict of str to str
    options : ReadOptions
        As asked for: which time point.
    """

    data: Path
    offset: int
    stored: np.dtype[Any]
    shape: tuple[int, ...]
    is_fortran: bool
    geometry: Geometry
    metadata: dict[str, str]
    options: ReadOptions = AS_IT_IS

    @property
    def time_points(self) -> int:
        """Number of images in it."""
        return self.shape[0] if len(self.shape) == 4 else 1

    @property
    def values(self) -> int:
        """Number of values of the image."""
        return math.prod(self.geometry.shape)

    def image_offset(self) -> int:
        """Bytes before the values of the image that is asked for.

        Raises
        ------
        InputError
            Where there are several and none is named.
        """
        number, _ = single(1, self.time_points, self.options)
        return self.offset + number * self.values * self.stored.itemsize


def parse_npy(path: Path, options: ReadOptions = AS_IT_IS) -> ArrayHeader:
    """Read the header of an .npy.

    Raises
    ------
    InputError
        When it is none, is cut short, or holds no image of real numbers.
    """
    with path.open("rb") as file:
        return _header(path, file, options)


def _header(path: Path, file: BinaryIO, options: ReadOptions) -> ArrayHeader:
    """The header of an array."""
    dtype, shape, is_fortran, offset = _fields(file)
    if dtype.kind not in "buif":
        raise InputError(
            f"values of type {dtype} given, one real number per voxel expected",
            "save one field of it",
        )
    most = 3 if is_fortran else 4
    if not 2 <= len(shape) <= most or min(shape) < 1:
        raise InputError(
            f"an array of shape {shape} given, (z, y, x) or (y, x) expected"
            + ", or (t, z, y, x)" * (most == 4),
            "save one channel, with its axes in the order z, y, x; of a sequence (t, z, y, x) as an .npy in C order",
        )
    needed = offset + math.prod(shape) * dtype.itemsize
    if needed > (size := path.stat().st_size):
        raise InputError(
            f"the header announces {needed} bytes, the array has {size}", TRUNCATED_HINT
        )
    budgets.AXIS.check(max(shape), "an axis of the array")
    x, y, z = options.spacing or (1.0, 1.0, 1.0)
    nz, ny, nx = (*[1] * (3 - len(shape)), *shape[-3:])
    geometry = Geometry((nz, ny, nx), (z, y, x))
    metadata = with_given_unit(with_warnings({}, "" if options.spacing else _NOTE), options)
    return ArrayHeader(path, offset, dtype, shape, is_fortran, geometry, metadata, options)


def _fields(file: BinaryIO) -> tuple[np.dtype[Any], tuple[int, ...], bool, int]:
    """Type, shape, order and length of a header.

    Raises
    ------
    InputError
        When it is damaged.
    """
    start = file.read(8)
    if start[:6] != _MAGIC or len(start) < 8:
        raise InputError(
            "this is not a NumPy array: it does not start as one", "is it the right file?"
        )
    width, code = (2, "<H") if start[6] == 1 else (4, "<I")
    try:
        (length,) = struct.unpack(code, file.read(width))
        if length > _MAX_HEADER_BYTES:
            raise ValueError
        fields = ast.literal_eval(file.read(length).decode("utf-8" if start[6] == 3 else "latin-1"))
        if set(fields) != {"descr", "fortran_order", "shape"} or not isinstance(
            fields["descr"], str
        ):
            raise ValueError
        dtype, shape = np.dtype(fields["descr"]), fields["shape"]
        if not isinstance(shape, tuple) or not all(
            type(n) is int and 0 <= n < 1 << 48 for n in shape
        ):
            raise ValueError
        return dtype, shape, bool(fields["fortran_order"]), 8 + width + length
    except (
        ValueError,
        TypeError,
        SyntaxError,
        KeyError,
        AttributeError,
        RecursionError,
        MemoryError,
        struct.error,
    ):
        raise InputError(
            "the header of the array is damaged, or no plain array", "save it with numpy.save"
        ) from None


def read_array(path: Path, header: ArrayHeader, available: int) -> Volume:
    """Read an array.

    Raises
    ------
    InputError
        When it is larger than the memory, or damaged.
    """
    check_memory(header.geometry.size, header.stored.itemsize * 2, available)
    count = header.values
    with header.data.open("rb") as file:
        file.seek(header.image_offset())
        flat = np.fromfile(file, header.stored, count)
    array = flat.reshape(header.shape[-3:], order="F" if header.is_fortran else "C").reshape(
        header.geometry.shape
    )
    plain: NDArray[Any] = np.ascontiguousarray(array, header.stored.newbyteorder("="))
    return Volume(plain, header.geometry, dict(header.metadata), path)


def open_npy(path: Path, header: ArrayHeader, opening: Opening) -> LazyVolume:
    """Open an .npy, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : ArrayHeader
        What it claims.
    opening : Opening
        Has no more to say here.

    Raises
    ------
    InputError
        When its first index runs fastest.
    """
    if header.is_fortran:
        raise InputError(
            "the values are packed the other way round (Fortran order): no box can be read by itself",
            "save it with numpy.ascontiguousarray",
        )
    voxels = RawVoxels(RawLayout(path, header.image_offset(), header.stored, header.geometry.shape))
    return LazyVolume(voxels, header.geometry, dict(header.metadata), path)


def write_npy(volume: Volume, path: Path) -> None:
    """Write an .npy."""
    with path.open("wb") as file:
        np.lib.format.write_array(file, volume.array, allow_pickle=False)
