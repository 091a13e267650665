"""NRRD: pynrrd takes the fields of a header, numpy and zlib the voxels; ITK writes.

ITK does not read: it takes a spacing that is no number for 1, and the axes of right-anterior-superior-time for LPS.
Checked here are sizes, units and kinds of axes. A segmentation of 3D Slicer is an NRRD with the names and colours
of its segments.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.boxes import bounding_box, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.files import library_named
from accelsurf.io.formats.raw_header import Encoding, RawHeader
from accelsurf.io.formats.text_header import check_units, data_file, header_lines
from accelsurf.io.headers import NRRD_KEY, TIMES_KEY
from accelsurf.settings.labels import LabelEntry
from accelsurf.settings.reading import AS_IT_IS, ReadOptions
from accelsurf.settings.wording import seconds_of

#: Kinds of an axis of space, of time points, and of none that is said; along the others lie the values of a voxel.
_SPACE = ("domain", "space")
_TIME = ("time",)
_SAYS_NOTHING = ("", "???", "none", "list")
_ITK_NAME = "NrrdImageIO"
_TYPES = {
    name: np.dtype(code)
    for code, names in {
        "i1": "signed char,int8,int8_t",
        "u1": "uchar,unsigned char,uint8,uint8_t",
        "i2": "short,short int,signed short,signed short int,int16,int16_t",
        "u2": "ushort,unsigned short,unsigned short int,uint16,uint16_t",
        "i4": "int,signed int,int32,int32_t",
        "u4": "uint,unsigned int,uint32,uint32_t",
        "i8": "longlong,long long,long long int,signed long long,signed long long int,int64,int64_t",
        "u8": "ulonglong,unsigned long long,unsigned long long int,uint64,uint64_t",
        "f4": "float",
        "f8": "double",
    }.items()
    for name in names.split(",")
}
_ENCODINGS: dict[str, Encoding] = {"raw": "raw", "gzip": "deflate", "gz": "deflate"}
#: Signs of x, y, z that make LPS of a space, by the letters and digits of its name. Spaces of no patient are left.
_TO_LPS = {
    **dict.fromkeys(("rightanteriorsuperior", "ras"), (-1, -1, 1)),
    **dict.fromkeys(("leftanteriorsuperior", "las"), (1, -1, 1)),
    **dict.fromkeys(("leftposteriorsuperior", "lps"), (1, 1, 1)),
    **dict.fromkeys(("", "scannerxyz", "3drighthanded", "3dlefthanded"), (1, 1, 1)),
}
#: Fields with an entry for each axis.
_BY_AXIS = ("spacings", "space directions", "kinds", "axis mins", "centerings")
_REQUIRED = {"type", "dimension", "sizes", "encoding"}
#: Names of all fields, without blanks; keys of others are written with :=, so that another name is a damaged one.
_KNOWN = _REQUIRED | set(
    "endian content number blocksize sampleunits min max oldmin oldmax datafile lineskip byteskip space spacedimension "
    "spaceunits spaceorigin spacedirections measurementframe spacings thicknesses axismins axismaxs centers centerings "
    "labels units kinds".split()
)
#: Lines in which Python would take for a number a text that is none to other programs.
_ODD_NUMBER = re.compile(
    r"(sizes|dimension|.* ?skip|spacings|space (o|di)|axis ?m).*(_|[^\0-\x7f])"
)
_NUMBER = re.compile(r"[0-9.eE+-]{1,30}")
_OWN_KEY = re.compile("[^:]*:=")
#: Further names of fields.
_SYNONYMS = {"datafile": "data file", "byteskip": "byte skip", "lineskip": "line skip"}
_SYNONYMS |= {"axismins": "axis mins", "centers": "centerings"}
_HEADER_SAMPLE = 1 << 14  # bytes, more than any header written here has


def parse_nrrd(path: Path, options: ReadOptions = AS_IT_IS) -> RawHeader:
    """Read the header of an NRRD.

    Raises
    ------
    InputError
        When it is none, is damaged, gives another unit than mm, or names a data file that does not exist;
        GeometryError when its axes are none.
    """
    with path.open("rb") as file:
        lines = header_lines(file, lambda line: not line.strip())
        offset = file.tell()
    if not lines[0].startswith("NRRD"):
        raise InputError(
            "this is not an NRRD image: it does not start with NRRD", "is it the right file?"
        )
    with library_named("the NRRD header is damaged", "copy or export the file again"):
        fields = _fields([line for line in lines if not _OWN_KEY.match(line)])
    encoding = fields["encoding"]
    skip = fields.get("byte skip", 0)
    stored = _stored(fields)
    if encoding not in _ENCODINGS:
        raise InputError(
            f"an NRRD of encoding {encoding} given, raw or gzip expected", "save it as gzip"
        )
    if fields.get("line skip") or (skip and encoding != "raw"):
        raise InputError(
            "an NRRD with lines to skip, or bytes of packed voxels, given", "save it as gzip"
        )
    units = [*fields.get("space units", []), *fields.get("units", [])]
    check_units([unit for unit in units if not seconds_of(unit)])
    place = _other_axis(fields)
    data = path
    if "data file" in fields:
        data, offset = data_file(path, fields["data file"]), 0
    if skip < 0:  # the voxels are the last bytes
        numbers = math.prod(fields["sizes"].tolist())
        skip = data.stat().st_size - offset - numbers * stored.itemsize
    return RawHeader(
        data=data,
        geometry=_geometry(fields, place),
        stored=stored,
        offset=offset + max(skip, 0),
        encoding=_ENCODINGS[encoding],
        asked=options,
        **(_space_lines(lines) if place is None else _along(fields, lines, place)),
    )


def _fields(lines: Sequence[str]) -> dict[str, Any]:
    """The fields of a header by pynrrd; values that are none are errors of many kinds."""
    import nrrd

    said = [line for line in lines[1:] if line.strip() and not line.startswith("#")]
    if odd := [line for line in said if ":" not in line or _ODD_NUMBER.match(line)]:
        raise ValueError(repr(odd[0][:80]))
    split = [line.partition(":") for line in said]
    named = [(_SYNONYMS.get(name.lower(), name.lower()), *rest) for name, *rest in split]
    if unknown := {name for name, *_ in named if name.replace(" ", "") not in _KNOWN}:
        raise ValueError(f"unknown field {min(unknown)[:80]!r}")
    if missing := _REQUIRED - {name for name, *_ in named}:
        raise ValueError(f"{', '.join(sorted(missing))} missing")
    # pynrrd takes a blank within a vector for the end of it.
    closed = [re.sub(r"(?<=[(,])\s+|\s+(?=[,)])", "", "".join(parts)) for parts in named]
    fields: dict[str, Any] = nrrd.read_header([lines[0], *closed])
    fields |= {"type": _TYPES[fields["type"].lower()], "encoding": fields["encoding"].lower()}
    sizes = fields["sizes"].tolist()
    none = [0] * len(sizes)
    if fields["dimension"] != len(sizes) or min(sizes) < 1:
        raise ValueError(f"dimension {fields['dimension']}, sizes {sizes}")
    if uneven := [key for key in _BY_AXIS if len(fields.get(key, none)) != len(sizes)]:
        raise ValueError(f"{uneven[0]} of {len(fields[uneven[0]])} axes, {len(sizes)} expected")
    return fields


def _stored(fields: Mapping[str, Any]) -> np.dtype[Any]:
    """Type of the values in the file; a single byte has no order."""
    stored: np.dtype[Any] = fields["type"]
    said = fields.get("endian", "little" if stored.itemsize == 1 else "").lower()
    if said not in ("little", "big"):
        raise InputError(
            f"the NRRD header gives endian {said[:40]!r}, little or big expected",
            "correct the header",
        )
    return stored.newbyteorder("<" if said == "little" else ">")


def _space_lines(lines: Sequence[str]) -> dict[str, Any]:
    """The lines that place the grid, as an argument of `RawHeader`."""
    keys = ("space", "space dimension", "space directions", "space origin")
    placing = [line for line in lines if line.partition(": ")[0] in keys]
    placed = any(line.startswith("space directions") for line in placing)
    return {"metadata": {NRRD_KEY: "\n".join(placing)}} if placed else {}


def _geometry(fields: Mapping[str, Any], place: int | None) -> Geometry:
    """The grid of the axes of space, all but one of four.

    Raises
    ------
    GeometryError
        When they are no axes of a known space.
    """
    axes = [axis for axis in range(fields["dimension"]) if axis != place]
    name = re.sub("[^a-z0-9]", "", fields.get("space", "").lower()).removesuffix("time")
    directions = fields.get("space directions")
    if name not in _TO_LPS or (name and directions is None):
        raise GeometryError(
            f"the header gives space {fields['space'][:40]!r}, with space directions {directions}",
            "write left-posterior-superior, and the directions of the three axes in it",
        )
    with library_named("the NRRD header does not place the axes", "correct the header"):
        to_lps = np.diag(_TO_LPS[name]).astype(float)
        origin = np.array(fields.get("space origin", np.zeros(3)), float)[:3]
        if directions is not None:
            steps = np.array([directions[axis][:3] for axis in axes])
            spacing = np.sqrt((steps**2).sum(1))
            with np.errstate(invalid="ignore"):
                direction = to_lps @ (steps.T / spacing)
            origin = to_lps @ origin
        else:
            direction, spacing = np.eye(3), np.ones(3)
            if "spacings" in fields:
                spacing = fields["spacings"][axes]
            if "axis mins" in fields and "spacings" in fields:  # of cells where they begin
                is_node = np.array(fields.get("centerings", ["cell"] * 4))[axes] == "node"
                origin = fields["axis mins"][axes] + np.where(is_node, 0.0, spacing / 2)
    nx, ny, nz = (int(n) for n in fields["sizes"][axes])
    hx, hy, hz = (float(step) for step in spacing)
    return Geometry((nz, ny, nx), (hz, hy, hx), tuple(origin.tolist()), direction)


def _other_axis(fields: Mapping[str, Any]) -> int | None:
    """Number of the axis of four that is none of space, by its kind or without a direction, else the last.

    Raises
    ------
    InputError
        When there are not three axes of space and perhaps another, or the other one lies between them.
    """
    count = fields["dimension"]
    kinds = [kind.lower() for kind in fields.get("kinds", [])]
    said = {n for n, kind in enumerate(kinds) if kind not in (*_SPACE, "", "???", "none")}
    said -= {n for n in said if count == 3 and kinds[n] in _TIME}
    for axis, direction in enumerate(fields.get("space directions", [])):
        said |= set() if np.isfinite(direction).all() else {axis}
    text = " x ".join(map(str, fields["sizes"]))
    if count not in (3, 4) or len(said) > count - 3:
        raise InputError(
            f"a {count}D image ({text}) given, of which {count - len(said)} axes are of space, 3D expected",
            "add a slice axis of size 1, extract one time point or channel first, or use Volume.from_array in Python",
        )
    if count == 3:
        return None
    place = said.pop() if said else 3
    kind = kinds[place] if kinds else ""
    if kind == "complex":
        raise InputError(
            "a complex image given, one real number per voxel expected", "take the magnitude first"
        )
    if place in (1, 2):
        raise InputError(
            f"a 4D NRRD whose axis {place + 1} is none of space ({kind or 'without a direction'}) given, the first or "
            "last one expected",
            "save that axis first (channels) or last (time points)",
        )
    if place == 0 and kind in _TIME:
        raise InputError(
            "the time axis of the NRRD comes first, before those of space",
            "save it last, or as an axis of kind list",
        )
    return place


def _along(fields: Mapping[str, Any], lines: Sequence[str], place: int) -> dict[str, Any]:
    """Arguments of `RawHeader` for the axis that is not spatial.

    A list of 3D Slicer may be a sequence; lines of its own say so. An axis that says nothing and runs slowest is time,
    since channels run fastest.
    """
    keyed = [line.partition(":=") for line in lines if _OWN_KEY.match(line)]
    said = {key.strip().lower(): value.strip() for key, _, value in keyed}
    count = int(fields["sizes"][place])
    times = said.get(TIMES_KEY, "").lower() or _times_of_slicer(said, fields, count)
    if place == 3:
        kind = fields["kinds"][3].lower() if "kinds" in fields else ""
        name = "time_points" if kind in (*_SPACE, *_TIME, *_SAYS_NOTHING) else "channels"
        return {name: count, "seconds": _seconds(fields), "times_text": times}
    marks = ("axis 0 index type", "axis 0 index values", "multivolume.framelabels")
    name = "time_points" if any(mark in said for mark in marks) else "channels"
    return {name: count, "is_interleaved": True, "times_text": times}


def _times_of_slicer(said: Mapping[str, str], fields: Mapping[str, Any], count: int) -> str:
    """The line of `accelsurf.io.headers` with the times of a sequence of 3D Slicer; empty where it has none."""
    unit = said.get("axis 0 index unit") or fields.get("units", [""])[0]
    factor = seconds_of(unit.lower())
    words = said.get("axis 0 index values", "").replace(",", " ").split()
    if not factor or len(words) != count or not all(map(_NUMBER.fullmatch, words)):
        return ""
    times = [float(word) * factor for word in words]
    rising = all(a < b for a, b in zip(times, times[1:], strict=False))
    return " ".join(["s", *map(repr, times)]) if rising and all(map(math.isfinite, times)) else ""


def _seconds(fields: Mapping[str, Any]) -> float | None:
    """Seconds along the fourth axis, by its spacing, or in a space of four axes by its direction."""
    if "spacings" in fields:
        step, units = fields["spacings"][3], fields.get("units", [])
    else:
        step, units = fields.get("space directions", [[0.0]])[-1][-1], fields.get("space units", [])
    seconds = float(step) * seconds_of(units[3]) if len(units) == 4 else 0.0
    return seconds if math.isfinite(seconds) and seconds > 0 else None


def write_nrrd(volume: Volume, path: Path) -> None:
    """Write an NRRD, compressed, with the lines that placed the volume when it was read."""
    from accelsurf.io import itk

    itk.save(volume, path, _ITK_NAME, compress=True)
    if (lines := volume.metadata.get(NRRD_KEY)) is not None:
        # Metadata may have come from another grid than the volume has now: the header alone is tried first.
        trial = path.with_name("trial.nrrd")
        with path.open("rb") as file:
            trial.write_bytes(file.read(_HEADER_SAMPLE))
        _put_space(trial, lines)
        grid = parse_nrrd(trial).geometry
        trial.unlink()
        if grid.matches(volume.geometry):
            _put_space(path, lines)


def _put_space(path: Path, lines: str) -> None:
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
    from accelsurf.io import itk

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
    itk.save(values, path, _ITK_NAME, compress=True, keys=keys)
