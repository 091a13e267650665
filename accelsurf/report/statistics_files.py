"""The tables of figures of the objects: NAME_statistics.csv and NAME_statistics.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from accelsurf.analysis.statistics import statistics
from accelsurf.io.headers import VALUE_UNIT_KEY
from accelsurf.report.document import to_json
from accelsurf.report.tables import csv_text
from accelsurf.settings.labels import LabelTable

if TYPE_CHECKING:
    from accelsurf.segmentation.result import Result

#: Of quality, what the tables have.
_QUALITY = ("probability", "warnings")


def rows_of(result: Result, table: LabelTable, with_quality: bool = True) -> list[dict[str, Any]]:
    """Return a dictionary for each object that has a voxel, in order of their ids.

    Parameters
    ----------
    result : Result
    table : LabelTable
        Their names.
    with_quality : bool, optional
        Whether to assess how likely each is good, which takes longest.
    """
    rows = []
    for one in result.objects:
        if not one.labels.any() or not one.has_surface:
            continue
        values = result.volume.array[one.box] if result.has_ids else result.volume.array
        quality = {key: getattr(one.quality, key) for key in _QUALITY} if with_quality else {}
        rows.append({"id": one.id, "name": table[one.id].name, **statistics(one, values), **quality})
    return rows


def statistics_json(rows: Sequence[Mapping[str, Any]], result: Result) -> str:
    """Return the figures as JSON, with the unit of the image's values."""
    return to_json({"unit": result.volume.metadata.get(VALUE_UNIT_KEY), "objects": list(rows)}) + "\n"


def statistics_csv(rows: Sequence[Mapping[str, Any]], result: Result) -> str:
    """Return the figures as a table, one row each; the columns of the image's values carry their unit."""
    unit = result.volume.metadata.get(VALUE_UNIT_KEY)
    columns: list[str] = []
    cells = []
    for row in rows:
        flat = _flat(row, unit)
        columns = columns or list(flat)
        cells.append(list(flat.values()))
    return csv_text(columns or ["id", "name"], cells)


def _flat(row: Mapping[str, Any], unit: str | None) -> dict[str, Any]:
    """A cell for each number; of lists one for each of (x, y, z)."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if key == "warnings":
            flat["warnings"] = "; ".join(value)
        elif key == "axes_directions":
            for n, own in enumerate(value, 1):
                flat |= {f"axis{n}_{axis}": part for axis, part in zip("xyz", own, strict=True)}
        elif key == "axes_mm":
            flat |= {f"axis{n}_mm": part for n, part in enumerate(value, 1)}
        elif isinstance(value, list):
            stem, _, last = key.rpartition("_")
            names = (f"{stem}_{axis}_{last}" for axis in "xyz")
            flat |= dict(zip(names, value, strict=True))
        else:
            in_unit = key in ("mean", "sd", "min", "max") or (key[:1] == "p" and key[1:].isdigit())
            flat[f"{key}_{unit.lower()}" if in_unit and unit else key] = value
    return flat
