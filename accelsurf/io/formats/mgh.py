"""MGH and MGZ of FreeSurfer, read only: nibabel takes the header apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import MAX_ORIGIN, Geometry
from accelsurf.io.files import library_named
from accelsurf.io.formats.deflate import GZIP_START, first_bytes
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.headers import MGH_KEY, with_warnings

_MGH_HEADER = 284
_MGH_VERSION = b"\0\0\0\1"
#: From RAS, as FreeSurfer has it, to LPS.
_TO_LPS = np.diag([-1.0, -1.0, 1.0])
#: Where the header says if its size of a voxel and its directions count: a whole number of 2 bytes.
_FLAG_AT = 28
#: Directions (x, y, z) in RAS of a volume without: coronal slices, FreeSurfer's `mghRead`. nibabel has them transposed.
_CORONAL = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_NO_PLACE = (
    "the header does not say where the volume lies (goodRASFlag is 0): as in FreeSurfer it is taken for coronal slices "
    "of 1 mm around 0,0,0"
)
#: Type codes; others are of FreeSurfer's own kinds, or none.
_MGH_TYPES = {0: "uint8", 4: "int16", 1: "int32", 3: "float32", 10: "uint16"}
_AGAIN = "copy or export it again"
#: Directions are written in single precision, by some with few digits.
_UNIT_TOLERANCE = 1e-3


def parse_mgh(path: Path) -> RawHeader:
    """Read the header of an MGH or MGZ.

    Raises
    ------
    InputError
        When it is none, or has several frames.
    """
    is_packed = path.suffix.lower() == ".mgz"
    with path.open("rb") as file:
        if is_packed and file.read(2) != GZIP_START:
            raise InputError(
                "this is not an MGZ: it is not gzip-compressed", "is it the right file?"
            )
        file.seek(0)
        begin = first_bytes(file, _MGH_HEADER) if is_packed else file.read(_MGH_HEADER)
    head, has_place = _mgh_header(begin)
    shape, code = tuple(int(n) for n in head["dims"]), int(head["type"])
    if min(shape) < 1:
        raise InputError(f"a header of shape {shape} given, a volume expected", _AGAIN)
    if shape[3] > 1:
        raise InputError(
            f"a volume of {shape[3]} frames given, one expected", "extract one frame first"
        )
    if code not in _MGH_TYPES:
        known = ", ".join(f"{number} ({name})" for number, name in _MGH_TYPES.items())
        hint = "convert it first: mri_convert -odt float IN OUT"
        raise InputError(f"an MGH of type {code} given, {known} expected", hint)
    return RawHeader(
        data=path,
        geometry=_mgh_geometry(head, shape),
        stored=np.dtype(_MGH_TYPES[code]).newbyteorder(">"),
        encoding="deflate" if is_packed else "raw",
        skip=_MGH_HEADER,
        metadata=with_warnings({MGH_KEY: "scanner"}, "" if has_place else _NO_PLACE),
    )


def _mgh_geometry(head: Any, shape: tuple[int, ...]) -> Geometry:
    """The grid that a header of MGH describes; where it says that it describes none, voxels of 1 mm as FreeSurfer."""
    numbers = np.concatenate([head[key].ravel() for key in ("delta", "Mdc", "Pxyz_c")])
    if not (np.abs(numbers) < MAX_ORIGIN).all():
        raise InputError("the header does not describe a grid", _AGAIN)
    # Else the size of a voxel would be told twice, and differently.
    lengths = np.linalg.norm(np.asarray(head["Mdc"], np.float64).reshape(3, 3), axis=1)
    if not (head["delta"] > 0).all() or not np.allclose(
        lengths, 1.0, rtol=0.0, atol=_UNIT_TOLERANCE
    ):
        raise InputError(
            "the axes in the header have no length of 1, or voxels no positive size", _AGAIN
        )
    affine = np.asarray(head.get_affine(), np.float64)
    steps = _TO_LPS @ affine[:3, :3]
    if not (spacing := np.linalg.norm(steps, axis=0)).all():
        raise InputError("the header does not describe a grid", _AGAIN)
    return Geometry(
        (shape[2], shape[1], shape[0]),
        tuple(map(float, spacing[::-1])),  # type: ignore[arg-type]
        tuple(map(float, _TO_LPS @ affine[:3, 3])),  # type: ignore[arg-type]
        steps / spacing,
    )


def _mgh_header(begin: bytes) -> tuple[Any, bool]:
    """The header by nibabel, which would repair it and print about that; and whether it says where the volume lies."""
    from nibabel.freesurfer.mghformat import MGHHeader

    if begin[: len(_MGH_VERSION)] != _MGH_VERSION:
        raise InputError("this is not an MGH file", "is it the right one?")
    with library_named("the header is damaged", _AGAIN):
        begin = begin.ljust(_MGH_HEADER, b"\0")
        header = MGHHeader(begin, check=False)
    has_place = int.from_bytes(begin[_FLAG_AT : _FLAG_AT + 2], "big", signed=True) > 0
    if not has_place:
        header["delta"], header["Mdc"], header["Pxyz_c"] = 1.0, _CORONAL, 0.0
    return header, has_place
