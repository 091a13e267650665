"""The volumes of each series, put together from slices, and the files that are left out of them.

Slices at the same places at several times are the frames of a sequence.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from types import MappingProxyType

from accelsurf.errors import InputError
from accelsurf.io.dicom.frames import Frame, frames_of
from accelsurf.io.dicom.sources import SourceFiles, series_of
from accelsurf.io.headers import FrameTimes

#: Positions that differ by less are one place, mm.
SAME_PLACE_MM = 0.01
#: Files of a kind that a message names.
_NAMED = 3
#: Phases by which slices of one place may differ in a sequence; by others they are of several contrasts.
TIME_PHASES = frozenset({"time point", "trigger time", "acquisition", "acquisition time", "file"})
#: Attributes with the time of a slice, and with the order of slices at one place: the first that tells them apart.
_TIMES = ("offset", "trigger", "frame", "acquisition", "content")
_ORDERS = ("offset", "trigger", "point", "frame", "acquisition", "content", "number")


@dataclass(frozen=True)
class DicomVolume:
    """Slices that belong together.

    Attributes
    ----------
    frames : tuple of Frame
    phase : dict of str to str
        Elements that tell it apart from the other volumes of its series; empty where there are none.
    """

    frames: tuple[Frame, ...]
    phase: dict[str, str] = field(default_factory=dict)

    @property
    def uid(self) -> str:
        """UID of its series."""
        return self.frames[0].uids.series

    def label(self, name: str) -> str:
        """One of the labels of its first slice."""
        return self.frames[0].labels[name]


@dataclass(frozen=True)
class LeftOut:
    """A file that is no part of a volume.

    Attributes
    ----------
    file : Path
    name : str
        As messages say it.
    kind : str
        Kind of object; empty for a damaged one.
    reason : str
        Why a damaged one cannot be read.
    series : str
        The UID of the series that it says it is of; empty where it does not.
    is_series_cut : bool
        Whether the file ends within that UID.
    has_image : bool
        Whether it is a whole image of another kind, as a localizer.
    """

    file: Path
    name: str
    kind: str
    reason: str = ""
    series: str = ""
    is_series_cut: bool = False
    has_image: bool = False

    def belongs_to(self, series: str) -> bool:
        """Test if it names a series, as far as it can be read."""
        return bool(self.series) and (
            series == self.series or (self.is_series_cut and series.startswith(self.series))
        )


@dataclass(frozen=True)
class Contents:
    """Volumes and other files of a folder.

    Attributes
    ----------
    volumes : tuple of DicomVolume
        In the order of the numbers of their series; their own numbers count from 1.
    left_out : tuple of LeftOut
        In the order of the files.
    """

    volumes: tuple[DicomVolume, ...]
    left_out: tuple[LeftOut, ...]

    def lost_from(self, series: str) -> list[LeftOut]:
        """Files that say they are of a series and have no image that can be read."""
        return [left for left in self.left_out if left.belongs_to(series) and not left.has_image]


def contents_of(
    files: SourceFiles, known: Mapping[Path, list[Frame]] = MappingProxyType({})
) -> Contents:
    """Read the headers of all files but those whose slices are known, and put their slices together."""
    series: dict[tuple[str, ...], list[Frame]] = {}
    left: list[LeftOut] = []
    for path in files.paths:
        name = shown(path, files.root)
        try:
            frames = known[path] if path in known else frames_of(path)
        except InputError as error:
            left.append(
                LeftOut(
                    path, name, "", error.message.removeprefix(f"{path.name}: "), *series_of(path)
                )
            )
            continue
        if not frames:
            left.append(LeftOut(path, name, "object without an image", "", *series_of(path)))
        elif kind := frames[0].labels["kind"]:
            left.append(LeftOut(path, name, kind, "", frames[0].uids.series, has_image=True))
        else:
            for frame in frames:
                series.setdefault(_series_key(frame), []).append(frame)
    for path in files.strays:
        left.append(LeftOut(path, shown(path, files.root), "", "no DICOM, or cut short"))
    volumes = [
        volume
        for key in sorted(series, key=lambda key: _order(series[key]))
        for volume in _split(series[key])
    ]
    places = [volume for volume in volumes if volume.frames[0].position is not None]
    if places:  # pictures of single planes beside scans
        for frame in (
            frame for volume in volumes if volume not in places for frame in volume.frames
        ):
            picture = "picture without a place"
            left.append(
                LeftOut(
                    frame.path,
                    names_of([frame], files.root),
                    picture,
                    "",
                    frame.uids.series,
                    has_image=True,
                )
            )
        volumes = places
    return Contents(tuple(volumes), tuple(left))


def count_in_words(left: Iterable[LeftOut]) -> str:
    """Count the files of each kind in words, with their names and the reasons.

    Examples
    --------
    >>> scouts = [LeftOut(Path(name), name, "localizer") for name in ("a", "b")]
    >>> count_in_words([*scouts, LeftOut(Path("c"), "c", "", "cut short")])
    '2 localizers (a, b), 1 file that cannot be read (c: cut short)'
    """
    kinds: dict[str, list[LeftOut]] = {}
    for file in left:
        kinds.setdefault(file.kind, []).append(file)
    words = []
    for kind in sorted(kinds, key=lambda kind: (not kind, kind)):
        found, number = kinds[kind], len(kinds[kind])
        noun, *rest = re.split(
            "(?= without | of | that )", kind or "file that cannot be read", maxsplit=1
        )
        words_of_kind = "".join([noun, "s" if number > 1 else "", *rest])
        names = [f"{left.name}: {left.reason}" if left.reason else left.name for left in found]
        more = f" and {number - _NAMED} more" if number > _NAMED else ""
        words.append(f"{number} {words_of_kind} ({', '.join(names[:_NAMED])}{more})")
    return ", ".join(words)


def shown(path: Path, root: Path) -> str:
    """A file's name from the folder that was given, or in the archive."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def names_of(frames: Iterable[Frame], root: Path, limit: int = 3) -> str:
    """Names of the files of some slices, for a message."""
    found = list(
        dict.fromkeys(
            shown(frame.path, root) + (f" frame {frame.number + 1}" if frame.frames > 1 else "")
            for frame in frames
        )
    )
    more = f" and {len(found) - limit} more" if len(found) > limit else ""
    return ", ".join(found[:limit]) + more


def _series_key(frame: Frame) -> tuple[str, ...]:
    """Key that slices of one series share; without a UID, of the other elements."""
    uid, labels = frame.uids.series, frame.labels
    if uid:
        return (uid,)
    return (
        "",
        labels["number"],
        labels["description"],
        labels["modality"],
        str(frame.rows),
        str(frame.columns),
    )


def _order(frames: Sequence[Frame]) -> tuple[int, str, str]:
    """Series in the order of their numbers."""
    number = frames[0].labels["number"]
    return (
        int(number) if number.isdigit() else 1 << 62,
        frames[0].uids.series,
        str(frames[0].path),
    )


def _split(frames: list[Frame]) -> list[DicomVolume]:
    """Part a series where slices lie at one place and something tells them apart; else it stays one."""
    if not _coincident(frames):
        return [DicomVolume(tuple(frames))]
    names = [
        name
        for name in dict.fromkeys(name for frame in frames for name in frame.phase)
        if 1 < len({frame.phase.get(name, "") for frame in frames}) < len(frames)
    ]
    for count in (1, 2, 3):
        for picked in combinations(names, count):
            parts: dict[tuple[str, ...], list[Frame]] = {}
            for frame in frames:
                parts.setdefault(tuple(frame.phase.get(name, "") for name in picked), []).append(
                    frame
                )
            if not any(map(_coincident, parts.values())):
                keys = sorted(parts, key=lambda key: tuple(map(_as_number, key)))
                return [
                    DicomVolume(tuple(parts[key]), dict(zip(picked, key, strict=True)))
                    for key in keys
                ]
    return [DicomVolume(tuple(frames))]


def _as_number(value: str) -> tuple[float, str]:
    try:
        return float(value), ""
    except ValueError:
        return float("inf"), value


def _coincident(frames: Sequence[Frame]) -> bool:
    """Test if two slices of one direction lie at one place."""
    seen: set[tuple[int, ...]] = set()
    for frame in frames:
        if frame.position is None or frame.orientation is None:
            continue
        turn = (round(100 * part) for part in frame.orientation)
        key = (*(round(part / SAME_PLACE_MM) for part in frame.position), *turn)
        if key in seen:
            return True
        seen.add(key)
    return False


def is_cine(frames: Sequence[Frame]) -> bool:
    """Test if several slices lie at one place, or are pictures of one file."""
    return len(_places(frames)) < len(frames)


def frames_in_time(
    frames: Sequence[Frame], root: Path
) -> tuple[list[tuple[Frame, ...]], FrameTimes]:
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
    order = next(
        (name for name in _ORDERS if all(_tells_apart(frames, name) for frames in places)), None
    )
    if order is None:
        message = "several slices lie at one place, and the files do not say in which order"
        raise InputError(message, "convert them with their times")
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
