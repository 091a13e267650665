"""MetaImage: the claims of its text header, read here; ITK writes.

ITK does not read: it takes an offset that is no number for 0, and a size of 4.5 for 4. The voxels lie in the file, in
one beside it, or in a list of files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.files import library_named
from accelsurf.io.formats.raw_header import ListedHeader, RawHeader
from accelsurf.io.formats.text_header import check_units, data_file, header_lines
from accelsurf.io.headers import TIMES_KEY, check_data_file
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions, check_readable

_TYPES = {
    **{"MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2"},
    **{"MET_INT": "i4", "MET_UINT": "u4", "MET_LONG": "i4", "MET_ULONG": "u4"},
    **{"MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8"},
}
#: Further names of keys.
_SYNONYMS = {
    **dict.fromkeys(("Position", "Origin"), "Offset"),
    **dict.fromkeys(("Orientation", "Rotation"), "TransformMatrix"),
    "ElementByteOrderMSB": "BinaryDataByteOrderMSB",
}
_REQUIRED = ("NDims", "DimSize", "ElementType")
# Without a value libraries take either.
_FLAGS = ("BinaryData", "BinaryDataByteOrderMSB", "CompressedData")
#: A number as other programs read it: Python takes more for digits.
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?", re.IGNORECASE | re.ASCII)
_DATA = re.compile(r"\s*ElementDataFile\s*[=:]")
#: Bytes after the header that are looked at.
_REST = 4096


def parse_metaimage(path: Path, options: ReadOptions = AS_IT_IS) -> RawHeader:
    """Read the header of a MetaImage.

    Raises
    ------
    InputError
        When it is none, is damaged, gives another unit than mm, or names a data file that does not exist;
        GeometryError when its axes are none.
    """
    with path.open("rb") as file:
        lines = header_lines(file, lambda line: _DATA.match(line) is not None)
        offset = file.tell()
        rest = file.read(budgets.TEXT_HEADER.limit + 1)
    fields = _fields(lines)
    name = fields["ElementDataFile"]
    is_local, is_list = name.upper() == "LOCAL", name.upper().split()[0] == "LIST"
    if rest[:_REST].strip() and not is_local and not is_list:
        raise InputError(
            "the MetaImage header goes on after ElementDataFile, where no reader looks",
            "put ElementDataFile last",
        )
    with library_named("the MetaImage header is damaged", "copy or export the file again"):
        sizes = [int(word) for word in _numbers(fields, "DimSize")]
        order = ">" if _is_true(fields, "BinaryDataByteOrderMSB") else "<"
        stored = np.dtype(order + _TYPES[fields["ElementType"].removesuffix("_ARRAY")])
        (channels,) = map(int, _numbers(fields, "ElementNumberOfChannels", "1"))
        (before,) = map(int, _numbers(fields, "HeaderSize", "0"))
        (packed,) = map(int, _numbers(fields, "CompressedDataSize", "-1"))
        if fields["NDims"] != str(len(sizes)) or min(*sizes, channels) < 1:
            raise ValueError(f"NDims {fields['NDims']}, DimSize {fields['DimSize']}")
    budgets.AXIS.check(max(*sizes, channels), "an axis of the image")
    check_units([fields.get("DistanceUnits", "")])
    times = sizes[3] if len(sizes) == 4 else 1
    if len(sizes) not in (3, 4) or (channels > 1 and times > 1):
        text = " x ".join(map(str, sizes))
        raise InputError(
            f"a {len(sizes)}D image ({text}) of {channels} values in each voxel given, 3D expected",
            "add a slice axis of size 1, or extract one volume or channel first",
        )
    if not _is_true(fields, "BinaryData", "True"):
        raise InputError(
            "a MetaImage whose voxels are text given, binary ones expected", "save it again"
        )
    claims: dict[str, Any] = {
        "geometry": _geometry(fields, sizes),
        "stored": stored,
        "channels": channels,
        "time_points": times,
        "is_interleaved": channels > 1,
        "asked": options,
    }
    is_packed = _is_true(fields, "CompressedData")
    if is_packed and (before or is_list):
        raise InputError(
            "packed voxels with a HeaderSize, or in several files, given", "save it as one file"
        )
    if is_list:
        parts = _listed(path, name, rest, sizes)
        return ListedHeader(data=path, parts=parts, bytes_before=before, **claims)
    data, first = (path, offset) if is_local else (data_file(path, name), 0)
    if (
        before < 0
    ):  # the voxels are the last bytes of the file, so that nothing before them is theirs
        before = data.stat().st_size - math.prod(sizes) * channels * stored.itemsize
    elif 0 < before < first:
        raise InputError(
            f"the MetaImage header of {offset} bytes gives a HeaderSize of {before}",
            "correct or remove it",
        )
    return RawHeader(
        data=data,
        offset=max(before, first),
        encoding="deflate" if is_packed else "raw",
        stored_bytes=packed if packed >= 0 else None,
        times_text=fields.get(TIMES_KEY, ""),
        **claims,
    )


def _fields(lines: Sequence[str]) -> dict[str, str]:
    """The fields of a header.

    Raises
    ------
    InputError
        When one is missing, is there twice, or has no value that must have one.
    """
    pairs = [re.split("[=:]", line, maxsplit=1) for line in lines if line.strip()]
    if not pairs or min(map(len, pairs)) < 2 or not _DATA.match(lines[-1]):
        raise InputError(
            "this is not a MetaImage: ElementDataFile is missing, or a line is none of its own",
            hint="is it the right file, and whole?",
        )
    named = [(_SYNONYMS.get(key.strip(), key.strip()), value.strip()) for key, value in pairs]
    fields = dict(named)
    if twice := [key for key, value in named if fields[key] != value]:
        raise InputError(
            f"the MetaImage header gives two values for {twice[0]}", "keep the one that is right"
        )
    if missing := [key for key in _REQUIRED if key not in fields]:
        raise InputError(
            f"the MetaImage header is damaged: {missing[0]} is missing", "copy or export it again"
        )
    for key in (*_FLAGS, "ElementDataFile"):
        if fields.get(key) == "":
            raise InputError(
                f"the MetaImage header has no value for {key}", "give it, or remove it"
            )
    return fields


def _numbers(fields: Mapping[str, str], key: str, default: str = "") -> list[str]:
    """The numbers of a key, as they are written.

    Raises
    ------
    GeometryError
        When one of them is none.
    """
    words = fields.get(key, default).split()
    if not words or not all(map(_NUMBER.fullmatch, words)):
        raise GeometryError(
            f"the header gives {key} = {fields.get(key, '')}, finite numbers expected",
            "correct the header",
        )
    return words


def _geometry(fields: Mapping[str, str], sizes: Sequence[int]) -> Geometry:
    """The grid of the first three axes; the rows of the matrix are their directions."""
    axes = len(sizes)
    spacing = fields.get("ElementSpacing", fields.get("ElementSize", "1 " * axes))
    given = {"ElementSpacing": spacing, "Offset": "0 " * axes}
    given["TransformMatrix"] = " ".join(map(str, np.eye(axes).ravel()))
    found = {}
    for key, default in given.items():
        words = _numbers({key: default} | dict(fields), key)
        found[key] = np.array(words, float)
        wanted = axes**2 if key == "TransformMatrix" else axes
        if len(words) != wanted:
            raise GeometryError(
                f"the header gives {key} = {' '.join(words)}, {wanted} finite numbers expected",
                "correct the header",
            )
    direction = found["TransformMatrix"].reshape(axes, axes).T[:3, :3]
    nx, ny, nz = sizes[:3]
    hx, hy, hz = found["ElementSpacing"][:3].tolist()
    return Geometry((nz, ny, nx), (hz, hy, hx), tuple(found["Offset"][:3].tolist()), direction)


def _listed(path: Path, name: str, rest: bytes, sizes: Sequence[int]) -> tuple[Path, ...]:
    """The files of a list, one for each slice, or each of as many axes as ``LIST 2D`` says.

    Raises
    ------
    InputError
        When the list has another number of files, or one is missing or lies elsewhere.
    """
    found = re.fullmatch(r"LIST(?:\s+([1-9])D?)?", name, re.IGNORECASE)
    if found is None or len(sizes) > 3:
        raise InputError(
            f"the voxels are spread over several files ({name[:40]}) of {len(sizes)} axes",
            "save the image as one file first",
        )
    axes = int(found.group(1) or len(sizes) - 1)
    budgets.TEXT_HEADER.check(len(rest), "the list of files")
    lines = rest.decode("utf-8", errors="replace").splitlines()
    names = [line.strip() for line in lines if line.strip()]
    wanted = math.prod(sizes[axes:])
    if axes > len(sizes) or len(names) != wanted:
        raise InputError(
            f"the list has {len(names)} files, {wanted} expected: one for each "
            f"{'slice' if axes == 2 else f'part of {axes} axes'}",
            "are all files of the list in the header?",
        )
    for part in names:
        if "\0" in part:
            raise InputError("a name in the list of files has a zero byte", "correct the list")
        check_data_file(path, path.parent / part)
        check_readable(path.parent / part, f"{part}: ")
    return tuple(path.parent / part for part in names)


def _is_true(fields: Mapping[str, str], key: str, default: str = "False") -> bool:
    return fields.get(key, default)[:1] in ("T", "t", "1")  # as MetaIO reads it


def write_metaimage(volume: Volume, path: Path) -> None:
    """Write a MetaImage, compressed; for .mhd the voxels go to a .zraw file beside it."""
    from accelsurf.io import itk

    itk.save(volume, path, "MetaImageIO", compress=True)
