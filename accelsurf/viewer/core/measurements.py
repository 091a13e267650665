"""Measures in a session: mesh statistics and diameters of its objects; distances and angles that a person draws."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from accelsurf.correct.finished import result_of
from accelsurf.errors import UsageError, check_known
from accelsurf.io.headers import VALUE_UNIT_KEY
from accelsurf.measure.diameters import Diameters, diameters
from accelsurf.output.label_files import table_of
from accelsurf.output.tables import rows_of, statistics_csv
from accelsurf.run.result import Result
from accelsurf.settings.wording import size_text
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


#: The kinds, and how many points each has; an angle is at its second point.
KINDS = {"distance": 2, "angle": 3}
#: Most measurements at a time.
MAX_COUNT = 100
#: Columns of their table.
COLUMNS = (
    "number", "kind", "value", "unit",
    *(f"{axis}{point}_mm" for point in (1, 2, 3) for axis in "xyz"),
)

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Measurement:
    """A distance or an angle.

    Attributes
    ----------
    number : int
        Its name; never used again.
    kind : str
        One of `KINDS`.
    points : tuple of (float, float, float)
        World mm (x, y, z), LPS; fewer than the kind has while it is being drawn.

    Examples
    --------
    >>> Measurement(1, "distance", ((0, 0, 0), (3, 4, 0))).value
    5.0
    >>> Measurement(2, "angle", ((1, 0, 0), (0, 0, 0), (0, 0, 2))).text()
    '90.0°'
    """

    number: int
    kind: str
    points: tuple[Point, ...]

    @property
    def is_complete(self) -> bool:
        """True if it has all its points."""
        return len(self.points) == KINDS[self.kind]

    @property
    def value(self) -> float | None:
        """The distance, mm, or the angle, degrees; None where there is none yet, as between points in one place."""
        points = np.asarray(self.points, float)
        if not self.is_complete:
            return None
        if self.kind == "distance":
            return float(np.linalg.norm(points[1] - points[0]))
        first, second = points[0] - points[1], points[2] - points[1]
        if not first.any() or not second.any():
            return None
        # Exact for small and for flat angles too, where the arc cosine is not.
        return math.degrees(
            math.atan2(float(np.linalg.norm(np.cross(first, second))), float(first @ second))
        )

    def text(self, unit: str = "mm") -> str:
        """The figure that is written beside it, a distance in the unit of the file."""
        if self.value is None:
            return ""
        return size_text(self.value, unit, digits=4) if self.kind == "distance" else f"{self.value:.1f}°"

    def with_end(self, end: int, to: ArrayLike) -> Measurement:
        """The same with another place of an end."""
        points = list(self.points)
        points[end] = _point(to)
        return replace(self, points=tuple(points))


class Measurements:
    """All that have been made and not deleted, in the order of their numbers."""

    def __init__(self) -> None:
        self._all: dict[int, Measurement] = {}
        self._last = 0

    def __iter__(self) -> Iterator[Measurement]:
        return iter(self._all.values())

    def __len__(self) -> int:
        return len(self._all)

    def __contains__(self, number: object) -> bool:
        return number in self._all

    def __getitem__(self, number: int) -> Measurement:
        if number not in self._all:
            raise UsageError(f"measurement {number} was named, which there is not")
        return self._all[number]

    def add(self, kind: str, points: Sequence[ArrayLike]) -> Measurement:
        """Add one.

        Raises
        ------
        UsageError
            For another kind, too many points, or when there are too many already.
        """
        check_known("measurement", kind, tuple(KINDS))
        if len(self._all) >= MAX_COUNT:
            raise UsageError(f"there are {MAX_COUNT} measurements, and no more are possible", "delete some")
        if not 1 <= len(points) <= KINDS[kind]:
            raise UsageError(f"{kind}: {len(points)} points were given, expected {KINDS[kind]}")
        self._last += 1
        self._all[self._last] = Measurement(self._last, kind, tuple(_point(point) for point in points))
        return self._all[self._last]

    def add_point(self, number: int, place: ArrayLike) -> None:
        """Give one its next point."""
        measurement = self[number]
        if not measurement.is_complete:
            self._all[number] = replace(measurement, points=(*measurement.points, _point(place)))

    def shorten(self, number: int) -> None:
        """Take its last point away, but never the first."""
        measurement = self[number]
        self._all[number] = replace(measurement, points=measurement.points[: max(len(measurement.points) - 1, 1)])

    def move(self, number: int, end: int, to: ArrayLike) -> None:
        """Move an end of one."""
        self._all[number] = self[number].with_end(end, to)

    def delete(self, number: int) -> None:
        """Delete one."""
        del self._all[self[number].number]

    def clear(self) -> None:
        """Delete all."""
        self._all.clear()

    def nearest(self, place: ArrayLike, within_mm: float) -> tuple[int, int] | None:
        """Number and end of the measurement that has an end nearest to a place, within so many mm."""
        at, best = np.asarray(place, float), None
        for measurement in self:
            for end, point in enumerate(measurement.points):
                distance = float(np.linalg.norm(np.asarray(point) - at))
                if distance <= within_mm:
                    best, within_mm = (measurement.number, end), distance
        return best

    def rows(self) -> list[dict[str, Any]]:
        """A row for each complete one, with the columns `COLUMNS`."""
        rows = []
        for measurement in self:
            if measurement.value is None:
                continue
            places: list[float | None] = [coordinate for point in measurement.points for coordinate in point]
            places += [None] * (9 - len(places))
            unit = "mm" if measurement.kind == "distance" else "degrees"
            rows.append(
                dict(
                    zip(COLUMNS, (measurement.number, measurement.kind, measurement.value, unit, *places), strict=True)
                )
            )
        return rows


def _point(place: ArrayLike) -> Point:
    """Three finite numbers."""
    values = np.asarray(place, float)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise UsageError(f"{place!r} was given, expected three finite numbers x, y, z in mm")
    x, y, z = (float(value) for value in values)
    return x, y, z
