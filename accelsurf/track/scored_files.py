"""Tracks in files: a folder of the Cell Tracking Challenge, or label maps with time and a table beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.image.check import as_labels
from accelsurf.image.sequence import ImageSequence
from accelsurf.io import ChallengeFolder, Outline, is_challenge, open_challenge, split_name
from accelsurf.track.output.files import read_tracks_table
from accelsurf.track.scores import (
    ExactLabels,
    Stretch,
    TrackedLabels,
    TrackingScores,
    score,
    stretches,
)

#: Ends of the names of label maps, and of the table that belongs to them.
_TRUTH = "_truth"
_TABLE = "_tracks.csv"
_MARKS = ("_labels", _TRUTH)


@dataclass(frozen=True)
class TrackedFile:
    """Tracks that were opened.

    Attributes
    ----------
    path : Path
    labels : TrackedLabels
    outlines : tuple of Outline
        Frames and slices with outlines that SEG is measured on; empty: the label maps.
    table : Path or None
        Where the parents are from; None: nothing says who came from whom.
    """

    path: Path
    labels: TrackedLabels
    outlines: tuple[Outline, ...] = ()
    table: Path | None = None


def open_tracks(path: Path) -> TrackedFile:
    """Open tracks; label maps are read frame by frame later.

    Parameters
    ----------
    path : Path
        A folder of the challenge; or a sequence of label maps, whose table of tracks is found beside it:
        ``NAME_tracks.csv`` beside ``NAME_labels.nii.gz``.

    Raises
    ------
    InputError
        When something cannot be read.
    """
    if is_challenge(path):
        return _of_challenge(path, open_challenge(path))
    from accelsurf.io import read_sequence

    sequence = read_sequence(path)
    table = table_beside(path)
    frames, parents = (
        read_tracks_table(table, _tracks_in) if table is not None else (_frames_shown(sequence), {})
    )
    tracks = stretches(frames, parents)
    return TrackedFile(
        path, TrackedLabels(len(sequence), lambda n: _as_labels(sequence, n), tracks), (), table
    )


def compare(result: TrackedFile, reference: TrackedFile) -> TrackingScores:
    """Score tracks by their reference.

    Raises
    ------
    InputError
        When they have not the same number of frames, or not the same grid.
    """
    if result.labels.frames != reference.labels.frames:
        raise InputError(
            f"{result.path} has {result.labels.frames} frames, {reference.path} has {reference.labels.frames}: as many "
            "expected",
            "give the result and the reference of the same sequence",
        )
    shape, wanted = result.labels.labels(0).shape, reference.labels.labels(0).shape
    if shape != wanted:
        raise InputError(
            f"{result.path} has frames of {shape} voxels (z, y, x), {reference.path} of {wanted}",
            "give the result and the reference of the same sequence",
        )
    return score(
        result.labels, reference.labels, _outlines(reference) if reference.outlines else None
    )


def table_beside(path: Path) -> Path | None:
    """The table of tracks that belongs to label maps; None where there is none.

    Of ``NAME_labels.nii.gz`` it is ``NAME_tracks.csv``, of ``NAME_truth.nii.gz`` also ``NAME_truth.csv``; of any other
    name that name with ``_tracks.csv``.

    Examples
    --------
    >>> table_beside(Path("absent_labels.nii.gz")) is None
    True
    """
    stem = split_name(path)[0]
    names = [
        stem + _TABLE,
        *(stem.removesuffix(mark) + _TABLE for mark in _MARKS if stem.endswith(mark)),
    ]
    if stem.endswith(_TRUTH):
        names.append(f"{stem}.csv")
    return next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)


def _of_challenge(path: Path, found: ChallengeFolder) -> TrackedFile:
    tracks = []
    for track in found.tracks:
        parents = (track.parent,) if track.parent else ()
        tracks.append(Stretch(track.label, track.label, track.first, track.last, parents))
    return TrackedFile(
        path, TrackedLabels(len(found.frames), found.labels, tracks), found.outlines, found.folder
    )


def _outlines(reference: TrackedFile) -> Iterator[ExactLabels]:
    from accelsurf.io import read_labels

    shape = reference.labels.labels(0).shape
    for outline in reference.outlines:
        if outline.frame < reference.labels.frames:
            labels = read_labels(outline.path).array
            _check_plane(outline, labels.shape, shape)
            yield ExactLabels(outline.frame, labels, outline.plane)


def _check_plane(outline: Outline, found: tuple[int, ...], frame: tuple[int, ...]) -> None:
    """Refuse outlines on another grid than the frame, or of a slice that it has not."""
    wanted = frame if outline.plane is None else (1, *frame[1:])
    if outline.plane is not None and outline.plane >= frame[0]:
        raise InputError(
            f"{outline.path}: of slice {outline.plane}, the frames have 0 to {frame[0] - 1}",
            "its name has the frame, then the slice: man_seg_TTT_ZZZ.tif",
        )
    if found != wanted:
        raise InputError(
            f"{outline.path}: of {found} voxels (z, y, x), {wanted} expected",
            "give the outlines of the same sequence",
        )


def _as_labels(sequence: ImageSequence, number: int) -> NDArray[Any]:
    """A frame as whole numbers."""
    try:
        return as_labels(sequence.frame(number).array)
    except InputError as error:
        raise InputError(
            f"{sequence.source}: frame {number}: {error.message}", error.hint
        ) from None


def _frames_shown(sequence: ImageSequence) -> dict[int, list[int]]:
    """Return the frames of each id."""
    frames: dict[int, list[int]] = {}
    for number in range(len(sequence)):
        for label in np.unique(_as_labels(sequence, number)):
            if label > 0:
                frames.setdefault(int(label), []).append(number)
    return frames


def _tracks_in(
    columns: Sequence[str], lines: Iterator[Mapping[str, str]]
) -> tuple[dict[int, list[int]], dict[int, tuple[int, ...]]]:
    """Read the frames in which each id is seen, and its parents, from the columns frame, id, parent and seen."""
    for name in ("frame", "id"):
        if name not in columns:
            raise InputError(
                f"no column {name}",
                "frame, id and parent are expected, as accelsurf track writes them",
            )
    frames: dict[int, set[int]] = {}
    parents: dict[int, tuple[int, ...]] = {}
    for line in lines:
        object_id = int(line["id"])
        if line.get("seen", "1") != "0":
            frames.setdefault(object_id, set()).add(int(line["frame"]))
        if line.get("parent"):
            parents[object_id] = tuple(int(parent) for parent in line["parent"].split(";"))
    return {object_id: sorted(numbers) for object_id, numbers in frames.items()}, parents
