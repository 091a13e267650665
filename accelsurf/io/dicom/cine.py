"""Slices at the same places at several times: the frames of a sequence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from accelsurf.errors import InputError
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.volumes import SAME_PLACE_MM, names_of
from accelsurf.io.headers import FrameTimes

#: Phases by which slices of one place may differ in a sequence; by others they are of several contrasts.
TIME_PHASES = frozenset({"time point", "trigger time", "acquisition", "acquisition time", "file"})
#: What says when a slice is, and what gives the order of those at one place: the first that tells them all apart.
_TIMES = ("offset", "trigger", "frame", "acquisition", "content")
_ORDERS = ("offset", "trigger", "point", "frame", "acquisition", "content", "number")


def is_cine(frames: Sequence[Frame]) -> bool:
    """Test if several slices lie at one place, or are pictures of one file."""
    return len(_places(frames)) < len(frames)


def frames_in_time(frames: Sequence[Frame], root: Path) -> tuple[list[tuple[Frame, ...]], FrameTimes]:
    """Part slices into the frames of a sequence; the n-th at each place belong together.

    The time of a frame is the mean over its slices, from the first frame on; where nothing says it, frames are counted.

    Parameters
    ----------
    frames : sequence of Frame
    root : Path
        The folder that messages name files from.

    Raises
    ------
    InputError
        When places have several numbers of slices, or slices differ in more than time.
    """
    places = list(_places(frames).values())
    contrasts = sorted({name for frames in places for name in _differing(frames)} - TIME_PHASES)
    if contrasts:
        raise InputError(
            f"slices at one place differ in {', '.join(contrasts)}, not in time alone",
            "say which by --series NUMBER; accelsurf info FOLDER lists them",
        )
    least, most = min(places, key=len), max(places, key=len)
    if len(least) < len(most):
        raise InputError(
            f"{len(most)} times were found at one place and {len(least)} at another ({names_of(least, root)}), "
            "as many at each expected",
            "give a complete series",
        )
    order = next((name for name in _ORDERS if all(_tells_apart(frames, name) for frames in places)), None)
    if order is None:
        raise InputError("nothing in the files tells the order of slices at one place", "convert them with their times")
    rows = [sorted(frames, key=lambda frame: frame.times[order]) for frames in places]
    parts = [tuple(row[n] for row in rows) for n in range(len(most))]
    return parts, _times_of(parts)


def _times_of(parts: Sequence[tuple[Frame, ...]]) -> FrameTimes:
    for name in _TIMES:
        if all(name in frame.times for part in parts for frame in part):
            means = [math.fsum(frame.times[name] for frame in part) / len(part) for part in parts]
            values = tuple(round(mean - means[0], 6) for mean in means)
            if all(a < b for a, b in zip(values, values[1:], strict=False)):
                return FrameTimes(values, "s")
    return FrameTimes.regular(len(parts), None)


def _places(frames: Sequence[Frame]) -> dict[tuple[int, ...], list[Frame]]:
    """Slices by where they lie; those that do not say it lie at one place."""
    found: dict[tuple[int, ...], list[Frame]] = {}
    for frame in frames:
        place = tuple(round(part / SAME_PLACE_MM) for part in frame.position or ())
        found.setdefault(place, []).append(frame)
    return found


def _differing(frames: Sequence[Frame]) -> set[str]:
    names = {name for frame in frames for name in frame.phase}
    return {name for name in names if len({frame.phase.get(name, "") for frame in frames}) > 1}


def _tells_apart(frames: Sequence[Frame], name: str) -> bool:
    return len({frame.times.get(name) for frame in frames} - {None}) == len(frames)
