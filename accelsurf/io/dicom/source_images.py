"""The slices that a volume was read from, as DICOM objects that are made of it refer to them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.writing_tools import derived_uid, library, quiet, short_text

Floats = NDArray[np.float64]

#: Where source and grid still are at one place, parts of the smallest spacing.
SAME_PLACE = 1e-2
#: Largest difference of direction cosines within one orientation.
SAME_DIRECTION = 1e-3
#: A date and a time of a source that has none.
NO_DATE, NO_TIME = "19000101", "000000"
_HINT = "a DICOM object refers to the slices by them: export the series again, with its identifiers"
_TEXTS = (
    "PatientName", "PatientID", "AccessionNumber", "StudyID", "ReferringPhysicianName", "StudyDescription",
    "PositionReferenceIndicator",
)
_DATES, _TIMES = ("PatientBirthDate", "StudyDate"), ("StudyTime",)
_PER_FILE = (
    "SOPClassUID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID", "Modality",
    "SeriesNumber", "SeriesDate", "SeriesTime", "AcquisitionDate", "AcquisitionTime", "ContentDate", "ContentTime",
    "PatientSex", "PatientAge", "Rows", "Columns", "PixelSpacing", "ImagePositionPatient", "ImageOrientationPatient",
    "NumberOfFrames", "SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence",
)


@dataclass(frozen=True, eq=False)
class SourceFrame:
    """One slice: a file, or a frame of one.

    Attributes
    ----------
    sop_class, sop_instance : str
        Identifiers of the file's object.
    number : int or None
        Of the frame, from 1 on; None where the file is one slice.
    position : ndarray (3,)
        World position of its first pixel's centre, mm LPS.
    orientation : ndarray (2, 3)
        Directions in which its columns and its rows are counted.
    spacing : (float, float)
        Between rows and between columns, mm.
    shape : (int, int)
        Rows and columns.
    """

    sop_class: str
    sop_instance: str
    number: int | None
    position: Floats
    orientation: Floats
    spacing: tuple[float, float]
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class SourceImages:
    """Slices of one series.

    Attributes
    ----------
    patient : dict of str to str
        Patient and study by DICOM keyword; "" where the source does not say.
    study_uid, series_uid, frame_of_reference : str
    modality : str
    series_number : int
    date, time : str
        Of the series, as DICOM writes them.
    frames : tuple of SourceFrame
    """

    patient: dict[str, str]
    study_uid: str
    series_uid: str
    frame_of_reference: str
    modality: str
    series_number: int
    date: str
    time: str
    frames: tuple[SourceFrame, ...]

    @cached_property
    def instances(self) -> tuple[tuple[str, str], ...]:
        """Class and identifier of each file's object, once."""
        return tuple(dict.fromkeys((frame.sop_class, frame.sop_instance) for frame in self.frames))

    def in_planes(self, geometry: Geometry) -> tuple[tuple[SourceFrame, ...], ...]:
        """Which frames lie in the plane of each slice of a grid; where in the plane does not matter.

        Raises
        ------
        InputError
            When no frame is parallel to the grid's slices.

        Examples
        --------
        >>> frame = SourceFrame("1.2", "1.3", None, np.zeros(3), np.eye(3)[:2], (1.0, 1.0), (4, 3))
        >>> source = SourceImages({}, "1", "2", "3", "CT", 1, NO_DATE, NO_TIME, (frame,))
        >>> [len(found) for found in source.in_planes(Geometry((2, 8, 6), (1.0, 0.5, 0.5)))]
        [1, 0]
        """
        normal = geometry.direction[:, 2]
        parallel = [frame for frame in self.frames if np.abs(frame.orientation @ normal).max() < SAME_DIRECTION]
        if not parallel:
            raise InputError(
                "the grid's slices are not parallel to those of the DICOM series",
                "write a label map, which may lie in any direction",
            )
        heights = [float((frame.position - geometry.origin) @ normal) / geometry.spacing[0] for frame in parallel]
        tolerance = SAME_PLACE * min(geometry.spacing) / geometry.spacing[0]
        found: list[list[SourceFrame]] = [[] for _ in range(geometry.shape[0])]
        for frame, height in zip(parallel, heights, strict=True):
            k = round(height)
            if abs(height - k) <= tolerance and 0 <= k < len(found):
                found[k].append(frame)
        return tuple(map(tuple, found))


def pixel_for_pixel(frame: SourceFrame, geometry: Geometry, k: int) -> bool:
    """Whether a frame's pixels are the voxels of a slice of the grid."""
    if frame.shape != geometry.shape[1:]:
        return False
    tolerance = SAME_PLACE * min(geometry.spacing)
    rows, columns = (n - 1 for n in frame.shape)
    ends = np.array([[0, 0], [0, columns], [rows, 0]])
    steps = np.stack([frame.orientation[1] * frame.spacing[0], frame.orientation[0] * frame.spacing[1]])
    places = frame.position + ends @ steps
    voxels = geometry.index_to_world(np.insert(ends.astype(float), 0, k, axis=1))
    return bool(np.linalg.norm(places - voxels, axis=1).max() <= tolerance)


def read(files: Sequence[Path]) -> SourceImages:
    """Read the headers of a volume's slices.

    Parameters
    ----------
    files : sequence of Path
        As `accelsurf.io.dicom.source_files` gives them.

    Raises
    ------
    InputError
        When a file is none, has no identifiers, or is of another series than the first.
    """
    headers = [(path, _header(path)) for path in files]
    path, first = headers[0]
    study, series = (_identifier(path, first, f"{what}InstanceUID") for what in ("Study", "Series"))
    frames: list[SourceFrame] = []
    for path, header in headers:
        if _identifier(path, header, "SeriesInstanceUID") != series:
            raise InputError(f"{path}: is of another series than {files[0].name}", "give a single series")
        frames += _frames(path, header)
    date, time = _date_and_time(first)
    return SourceImages(
        _patient(first), study, series, _text(first, "FrameOfReferenceUID") or derived_uid(study, series, "frame"),
        _text(first, "Modality") or "OT", _whole(first, "SeriesNumber"), date, time, tuple(frames),
    )


def _header(path: Path) -> Any:
    pydicom = library("pydicom")
    try:
        with quiet():
            header = pydicom.dcmread(
                path, stop_before_pixels=True, force=True, specific_tags=[*_TEXTS, *_DATES, *_TIMES, *_PER_FILE]
            )
            header.decode()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})", "is it still there?") from error
    except Exception as error:  # pydicom raises errors of many kinds on damaged files
        raise InputError(f"{path}: is no DICOM file ({' '.join(str(error).split())[:100]})", "copy it again") from error
    return header


def _text(header: Any, keyword: str) -> str:
    """A value as a text; "" where it is missing, empty or unreadable."""
    try:
        with quiet():
            value = header.get(keyword)
    except Exception:  # a damaged value is as none
        return ""
    return "" if value is None else str(value).strip().strip("\0")


def _whole(header: Any, keyword: str) -> int:
    text = _text(header, keyword)
    return int(text) if re.fullmatch(r"[0-9]{1,7}", text) else 0


def _identifier(path: Path, header: Any, keyword: str) -> str:
    text = _text(header, keyword)
    if not re.fullmatch(r"[0-9]+(\.[0-9]+)*", text) or len(text) > 64:
        raise InputError(f"{path}: has no {keyword}", _HINT)
    return text


def _patient(header: Any) -> dict[str, str]:
    """What is copied of patient and study: values that DICOM allows, else ""."""
    found = {keyword: short_text(_text(header, keyword)) for keyword in _TEXTS}
    for keywords, pattern in ((_DATES, r"[0-9]{8}"), (_TIMES, r"[0-9]{2,6}(\.[0-9]{1,6})?")):
        found |= {key: text if re.fullmatch(pattern, text := _text(header, key)) else "" for key in keywords}
    found["AccessionNumber"], found["StudyID"] = found["AccessionNumber"][:16], found["StudyID"][:16]
    sex, age = _text(header, "PatientSex"), _text(header, "PatientAge")
    found["PatientSex"] = sex if sex in ("M", "F", "O") else ""
    if re.fullmatch(r"[0-9]{3}[DWMY]", age):
        found["PatientAge"] = age
    return found


def _date_and_time(header: Any) -> tuple[str, str]:
    for what in ("Series", "Study", "Acquisition", "Content"):
        date, time = _text(header, f"{what}Date"), _text(header, f"{what}Time")
        if re.fullmatch(r"[0-9]{8}", date):
            return date, time if re.fullmatch(r"[0-9]{6}(\.[0-9]{1,6})?", time) else NO_TIME
    return NO_DATE, NO_TIME


def _frames(path: Path, header: Any) -> Iterable[SourceFrame]:
    sop_class, instance = _identifier(path, header, "SOPClassUID"), _identifier(path, header, "SOPInstanceUID")
    shape = (_whole(header, "Rows"), _whole(header, "Columns"))
    groups = header.get("PerFrameFunctionalGroupsSequence")
    if not groups:
        yield SourceFrame(sop_class, instance, None, *_place(path, [header]), shape)
        return
    shared = header.get("SharedFunctionalGroupsSequence") or []
    for number, group in enumerate(groups, start=1):
        yield SourceFrame(sop_class, instance, number, *_place(path, [*_macros(group), *_macros(*shared[:1])]), shape)


def _macros(*groups: Any) -> list[Any]:
    """The items of a frame's groups that say where it is."""
    names = ("PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence")
    return [group.get(name)[0] for group in groups for name in names if group.get(name)]


def _place(path: Path, items: Sequence[Any]) -> tuple[Floats, Floats, tuple[float, float]]:
    """Position, orientation and spacing of a frame, each from the first item that has it."""
    found = []
    for keyword, count in (("ImagePositionPatient", 3), ("ImageOrientationPatient", 6), ("PixelSpacing", 2)):
        values = next((item.get(keyword) for item in items if item.get(keyword) is not None), None)
        try:
            numbers = np.array([float(value) for value in values or ()])
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise InputError(f"{path}: has no {keyword}", "a DICOM object needs to know where its slices lie")
        found.append(numbers)
    return found[0], found[1].reshape(2, 3), (float(found[2][0]), float(found[2][1]))
