"""Slices put together: the volumes of each series, and what is none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from accelsurf.errors import InputError
from accelsurf.io.dicom.frames import Frame, frames_of
from accelsurf.io.dicom.sources import SourceFiles

#: Positions that differ by less are one place, mm.
SAME_PLACE_MM = 0.01
#: Kinds of objects that are no images of a volume, by the first part of the name of their class.
_CLASSES = {
    "1.2.840.10008.5.1.4.1.1.66.4": "segmentation",
    "1.2.840.10008.5.1.4.1.1.66.7": "segmentation",
    "1.2.840.10008.5.1.4.1.1.481.2": "dose",
}
_MODALITIES = {
    "SR": "report", "DOC": "report", "PR": "display state", "KO": "selection", "RTSTRUCT": "structure set",
    "RTPLAN": "plan", "RTDOSE": "dose", "SEG": "segmentation", "REG": "registration", "FID": "fiducials",
}


@dataclass(frozen=True)
class DicomVolume:
    """Slices that belong together.

    Attributes
    ----------
    frames : tuple of Frame
    phase : dict of str to str
        What tells it apart from the other volumes of its series; empty where there is none.
    """

    frames: tuple[Frame, ...]
    phase: dict[str, str] = field(default_factory=dict)

    @property
    def uid(self) -> str:
        """Of its series."""
        return self.frames[0].uids[1]

    def label(self, name: str) -> str:
        """One of the labels of its first slice."""
        return self.frames[0].labels[name]


@dataclass(frozen=True)
class Contents:
    """What a folder holds.

    Attributes
    ----------
    volumes : tuple of DicomVolume
        In the order of the numbers of their series; their own numbers count from 1.
    skipped : dict of str to int
        How many files are something else, by kind.
    damaged : tuple of str
        Names of files that cannot be read.
    """

    volumes: tuple[DicomVolume, ...]
    skipped: dict[str, int]
    damaged: tuple[str, ...]


def contents_of(files: SourceFiles) -> Contents:
    """Read the headers of all files, and put their slices together."""
    series: dict[tuple[str, ...], list[Frame]] = {}
    skipped: Counter[str] = Counter()
    damaged: list[str] = []
    for path in files.paths:
        try:
            frames = frames_of(path)
        except InputError:
            damaged.append(shown(path, files.root))
            continue
        kind = _kind(frames)
        if kind:
            skipped[kind] += 1
            continue
        for frame in frames:
            series.setdefault(_series_key(frame), []).append(frame)
    volumes = [volume for key in sorted(series, key=lambda key: _order(series[key])) for volume in _split(series[key])]
    places = [volume for volume in volumes if volume.frames[0].position is not None]
    if places:  # pictures of single planes beside scans
        skipped["picture without a place"] += sum(len(one.frames) for one in volumes if one not in places)
        volumes = places
    return Contents(tuple(volumes), {kind: n for kind, n in sorted(skipped.items()) if n}, tuple(damaged))


def counted(skipped: Mapping[str, int]) -> str:
    """How many of each kind, as a person says it.

    Examples
    --------
    >>> counted({"localizer": 2, "object without an image": 1})
    '2 localizers, 1 object without an image'
    """
    words = []
    for kind, number in skipped.items():
        noun, _, rest = kind.partition(" without ")
        words.append(f"{number} {noun}{'s' if number > 1 else ''}" + (f" without {rest}" if rest else ""))
    return ", ".join(words)


def shown(path: Path, root: Path) -> str:
    """A file's name from the folder that was given."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def names_of(frames: Iterable[Frame], root: Path, limit: int = 3) -> str:
    """Names of the files of some slices, for a message."""
    found = list(dict.fromkeys(
        shown(frame.path, root) + (f" frame {frame.number + 1}" if frame.frames > 1 else "") for frame in frames
    ))
    more = f" and {len(found) - limit} more" if len(found) > limit else ""
    return ", ".join(found[:limit]) + more


def _kind(frames: Sequence[Frame]) -> str:
    """What a file is if it is no image of a volume; empty for those that are."""
    if not frames:
        return "object without an image"
    first = frames[0]
    if (known := _CLASSES.get(first.labels["class"]) or _MODALITIES.get(first.labels["modality"])) is not None:
        return known
    if "LOCALIZER" in first.image_type:
        return "localizer"
    return ""


def _series_key(frame: Frame) -> tuple[str, ...]:
    """What slices of one series share; where it has no UID, by what else there is."""
    uid, labels = frame.uids[1], frame.labels
    if uid:
        return (uid,)
    return ("", labels["number"], labels["description"], labels["modality"], str(frame.rows), str(frame.columns))


def _order(frames: Sequence[Frame]) -> tuple[int, str, str]:
    """Series in the order of their numbers."""
    number = frames[0].labels["number"]
    return (int(number) if number.isdigit() else 1 << 62, frames[0].uids[1], str(frames[0].path))


def _split(frames: list[Frame]) -> list[DicomVolume]:
    """Part a series where slices lie at one place and something tells them apart; else it stays one."""
    if not _coincident(frames):
        return [DicomVolume(tuple(frames))]
    names = [
        name for name in dict.fromkeys(name for frame in frames for name in frame.phase)
        if 1 < len({frame.phase.get(name, "") for frame in frames}) < len(frames)
    ]
    for count in (1, 2, 3):
        for picked in combinations(names, count):
            parts: dict[tuple[str, ...], list[Frame]] = {}
            for frame in frames:
                parts.setdefault(tuple(frame.phase.get(name, "") for name in picked), []).append(frame)
            if not any(map(_coincident, parts.values())):
                keys = sorted(parts, key=lambda key: tuple(map(_as_number, key)))
                return [DicomVolume(tuple(parts[key]), dict(zip(picked, key, strict=True))) for key in keys]
    return [DicomVolume(tuple(frames))]


def _as_number(value: str) -> tuple[float, str]:
    try:
        return float(value), ""
    except ValueError:
        return float("inf"), value


def _coincident(frames: Sequence[Frame]) -> bool:
    """Whether two slices of one direction lie at one place."""
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
