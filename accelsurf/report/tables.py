"""The tables of a run as CSV text: one line per step, or one per object; pure functions from values to text."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from accelsurf.settings.trace_columns import TRACE_COLUMNS, row_values

if TYPE_CHECKING:
    from accelsurf.evolution.records import StepRecord


def trace_csv(history: Iterable[StepRecord]) -> str:
    """Return the trace of a run: one line per step, the columns of `accelsurf.settings.trace_columns`, without loss.

    Parameters
    ----------
    history : iterable of StepRecord
        One record per step. True is 1.
    """
    return csv_text(tuple(TRACE_COLUMNS), (tuple(row_values(record).values()) for record in history))


def objects_trace_csv(histories: Mapping[int, Iterable[StepRecord]]) -> str:
    """Return the trace of several objects, one after the other: as `trace_csv`, after a column ``object``."""
    rows = ((own, *row_values(record).values()) for own, history in histories.items() for record in history)
    return csv_text(("object", *TRACE_COLUMNS), rows)


def objects_csv(objects: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of several objects, one row each, from `describe_objects`; missing values are empty."""
    # What a run cost is not the same after it was taken up again.
    plain = [key for key in objects[0] if key not in ("centroid", "quality", "message", "cells_visited")]
    known: Mapping[str, Any] = next((one["quality"] for one in objects if one["quality"]), {})
    measures = [key for key in known if key != "warnings"]
    rows = []
    for one in objects:
        quality = one["quality"] or {}
        place = one["centroid"] or (None, None, None)
        doubts = "; ".join(quality.get("warnings", ()))
        rows.append([*(one[key] for key in plain), *place, *(quality.get(key) for key in measures), doubts])
    return csv_text((*plain, "x_mm", "y_mm", "z_mm", *measures, "warnings"), rows)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table as CSV; True is 1."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return stream.getvalue()


def _cell(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return int(value) if isinstance(value, bool) else repr(value) if isinstance(value, float) else value
