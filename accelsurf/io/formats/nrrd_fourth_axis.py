"""The fourth axis of an NRRD: values of a voxel, or time points."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from accelsurf.errors import InputError
from accelsurf.io.headers import TIMES_KEY

#: Seconds of a unit of time.
SECONDS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
#: Kinds of an axis of space, of time points, and of none that is said; along the others lie the values of a voxel.
_SPACE, _TIME, _SAYS_NOTHING = ("domain", "space"), ("time",), ("", "???", "none", "list")
_NUMBER = re.compile(r"[0-9.eE+-]{1,30}")


def fourth_axis(fields: Mapping[str, str], lines: Sequence[str], sizes: Sequence[int]) -> dict[str, Any]:
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
            "the time axis of the NRRD comes first, before those of space", "save it last, or as an axis of kind list"
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
    said = {key.strip().lower(): value.strip() for key, _, value in (line.partition(":=") for line in lines)}
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
    without = [place for place, vector in enumerate(vectors[:4]) if vector == "none" or "nan" in vector]
    other = [place for place, kind in enumerate(kinds) if kind not in (*_SPACE, "")]
    if len(without) == 1:
        return without[0], True
    return (other[0] if len(other) == 1 else 3), False


def _times_of_slicer(said: Mapping[str, str], fields: Mapping[str, str], count: int) -> str:
    """The line of `accelsurf.io.headers` with the times of a sequence of 3D Slicer; empty where it has none."""
    units = re.findall(r'"([^"]*)"', fields.get("units", ""))
    factor = SECONDS.get((said.get("axis 0 index unit") or (units[0] if units else "")).lower())
    words = said.get("axis 0 index values", "").replace(",", " ").split()
    if factor is None or len(words) != count or not all(map(_NUMBER.fullmatch, words)):
        return ""
    try:
        times = [float(word) * factor for word in words]
    except ValueError:
        return ""
    rising = all(a < b for a, b in zip(times, times[1:], strict=False))
    return " ".join(["s", *map(repr, times)]) if rising and all(map(math.isfinite, times)) else ""


def _seconds(fields: Mapping[str, str]) -> float | None:
    """Seconds along the fourth axis, by its spacing, or in a space of four axes by its direction."""
    steps, units = fields.get("spacings", "").split(), re.findall(r'"([^"]*)"', fields.get("units", ""))
    if not steps and "space units" in fields:
        last = fields.get("space directions", "").rpartition("(")[2].rstrip(") ").split(",")
        steps, units = [""] * 3 + last[-1:], re.findall(r'"([^"]*)"', fields["space units"])
    if len(steps) != 4 or len(units) != 4 or _NUMBER.fullmatch(steps[3].strip()) is None:
        return None
    try:
        seconds = float(steps[3]) * SECONDS.get(units[3], 0.0)
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and seconds > 0 else None
