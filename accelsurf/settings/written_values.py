"""Values of settings as they are written, before their types are checked."""

from __future__ import annotations

from typing import Any

from accelsurf.settings import energy_expression
from accelsurf.settings.intervals import INTERVAL_FORM, interval_of
from accelsurf.settings.reading import spacing_of
from accelsurf.settings.volumes import VOLUME_FORM, volume_mm3


def checked_volume(value: Any) -> Any:
    """Refuse a volume of 0."""
    if isinstance(value, str) and VOLUME_FORM.fullmatch(value):
        volume_mm3(value)
    return value


def checked_interval(value: Any) -> Any:
    """Refuse an interval of 0; a number of steps may be written as a number."""
    if isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    if isinstance(value, str) and INTERVAL_FORM.fullmatch(value):
        interval_of(value)
    return value


def checked_spacing(value: Any) -> Any:
    """Check the size of a voxel; a list of numbers in mm becomes its text."""
    if isinstance(value, (list, tuple)):
        value = ",".join(str(number) for number in value)
    elif isinstance(value, (int, float)):
        value = str(value)
    if isinstance(value, str):
        spacing_of(value)
    return value


def one_or_many(value: Any) -> Any:
    """Turn a single start into a tuple of one."""
    return (value,) if isinstance(value, str) else value


def checked_expression(value: Any) -> Any:
    """Check an energy; turn a list of tables into its text."""
    if isinstance(value, (list, tuple)):
        value = energy_expression.from_tables(value)
    if isinstance(value, str):
        value = " ".join(value.split())
        energy_expression.parse(value)
    return value


def all_split(value: Any) -> Any:
    """As `split_commas`, of several texts."""
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        value = ",".join(value) if value else ()
    return split_commas(value)


def split_commas(value: Any) -> Any:
    """Turn ``"ply,stl"`` into ``("ply", "stl")``; names given twice count once."""
    if value == "auto":
        return value
    if isinstance(value, str):
        value = value.split(",")
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        return tuple(dict.fromkeys(item.strip().lower() for item in value))
    return value
