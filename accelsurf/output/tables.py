"""The tables of a run as CSV text: a line per step, per object, or of an object's figures; pure functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from accelsurf.io import VALUE_UNIT_KEY, table_text
from accelsurf.measure import object_statistics
from accelsurf.output.document import report_json
from accelsurf.settings.labels import LabelTable
from accelsurf.settings.trace_columns import TRACE_COLUMNS, row_values

if TYPE_CHECKING:
    from accelsurf.evolution import StepRecord
    from accelsurf.run import Result

#: Entries of quality in the tables.
_QUALITY = ("probability", "warnings")


def trace_csv(history: Iterable[StepRecord]) -> str:
    """Return the trace of a run: one line per step, the columns of `accelsurf.settings.trace_columns`, without loss.

    Parameters
    ----------
    history : iterable of StepRecord
        One record per step. True is 1.
    """
    return table_text(
        tuple(TRACE_COLUMNS), (tuple(row_values(record).values()) for record in history)
    )


def objects_trace_csv(histories: Mapping[int, Iterable[StepRecord]]) -> str:
    """Return the trace of several objects, one after the other: as `trace_csv`, after a column ``object``."""
    rows = (
        (object_id, *row_values(record).values())
        for object_id, history in histories.items()
        for record in history
    )
    return table_text(("object", *TRACE_COLUMNS), rows)


def objects_csv(objects: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of several objects, one row each, each from `describe_object`; missing values are empty."""
    # The cost of a run is not the same after it was taken up again.
    plain = [
        key for key in objects[0] if key not in ("centroid", "quality", "message", "cells_visited")
    ]
    known: Mapping[str, Any] = next((row["quality"] for row in objects if row["quality"]), {})
    measures = [key for key in known if key != "warnings"]
    rows = []
    for row in objects:
        quality = row["quality"] or {}
        place = row["centroid"] or (None, None, None)
        warnings = "; ".join(quality.get("warnings", ()))
        rows.append(
            [
                *(row[key] for key in plain),
                *place,
                *(quality.get(key) for key in measures),
                warnings,
            ]
        )
    return table_text((*plain, "x_mm", "y_mm", "z_mm", *measures, "warnings"), rows)


def rows_of(result: Result, table: LabelTable) -> list[dict[str, Any]]:
    """Return a dictionary for each object that has a voxel, in order of their ids.

    Parameters
    ----------
    result : Result
    table : LabelTable
        Their names.
    """
    rows = []
    for segmented in result.objects:
        if not segmented.labels.any() or not segmented.has_surface:
            continue
        values = result.volume.array[segmented.box] if result.has_ids else result.volume.array
        quality = {key: getattr(segmented.quality, key) for key in _QUALITY}
        rows.append(
            {
                "id": segmented.id,
                "name": table[segmented.id].name,
                **object_statistics(segmented, values),
                **quality,
            }
        )
    return rows


def statistics_json(rows: Sequence[Mapping[str, Any]], result: Result) -> str:
    """Return the figures as JSON, with the unit of the image's values."""
    return (
        report_json({"unit": result.volume.metadata.get(VALUE_UNIT_KEY), "objects": list(rows)})
        + "\n"
    )


def statistics_csv(rows: Sequence[Mapping[str, Any]], result: Result) -> str:
    """Return the figures as a table, one row each; the columns of the image's values carry their unit."""
    unit = result.volume.metadata.get(VALUE_UNIT_KEY)
    columns: list[str] = []
    cells = []
    for row in rows:
        flat = _flat(row, unit)
        columns = columns or list(flat)
        cells.append(list(flat.values()))
    return table_text(columns or ["id", "name"], cells)


def _flat(row: Mapping[str, Any], unit: str | None) -> dict[str, Any]:
    """A cell for each number; of lists one for each of (x, y, z)."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if key == "warnings":
            flat["warnings"] = "; ".join(value)
        elif key == "axes_directions":
            for n, direction in enumerate(value, 1):
                flat |= {
                    f"axis{n}_{axis}": part for axis, part in zip("xyz", direction, strict=True)
                }
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
