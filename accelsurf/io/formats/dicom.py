"""DICOM as a format of images: the choice of a series, its grid, its values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.dicom import pixels, segments
from accelsurf.io.dicom.frames import Frame, frames_of
from accelsurf.io.dicom.segments import Segments
from accelsurf.io.dicom.slices import Slices, ordered
from accelsurf.io.dicom.sources import (
    HINTS,
    SEGMENTATION,
    SourceFiles,
    dicom_library,
    files_of,
    holds_dicom,
    is_dicom,
)
from accelsurf.io.dicom.volumes import (
    TIME_PHASES,
    Contents,
    DicomVolume,
    contents_of,
    count_in_words,
    shown,
)
from accelsurf.io.headers import (
    DICOM_KEY,
    LABELS_KEY,
    VALUE_UNIT_KEY,
    ZERO_BEYOND_KEY,
    with_given_unit,
    with_warnings,
)
from accelsurf.io.memory import check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

#: Series that a message lists.
_LISTED = 6
_DAMAGE_HINT = "copy the scan again"
_SERIES_HINT = "give the folder of a CT, MR or PET series"

__all__ = [
    "DicomHeader",
    "holds_dicom",
    "is_dicom",
    "listing",
    "parse_dicom",
    "read_dicom",
]


@dataclass(frozen=True, eq=False)
class DicomHeader:
    """A series that was selected.

    Attributes
    ----------
    slices : Slices
        In their order.
    geometry : Geometry
        The grid of the volume.
    notes : tuple of str
        Warnings for the user.
    options : ReadOptions
        As given.
    """

    slices: Slices
    geometry: Geometry
    notes: tuple[str, ...]
    options: ReadOptions = AS_IT_IS


def parse_dicom(path: Path, options: ReadOptions = AS_IT_IS) -> DicomHeader | Segments:
    """Choose a series, and prove that its slices lie on a grid; or the segmentation, where there is no series.

    Raises
    ------
    InputError
        When there is no image, or there are several and none was selected.
    GeometryError
        When the slices lie on no grid.
    """
    found = found_in(path)
    contents = found.contents
    if (segmentation := segmentation_of(contents)) is not None:
        if options.given:
            raise UsageError(
                f"{options.given[0]} was given, a DICOM segmentation has no such choice",
                "leave it out",
            )
        return segments.parse_segments(segmentation, found.files.root)
    volume = volume_of(contents, options, found.file)
    refuse_lost(contents, volume.uid)
    slices = ordered(volume, found.files.root, options.spacing)
    notes = notes_on_left_out(contents, volume.uid, found.file)
    try:
        return on_grid(slices, options, notes)
    except GeometryError as error:  # a file that cannot be read may be the missing slice
        raise GeometryError("; ".join((error.message, *notes)), error.hint) from error


class FoundDicom(NamedTuple):
    """The DICOM files of a path, their contents, and the file itself where one was given."""

    files: SourceFiles
    contents: Contents
    file: Path | None


def found_in(path: Path) -> FoundDicom:
    """Read the headers of the files of a path.

    Raises
    ------
    InputError
        When there is no DICOM, or the file that was given is damaged.
    """
    dicom_library()
    files = files_of(path)
    file = path if path.is_file() else None
    if file is None:
        return FoundDicom(files, contents_of(files), None)
    frames = _frames_of(file)
    if len(frames) > 1 or (frames and frames[0].labels["kind"] == SEGMENTATION):
        files = SourceFiles(files.root, (file,))
    return FoundDicom(files, contents_of(files, {file: frames}), file)


def segmentation_of(contents: Contents) -> Path | None:
    """The segmentation that is meant where there is no image of a volume; None where there is an image, or none.

    Raises
    ------
    InputError
        When there are several.
    """
    found = [left for left in contents.left_out if left.kind == SEGMENTATION]
    if contents.volumes or not found:
        return None
    if len(found) > 1:
        raise InputError(
            f"several segmentations are in it: {count_in_words(found)}", "give one of the files"
        )
    return found[0].file


def _frames_of(file: Path) -> list[Frame]:
    """The slices of the file that was given; its name is told already."""
    try:
        return frames_of(file)
    except InputError as error:
        raise InputError(error.message.removeprefix(f"{file.name}: "), error.hint) from error


def refuse_lost(contents: Contents, series: str) -> None:
    """Refuse a series of which a file cannot be read: at an end no gap tells of it.

    Raises
    ------
    InputError
        With the names of the files.
    """
    if lost := contents.lost_from(series):
        raise InputError(
            f"a slice of the series is lost: {count_in_words(lost)}",
            "copy it again; to go on without it, take it out of the folder",
        )


def on_grid(slices: Slices, options: ReadOptions, notes: list[str]) -> DicomHeader:
    """The header of slices in their order; ``notes`` come before its own.

    Raises
    ------
    GeometryError
        When the slices lie on no grid.
    """
    notes = [*notes, *([slices.note] if slices.note else [])]
    return DicomHeader(slices, slices.geometry, tuple(notes), options)


def volume_of(contents: Contents, options: ReadOptions, file: Path | None) -> DicomVolume:
    """The volume that is meant."""
    volumes = contents.volumes
    if not volumes:
        kinds_found = {left.kind for left in contents.left_out}
        hint = _DAMAGE_HINT if kinds_found == {""} else _SERIES_HINT
        raise InputError(
            f"it has no 3D image, but {count_in_words(contents.left_out) or 'nothing'}",
            next((HINTS[kind] for kind in HINTS if kind in kinds_found), hint),
        )
    if options.series is not None:
        return _by_name(volumes, options.series)
    if file is not None:
        volumes = volumes_of_file(contents, file)
    if len(volumes) > 1:
        raise InputError(
            f"{len(volumes)} volumes are in it: {_short_list(contents, volumes)}",
            "say which by --series NUMBER; accelsurf info FOLDER lists them"
            + ("; accelsurf track takes all as frames" if _differ_in_time(volumes) else ""),
        )
    return volumes[0]


def volumes_of_file(contents: Contents, file: Path) -> tuple[DicomVolume, ...]:
    """The volumes that a file is of: those that are of it alone, else those with a slice of it.

    Raises
    ------
    InputError
        When it has no slice of a volume.
    """
    found = [
        volume for volume in contents.volumes if any(frame.path == file for frame in volume.frames)
    ]
    if not found:
        said = [left for left in contents.left_out if left.file == file]
        hint = HINTS.get(said[0].kind, _SERIES_HINT) if said else _SERIES_HINT
        raise InputError(
            f"this file has no 3D image, but {count_in_words(said) or 'nothing'}", hint
        )
    alone = [volume for volume in found if all(frame.path == file for frame in volume.frames)]
    return tuple(alone or found)


def _differ_in_time(volumes: tuple[DicomVolume, ...]) -> bool:
    """Test if they are one series at several times."""
    return len({volume.uid for volume in volumes}) == 1 and all(
        set(volume.phase) <= TIME_PHASES for volume in volumes
    )


def _by_name(volumes: tuple[DicomVolume, ...], asked: str) -> DicomVolume:
    """A volume by its number in the list, or by the UID of its series."""
    if asked.isdigit() and 1 <= int(asked) <= len(volumes):
        return volumes[int(asked) - 1]
    found = [volume for volume in volumes if volume.uid == asked]
    if len(found) == 1:
        return found[0]
    if found:
        numbers = ", ".join(str(n) for n, volume in enumerate(volumes, 1) if volume.uid == asked)
        raise InputError(
            f"series {asked[:80]} has {len(found)} volumes, numbers {numbers}",
            "give --series with one of the numbers",
        )
    raise InputError(
        f"series {asked[:80]} is not in it, which has 1 to {len(volumes)}",
        "accelsurf info FOLDER lists them",
    )


def _short_list(contents: Contents, volumes: tuple[DicomVolume, ...]) -> str:
    numbered = [(n, volume) for n, volume in enumerate(contents.volumes, 1) if volume in volumes]
    parts = [
        f"{n} {_title(volume)}, {len(volume.frames)} slices" for n, volume in numbered[:_LISTED]
    ]
    return "; ".join(parts) + (
        f"; {len(numbered) - _LISTED} more" if len(numbered) > _LISTED else ""
    )


def _title(volume: DicomVolume) -> str:
    phase = ", ".join(f"{name} {value}" for name, value in volume.phase.items())
    words = f"{volume.label('modality')} {volume.label('description')}".strip() or "without a name"
    return f"{words} ({phase})" if phase else words


def notes_on_left_out(contents: Contents, series: str, file: Path | None) -> list[str]:
    """Notes on files that are no part of a volume; beside a file only on damaged ones."""
    named = [
        left
        for left in contents.left_out
        if file is None or (left.reason and (not left.series or left.belongs_to(series)))
    ]
    return [f"left out: {count_in_words(named)}"] if named else []


def read_dicom(path: Path, header: DicomHeader | Segments, available: int) -> Volume:
    """Read the values of the series, or the label map of a segmentation.

    Raises
    ------
    InputError
        When it is larger than the memory, or its values are damaged.
    """
    if isinstance(header, Segments):
        return read_labels(path, header, available)
    frames = header.slices.frames
    dtype = pixels.value_type(frames)
    check_memory(header.geometry.size, dtype.itemsize, available)
    values, note = pixels.read_values(frames)
    metadata = with_warnings({DICOM_KEY: frames[0].uids.series}, *header.notes, note)
    metadata = with_given_unit(metadata, header.options)
    if frames[0].labels["unit"]:
        metadata[VALUE_UNIT_KEY] = frames[0].labels["unit"]
    return Volume(values, header.geometry, metadata, path)


def read_labels(
    path: Path, header: DicomHeader | Segments, available: int, ids: Sequence[tuple[int, int]] = ()
) -> Volume:
    """Read a segmentation as a label map of the numbers of its segments; a series as `read_dicom` does.

    Parameters
    ----------
    path : Path
    header : DicomHeader or Segments
    available : int
        Bytes.
    ids : sequence of (first, last)
        Segments that are wanted; none for all.

    Raises
    ------
    InputError
        As `read_dicom`, and where segments overlap.
    """
    if isinstance(header, DicomHeader):
        return read_dicom(path, header, available)
    labels = segments.read_segments(header, available, ids)
    metadata = {
        DICOM_KEY: header.frames[0].uids.series,
        LABELS_KEY: header.table.to_json(),
        ZERO_BEYOND_KEY: "yes",
    }
    return Volume(labels, header.geometry, with_warnings(metadata, header.note), path)


def listing(path: Path) -> list[dict[str, Any]]:
    """List the volumes of a folder, archive or file; lengths in mm, in the order (x, y, z).

    Raises
    ------
    InputError
        When there is no DICOM.
    """
    found = found_in(path)
    files, contents = found.files, found.contents
    if (segmentation := segmentation_of(contents)) is not None:
        return [_segmentation_entry(segments.parse_segments(segmentation, files.root), files)]
    if not contents.volumes:
        volume_of(contents, AS_IT_IS, None)  # its error names the contents
    volumes = contents.volumes if found.file is None else volumes_of_file(contents, found.file)
    numbered = [
        (number, volume) for number, volume in enumerate(contents.volumes, 1) if volume in volumes
    ]
    entries = [_entry(number, volume, files, contents) for number, volume in numbered]
    entries[0]["left_out"] = notes_on_left_out(contents, volumes[0].uid, found.file)
    return entries


def _entry(
    number: int, volume: DicomVolume, files: SourceFiles, contents: Contents
) -> dict[str, Any]:
    entry = _first_entry(number, volume, files)
    try:
        slices = ordered(volume, files.root)
    except GeometryError as error:
        return {**entry, "warnings": [error.message]}
    first = slices.frames[0]
    entry["size"] = [first.columns, first.rows, len(slices.frames)]
    entry["spacing"] = [round(part, 6) for part in reversed(slices.spacing)]
    entry["orientation"] = orientation_words(slices.axes)
    lost = contents.lost_from(volume.uid)
    entry["warnings"] = [
        *([f"a slice of the series is lost: {count_in_words(lost)}"] if lost else []),
        *slices.faults,
        *([slices.note] if slices.note else []),
    ]
    return entry


def _first_entry(number: int, volume: DicomVolume, files: SourceFiles) -> dict[str, Any]:
    """Entry of a volume without its grid."""
    return {
        "number": number,
        "uid": volume.uid,
        "modality": volume.label("modality"),
        "description": volume.label("description"),
        "series_number": volume.label("number"),
        "phase": volume.phase,
        "files": len({frame.path for frame in volume.frames}),
        "first_file": shown(volume.frames[0].path, files.root),
        "size": None,
        "spacing": None,
        "orientation": None,
        "unit": volume.label("unit") or None,
        "warnings": [],
        "segments": [],
    }


def _segmentation_entry(found: Segments, files: SourceFiles) -> dict[str, Any]:
    geometry = found.geometry
    return {
        **_first_entry(1, DicomVolume(found.frames), files),
        "size": list(geometry.size),
        "spacing": [round(part, 6) for part in geometry.spacing_xyz],
        "orientation": orientation_words(geometry.direction),
        "warnings": [found.note] if found.note else [],
        "segments": [
            {"id": entry.id, "name": entry.name, "color": entry.hex} for entry in found.table
        ],
        "left_out": [],
    }


def orientation_words(axes: NDArray[np.float64]) -> str:
    """Name the plane of the patient in which the slices lie: axial, coronal or sagittal, or oblique near one."""
    normal = abs(axes[:, 2])
    name = ("sagittal", "coronal", "axial")[int(normal.argmax())]
    return name if normal.max() > 0.999 else f"oblique, near {name}"
