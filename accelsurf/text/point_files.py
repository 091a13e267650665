"""Points from files of other programs: 3D Slicer (.mrk.json, .fcsv, .csv), napari (.csv), ITK-SNAP's c3d (.txt).

Each file names its coordinate system, or its program has one: Slicer's are RAS or LPS in mm, napari's are indices of
voxels along the array's axes, c3d's are RAS in mm. Files are hostile until they are checked.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from accelsurf.errors import InputError
from accelsurf.io import bytes_within
from accelsurf.settings import budgets
from accelsurf.settings.wording import shown
from accelsurf.text.coordinates import UNITS_MM, Coordinates, Suffix
from accelsurf.text.starts import MAX_LENGTH
from accelsurf.text.tables import columns_in

#: Coordinate systems as Slicer names them, in words and, in older files, as numbers.
_SYSTEMS = {
    "ras": Suffix(ras=True),
    "0": Suffix(ras=True),
    "lps": Suffix(),
    "1": Suffix(),
    "ijk": Suffix("vox"),
    "2": Suffix("vox"),
}
#: Columns of a table, and their coordinate system: Slicer's tables of control points, napari's points.
_COLUMNS: dict[tuple[str, ...], Suffix] = {
    ("r", "a", "s"): Suffix(ras=True),
    ("l", "p", "s"): Suffix(),
    ("axis-2", "axis-1", "axis-0"): Suffix("vox"),
    ("axis-1", "axis-0"): Suffix("vox"),
}
#: Columns of an .fcsv file unless it says others.
_FCSV_COLUMNS = ("id", "x", "y", "z")
_OWN = tuple(set(columns_in(system, ("x", "y", "z"))) for system in ("", "vox", "shown"))
#: Kinds of Slicer's markups whose control points lie where somebody has clicked.
_CLICKED_MARKUPS = ("Fiducial", "PointList", "Line", "Angle", "Curve", "ClosedCurve")
_EXPECTED = (
    "points of 3D Slicer (.mrk.json, .fcsv, .csv), of napari (.csv with axis-0,axis-1,axis-2), of c3d (.txt), "
    "or stroke:FILE.csv with columns x,y,z"
)


class _Points(NamedTuple):
    """Points as a file has them: rows of numbers, and their coordinate system."""

    rows: list[tuple[float, ...]]
    suffix: Suffix


def has_own_columns(file: str) -> bool:
    """Return True if a file is a table of points or balls with the columns of accelsurf.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    if not file.lower().endswith(".csv"):
        return False
    first = next((line for line in _lines(file) if not line.startswith("#")), "")
    columns = {name.strip() for name in first.split(",")}
    return any(names <= columns for names in _OWN)


def read_points(file: str) -> list[Coordinates]:
    """Return the points of a file, in its order.

    Parameters
    ----------
    file : str

    Raises
    ------
    InputError
        When it cannot be read, is of another form or too large, or has no point.
    """
    lower = file.lower()
    if lower.endswith(".json"):
        sets = _of_markups(file)
    elif lower.endswith(".fcsv"):
        sets = [_of_fcsv(file)]
    else:
        sets = [_of_table(file) if lower.endswith(".csv") else _of_landmarks(file)]
    budgets.POINTS.check(sum(len(points.rows) for points in sets), file)
    found = []
    for rows, suffix in sets:
        if not all(abs(value) <= MAX_LENGTH for row in rows for value in row):
            raise InputError(
                f"{file}: a point has a coordinate that is no finite number",
                f"expected {_EXPECTED}",
            )
        flat = [row if len(row) == 3 else (*row, 0.0) for row in rows]  # napari's, of one slice
        found += [suffix.coordinates(row) for row in flat]
    if not found:
        raise InputError(f"{file}: it has no point", f"expected {_EXPECTED}")
    return found


def _of_markups(file: str) -> list[_Points]:
    """The control points of a .mrk.json file, by its markups."""
    content = bytes_within(file, budgets.POINT_FILE)
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError(f"{file}: not JSON", f"expected {_EXPECTED}") from None
    markups = document.get("markups") if isinstance(document, Mapping) else None
    if not isinstance(markups, list) or not all(isinstance(markup, Mapping) for markup in markups):
        raise InputError(
            f"{file}: it has no list of markups", "save it as markups (.mrk.json) in 3D Slicer"
        )
    return [_of_markup(file, markup) for markup in markups]


def _of_markup(file: str, markup: Mapping[str, Any]) -> _Points:
    kind = markup.get("type", _CLICKED_MARKUPS[0])
    if kind not in _CLICKED_MARKUPS:
        raise InputError(
            f"{file}: markups of the type {shown(kind)}", "save a point list, a line or a curve"
        )
    suffix = _system(file, markup.get("coordinateSystem", "LPS"))
    unit = markup.get("coordinateUnits", "mm")
    unit = (
        unit[0] if isinstance(unit, list) and unit else unit
    )  # newer files have a code, its scheme and its meaning
    if not isinstance(unit, str) or unit not in UNITS_MM:
        raise InputError(
            f"{file}: coordinates in {shown(unit)}, expected {', '.join(UNITS_MM)}", "save it in mm"
        )
    points = markup.get("controlPoints", [])
    if not isinstance(points, list) or not all(isinstance(point, Mapping) for point in points):
        raise InputError(
            f"{file}: its control points are no list of points", f"expected {_EXPECTED}"
        )
    placed = [point for point in points if point.get("positionStatus", "defined") == "defined"]
    return _Points(
        [_position(file, point.get("position")) for point in placed],
        suffix._replace(unit=UNITS_MM[unit]),
    )


def _position(file: str, value: Any) -> tuple[float, ...]:
    is_row = isinstance(value, list) and len(value) == 3
    if not is_row or not all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in value
    ):
        raise InputError(
            f"{file}: position {shown(value)} of a control point, expected three numbers",
            "save it again",
        )
    try:
        return tuple(float(v) for v in value)
    except OverflowError:
        raise InputError(
            f"{file}: position {shown(value)} of a control point is too large", "save it again"
        ) from None


def _system(file: str, name: Any) -> Suffix:
    suffix = _SYSTEMS.get(str(name).strip().lower())
    if suffix is None:
        raise InputError(
            f"{file}: coordinate system {shown(name)}, expected RAS, LPS or IJK",
            "save it again as LPS",
        )
    return suffix


def _of_fcsv(file: str) -> _Points:
    """The points of an .fcsv file; one that names no coordinate system is RAS."""
    columns = list(_FCSV_COLUMNS)
    suffix = Suffix(ras=True)
    body = []
    for line in _lines(file):
        said = re.fullmatch(r"#\s*(CoordinateSystem|columns)\s*=\s*([^\r\n]*?)[\s,]*", line)
        if said is not None and said[1] == "columns":
            columns = [name.strip() for name in said[2].split(",")]
        elif said is not None:
            suffix = _system(file, said[2])
        elif line.strip() and not line.startswith("#"):
            body.append(line)
    return _Points(_rows(file, body, columns, ("x", "y", "z")), suffix)


def _of_table(file: str) -> _Points:
    """The points of a table of Slicer or napari."""
    lines = [line for line in _lines(file) if line.strip() and not line.startswith("#")]
    columns = [name.strip().strip('"').lower() for name in (lines[0] if lines else "").split(",")]
    if "shape-type" in columns:
        raise InputError(f"{file}: it is a table of shapes", "save a layer of points")
    for names, suffix in _COLUMNS.items():
        if set(names) <= set(columns) and ("axis-3" not in columns):
            return _Points(_rows(file, lines[1:], columns, names), suffix)
    raise InputError(
        f"{file}: {shown(','.join(columns))} was given as the first line", f"expected {_EXPECTED}"
    )


def _of_landmarks(file: str) -> _Points:
    """The points of a text file as c3d takes them: X Y Z LABEL in each line, RAS."""
    body = [
        ",".join(line.split()) for line in _lines(file) if line.strip() and not line.startswith("#")
    ]
    return _Points(_rows(file, body, ["x", "y", "z", "label"], ("x", "y", "z")), Suffix(ras=True))


def _rows(
    file: str, lines: Iterable[str], columns: Sequence[str], names: Sequence[str]
) -> list[tuple[float, ...]]:
    """Numbers of some columns of each line."""
    if not set(names) <= set(columns):
        raise InputError(
            f"{file}: columns {shown(','.join(columns))} without {','.join(names)}", "save it again"
        )
    at, out = [columns.index(name) for name in names], []
    try:
        for row in csv.reader(lines, skipinitialspace=True):
            out.append(tuple(float(row[place]) for place in at))
    except (ValueError, IndexError, csv.Error):
        raise InputError(
            f"{file}: point {len(out) + 1} has no {len(names)} numbers", f"expected {_EXPECTED}"
        ) from None
    return out


def _lines(file: str) -> list[str]:
    """The lines of a file of text."""
    try:
        return bytes_within(file, budgets.POINT_FILE).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{file}: not a file of text", f"expected {_EXPECTED}") from None
