"""Sequences written as 4D NIfTI, NRRD and MetaImage: their headers, and the frames one after the other.

SimpleITK would need all frames in memory. Where a step and its unit do not say the times, a line of text does: in an
extension of a NIfTI (code 6, a comment), as a key of the others.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelsurf.io.formats.deflate import gzip_file
from accelsurf.io.formats.nifti import COMMENT_CODE
from accelsurf.io.headers import TIMES_KEY, single_precision

if TYPE_CHECKING:
    from accelsurf.io.sequences.writing import FrameStack

_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_MAX_AXIS = 2**15 - 1
_NRRD_TYPES = {"i1": "int8", "u1": "uint8", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint",
               "i8": "longlong", "u8": "ulonglong", "f4": "float", "f8": "double"}  # fmt: skip
_META_TYPES = {"i1": "MET_CHAR", "u1": "MET_UCHAR", "i2": "MET_SHORT", "u2": "MET_USHORT", "i4": "MET_INT",
               "u4": "MET_UINT", "i8": "MET_LONG_LONG", "u8": "MET_ULONG_LONG", "f4": "MET_FLOAT",
               "f8": "MET_DOUBLE"}  # fmt: skip
_LEVEL = 6


def write_nifti(path: Path, frames: FrameStack) -> None:
    """Write a NIfTI-1; a NIfTI-2 where an axis is too long for that."""
    with path.open("wb") as file:
        file.write(_nifti_header(frames))
        for array in frames:
            file.write(array.data)


def write_packed_nifti(path: Path, frames: FrameStack) -> None:
    """Write a NIfTI, compressed, the same bytes for the same frames."""
    plain = path.parent.parent / "packed.nii"
    write_nifti(plain, frames)
    gzip_file(plain, path)
    plain.unlink()


def _nifti_header(frames: FrameStack) -> bytes:
    """Header and extension."""
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    geometry, times = frames.geometry, frames.times
    shape = (*geometry.size, len(frames))
    second = max(shape) > _MAX_AXIS
    header = Nifti2Header(endianness="<") if second else Nifti1Header(endianness="<")
    affine = np.eye(4)
    affine[:3, :3] = geometry.direction * geometry.spacing_xyz
    affine[:3, 3] = geometry.origin
    header.set_data_dtype(frames.dtype)
    header.set_data_shape(shape)
    header.set_qform(_RAS @ affine, code=1)
    header.set_sform(_RAS @ affine, code=1)
    is_plain = times.is_count or (times.seconds is not None and single_precision(times.seconds) == times.seconds)
    header["pixdim"][4] = times.mean_step
    header.set_xyzt_units("mm", "sec" if times.unit == "s" else None)
    extension = b"" if is_plain else _extension(times.text)
    header["magic"] = b"n+2" if second else b"n+1"
    begin = len(header.binaryblock)
    header["vox_offset"] = begin + 4 + len(extension)
    return bytes(header.binaryblock) + (b"\1\0\0\0" if extension else b"\0\0\0\0") + extension


def _extension(text: str) -> bytes:
    content = f"{TIMES_KEY}: {text}".encode()
    size = -(-(len(content) + 8) // 16) * 16
    return struct.pack("<2i", size, COMMENT_CODE) + content.ljust(size - 8, b"\0")


def write_nrrd(path: Path, frames: FrameStack) -> None:
    """Write an NRRD, compressed, in the space left-posterior-superior-time."""
    geometry, times = frames.geometry, frames.times
    axes = [geometry.direction[:, axis] * h for axis, h in enumerate(geometry.spacing_xyz)]
    vectors = " ".join(f"({_comma([*axis.tolist(), 0.0])})" for axis in axes)
    lines = [
        *("NRRD0005", f"type: {_NRRD_TYPES[frames.dtype.str[1:]]}", "dimension: 4"),
        *("space: left-posterior-superior-time", f"sizes: {_words([*geometry.size, len(frames)])}"),
        f"space directions: {vectors} (0.0,0.0,0.0,{times.mean_step!r})",
        *("kinds: domain domain domain time", "endian: little", "encoding: gzip"),
        f'space units: "mm" "mm" "mm" "{times.unit if times.unit == "s" else ""}"',
        f"space origin: ({_comma([*geometry.origin, times.values[0]])})",
    ]
    if not (times.is_count or times.seconds):
        lines.append(f"{TIMES_KEY}:={times.text}")
    with path.open("wb") as out:
        out.write(("\n".join(lines) + "\n\n").encode())
        with gzip.GzipFile(filename="", mode="wb", compresslevel=_LEVEL, fileobj=out, mtime=0) as packed:
            for array in frames:
                packed.write(array.data)


def write_metaimage(path: Path, frames: FrameStack) -> None:
    """Write a MetaImage, compressed; of an .mhd the voxels go to a .zraw file beside it."""
    data = path.with_suffix(".zraw") if path.suffix.lower() == ".mhd" else path.parent.parent / "packed.zraw"
    pack, count = zlib.compressobj(_LEVEL), 0
    with data.open("wb") as out:
        for array in frames:
            count += out.write(pack.compress(array.tobytes()))
        count += out.write(pack.flush())
    local = data.parent != path.parent
    header = "".join(f"{key} = {value}\n" for key, value in _meta_fields(frames, count).items())
    with path.open("wb") as out:
        out.write(f"{header}ElementDataFile = {'LOCAL' if local else data.name}\n".encode())
        if local:
            with data.open("rb") as packed:
                while block := packed.read(1 << 20):
                    out.write(block)
    if local:
        data.unlink()


def _meta_fields(frames: FrameStack, packed_bytes: int) -> Mapping[str, Any]:
    geometry, times = frames.geometry, frames.times
    matrix = np.eye(4)
    matrix[:3, :3] = geometry.direction.T  # a row for each axis
    fields: dict[str, Any] = {
        "ObjectType": "Image", "NDims": 4, "BinaryData": "True", "BinaryDataByteOrderMSB": "False",
        "CompressedData": "True", "CompressedDataSize": packed_bytes,
        "TransformMatrix": _words(matrix.ravel().tolist()),
        "Offset": _words([*geometry.origin, times.values[0]]), "CenterOfRotation": "0 0 0 0",
        "ElementSpacing": _words([*geometry.spacing_xyz, times.mean_step]),
        "DimSize": _words([*geometry.size, len(frames)]),
    }  # fmt: skip
    if not times.is_count:
        fields[TIMES_KEY] = f"s {times.seconds!r}" if times.seconds else times.text
    return fields | {"ElementType": _META_TYPES[frames.dtype.str[1:]]}


def _words(numbers: list[Any]) -> str:
    return " ".join(map(repr, numbers))


def _comma(numbers: list[Any]) -> str:
    return ",".join(map(repr, numbers))
