"""What each slice of a DICOM file says of itself: where it lies, what it is of, how its values are meant."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError
from accelsurf.io.dicom.library import quiet, read_dataset

Floats = tuple[float, ...]

_TAGS = [
    *("SOPClassUID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID", "Modality"),
    *("SeriesDescription", "SeriesNumber", "InstanceNumber", "ImageType", "Rows", "Columns", "NumberOfFrames"),
    *("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "ImagerPixelSpacing", "SliceThickness"),
    *("SpacingBetweenSlices", "RescaleSlope", "RescaleIntercept", "RescaleType", "Units", "BitsStored"),
    *("BitsAllocated", "PixelRepresentation", "SamplesPerPixel", "PhotometricInterpretation", "EchoTime"),
    *("AcquisitionNumber", "AcquisitionTime", "ContentTime", "TemporalPositionIdentifier", "TriggerTime"),
    *("DiffusionBValue", "DiffusionGradientOrientation", "SharedFunctionalGroupsSequence"),
    *("PerFrameFunctionalGroupsSequence", "FrameTime", "FrameTimeVector", "CineRate", "RecommendedDisplayFrameRate"),
    "TransferSyntaxUID",
]
#: The number of images in a mosaic and the block that says which way they follow (Siemens).
_MOSAIC_COUNT, _MOSAIC_CREATOR, _MOSAIC_BLOCK, _BLOCK_CREATOR = (
    0x0019_100A, 0x0019_0010, 0x0029_1010, 0x0029_0010,
)
#: Frames of a file: beyond that its header is damaged.
_MAX_FRAMES = 1 << 20
_MAX_SIDE = 1 << 16


@dataclass(frozen=True)
class Frame:
    """One slice.

    Attributes
    ----------
    path : Path
    number : int
        Of the frame in its file, from 0 on.
    frames : int
        How many the file has.
    corner : tuple of int or None
        First row and column, where the slice is a part of a mosaic.
    rows, columns : int
    position : tuple of float or None
        Centre of the first pixel, mm, LPS.
    orientation : tuple of float or None
        Directions along a row and along a column, six numbers.
    spacing : tuple of float or None
        Between rows and between columns, mm.
    thickness : float or None
        Distance to the next slice as the file says it, mm.
    slope, intercept : float
        Value = slope * stored + intercept.
    uids : tuple of str
        Of study, series, instance and frame of reference.
    labels : dict of str to str
        modality, description, number, unit, transfer syntax.
    image_type : tuple of str
    pixel : tuple
        Bits stored, bits allocated, whether signed, samples per pixel, photometric interpretation.
    phase : dict of str to str
        What may tell apart slices at one place.
    times : dict of str to float
        When it is, seconds, by what says so, and what else gives the order of slices at one place; see `_times`.
    """

    path: Path
    number: int
    frames: int
    corner: tuple[int, int] | None
    rows: int
    columns: int
    position: Floats | None
    orientation: Floats | None
    spacing: Floats | None
    thickness: float | None
    slope: float
    intercept: float
    uids: tuple[str, str, str, str]
    labels: dict[str, str]
    image_type: tuple[str, ...]
    pixel: tuple[int, int, bool, int, str]
    phase: dict[str, str]
    times: dict[str, float] = field(default_factory=dict)


def frames_of(path: Path) -> list[Frame]:
    """Read the slices of a file, without their values.

    Raises
    ------
    InputError
        When the file is damaged; one without an image gives none.
    """
    dataset = read_dataset(path, _TAGS)
    try:
        with quiet():  # elements are converted where they are asked for
            return _frames(path, dataset)
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:  # elements of a wrong kind, sequences too deep: what a damaged file can say has no end
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{path.name}: the header is damaged ({reason})", "copy it again") from error


def text(dataset: Any, name: str) -> str:
    """An element as text; empty where there is none."""
    value = dataset.get(name)
    return "" if value is None else " ".join(str(value).split())[:120]


def _numbers(dataset: Any, name: str, count: int) -> Floats | None:
    """So many finite numbers; None where the element has others."""
    value = None if dataset is None else dataset.get(name)
    if value is None or value == "":
        return None
    parts = [value] if isinstance(value, (int, float, str)) else list(value)
    found = tuple(float(part) for part in parts if part is not None)
    return found if len(found) == count and all(map(math.isfinite, found)) else None


def _number(dataset: Any, name: str) -> float | None:
    found = _numbers(dataset, name, 1)
    return None if found is None else found[0]


def _frames(path: Path, dataset: Any) -> list[Frame]:
    rows, columns = (int(dataset.get(name) or 0) for name in ("Rows", "Columns"))
    if rows <= 0 or columns <= 0:
        return []  # a report, a structure set, a state of display
    count = int(dataset.get("NumberOfFrames") or 1)
    if not 1 <= count <= _MAX_FRAMES or rows > _MAX_SIDE or columns > _MAX_SIDE:
        raise InputError(f"{path.name}: {columns} x {rows} pixels, {count} frames announced", "the header is damaged")
    image_type = tuple(str(part).upper() for part in _listed(dataset.get("ImageType")))
    if "MOSAIC" in image_type:
        from accelsurf.io.dicom.mosaic import tiles_of

        dataset = read_dataset(path, [*_TAGS, *_mosaic_tags()])
        return [_frame(path, dataset, 0, 1, image_type, tile) for tile in tiles_of(path, dataset)]
    return [_frame(path, dataset, number, count, image_type, None) for number in range(count)]


def _mosaic_tags() -> list[Any]:
    return [_MOSAIC_COUNT, _MOSAIC_CREATOR, _MOSAIC_BLOCK, _BLOCK_CREATOR]


def _listed(value: Any) -> list[Any]:
    return [] if value is None else [value] if isinstance(value, str) else list(value)


def _frame(path: Path, dataset: Any, number: int, count: int, image_type: tuple[str, ...], tile: Any) -> Frame:
    place = _group(dataset, number, "PlanePositionSequence")
    turn = _group(dataset, number, "PlaneOrientationSequence")
    size = _group(dataset, number, "PixelMeasuresSequence")
    scale = _group(dataset, number, "PixelValueTransformationSequence")
    slope, intercept = _number(scale, "RescaleSlope"), _number(scale, "RescaleIntercept")
    if slope == 0:
        raise InputError(f"{path.name}: its values are scaled by 0", "the header is damaged")
    spacing = _numbers(size, "PixelSpacing", 2) or _numbers(dataset, "ImagerPixelSpacing", 2)
    thickness = _number(size, "SpacingBetweenSlices") or _number(size, "SliceThickness")
    corner, rows, columns, position = None, int(dataset.Rows), int(dataset.Columns), _numbers(
        place, "ImagePositionPatient", 3
    )
    if tile is not None:
        corner, rows, columns, position = tile
    kind = _frame_type(dataset, number)
    return Frame(
        path, number, count, corner, rows, columns, position,
        _numbers(turn, "ImageOrientationPatient", 6),
        spacing if spacing is not None and min(spacing) > 0 else None,
        abs(thickness) if thickness else None,
        1.0 if slope is None else slope,
        0.0 if intercept is None else intercept,
        tuple(text(dataset, f"{one}UID") for one in  # type: ignore[arg-type]
              ("StudyInstance", "SeriesInstance", "SOPInstance", "FrameOfReference")),
        {
            "modality": text(dataset, "Modality"),
            "description": text(dataset, "SeriesDescription"),
            "number": text(dataset, "SeriesNumber"),
            "unit": _unit(dataset, scale),
            "class": text(dataset, "SOPClassUID"),
        },
        image_type,
        (
            int(dataset.get("BitsStored") or dataset.get("BitsAllocated") or 16),
            int(dataset.get("BitsAllocated") or 16),
            bool(dataset.get("PixelRepresentation") or 0),
            int(dataset.get("SamplesPerPixel") or 1),
            text(dataset, "PhotometricInterpretation"),
        ),
        {name: value for name, value in _phase(path, dataset, number, count, kind).items() if value},
        {name: value for name, value in _times(dataset, number).items() if value is not None and math.isfinite(value)},
    )


def _group(dataset: Any, number: int, name: str) -> Any:
    """A functional group of a frame: its own, else that of all frames, else the file's top level."""
    for sequence, place in (("PerFrameFunctionalGroupsSequence", number), ("SharedFunctionalGroupsSequence", 0)):
        groups = dataset.get(sequence)
        if groups and place < len(groups) and (found := groups[place].get(name)):
            return found[0]
    return dataset


def _frame_type(dataset: Any, number: int) -> str:
    for name in ("MRImageFrameTypeSequence", "CTImageFrameTypeSequence", "PETFrameTypeSequence"):
        group = _group(dataset, number, name)
        if group is not dataset:
            return "\\".join(map(str, _listed(group.get("FrameType"))))
    return ""


def _phase(path: Path, dataset: Any, number: int, count: int, kind: str) -> dict[str, str]:
    """What may tell apart slices at one place, most telling first."""
    content = _group(dataset, number, "FrameContentSequence")
    echo = _group(dataset, number, "MREchoSequence")
    diffusion = _group(dataset, number, "MRDiffusionSequence")
    gradient = _group(diffusion, 0, "DiffusionGradientDirectionSequence") if diffusion is not dataset else dataset
    return {
        "stack": text(content, "StackID"),
        "type": kind or "\\".join(map(str, _listed(dataset.get("ImageType")))),
        "echo time": text(echo, "EffectiveEchoTime") or text(dataset, "EchoTime"),
        "time point": text(content, "TemporalPositionIndex") or text(dataset, "TemporalPositionIdentifier"),
        "trigger time": text(dataset, "TriggerTime"),
        "b-value": text(diffusion, "DiffusionBValue"),
        "gradient": text(gradient, "DiffusionGradientOrientation"),
        "acquisition": text(dataset, "AcquisitionNumber"),
        "acquisition time": text(content, "FrameAcquisitionDateTime") or text(dataset, "AcquisitionTime"),
        "file": path.name if count > 1 else "",
    }


def _times(dataset: Any, number: int) -> dict[str, float | None]:
    """Seconds: offset from the first, since the heart's trigger, in the file, of the day; and what gives the order."""
    content = _group(dataset, number, "FrameContentSequence")
    trigger = _number(_group(dataset, number, "CardiacSynchronizationSequence"), "NominalCardiacTriggerDelayTime")
    trigger = _number(dataset, "TriggerTime") if trigger is None else trigger
    offset = _group(dataset, number, "TemporalPositionSequence")
    point = text(content, "TemporalPositionIndex") or text(dataset, "TemporalPositionIdentifier")
    instance = _number(dataset, "InstanceNumber")
    return {
        "offset": None if offset is dataset else _number(offset, "TemporalPositionTimeOffset"),
        "trigger": None if trigger is None else 1e-3 * trigger,
        "point": float(point) if point.isdigit() else None,
        "frame": _time_in_file(dataset, number),
        "acquisition": _seconds(text(content, "FrameAcquisitionDateTime") or text(dataset, "AcquisitionTime")),
        "content": _seconds(text(dataset, "ContentTime")),
        "number": None if instance is None else instance * _MAX_FRAMES + number,
    }


def _time_in_file(dataset: Any, number: int) -> float | None:
    """Time of a frame of a loop, seconds from the first."""
    steps = dataset.get("FrameTimeVector")
    if steps is not None and not isinstance(steps, (str, int, float)) and number < len(steps):
        return 1e-3 * math.fsum(float(step) for step in list(steps)[1 : number + 1])
    step = _number(dataset, "FrameTime")
    if step is not None and step > 0:
        return 1e-3 * step * number
    rate = _number(dataset, "CineRate") or _number(dataset, "RecommendedDisplayFrameRate")
    return number / rate if rate is not None and rate > 0 else None


def _seconds(value: str) -> float | None:
    """Seconds since midnight of a time HHMMSS.F, or of a date and time."""
    found = re.fullmatch(r"(?:[0-9]{8})?([0-9]{2})([0-9]{2})([0-9]{2}(?:\.[0-9]{1,6})?)(?:[+-][0-9]{4})?", value)
    if found is None:
        return None
    hours, minutes, seconds = (float(part) for part in found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def _unit(dataset: Any, scale: Any) -> str:
    """The unit of the values as the file says it; HU of a CT that says nothing else."""
    own = text(scale, "RescaleType") or text(dataset, "Units")
    if text(dataset, "Modality") == "CT":
        return "HU" if own.upper() in ("", "HU", "US") else own
    return "" if own.upper() in ("US", "NONE") else own
