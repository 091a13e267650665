"""The slices that a volume was read from, as DICOM objects that are made of it refer to them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.slices import TOLERANCE_MM
from accelsurf.io.dicom.sources import quiet, read_dataset
from accelsurf.io.dicom.writing_tools import derived_uid, short_text

#: Largest part of a voxel that two places may differ by to be one.
_MAX_PART = 0.25
#: Largest cosine between a slice's normal and its plane.
_PARALLEL = 1e-3
#: A date and a time of a source that has none.
NO_DATE = "19000101"
NO_TIME = "000000"
_HINT = "a DICOM object refers to the slices by it: export the series again, with its identifiers"
_TEXTS = (
    "PatientName",
    "PatientID",
    "AccessionNumber",
    "StudyID",
    "ReferringPhysicianName",
    "StudyDescription",
    "PositionReferenceIndicator",
)
_DATES = ("PatientBirthDate", "StudyDate")
_TIMES = ("StudyTime",)
_DATED = ("Series", "Study", "Acquisition", "Content")
_OTHERS = (
    "PatientSex",
    "PatientAge",
    "SeriesNumber",
    *(f"{what}{part}" for what in _DATED for part in ("Date", "Time")),
)


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
    frames : tuple of Frame
        Each with a place, and the identifiers of its file.
    """

    patient: dict[str, str]
    study_uid: str
    series_uid: str
    frame_of_reference: str
    modality: str
    series_number: int
    date: str
    time: str
    frames: tuple[Frame, ...]

    @cached_property
    def instances(self) -> tuple[tuple[str, str], ...]:
        """Class and identifier of each file's object, once."""
        return tuple(
            dict.fromkeys((frame.labels["class"], frame.uids.instance) for frame in self.frames)
        )

    def in_planes(self, geometry: Geometry) -> tuple[tuple[Frame, ...], ...]:
        """Frames in the plane of each slice of a grid, anywhere in the plane.

        Raises
        ------
        InputError
            When no frame is parallel to the grid's slices.
        """
        normal = geometry.direction[:, 2]
        turns = (np.array(frame.orientation, np.float64).reshape(2, 3) for frame in self.frames)
        pairs = zip(self.frames, turns, strict=True)
        parallel = [frame for frame, turn in pairs if np.abs(turn @ normal).max() < _PARALLEL]
        if not parallel:
            raise InputError(
                "the grid's slices are not parallel to those of the DICOM series",
                "write a label map, which may lie in any direction",
            )
        found: list[list[Frame]] = [[] for _ in range(geometry.shape[0])]
        for frame in parallel:
            height = float((np.array(frame.position) - geometry.origin) @ normal)
            k = round(height / geometry.spacing[0])
            if 0 <= k < len(found) and abs(height - k * geometry.spacing[0]) <= _tolerance(
                geometry
            ):
                found[k].append(frame)
        return tuple(map(tuple, found))


def _tolerance(geometry: Geometry) -> float:
    """Places that differ by no more, mm, are one: so far the slices of a grid may lie from it."""
    return min(1.01 * TOLERANCE_MM, _MAX_PART * min(geometry.spacing))


def pixel_for_pixel(frame: Frame, geometry: Geometry, k: int) -> bool:
    """Test if a frame's pixels are the voxels of a slice of the grid."""
    if frame.spacing is None or (frame.rows, frame.columns) != geometry.shape[1:]:
        return False
    turn = np.array(frame.orientation, np.float64).reshape(2, 3)
    ends = np.array([[0, 0], [0, frame.columns - 1], [frame.rows - 1, 0]])
    steps = np.stack([turn[1] * frame.spacing[0], turn[0] * frame.spacing[1]])
    voxels = geometry.index_to_world(np.insert(ends.astype(float), 0, k, axis=1))
    return bool(
        np.linalg.norm(frame.position + ends @ steps - voxels, axis=1).max() <= _tolerance(geometry)
    )


def read_source_images(frames: Sequence[Frame]) -> SourceImages:
    """Read the attributes of a volume's slices beside their places: patient, study and dates.

    Parameters
    ----------
    frames : sequence of Frame
        Of one series.

    Raises
    ------
    InputError
        When a slice has no identifiers or no place, or its file cannot be read.
    """
    for frame in frames:
        named = ("StudyInstanceUID", "SeriesInstanceUID", "SOPInstanceUID")
        for keyword, uid in zip(named, frame.uids[:3], strict=True):
            _check_uid(frame, keyword, uid)
        _check_uid(frame, "SOPClassUID", frame.labels["class"])
        if frame.position is None or frame.orientation is None:
            raise InputError(
                f"{frame.path.name}: does not say where it lies",
                "a DICOM object needs slices with positions",
            )
    first = frames[0]
    header = read_dataset(first.path, [*_TEXTS, *_DATES, *_TIMES, *_OTHERS])
    date, time = _date_and_time(header)
    uids = first.uids
    number = first.labels["number"]
    return SourceImages(
        _patient(header),
        uids.study,
        uids.series,
        uids.world
        if _is_uid(uids.world)
        else derived_uid(uids.study, uids.series, "frame of reference"),
        first.labels["modality"] or "OT",
        int(number) if re.fullmatch("[0-9]{1,7}", number) else 0,
        date,
        time,
        tuple(frames),
    )


def _is_uid(text: str) -> bool:
    return re.fullmatch(r"[0-9]+(\.[0-9]+)*", text) is not None and len(text) <= 64


def _check_uid(frame: Frame, keyword: str, uid: str) -> None:
    if not _is_uid(uid):
        raise InputError(f"{frame.path.name}: has no {keyword}", _HINT)


def _text(header: Any, keyword: str) -> str:
    """A value as a text; "" where it is missing, empty or unreadable."""
    try:
        with quiet():
            value = header.get(keyword)
    except Exception:  # a damaged value may raise any error; it counts as missing
        return ""
    return "" if value is None else str(value).strip().strip("\0")


def _patient(header: Any) -> dict[str, str]:
    """Values that are copied of patient and study; "" for one that DICOM does not allow."""
    found = {keyword: short_text(_text(header, keyword)) for keyword in _TEXTS}
    for keywords, pattern in ((_DATES, r"[0-9]{8}"), (_TIMES, r"[0-9]{2,6}(\.[0-9]{1,6})?")):
        found |= {
            key: text if re.fullmatch(pattern, text := _text(header, key)) else ""
            for key in keywords
        }
    found["AccessionNumber"], found["StudyID"] = (
        found["AccessionNumber"][:16],
        found["StudyID"][:16],
    )
    sex, age = _text(header, "PatientSex"), _text(header, "PatientAge")
    found["PatientSex"] = sex if sex in ("M", "F", "O") else ""
    if re.fullmatch(r"[0-9]{3}[DWMY]", age):
        found["PatientAge"] = age
    return found


def _date_and_time(header: Any) -> tuple[str, str]:
    for what in _DATED:
        date, time = _text(header, f"{what}Date"), _text(header, f"{what}Time")
        if re.fullmatch(r"[0-9]{8}", date):
            return date, time if re.fullmatch(r"[0-9]{6}(\.[0-9]{1,6})?", time) else NO_TIME
    return NO_DATE, NO_TIME
