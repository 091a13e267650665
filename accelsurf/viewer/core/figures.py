"""The figures of the objects of a session, as they are now: those of `NAME_statistics.csv`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from accelsurf.correct.finished import result_of
from accelsurf.errors import UsageError
from accelsurf.io.headers import VALUE_UNIT_KEY
from accelsurf.measure.diameters import Diameters, diameters
from accelsurf.output.label_files import table_of
from accelsurf.output.tables import rows_of, statistics_csv
from accelsurf.run.result import Result
from accelsurf.viewer.core.timeline import Timeline


class Figures(NamedTuple):
    """The figures of all objects that have a surface.

    Attributes
    ----------
    step : int
        Of the state that they are about.
    rows : tuple of dict
        One for each object: ``id``, ``name``, and what `accelsurf.measure.statistics.statistics` returns.
    csv : str
        The same as a table.
    value_unit : str
        Unit of the image's values, as HU; empty where it is not known.
    """

    step: int
    rows: tuple[dict[str, Any], ...]
    csv: str
    value_unit: str


def figures_of(timeline: Timeline) -> Figures:
    """Return the figures of the present state."""
    result = _present(timeline)
    rows = rows_of(result, table_of(result.config), with_quality=False)
    unit = result.volume.metadata.get(VALUE_UNIT_KEY, "")
    return Figures(timeline.step_number, tuple(rows), statistics_csv(rows, result), unit)


def diameters_of(timeline: Timeline, object_id: int) -> Diameters:
    """Return the longest lines of an object in the present state.

    Raises
    ------
    UsageError
        When there is no such object, or it has no voxel.
    """
    segmented = next(
        (segmented for segmented in _present(timeline).objects if segmented.id == object_id and segmented.labels.any()),
        None,
    )
    if segmented is None:
        raise UsageError(f"object {object_id} has no voxel to measure")
    return diameters(np.asarray(segmented.labels > 0), (0, 0, 0), segmented.geometry)


def _present(timeline: Timeline) -> Result:
    timeline.run.apply_edits()
    return timeline.corrections.result() or result_of(timeline.run)
