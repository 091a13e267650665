"""Folders of the Cell Tracking Challenge: a table of tracks, and a label map for each frame.

A result has ``res_track.txt`` and ``mask000.tif``; a reference ``TRA/man_track.txt`` and ``TRA/man_track000.tif``, and
in ``SEG`` outlines of some frames, ``man_seg000.tif``, or of single slices of them, ``man_seg_000_012.tif``: the frame,
then the slice.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.files import bytes_within, naming
from accelsurf.io.images import read_labels
from accelsurf.settings import budgets

_TABLES = ("res_track.txt", "man_track.txt")
_TABLE_HINT = "correct the table of tracks"
_FRAME = re.compile(r"(?:mask|man_track)([0-9]+)\.tiff?", re.IGNORECASE)
_OUTLINE = re.compile(r"man_seg_?([0-9]+)\.tiff?", re.IGNORECASE)
_SLICE = re.compile(r"man_seg_?([0-9]+)_([0-9]+)\.tiff?", re.IGNORECASE)


class ChallengeTrack(NamedTuple):
    """A line of the table: label, first and last frame, label of the parent or 0."""

    label: int
    first: int
    last: int
    parent: int


class Outline(NamedTuple):
    """A label map with outlines of a frame, or of one slice of it: ``plane`` along z."""

    frame: int
    path: Path
    plane: int | None = None


@dataclass(frozen=True)
class ChallengeFolder:
    """Tracks and label maps of a folder; nothing of a label map is read yet.

    Attributes
    ----------
    folder : Path
        Where the table is.
    tracks : tuple of ChallengeTrack
    frames : tuple of Path
        Label maps in the order of the frames.
    outlines : tuple of Outline
        Of frames and slices that have outlines of their own, in their order.
    """

    folder: Path
    tracks: tuple[ChallengeTrack, ...]
    frames: tuple[Path, ...]
    outlines: tuple[Outline, ...]

    def labels(self, number: int) -> NDArray[Any]:
        """The label map (nz, ny, nx) of a frame."""
        return read_labels(self.frames[number]).array


def is_challenge(path: Path) -> bool:
    """Test if a path is a folder of the challenge, or one of a reference, with a folder ``TRA`` in it."""
    return any((folder / table).is_file() for folder in (path, path / "TRA") for table in _TABLES)


def open_challenge(path: Path) -> ChallengeFolder:
    """Read the table of tracks, and list the label maps.

    Raises
    ------
    InputError
        When there is no table, a line of it is none, or a frame lacks.
    """
    folder = path / "TRA" if any((path / "TRA" / table).is_file() for table in _TABLES) else path
    table = next((folder / name for name in _TABLES if (folder / name).is_file()), None)
    if table is None:
        raise InputError(
            f"{path}: neither {' nor '.join(_TABLES)} in it", "is it a folder of tracks?"
        )
    content = bytes_within(table, budgets.CASES)
    with naming(table):
        tracks = _read_tracks(content)
    frames = _numbered(folder, _FRAME)
    lacking = next((n for n in range(len(frames)) if n not in frames), None)
    if not frames or lacking is not None:
        raise InputError(
            f"{folder}: the label map of frame {lacking or 0} is not there", "are all files there?"
        )
    exact = folder.parent / "SEG" if folder.name == "TRA" else folder
    return ChallengeFolder(
        folder,
        tracks,
        tuple(frames[n] for n in range(len(frames))),
        _outlines_in(exact),
    )


def _outlines_in(folder: Path) -> tuple[Outline, ...]:
    """The outlines in a folder, by frame and slice.

    Raises
    ------
    InputError
        When a frame has outlines of the whole and of slices: an object would count several times.
    """
    whole = [Outline(frame, path) for frame, path in sorted(_numbered(folder, _OUTLINE).items())]
    slices = [
        Outline(int(found[1]), path, int(found[2]))
        for path in (sorted(folder.iterdir()) if folder.is_dir() else ())
        if (found := _SLICE.fullmatch(path.name))
    ]
    twice = {outline.frame for outline in whole} & {outline.frame for outline in slices}
    if twice:
        raise InputError(
            f"{folder}: frame {min(twice)} has outlines of the whole frame and of single slices",
            "keep one of the two",
        )
    return (*whole, *sorted(slices, key=lambda outline: (outline.frame, outline.plane or 0)))


def _numbered(folder: Path, pattern: re.Pattern[str]) -> dict[int, Path]:
    """Files by the number in their names."""
    files = folder.iterdir() if folder.is_dir() else ()
    return {
        int(found[1]): path for path in sorted(files) if (found := pattern.fullmatch(path.name))
    }


def _read_tracks(content: bytes) -> tuple[ChallengeTrack, ...]:
    tracks: dict[int, ChallengeTrack] = {}
    for number, line in enumerate(content.decode("ascii", "replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            track = ChallengeTrack(*(int(word) for word in line.split()))
        except (TypeError, ValueError):
            raise InputError(
                f"line {number}: {line[:40]!r} given, expected four whole numbers: label, first and last frame, parent",
                _TABLE_HINT,
            ) from None
        if not (0 < track.label < 2**32 and 0 <= track.first <= track.last and track.parent >= 0):
            raise InputError(
                f"line {number}: {line[:40]!r} given, expected a label above 0, and first <= last frame",
                _TABLE_HINT,
            )
        if track.label in tracks:
            raise InputError(
                f"line {number}: a second track with the label {track.label}", _TABLE_HINT
            )
        tracks[track.label] = track
    return tuple(tracks.values())
