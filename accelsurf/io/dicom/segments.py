"""DICOM Segmentation objects read as label maps: binary, fractional, and label maps themselves.

Their frames are slices of one segment each, and only those that have a voxel: the grid follows from where they lie, and
beyond it there is no label.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame, frames_of
from accelsurf.io.dicom.pixels import stored_values
from accelsurf.io.dicom.slices import TOLERANCE_MM, ordered
from accelsurf.io.dicom.sources import (
    HEADER_HINT,
    TAGS,
    damage_of,
    dicom_library,
    number_of,
    read_dataset,
    text,
)
from accelsurf.io.dicom.volumes import DicomVolume
from accelsurf.io.memory import check_memory
from accelsurf.settings.labels import MAX_NAME, LabelEntry, LabelTable, default_color, holds

_TAGS = (
    "SegmentationType",
    "MaximumFractionalValue",
    "SegmentSequence",
    "SharedFunctionalGroupsSequence",
    "PerFrameFunctionalGroupsSequence",
    "PixelPaddingValue",
    *TAGS,
)
_BINARY = "BINARY"
_FRACTIONAL = "FRACTIONAL"
_LABELMAP = "LABELMAP"
_MAX_NUMBER = 65535
_HINT = "export it again, as a DICOM segmentation with a place for each frame"


@dataclass(frozen=True, eq=False)
class Segments:
    """A segmentation that was selected.

    Attributes
    ----------
    file : Path
    kind : {"BINARY", "FRACTIONAL", "LABELMAP"}
    full : int
        Of fractions: the stored number for 1.
    background : int
        Of a label map: the stored number where there is no segment.
    frames : tuple of Frame
    geometry : Geometry
        The grid that holds all frames.
    places : tuple of int
        Slice of the grid of each frame.
    numbers : tuple of int
        Segment of each frame; 0 for the frames of a label map.
    table : LabelTable
        Segments by number, with names and colours.
    """

    file: Path
    kind: str
    full: int
    background: int
    frames: tuple[Frame, ...]
    geometry: Geometry
    places: tuple[int, ...]
    numbers: tuple[int, ...]
    table: LabelTable

    @property
    def note(self) -> str:
        """Note for the user; empty for nothing."""
        return (
            "fractions: a voxel is of a segment where at least half of it is"
            if self.kind == _FRACTIONAL
            else ""
        )


def parse_segments(file: Path, root: Path) -> Segments:
    """Read the description of the segments of a segmentation, and prove that its frames lie on a grid.

    Parameters
    ----------
    file : Path
    root : Path
        The folder that messages name files from.

    Raises
    ------
    InputError
        When it is damaged, or of a whole-slide image.
    GeometryError
        When its frames lie on no grid.
    """
    dataset = read_dataset(file, _TAGS)
    with damage_of(file, HEADER_HINT):
        if text(dataset, "DimensionOrganizationType").startswith("TILED") or dataset.get(
            "TotalPixelMatrixRows"
        ):
            raise InputError(
                f"{file.name}: a segmentation of a whole-slide image, in tiles", "export it as TIFF"
            )
        frames = tuple(frames_of(file, of_segmentation=True))
        if not frames:
            raise InputError(f"{file.name}: a segmentation without an image", "export it again")
        kind = text(dataset, "SegmentationType") or _BINARY
        if kind not in (_BINARY, _FRACTIONAL, _LABELMAP):
            raise InputError(
                f"{file.name}: a segmentation of the unknown type {kind[:40]}",
                "export it as BINARY",
            )
        full = int(dataset.get("MaximumFractionalValue") or 0)
        if kind == _FRACTIONAL and not 1 <= full <= 255:
            raise InputError(f"{file.name}: fractions without their largest value", HEADER_HINT)
        table = _table(file, dataset)
        numbers = tuple(0 if kind == _LABELMAP else _number(frame, table) for frame in frames)
        geometry, places = _grid(frames, root, _step(dataset))
        seen = set(zip(places, numbers, strict=True))
        if len(seen) < len(frames):
            raise InputError(
                f"{file.name}: two frames of a segment lie at one place", "export it again"
            )
        background = int(dataset.get("PixelPaddingValue") or 0) if kind == _LABELMAP else 0
        return Segments(file, kind, full, background, frames, geometry, places, numbers, table)


def _number(frame: Frame, table: LabelTable) -> int:
    said = frame.phase.get("segment", "")
    if not said.isdigit() or int(said) not in table.entries:
        raise InputError(
            f"{frame.path.name}: frame {frame.number + 1} is of segment {said or 'nothing'}, one of "
            f"{', '.join(str(entry.id) for entry in table)} expected",
            HEADER_HINT,
        )
    return int(said)


def _table(file: Path, dataset: Any) -> LabelTable:
    """Names and colours of the segments."""
    entries = {}
    for item in dataset.get("SegmentSequence") or ():
        number = int(item.SegmentNumber)
        if number in entries or not 0 <= number <= _MAX_NUMBER:
            raise InputError(
                f"{file.name}: segment number {number} is there twice, or too large",
                "export it again",
            )
        name = "".join(letter for letter in text(item, "SegmentLabel") if letter.isprintable())[
            :MAX_NAME
        ].strip()
        color = item.get("RecommendedDisplayCIELabValue")
        rgb = default_color(max(number, 1))
        if color is not None and len(color) == 3:
            shown = (
                dicom_library("highdicom.color")
                .CIELabColor.from_dicom_value([int(part) for part in color])
                .to_rgb()
            )
            rgb = (int(shown[0]), int(shown[1]), int(shown[2]))
        entries[number] = LabelEntry(number, name or f"segment {number}", rgb)
    entries.pop(0, None)  # the background of a label map
    if not entries:
        raise InputError(f"{file.name}: a segmentation without segments", "is it the right file?")
    return LabelTable(entries)


def _step(dataset: Any) -> float | None:
    """Distance of slices as the file says it; its thickness of a slice may be another."""
    shared, frames = (
        dataset.get(f"{name}FunctionalGroupsSequence") for name in ("Shared", "PerFrame")
    )
    for groups in (shared, frames):
        sizes = groups[0].get("PixelMeasuresSequence") if groups else None
        if sizes and (step := number_of(sizes[0], "SpacingBetweenSlices")):
            return abs(step)
    return None


def _grid(
    frames: Sequence[Frame], root: Path, step: float | None
) -> tuple[Geometry, tuple[int, ...]]:
    """The grid of all frames, and the slice of each on it."""
    slices = ordered(DicomVolume(tuple(frames)), root)
    if len(slices.frames) < len(frames):
        raise GeometryError("; ".join(slices.faults), _HINT)
    along, aside = slices.along, slices.aside
    if np.abs(aside).max() > TOLERANCE_MM:
        raise GeometryError(
            f"frames of the segmentation are shifted sideways by {np.abs(aside).max():.3g} mm, or tilted",
            _HINT,
        )
    gaps = np.diff(along)
    gaps = gaps[gaps > TOLERANCE_MM]
    if not gaps.size:
        height = step or abs(slices.frames[0].thickness or 1.0)
    else:
        height = next(
            (h for h in (step, float(gaps.min())) if h is not None and _is_regular(along, h)), 0.0
        )
        if height <= TOLERANCE_MM:
            raise GeometryError(
                "frames of the segmentation lie at distances that are no multiples of one", _HINT
            )
        height = float(along[-1]) / round(float(along[-1]) / height)
    index = np.rint(along / height).astype(int)
    first = slices.frames[0]
    shape = (int(index[-1]) + 1, first.rows, first.columns)
    geometry = Geometry(
        shape, (height, *slices.spacing[1:]), tuple(slices.positions[0].tolist()), slices.axes
    )
    by_frame = {
        frame.number: place for frame, place in zip(slices.frames, index.tolist(), strict=True)
    }
    return geometry, tuple(by_frame[frame.number] for frame in frames)


def _is_regular(along: NDArray[np.float64], height: float) -> bool:
    return bool(np.abs(along - np.rint(along / height) * height).max() <= TOLERANCE_MM)


def read_segments(
    segments: Segments, available: int, ids: Sequence[tuple[int, int]] = ()
) -> NDArray[Any]:
    """Read the label map: the number of a segment in each of its voxels, 0 elsewhere.

    Parameters
    ----------
    segments : Segments
    available : int
        Bytes.
    ids : sequence of (first, last)
        Segments that are wanted; none for all.

    Raises
    ------
    InputError
        When it is larger than the memory, damaged, or segments that are wanted overlap.
    """
    largest = _MAX_NUMBER if segments.kind == _LABELMAP else max(segments.table.entries)
    dtype = np.dtype(np.uint8 if largest <= 255 else np.uint16)
    check_memory(segments.geometry.size, dtype.itemsize, available)
    out = np.zeros(segments.geometry.shape, dtype)
    dataset = read_dataset(segments.file)
    for frame, place, number in zip(
        segments.frames, segments.places, segments.numbers, strict=True
    ):
        if number and ids and not holds(ids, number):
            continue
        stored = stored_values(segments.file, dataset, frame)
        if stored.shape != out.shape[1:]:
            raise InputError(
                f"{segments.file.name}: {stored.shape} pixels, {out.shape[1:]} announced",
                "copy it again",
            )
        if segments.kind == _LABELMAP:
            out[place] = np.where(stored == segments.background, 0, stored)
            continue
        inside = (
            stored > 0 if segments.kind == _BINARY else 2 * stored.astype(np.int32) >= segments.full
        )
        both = inside & (out[place] != 0)
        if both.any():
            raise _overlap(segments, int(out[place][both][0]), number, frame, int(both.sum()))
        out[place][inside] = number
    return out


def _overlap(segments: Segments, first: int, second: int, frame: Frame, count: int) -> InputError:
    names = " and ".join(f"{number} ({segments.table[number].name})" for number in (first, second))
    return InputError(
        f"segments {names} overlap in {count} voxels of frame {frame.number + 1}, and a voxel has one label",
        f"name one of them after the file, as FILE@{second} (--start label:, --objects, evaluate); for other options "
        "export the segments without overlap",
    )
