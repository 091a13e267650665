"""NRRD and MetaImage: the claims of their text headers, and the lines of an NRRD header that place the grid.

ITK reads the voxels. It takes any unit for mm, and for some damaged headers it returns uninitialized memory. So the
headers are read here first. A segmentation of 3D Slicer is an NRRD with the names and colours of its segments.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.boxes import bounding_box, whole_box
from accelsurf.image.volume import Volume
from accelsurf.io import itk
from accelsurf.io.formats.raw_header import ByteOrder, Encoding, ListedHeader, RawHeader
from accelsurf.io.headers import TIMES_KEY, check_data_file
from accelsurf.settings import budgets
from accelsurf.settings.labels import LabelEntry
from accelsurf.settings.reading import AS_IT_IS, ReadOptions, check_readable
from accelsurf.settings.wording import seconds_of

#: Kinds of an axis of space, of time points, and of none that is said; along the others lie the values of a voxel.
_SPACE, _TIME, _SAYS_NOTHING = ("domain", "space"), ("time",), ("", "???", "none", "list")
_NUMBER = re.compile(r"[0-9.eE+-]{1,30}")
NRRD_KEY = "nrrd_space"
"""Where `Volume.metadata` keeps the lines of an NRRD header that place the grid."""
NRRD_ITK_NAME, METAIMAGE_ITK_NAME = "NrrdImageIO", "MetaImageIO"
"""The classes of ITK that read and write these formats."""
_NRRD_BYTES = {
    **dict.fromkeys(
        ("signed char", "int8", "int8_t", "uchar", "unsigned char", "uint8", "uint8_t"), 1
    ),
    **dict.fromkeys(
        ("short", "short int", "signed short", "signed short int", "int16", "int16_t"), 2
    ),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), 2),
    **dict.fromkeys(
        ("int", "signed int", "int32", "int32_t", "uint", "unsigned int", "uint32", "uint32_t"), 4
    ),
    **dict.fromkeys(
        ("longlong", "long long", "long long int", "signed long long", "signed long long int"), 8
    ),
    **dict.fromkeys(
        ("int64", "int64_t", "ulonglong", "unsigned long long", "unsigned long long int"), 8
    ),
    **dict.fromkeys(("uint64", "uint64_t", "double"), 8),
    "float": 4,
}
_NRRD_ENCODINGS: dict[str, Encoding] = {"raw": "raw", "gzip": "deflate", "gz": "deflate"}
_META_BYTES = {
    **dict.fromkeys(("MET_CHAR", "MET_UCHAR"), 1),
    **dict.fromkeys(("MET_SHORT", "MET_USHORT"), 2),
    **dict.fromkeys(("MET_INT", "MET_UINT", "MET_LONG", "MET_ULONG", "MET_FLOAT"), 4),
    **dict.fromkeys(("MET_LONG_LONG", "MET_ULONG_LONG", "MET_DOUBLE"), 8),
}
_MAX_LENGTH = 1e12  # mm
_MAX_FIELD = 1000
_MAX_AXES = 16
_NOT_PACKED = (
    "the voxels are compressed without a CompressedDataSize, or with a HeaderSize: ITK cannot read that",
    "save the image again, e.g. uncompressed",
)
# Lines whose length depends on NDims, which must come before them.
_META_SIZED = frozenset(
    "NDims DimSize ElementSpacing ElementSize Offset Position Origin TransformMatrix Orientation Rotation "
    "CenterOfRotation AnatomicalOrientation".split()
)
# Without a value libraries take either.
_META_FLAGS = ("BinaryData", "BinaryDataByteOrderMSB", "ElementByteOrderMSB", "CompressedData")
#: Bytes after the header that are looked at.
_REST = 4096
_LIST = re.compile(r"\s*ElementDataFile\s*[=:]\s*LIST\b", re.IGNORECASE)


def parse_nrrd(path: Path, options: ReadOptions = AS_IT_IS) -> RawHeader:
    """Read the header of an NRRD.

    Raises
    ------
    InputError
        When it is none, is damaged, gives another unit than mm, or names a data file that does not exist;
        GeometryError when its axes are none.
    """
    with path.open("rb") as file:
        if file.read(4) != b"NRRD":
            raise InputError(
                "this is not an NRRD image: it does not start with NRRD",
                hint="is it the right file?",
            )
        file.seek(0)
        lines = _header_lines(file, lambda line: not line.strip())
        offset = file.tell()
    _check_fields(lines)
    fields = {
        key.strip().lower(): value.strip()
        for key, colon, value in (
            line.partition(": ") for line in lines[1:] if not line.startswith("#")
        )
        if colon
    }
    try:
        sizes = _whole(fields["sizes"])
        item = _NRRD_BYTES[fields["type"].lower()]
        encoding = fields["encoding"].lower()
        if _whole(fields["dimension"]) != [len(sizes)] or min(sizes) < 1 or len(sizes) > _MAX_AXES:
            raise ValueError
    except (LookupError, ValueError):
        raise InputError(
            f"the NRRD header is damaged: type {fields.get('type')}, sizes {fields.get('sizes')}, "
            f"encoding {fields.get('encoding')}",
            hint="copy or export the file again",
        ) from None
    budgets.AXIS.check(max(sizes), "an axis of the image")
    _check_nrrd_axes(fields, len(sizes))
    axis = fourth_axis(fields, lines, sizes)
    said = (
        " ".join(fields.get(key, "") for key in ("space units", "units")).replace('"', " ").split()
    )
    _check_units([unit for unit in said if not seconds_of(unit)])
    data = path
    if detached := fields.get("data file") or fields.get("datafile"):
        data, offset = _detached(path, detached), 0
    if encoding not in _NRRD_ENCODINGS:
        raise InputError(
            f"an NRRD of encoding {encoding} given, raw or gzip expected", "save it as gzip"
        )
    coding, numbers, order = _NRRD_ENCODINGS[encoding], math.prod(sizes), _nrrd_order(fields, item)
    offset += _nrrd_skip(fields, coding, data.stat().st_size - offset - numbers * item)
    metadata = {}
    if len(sizes) == 3 and "space directions" in fields:
        keys = ("space", "space dimension", "space directions", "space origin")
        metadata[NRRD_KEY] = "\n".join(f"{k}: {fields[k]}" for k in keys if k in fields)
    return RawHeader(
        data,
        offset,
        coding,
        numbers * item,
        NRRD_ITK_NAME,
        metadata=metadata,
        numbers=numbers,
        order=order,
        **axis,
        asked=options,
    )


def _nrrd_skip(fields: dict[str, str], coding: Encoding, most: int) -> int:
    """Bytes before raw voxels; all but theirs, ``most``, where the header gives -1."""
    try:
        (lines,) = _whole(fields.get("line skip") or fields.get("lineskip") or "0")
        (skip,) = _whole(fields.get("byte skip") or fields.get("byteskip") or "0")
    except ValueError:
        lines, skip = 1, 0
    if lines or (skip and coding != "raw"):
        raise InputError(
            "an NRRD with lines to skip, or bytes of packed voxels, given", "save it as gzip"
        )
    return skip if skip >= 0 else max(most, 0)


def _nrrd_order(fields: dict[str, str], item: int) -> ByteOrder:
    """Byte order; of single bytes any."""
    said = fields.get("endian", "little" if item == 1 else "").lower()
    if said not in ("little", "big"):
        raise InputError(
            f"the NRRD header gives endian {said[:40]!r}, little or big expected",
            "correct the header",
        )
    return "<" if said == "little" else ">"


def _check_fields(lines: list[str]) -> None:
    """Refuse what would overrun the memory of the library that reads the voxels when it quotes a header."""
    fields = (line for line in lines if not line.startswith(("#", "content:")) and ":=" not in line)
    longest = max(map(len, fields), default=0)
    if longest > _MAX_FIELD:
        raise InputError(
            f"the NRRD header has a field of {longest} characters, at most {_MAX_FIELD} expected",
            "is it damaged?",
        )


def _check_nrrd_axes(fields: dict[str, str], dimension: int) -> None:
    if dimension != 3:
        return  # another kind of image: refused by that name later
    if text := fields.get("space directions"):
        vectors = text.replace("(", " ").replace(")", " ").replace(",", " ")
        values = _numbers(vectors, "space directions", 9)
        spacing = np.linalg.norm(np.reshape(values, (3, 3)), axis=1).tolist()
    else:
        spacing = _numbers(fields.get("spacings", "1 1 1"), "spacings", 3)
    _check_spacing(spacing)


def fourth_axis(
    fields: Mapping[str, str], lines: Sequence[str], sizes: Sequence[int]
) -> dict[str, Any]:
    """Return what the fourth axis is, as arguments of `RawHeader`.

    The axis beside those of space is the one of another kind, or without a direction. A list of 3D Slicer may be a
    sequence; lines of its own say so. An axis that says nothing and runs slowest is time, since channels run fastest.

    Parameters
    ----------
    fields : mapping of str to str
        Of the header.
    lines : sequence of str
        Of the header; those with ``:=`` are free.
    sizes : sequence of int

    Raises
    ------
    InputError
        When the axis lies between those of space, or is of time and runs fastest.
    """
    if len(sizes) != 4:
        return {}
    kinds = [*fields.get("kinds", "").lower().split(), *[""] * 4][:4]
    place, is_without = _place(kinds, fields.get("space directions", ""))
    kind = kinds[place]
    if place == 0 and kind in _TIME:
        raise InputError(
            "the time axis of the NRRD comes first, before those of space",
            "save it last, or as an axis of kind list",
        )
    if place in (1, 2):
        raise InputError(
            f"a 4D NRRD whose axis {place + 1} is none of space ({kind or 'without a direction'}) given, the first or "
            "last one expected",
            "save that axis first (channels) or last (time points)",
        )
    if is_without and kind in ("", "???", "none", *_SPACE, *_TIME):
        raise InputError(
            f"a 4D NRRD of {sizes[place]} volumes given, along an axis without a direction whose kind is "
            f"{kind or 'not said'}: list expected, else ITK does not read it",
            "write list for that axis in the line kinds of the header; then --time-index N takes one volume, and "
            "accelsurf track follows all",
        )
    said = {
        key.strip().lower(): value.strip()
        for key, _, value in (line.partition(":=") for line in lines)
    }
    times = said.get(TIMES_KEY, "").lower() or _times_of_slicer(said, fields, sizes[place])
    if place == 3:
        name = "time_points" if kind in (*_SPACE, *_TIME, *_SAYS_NOTHING) else "channels"
        return {name: sizes[3], "seconds": _seconds(fields), "times_text": times}
    marks = ("axis 0 index type", "axis 0 index values", "multivolume.framelabels")
    name = "time_points" if any(mark in said for mark in marks) else "channels"
    return {name: sizes[0], "is_interleaved": True, "times_text": times}


def _place(kinds: Sequence[str], directions: str) -> tuple[int, bool]:
    """Number of the axis that is none of space, the last where nothing tells; whether it is given no direction."""
    vectors = re.findall(r"none|\([^)]*\)", directions.lower())
    without = [
        place for place, vector in enumerate(vectors[:4]) if vector == "none" or "nan" in vector
    ]
    other = [place for place, kind in enumerate(kinds) if kind not in (*_SPACE, "")]
    if len(without) == 1:
        return without[0], True
    return (other[0] if len(other) == 1 else 3), False


def _times_of_slicer(said: Mapping[str, str], fields: Mapping[str, str], count: int) -> str:
    """The line of `accelsurf.io.headers` with the times of a sequence of 3D Slicer; empty where it has none."""
    units = re.findall(r'"([^"]*)"', fields.get("units", ""))
    factor = seconds_of((said.get("axis 0 index unit") or (units[0] if units else "")).lower())
    words = said.get("axis 0 index values", "").replace(",", " ").split()
    if not factor or len(words) != count or not all(map(_NUMBER.fullmatch, words)):
        return ""
    try:
        times = [float(word) * factor for word in words]
    except ValueError:
        return ""
    rising = all(a < b for a, b in zip(times, times[1:], strict=False))
    return " ".join(["s", *map(repr, times)]) if rising and all(map(math.isfinite, times)) else ""


def _seconds(fields: Mapping[str, str]) -> float | None:
    """Seconds along the fourth axis, by its spacing, or in a space of four axes by its direction."""
    steps, units = (
        fields.get("spacings", "").split(),
        re.findall(r'"([^"]*)"', fields.get("units", "")),
    )
    if not steps and "space units" in fields:
        last = fields.get("space directions", "").rpartition("(")[2].rstrip(") ").split(",")
        steps, units = [""] * 3 + last[-1:], re.findall(r'"([^"]*)"', fields["space units"])
    if len(steps) != 4 or len(units) != 4 or _NUMBER.fullmatch(steps[3].strip()) is None:
        return None
    try:
        seconds = float(steps[3]) * seconds_of(units[3])
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and seconds > 0 else None


def parse_metaimage(path: Path, options: ReadOptions = AS_IT_IS) -> RawHeader:
    """Read the header of a MetaImage.

    Raises
    ------
    InputError
        When it is none, is damaged, gives another unit than mm, is packed as ITK cannot read it, or names a data file
        that does not exist; GeometryError when its axes are none.
    """
    with path.open("rb") as file:
        lines = _header_lines(
            file, lambda line: re.match(r"\s*ElementDataFile\s*[=:]", line) is not None
        )
        offset = file.tell()
        rest = file.read(_REST)
        files = file.read(budgets.TEXT_HEADER.limit) if lines and _LIST.match(lines[-1]) else b""
    pairs = [re.split("[=:]", line, maxsplit=1) for line in lines if line.strip()]
    fields = {pair[0].strip(): pair[-1].strip() for pair in pairs}
    keys = [pair[0].strip() for pair in pairs if len(pair) == 2]
    if len(set(keys)) < len(keys):
        raise InputError(
            "the MetaImage header says the same key twice", hint="keep the one that is right"
        )
    name = fields.get("ElementDataFile", "")
    if (
        not name
        or next((k for k in fields if k in _META_SIZED), "") != "NDims"
        or min(map(len, pairs)) < 2
    ):
        raise InputError(
            "this is not a MetaImage: NDims, DimSize or ElementDataFile is missing or out of order",
            hint="is it the right file, and whole?",
        )
    is_list = name.upper().split()[:1] == ["LIST"]
    if rest.strip() and not is_list and name.upper() != "LOCAL":
        raise InputError(
            "the MetaImage header goes on after ElementDataFile, where no reader looks",
            "put ElementDataFile last",
        )
    _check_meta_flags(fields)
    try:
        sizes = _whole(fields["DimSize"])
        item = _META_BYTES[fields["ElementType"].removesuffix("_ARRAY")]
        (channels,) = _whole(fields.get("ElementNumberOfChannels", "1"))
        (skip,) = _whole(fields.get("HeaderSize", "0"))
        stored = _whole(fields["CompressedDataSize"])[0] if "CompressedDataSize" in fields else None
        if (
            _whole(fields["NDims"]) != [len(sizes)]
            or min(sizes) < 1
            or len(sizes) > _MAX_AXES
            or channels < 1
        ):
            raise ValueError
    except (LookupError, ValueError):
        raise InputError(
            f"the MetaImage header is damaged: NDims {fields.get('NDims')}, DimSize {fields.get('DimSize')}, "
            f"ElementType {fields.get('ElementType')}",
            hint="copy or export the file again",
        ) from None
    budgets.AXIS.check(max(*sizes, channels), "an axis of the image")
    numbers = math.prod(sizes) * channels
    _check_meta_axes(fields, len(sizes))
    _check_units([fields["DistanceUnits"]] if "DistanceUnits" in fields else [])
    data = path
    if name.upper() != "LOCAL" and not is_list:
        data, offset = _detached(path, name), 0
    if not _is_true(fields, "BinaryData", "True"):
        raise InputError(
            "a MetaImage whose voxels are text given, binary ones expected", "save it again"
        )
    encoding: Encoding = "raw"
    if _is_true(fields, "CompressedData"):
        encoding = "deflate"
        if skip != 0 or (stored is None and data == path):
            # ITK then decompresses nothing and returns uninitialized memory.
            raise InputError(*_NOT_PACKED)
    if is_list:
        return _listed(
            path, fields, rest + files, _ListedVoxels(sizes, channels, item, skip, options)
        )
    if 0 < skip < offset:
        raise InputError(
            f"the MetaImage header of {offset} bytes gives a HeaderSize of {skip}",
            "correct or remove it",
        )
    # HeaderSize -1 means: the voxels are the last bytes of the file, so that nothing before them is theirs.
    count, order = numbers * item, _meta_order(fields)
    offset = max(skip if skip >= 0 else data.stat().st_size - count, offset)
    axis = _meta_fourth_axis(channels, sizes) | {"times_text": fields.get(TIMES_KEY, "")}
    return RawHeader(
        data,
        offset,
        encoding,
        count,
        METAIMAGE_ITK_NAME,
        stored_bytes=stored,
        numbers=numbers,
        order=order,
        **axis,
        asked=options,
    )


class _ListedVoxels(NamedTuple):
    """Claims of a MetaImage about voxels that lie in several files: see `ListedHeader`."""

    sizes: list[int]
    channels: int
    item: int
    skip: int
    options: ReadOptions


def _listed(
    path: Path, fields: Mapping[str, str], rest: bytes, said: _ListedVoxels
) -> ListedHeader:
    """The header of a MetaImage with a list of files, one for each slice, or each of as many axes as ``LIST 2D`` says.

    Raises
    ------
    InputError
        When the list has another number of files, one is missing or lies elsewhere, or they are packed.
    """
    name, sizes = fields["ElementDataFile"], said.sizes
    found = re.fullmatch(r"LIST(?:\s+([1-9])D?)?", name, re.IGNORECASE)
    if found is None or len(sizes) > 3:
        raise InputError(
            f"the voxels are spread over several files ({name[:40]}) of {len(sizes)} axes",
            "save the image as one file first",
        )
    axes = int(found.group(1) or max(len(sizes) - 1, 1))
    if _is_true(dict(fields), "CompressedData"):
        raise InputError(
            "the files of the list are packed, plain ones expected", "save the image as one file"
        )
    budgets.TEXT_HEADER.check(len(rest), "the list of files")
    names = [line.strip() for line in rest.decode("utf-8", errors="replace").splitlines()]
    names = [line for line in names if line]
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
    numbers = math.prod(sizes) * said.channels
    return ListedHeader(
        path,
        0,
        "raw",
        numbers * said.item,
        METAIMAGE_ITK_NAME,
        numbers=numbers,
        order=_meta_order(dict(fields)),
        **_meta_fourth_axis(said.channels, sizes),
        asked=said.options,
        parts=tuple(path.parent / part for part in names),
        skipped=said.skip,
    )


def _check_meta_flags(fields: Mapping[str, str]) -> None:
    for flag in _META_FLAGS:
        if fields.get(flag) == "":
            raise InputError(
                f"the MetaImage header has no value for {flag}", hint="give it True or False"
            )


def _meta_fourth_axis(channels: int, sizes: Sequence[int]) -> dict[str, Any]:
    """Axis of time beside the three of space, as arguments of `RawHeader`."""
    times = sizes[3] if len(sizes) == 4 else 1
    if channels > 1 and times > 1:
        raise InputError(
            f"a 4D MetaImage of {times} volumes with {channels} values in each voxel given",
            "extract one volume first",
        )
    return {"channels": channels, "time_points": times, "is_interleaved": channels > 1}


def _meta_order(fields: dict[str, str]) -> ByteOrder:
    key = "BinaryDataByteOrderMSB" if "BinaryDataByteOrderMSB" in fields else "ElementByteOrderMSB"
    return ">" if _is_true(fields, key) else "<"


def _check_meta_axes(fields: dict[str, str], dimension: int) -> None:
    spacing = fields.get("ElementSpacing", fields.get("ElementSize", " ".join(["1"] * dimension)))
    _check_spacing(_numbers(spacing, "ElementSpacing", dimension))
    for key, count in (("Offset", dimension), ("Position", dimension), ("Origin", dimension)):
        if key in fields:
            _numbers(fields[key], key, count)
    for key in ("TransformMatrix", "Orientation", "Rotation"):
        if key in fields:
            _numbers(fields[key], key, dimension * dimension)


def _is_true(fields: dict[str, str], key: str, default: str = "False") -> bool:
    return fields.get(key, default)[:1] in ("T", "t", "1")  # as MetaIO reads it


def _header_lines(file: BinaryIO, last: Callable[[str], bool]) -> list[str]:
    """Lines of a text header up to and including the one that ends it (or the end of the file)."""
    lines: list[str] = []
    most = budgets.TEXT_HEADER.limit
    while (left := most - file.tell()) > 0 and (raw := file.readline(left)):
        lines.append(raw.decode("utf-8", errors="replace").rstrip("\r\n"))
        if last(lines[-1]):
            break
    return lines


def _detached(path: Path, name: str) -> Path:
    """The data file a header names, relative to the header."""
    if name.split()[0].upper() == "LIST" or "%" in name:
        raise InputError(
            f"the voxels are spread over several files ({name})",
            hint="save the image as one file first",
        )
    data = path.parent / name
    if "\0" in name or not data.is_file():
        raise InputError(
            f"the header names the data file {name}, which is missing",
            hint=f"copy {name} into the same folder, under that name",
        )
    return data


def _plain(text: str) -> str:
    """A text of numbers as other programs read them: without what only Python takes for digits."""
    if "_" in text or not text.isascii():
        raise ValueError
    return text


def _whole(text: str) -> list[int]:
    return [int(n) for n in _plain(text).split()]


def _numbers(text: str, key: str, count: int) -> list[float]:
    try:
        values = [float(v) for v in _plain(text).split()]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) <= _MAX_LENGTH for value in values):
        raise GeometryError(
            f"the header gives {key} = {text}, {count} finite numbers expected, of at most {_MAX_LENGTH:g} mm",
            hint="correct the header",
        )
    return values


def _check_spacing(spacing: list[float]) -> None:
    if any(h <= 0 for h in spacing):
        raise GeometryError(
            f"the header gives spacing (x,y,z) = ({', '.join(f'{h:g}' for h in spacing)}), positive numbers expected",
            hint="correct the spacing in the header",
        )


def _check_units(units: list[str]) -> None:
    """Millimetres are the only unit that ITK has for these formats; anything else it would silently take as mm."""
    for unit in units:
        if unit.lower() not in (
            "",
            "mm",
            "millimeter",
            "millimeters",
            "millimetre",
            "millimetres",
            "???",
            "?",
        ):
            raise InputError(
                f"the header gives lengths in {unit}, mm expected",
                hint="convert spacing and origin to mm in the header, or take out the unit to have them read as mm",
            )


def is_nrrd_anatomical(metadata: Mapping[str, str]) -> bool:
    """Test if an NRRD names its space by a patient's axes."""
    return "space: left-" in metadata.get(NRRD_KEY, "")


def put_nrrd_space(path: Path, lines: str) -> None:
    """Replace the lines of an NRRD header that place the grid by others, in place."""
    head, gap, voxels = path.read_bytes().partition(b"\n\n")
    wanted = dict(line.split(": ", 1) for line in lines.splitlines())
    written = []
    for line in head.decode().splitlines():
        key = line.split(": ", 1)[0]
        if key == "space":
            written += [f"{k}: {wanted[k]}" for k in ("space", "space dimension") if k in wanted]
        elif not key.startswith("space "):
            written.append(line)
        elif key in wanted:
            written.append(f"{key}: {wanted[key]}")
    path.write_bytes("\n".join(written).encode() + gap + voxels)


def write_segmentation(labels: Volume, entries: list[LabelEntry], path: Path) -> None:
    """Write a segmentation.

    Parameters
    ----------
    labels : Volume
        A label map.
    entries : list of LabelEntry
        Its segments; those without a voxel are written too.
    path : Path
        Ends in .seg.nrrd.
    """
    keys = {
        "Segmentation_SourceRepresentation": "Binary labelmap",
        "Segmentation_MasterRepresentation": "Binary labelmap",
        "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
        "Segmentation_ReferenceImageExtentOffset": "0 0 0",
    }
    for number, entry in enumerate(entries):
        inside = labels.array == entry.id
        box = bounding_box(inside) or whole_box(labels.array.shape)
        extent = " ".join(f"{part.start} {part.stop - 1}" for part in reversed(box))
        keys |= {
            f"Segment{number}_ID": f"Segment_{entry.id}",
            f"Segment{number}_Name": entry.name,
            f"Segment{number}_NameAutoGenerated": "0",
            f"Segment{number}_Color": " ".join(f"{part / 255:.6g}" for part in entry.color),
            f"Segment{number}_ColorAutoGenerated": "0",
            f"Segment{number}_Extent": extent,
            f"Segment{number}_LabelValue": str(entry.id),
            f"Segment{number}_Layer": "0",
            f"Segment{number}_Tags": "Segmentation.Status:completed|",
        }
    values = labels.with_array(np.ascontiguousarray(labels.array))
    itk.save(values, path, NRRD_ITK_NAME, compress=True, keys=keys)
