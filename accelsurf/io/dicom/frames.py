"""Frames of DICOM files: place, contrast, time and meaning of the values of each slice.

Of reconstructed slices of nuclear medicine the file gives the place of the first alone.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf.errors import InputError
from accelsurf.io.dicom import sources
from accelsurf.io.dicom.sources import (
    HEADER_HINT,
    Elements,
    PixelBytes,
    damage_of,
    dicom_library,
    listed,
    number_of,
    numbers_of,
    read_header,
    text,
)
from accelsurf.settings import budgets

_NUCLEAR_TAGS = (
    "DetectorInformationSequence",
    "SliceVector",
    "TimeSlotVector",
    "EnergyWindowVector",
)
_NUCLEAR = "1.2.840.10008.5.1.4.1.1.20"
_RECONSTRUCTED = {"RECON TOMO", "RECON GATED TOMO"}
_TAGS = [
    *(
        "SOPClassUID",
        "SOPInstanceUID",
        "StudyInstanceUID",
        "SeriesInstanceUID",
        "FrameOfReferenceUID",
        "Modality",
    ),
    *(
        "SeriesDescription",
        "SeriesNumber",
        "InstanceNumber",
        "ImageType",
        "Rows",
        "Columns",
        "NumberOfFrames",
    ),
    *(
        "ImagePositionPatient",
        "ImageOrientationPatient",
        "PixelSpacing",
        "ImagerPixelSpacing",
        "SliceThickness",
    ),
    *(
        "SpacingBetweenSlices",
        "RescaleSlope",
        "RescaleIntercept",
        "RescaleType",
        "Units",
        "BitsStored",
    ),
    *(
        "BitsAllocated",
        "PixelRepresentation",
        "SamplesPerPixel",
        "PhotometricInterpretation",
        "EchoTime",
    ),
    *(
        "AcquisitionNumber",
        "AcquisitionTime",
        "ContentTime",
        "TemporalPositionIdentifier",
        "TriggerTime",
    ),
    *("DiffusionBValue", "DiffusionGradientOrientation", "SharedFunctionalGroupsSequence"),
    *(
        "PerFrameFunctionalGroupsSequence",
        "FrameTime",
        "FrameTimeVector",
        "CineRate",
        "RecommendedDisplayFrameRate",
    ),
    *(
        "ModalityLUTSequence",
        *(
            f"{kind}PixelPadding{part}"
            for kind in ("", "Float", "DoubleFloat")
            for part in ("Value", "RangeLimit")
        ),
    ),
    *sources.TAGS,
    *_NUCLEAR_TAGS,
]
#: Samples of a pixel on average, where colours are stored for pairs of pixels.
_HALVED = "YBR_FULL_422"
_MAX_SIDE = 1 << 16
_MAX_BITS = 64


class Identifiers(NamedTuple):
    """UIDs of study, series, object and frame of reference; empty where a file does not say them."""

    study: str
    series: str
    instance: str
    world: str


class PixelForm(NamedTuple):
    """Form of the numbers of a pixel: bits that count, bits in the file, sign, how many, and their kind of colour."""

    bits: int
    allocated: int
    is_signed: bool
    samples: int
    colour: str


@dataclass(frozen=True)
class Frame:
    """One slice.

    Attributes
    ----------
    path : Path
    rows, columns : int
    uids : Identifiers
    labels : dict of str to str
        modality, description, number, unit, class; kind: type of an object that is no slice of a volume, else empty.
    pixel : PixelForm
    padding : tuple of float or None
        Lowest and highest stored number where there is no image.
    number : int
        Of the frame in its file, from 0 on.
    frames : int
        How many the file has.
    position : tuple of float or None
        Centre of the first pixel, mm, LPS.
    orientation : tuple of float or None
        Directions along a row and along a column, six numbers.
    spacing : tuple of float or None
        Between rows and between columns, mm.
    thickness : float or None
        Distance to the next slice as the file says it, mm; negative where the next lies against the normal.
    slope, intercept : float
        Value = slope * stored + intercept.
    phase : dict of str to str
        Elements that may tell apart slices at one place.
    times : dict of str to float
        Times in seconds, and other numbers that give the order of slices at one place, by name; see `_times`.
    has_table : bool
        Whether a table maps stored numbers to values, in place of slope and intercept.
    """

    path: Path
    rows: int
    columns: int
    uids: Identifiers
    labels: dict[str, str]
    pixel: PixelForm
    padding: tuple[float, float] | None = None
    number: int = 0
    frames: int = 1
    position: tuple[float, ...] | None = None
    orientation: tuple[float, ...] | None = None
    spacing: tuple[float, ...] | None = None
    thickness: float | None = None
    slope: float = 1.0
    intercept: float = 0.0
    phase: dict[str, str] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    has_table: bool = False


def frames_of(path: Path, of_segmentation: bool = False) -> list[Frame]:
    """Read the slices of a file, without their values.

    Parameters
    ----------
    path : Path
    of_segmentation : bool
        Whether all frames of a segmentation are wanted; else the first stands for all, as in any object but slices.

    Returns
    -------
    list of Frame
        Empty where the file has no image.

    Raises
    ------
    InputError
        When the file is damaged, or has less than its header announces.
    """
    dataset, pixels = read_header(path, _TAGS)
    with damage_of(path, HEADER_HINT):  # elements are converted where they are asked for
        return _frames(path, Elements(dataset), pixels, of_segmentation)


def _frames(
    path: Path, dataset: Elements, pixels: PixelBytes | None, of_segmentation: bool
) -> list[Frame]:
    rows, columns = (int(dataset.get(name) or 0) for name in ("Rows", "Columns"))
    kind = sources.kind_of(dataset)
    if kind and not (of_segmentation and kind == sources.SEGMENTATION):
        return [_frame(_common(path, dataset), dataset, 0, 1, _elapsed(dataset), kind)]
    if not any(dataset.get(name) for name in ("SOPClassUID", "Modality", "Rows")):
        what = "its header has no SOP class, modality or number of rows; cut short?"
        raise InputError(f"{path.name}: {what}", "copy it again")
    if rows <= 0 or columns <= 0 or pixels is None:
        if pixels is not None or sources.is_image(dataset):
            what = "no pixels" if pixels is None else "no rows and columns"
            raise InputError(f"{path.name}: {what} in it; cut short?", "copy it again")
        return []
    count = int(dataset.get("NumberOfFrames") or 1)
    if count < 1 or rows > _MAX_SIDE or columns > _MAX_SIDE:
        raise InputError(
            f"{path.name}: {columns} x {rows} pixels, {count} frames announced", HEADER_HINT
        )
    budgets.DICOM_FRAMES.check(count, f"{path.name} announces")
    _check_pixels(path, dataset, pixels, rows * columns, count)
    groups = dataset.get("PerFrameFunctionalGroupsSequence")
    if groups and len(groups) != count:
        raise InputError(
            f"{path.name}: {count} frames announced, {len(groups)} described", HEADER_HINT
        )
    common, elapsed = _common(path, dataset), _elapsed(dataset)
    order = order_of(dataset, count)
    if groups or _is_reconstructed(dataset):
        return [_frame(common, dataset, number, count, elapsed) for number in order]
    # Frames of a plain loop differ by time alone.
    first = _frame(common, dataset, 0, count, elapsed)
    return [
        replace(first, number=number, times=_times(dataset, number, elapsed)) for number in order
    ]


def _check_pixels(path: Path, dataset: Elements, pixels: PixelBytes, size: int, count: int) -> None:
    """Refuse a file that has less than its header announces, before anything is allocated for it."""
    bits, samples = (
        int(dataset.get("BitsAllocated") or 16),
        int(dataset.get("SamplesPerPixel") or 1),
    )
    if not 1 <= bits <= _MAX_BITS or not 1 <= samples <= 4:
        raise InputError(f"{path.name}: {samples} samples of {bits} bits for a pixel", HEADER_HINT)
    if text(dataset, "PhotometricInterpretation") == _HALVED and pixels.announced is not None:
        samples = 2
    syntax = getattr(dataset.dataset, "file_meta", {}).get("TransferSyntaxUID")
    is_packed = syntax is not None and dicom_library("pydicom.uid").UID(syntax).is_encapsulated
    if is_packed != (pixels.announced is None):
        raise InputError(
            f"{path.name}: its pixels are {'not compressed' if is_packed else 'compressed'}, but its transfer syntax "
            f"({getattr(syntax, 'name', 'none')}) says that they are{'' if is_packed else ' not'}",
            "export it again",
        )
    if pixels.announced is not None:
        needed = (size * count * samples * bits + 7) // 8
        if pixels.present < needed:
            raise InputError(
                f"{path.name}: {pixels.present} of {needed} bytes of its pixels are there; cut short?",
                "copy it again",
            )
        if pixels.announced >= needed + size * samples * bits // 8 > needed:
            raise InputError(
                f"{path.name}: {count} frames announced, {pixels.announced} bytes of pixels in it, {needed} expected",
                HEADER_HINT,
            )
        return
    if not pixels.is_whole:
        raise InputError(
            f"{path.name}: its compressed pixels have no end mark; cut short?", "copy it again"
        )
    if pixels.pieces < count:
        raise InputError(
            f"{path.name}: {count} frames announced, {pixels.pieces} compressed ones in it "
            f"({getattr(syntax, 'name', 'none')})",
            "if it is a video, export its frames as images; else export the scan again",
        )
    budgets.DICOM_PACKED.check(
        size * samples * bits // 8,
        f"{path.name} announces for each frame",
        pixels.present // count + 4096,
    )


def _common(path: Path, dataset: Elements) -> Frame:
    """A frame with the elements that a file has for all its frames."""
    allocated = int(dataset.get("BitsAllocated") or 16)
    pixel = PixelForm(
        int(dataset.get("BitsStored") or allocated),
        allocated,
        bool(dataset.get("PixelRepresentation") or 0),
        int(dataset.get("SamplesPerPixel") or 1),
        text(dataset, "PhotometricInterpretation"),
    )
    names = {
        "modality": "Modality",
        "description": "SeriesDescription",
        "number": "SeriesNumber",
        "class": "SOPClassUID",
    }
    kinds_of_uid = ("StudyInstance", "SeriesInstance", "SOPInstance", "FrameOfReference")
    return Frame(
        path,
        int(dataset.get("Rows") or 0),
        int(dataset.get("Columns") or 0),
        Identifiers(*(text(dataset, f"{name}UID") for name in kinds_of_uid)),
        {label: text(dataset, name) for label, name in names.items()},
        pixel,
        _padding(path, dataset, pixel),
    )


def _frame(
    common: Frame,
    dataset: Elements,
    number: int,
    count: int,
    elapsed: tuple[float, ...],
    kind: str = "",
) -> Frame:
    place = _group(dataset, number, "PlanePositionSequence")
    turn = _group(dataset, number, "PlaneOrientationSequence")
    size = _group(dataset, number, "PixelMeasuresSequence")
    scale = _group(dataset, number, "PixelValueTransformationSequence")
    table = scale.get("ModalityLUTSequence")
    slope, intercept = (
        (1.0, 0.0)
        if table
        else (
            _rescaling(common.path, scale, "RescaleSlope", 1.0),
            _rescaling(common.path, scale, "RescaleIntercept", 0.0),
        )
    )
    if slope == 0:
        raise InputError(f"{common.path.name}: its values are scaled by 0", HEADER_HINT)
    spacing = numbers_of(size, "PixelSpacing", 2) or numbers_of(dataset, "ImagerPixelSpacing", 2)
    position, orientation = place_of(dataset, number) or (
        numbers_of(place, "ImagePositionPatient", 3),
        numbers_of(turn, "ImageOrientationPatient", 6),
    )
    phase = _phase(common.path, dataset, number, count)
    return replace(
        common,
        number=number,
        frames=count,
        position=position,
        orientation=orientation,
        spacing=spacing if spacing is not None and min(spacing) > 0 else None,
        thickness=number_of(size, "SpacingBetweenSlices")
        or number_of(size, "SliceThickness")
        or None,
        slope=slope,
        intercept=intercept,
        labels={**common.labels, "unit": _unit(dataset, scale, table), "kind": kind},
        phase={name: value for name, value in phase.items() if value},
        times=_times(dataset, number, elapsed),
        has_table=bool(table),
    )


def _rescaling(path: Path, dataset: Any, name: str, default: float) -> float:
    """Slope or intercept; the default where the element is absent or empty, and no value that is none."""
    given = text(dataset, name)
    number = number_of(dataset, name) if given else default
    if number is None:
        raise InputError(
            f"{path.name}: {name} is {given[:40]}, a finite number expected", HEADER_HINT
        )
    return number


def _padding(path: Path, dataset: Elements, pixel: PixelForm) -> tuple[float, float] | None:
    """Return the lowest and the highest stored number where there is no image."""
    for kind in ("", "Float", "DoubleFloat"):
        value = dataset.get(f"{kind}PixelPaddingValue")
        if value is None or value == "":
            continue
        limit = dataset.get(f"{kind}PixelPaddingRangeLimit")
        ends = [float(end) for end in (value, value if limit is None or limit == "" else limit)]
        if not all(map(math.isfinite, ends)):
            raise InputError(f"{path.name}: the value of its padding is no number", HEADER_HINT)
        if (
            not kind
        ):  # some write it without the sign of their pixels, or with one that they have not
            whole = 1 << pixel.allocated
            sign = pixel.is_signed
            ends = [end - whole if sign and end >= whole // 2 else end for end in ends]
            ends = [end + whole if not sign and end < 0 else end for end in ends]
        return min(ends), max(ends)
    return None


def _group(dataset: Any, number: int, name: str) -> Any:
    """A functional group of a frame: its own, else that of all frames, else the file's top level."""
    for sequence, place in (
        ("PerFrameFunctionalGroupsSequence", number),
        ("SharedFunctionalGroupsSequence", 0),
    ):
        groups = dataset.get(sequence)
        if groups and place < len(groups) and (found := groups[place].get(name)):
            return found[0]
    return dataset


def _frame_type(dataset: Any, number: int) -> str:
    for name in ("MRImageFrameTypeSequence", "CTImageFrameTypeSequence", "PETFrameTypeSequence"):
        group = _group(dataset, number, name)
        if group is not dataset:
            return "\\".join(listed(group.get("FrameType")))
    return "\\".join(listed(dataset.get("ImageType")))


def _phase(path: Path, dataset: Any, number: int, count: int) -> dict[str, str]:
    """Elements that may tell apart slices at one place, most telling first."""
    content = _group(dataset, number, "FrameContentSequence")
    echo = _group(dataset, number, "MREchoSequence")
    diffusion = _group(dataset, number, "MRDiffusionSequence")
    gradient = (
        _group(diffusion, 0, "DiffusionGradientDirectionSequence")
        if diffusion is not dataset
        else dataset
    )
    segment = _group(dataset, number, "SegmentIdentificationSequence")
    return {
        "segment": text(segment, "ReferencedSegmentNumber"),
        "stack": text(content, "StackID"),
        "type": _frame_type(dataset, number),
        "echo time": text(echo, "EffectiveEchoTime") or text(dataset, "EchoTime"),
        "time point": text(content, "TemporalPositionIndex")
        or text(dataset, "TemporalPositionIdentifier"),
        "trigger time": text(dataset, "TriggerTime"),
        "b-value": text(diffusion, "DiffusionBValue"),
        "gradient": text(gradient, "DiffusionGradientOrientation"),
        "acquisition": text(dataset, "AcquisitionNumber"),
        "acquisition time": text(content, "FrameAcquisitionDateTime")
        or text(dataset, "AcquisitionTime"),
        **phase_of(dataset, number),
        "file": path.name if count > 1 else "",
    }


def _times(dataset: Elements, number: int, elapsed: tuple[float, ...]) -> dict[str, float]:
    """Times, s (from the first, since the heart's trigger, in the file, of the day), and numbers that give order."""
    content = _group(dataset, number, "FrameContentSequence")
    trigger = number_of(
        _group(dataset, number, "CardiacSynchronizationSequence"), "NominalCardiacTriggerDelayTime"
    )
    trigger = number_of(dataset, "TriggerTime") if trigger is None else trigger
    offset = _group(dataset, number, "TemporalPositionSequence")
    point = text(content, "TemporalPositionIndex") or text(dataset, "TemporalPositionIdentifier")
    instance = number_of(dataset, "InstanceNumber")
    found = {
        "offset": None if offset is dataset else number_of(offset, "TemporalPositionTimeOffset"),
        "trigger": None if trigger is None else 1e-3 * trigger,
        "point": float(point) if point.isdigit() else None,
        "frame": _time_in_file(dataset, number, elapsed),
        "acquisition": _seconds(
            text(content, "FrameAcquisitionDateTime") or text(dataset, "AcquisitionTime")
        ),
        "content": _seconds(text(dataset, "ContentTime")),
        "number": None if instance is None else instance * budgets.DICOM_FRAMES.limit + number,
    }
    return {
        name: value for name, value in found.items() if value is not None and math.isfinite(value)
    }


def _elapsed(dataset: Elements) -> tuple[float, ...]:
    """Times of the frames of a loop, seconds from the first, where the file has a list of steps."""
    steps = dataset.get("FrameTimeVector")
    if steps is None or isinstance(steps, (str, int, float)):
        return ()
    return tuple(
        1e-3 * time for time in accumulate([0.0, *(float(step) for step in list(steps)[1:])])
    )


def _time_in_file(dataset: Elements, number: int, elapsed: tuple[float, ...]) -> float | None:
    """Time of a frame of a loop, seconds from the first."""
    if number < len(elapsed):
        return elapsed[number]
    step = number_of(dataset, "FrameTime")
    if step is not None and step > 0:
        return 1e-3 * step * number
    rate = number_of(dataset, "CineRate") or number_of(dataset, "RecommendedDisplayFrameRate")
    return number / rate if rate is not None and rate > 0 else None


def _seconds(value: str) -> float | None:
    """Seconds since midnight of a time HHMMSS.F, or of a date and time."""
    found = re.fullmatch(
        r"(?:[0-9]{8})?([0-9]{2})([0-9]{2})([0-9]{2}(?:\.[0-9]{1,6})?)(?:[+-][0-9]{4})?", value
    )
    if found is None:
        return None
    hours, minutes, seconds = (float(part) for part in found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def _unit(dataset: Elements, scale: Any, table: Any) -> str:
    """The unit of the values as the file says it; HU of a CT that says nothing else."""
    said = text(table[0], "ModalityLUTType") if table else text(scale, "RescaleType")
    said = said or text(dataset, "Units")
    if text(dataset, "Modality") == "CT":
        return "HU" if said.upper() in ("", "HU", "US") else said
    return "" if said.upper() in ("US", "NONE") else said


def _is_reconstructed(dataset: Any) -> bool:
    return str(dataset.get("SOPClassUID")) == _NUCLEAR and bool(
        _RECONSTRUCTED & set(listed(dataset.get("ImageType")))
    )


def order_of(dataset: Any, count: int) -> list[int]:
    """The frames of a file in the order of their slices; as they come where nothing else is said."""
    numbers = list(range(count))
    if not _is_reconstructed(dataset):
        return numbers
    places = [_entry(dataset, "SliceVector", number) for number in numbers]
    return numbers if None in places else sorted(numbers, key=lambda number: places[number] or 0)


def place_of(dataset: Any, number: int) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Position (3) and directions (6) of a frame; None where the file is of another kind, or does not say them.

    The sign of *Spacing Between Slices* says whether slices follow along the normal or against it (PS3.3 C.8.4.15).
    """
    if not _is_reconstructed(dataset):
        return None
    detectors = dataset.get("DetectorInformationSequence")
    first = detectors[0] if detectors else dataset
    position, turn = (
        numbers_of(first, "ImagePositionPatient", 3),
        numbers_of(first, "ImageOrientationPatient", 6),
    )
    step = number_of(dataset, "SpacingBetweenSlices")
    if position is None or turn is None or step is None:
        return None
    place = _entry(dataset, "SliceVector", number)
    normal = np.cross(turn[:3], turn[3:])
    moved = np.array(position) + (number if place is None else place - 1) * step * normal
    return tuple(moved.tolist()), turn


def phase_of(dataset: Any, number: int) -> dict[str, str]:
    """Elements that may tell apart slices at one place."""
    if not _is_reconstructed(dataset):
        return {}
    names = {"energy window": "EnergyWindowVector", "trigger time": "TimeSlotVector"}
    found = {what: _entry(dataset, name, number) for what, name in names.items()}
    return {what: str(value) for what, value in found.items() if value is not None}


def _entry(dataset: Any, name: str, number: int) -> int | None:
    """Entry of a vector for a frame; None where there is none."""
    value = dataset.get(name)
    if value is None or isinstance(value, (str, bytes)):
        return None
    if isinstance(value, int):
        return value if number == 0 else None
    return int(value[number]) if number < len(value) else None
