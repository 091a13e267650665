"""Volumes that are read by a library and not written: GIPL by ITK, MGH and MGZ of FreeSurfer by nibabel."""

from __future__ import annotations

import gzip
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.memory import check_memory

_GIPL_HEADER, _GIPL_MAGIC_AT = 256, 252
_MGH_HEADER, _MGH_VERSION = 284, b"\0\0\0\1"
_GIPL_MAGICS = (b"\xef\xff\xe9\xb0", b"\x2a\xe3\x89\xb8")
#: From RAS, as FreeSurfer has it, to LPS.
_TO_LPS = np.diag([-1.0, -1.0, 1.0])
_MAX_VALUES = 1 << 40


@dataclass(frozen=True, eq=False)
class VolumeHeader:
    """What a header claims.

    Attributes
    ----------
    geometry : Geometry
    dtype : numpy.dtype
        Of the values as they are given.
    """

    geometry: Geometry
    dtype: np.dtype[Any]

    @property
    def values(self) -> int:
        """How many voxels there are."""
        return math.prod(self.geometry.shape)


def parse_gipl(path: Path) -> VolumeHeader:
    """Read the header of a GIPL.

    Raises
    ------
    InputError
        When it is none, or incomplete.
    """
    with path.open("rb") as file:
        begin = file.read(_GIPL_HEADER)
    if len(begin) < _GIPL_HEADER or begin[_GIPL_MAGIC_AT:] not in _GIPL_MAGICS:
        raise InputError("this is not a GIPL file", "is it the right one?")
    try:
        reader = itk.open_reader(path, "GiplImageIO")
    except RuntimeError as error:
        raise InputError("the header is damaged", "copy or export it again") from error
    itk.check_kind(reader)
    dtype, geometry = itk.voxel_type(reader), itk.geometry_of(reader)
    needed = _GIPL_HEADER + math.prod(geometry.shape) * dtype.itemsize
    if path.stat().st_size < needed:
        raise InputError(
            f"the header announces {needed} bytes, the file has {path.stat().st_size}", "copy or export it again"
        )
    return VolumeHeader(geometry, dtype)


def read_gipl(path: Path, header: VolumeHeader, available: int) -> Volume:
    """Read a GIPL.

    Raises
    ------
    InputError
        When it is larger than the memory.
    """
    check_memory(header.geometry.size, header.dtype.itemsize, available)
    return Volume(itk.array_of(path, "GiplImageIO"), header.geometry, {}, path)


def parse_mgh(path: Path) -> VolumeHeader:
    """Read the header of an MGH or MGZ.

    Raises
    ------
    InputError
        When it is none, or has several frames.
    """
    head = _mgh(path)
    shape = tuple(int(n) for n in head["dims"])
    frames = math.prod(shape[3:])
    if min(shape) < 1 or math.prod(shape) > _MAX_VALUES:
        raise InputError(f"a header of shape {shape} given, a volume expected", "copy it again")
    if frames > 1:
        raise InputError(f"a volume of {frames} frames given, one expected", "extract one frame first")
    affine = np.asarray(head.get_affine(), np.float64)
    steps = _TO_LPS @ affine[:3, :3]
    if not np.isfinite(affine).all() or not (spacing := np.linalg.norm(steps, axis=0)).all():
        raise InputError("the header does not describe a grid", "copy it again")
    origin = _TO_LPS @ affine[:3, 3]
    geometry = Geometry(
        (shape[2], shape[1], shape[0]), tuple(map(float, spacing[::-1])),  # type: ignore[arg-type]
        tuple(map(float, origin)), steps / spacing,  # type: ignore[arg-type]
    )
    return VolumeHeader(geometry, np.dtype(head.get_data_dtype()).newbyteorder("="))


def read_mgh(path: Path, header: VolumeHeader, available: int) -> Volume:
    """Read an MGH or MGZ.

    Raises
    ------
    InputError
        When it is damaged, or larger than the memory.
    """
    check_memory(header.geometry.size, 2 * header.dtype.itemsize, available)
    try:
        with _opened(path) as file:
            file.seek(_MGH_HEADER)
            content = file.read(header.values * header.dtype.itemsize)
        stored = np.frombuffer(content, header.dtype.newbyteorder(">")).reshape(header.geometry.shape)
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError("the voxels are incomplete or damaged", "copy it again") from error
    return Volume(stored.astype(header.dtype), header.geometry, {"mgh": "scanner"}, path)


def is_anatomical(metadata: dict[str, str]) -> bool:
    """Whether the axes of the world are a patient's: FreeSurfer's are."""
    return "mgh" in metadata


def _opened(path: Path) -> IO[bytes]:
    """The file, unpacked where its name says that it is packed."""
    return gzip.open(path) if path.suffix.lower() == ".mgz" else path.open("rb")  # type: ignore[return-value]


def _mgh(path: Path) -> Any:
    """The header by nibabel."""
    from nibabel.freesurfer.mghformat import MGHHeader

    try:
        with _opened(path) as file:
            if file.read(len(_MGH_VERSION)) != _MGH_VERSION:
                raise InputError("this is not an MGH file", "is it the right one?")
            file.seek(0)
            return MGHHeader.from_header(MGHHeader(file.read(_MGH_HEADER).ljust(_MGH_HEADER, b"\0")))
    except InputError:
        raise
    except Exception as error:  # nibabel, gzip and zlib raise errors of many kinds about damaged files
        raise InputError("this is not an MGH file, or damaged", "is it the right one?") from error
