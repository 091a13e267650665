"""Reconstructed slices of nuclear medicine: their order and places, which the file gives for the first frame alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from accelsurf.io.dicom.elements import Floats, listed, number_of, numbers_of

TAGS = ("DetectorInformationSequence", "SliceVector", "TimeSlotVector", "EnergyWindowVector")
_CLASS = "1.2.840.10008.5.1.4.1.1.20"
_RECONSTRUCTED = {"RECON TOMO", "RECON GATED TOMO"}


def _is_reconstructed(dataset: Any) -> bool:
    return str(dataset.get("SOPClassUID")) == _CLASS and bool(_RECONSTRUCTED & set(listed(dataset.get("ImageType"))))


def _entry(dataset: Any, name: str, number: int) -> int | None:
    """What a vector says of a frame; None where there is none."""
    value = dataset.get(name)
    if value is None or isinstance(value, (str, bytes)):
        return None
    if isinstance(value, int):
        return value if number == 0 else None
    return int(value[number]) if number < len(value) else None


def order_of(dataset: Any, count: int) -> list[int]:
    """The frames of a file in the order of their slices; as they come where nothing else is said."""
    numbers = list(range(count))
    if not _is_reconstructed(dataset):
        return numbers
    places = [_entry(dataset, "SliceVector", number) for number in numbers]
    return numbers if None in places else sorted(numbers, key=lambda number: places[number] or 0)


def place_of(dataset: Any, number: int) -> tuple[Floats, Floats] | None:
    """Position (3) and directions (6) of a frame; None where the file is of another kind, or does not say them.

    The sign of *Spacing Between Slices* says whether slices follow along the normal or against it (PS3.3 C.8.4.15).
    """
    if not _is_reconstructed(dataset):
        return None
    detectors = dataset.get("DetectorInformationSequence")
    first = detectors[0] if detectors else dataset
    position, turn = numbers_of(first, "ImagePositionPatient", 3), numbers_of(first, "ImageOrientationPatient", 6)
    step = number_of(dataset, "SpacingBetweenSlices")
    if position is None or turn is None or step is None:
        return None
    place = _entry(dataset, "SliceVector", number)
    normal = np.cross(turn[:3], turn[3:])
    moved = np.array(position) + (number if place is None else place - 1) * step * normal
    return tuple(moved.tolist()), turn


def phase_of(dataset: Any, number: int) -> dict[str, str]:
    """What may tell apart slices at one place."""
    if not _is_reconstructed(dataset):
        return {}
    names = {"energy window": "EnergyWindowVector", "trigger time": "TimeSlotVector"}
    found = {what: _entry(dataset, name, number) for what, name in names.items()}
    return {what: str(value) for what, value in found.items() if value is not None}
