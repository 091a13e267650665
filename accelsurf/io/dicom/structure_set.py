"""DICOM RT Structure Sets: regions as closed contours in the planes of the slices that they were made of.

A region with a hole has a contour for it, and what is inside an odd number of contours of a plane belongs to the region
(exclusive or): so nearly every program reads contours of the type CLOSED_PLANAR. The data set is written by pydicom
in implicit VR: with explicit VR a value, and so a contour, could have 65534 bytes only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.library import library, quiet
from accelsurf.io.dicom.source_images import SourceImages
from accelsurf.io.dicom.writing_tools import SH, derived_uid, file_bytes, short_text
from accelsurf.settings.labels import LabelEntry

Floats = NDArray[np.float64]

_STRUCTURE_SET, _IMPLICIT = "1.2.840.10008.5.1.4.1.1.481.3", "1.2.840.10008.1.2"
#: Largest number of a region.
MAX_NUMBER = 2**31 - 1
_STUDY = "1.2.840.10008.3.1.2.3.1"
#: Of the software that wrote the file: a UUID that was made for it.
_IMPLEMENTATION = derived_uid("accelsurf", "DICOM")
#: Digits of a coordinate in mm after the point: nanometres, and 16 characters up to a kilometre.
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class Region:
    """One region.

    Attributes
    ----------
    entry : LabelEntry
        Its id, name and colour.
    loops : dict of int to sequence of ndarray (n, 3)
        Closed contours, world mm LPS, by the index of their slice.
    """

    entry: LabelEntry
    loops: Mapping[int, Sequence[Floats]]


def structure_set_bytes(
    regions: Sequence[Region], geometry: Geometry, source: SourceImages, version: str, seed: str
) -> bytes:
    """A DICOM RT Structure Set file.

    Parameters
    ----------
    regions : sequence of Region
        Their numbers are those of the label map.
    geometry : Geometry
        The grid whose slices the contours lie in, parallel to those of the source.
    source : SourceImages
    version : str
        Of accelsurf.
    seed : str
        What the identifiers follow from.

    Raises
    ------
    UsageError
        Without a region, or with an id that no region can have.
    InputError
        When the grid's slices are not parallel to those of the source, or a package is missing.
    """
    if not regions:
        raise UsageError("an RT Structure Set needs an object, none is left", "start closer to the objects")
    largest = max(region.entry.id for region in regions)
    if largest > MAX_NUMBER:
        raise UsageError(
            f"an RT Structure Set holds ids up to {MAX_NUMBER}, {largest} was given", "give the objects other ids"
        )
    by_slice = source.in_planes(geometry)
    with quiet():
        dataset = _head(source, version, seed)
        dataset.ReferencedFrameOfReferenceSequence = [_frame_of_reference(source)]
        dataset.StructureSetROISequence = [_roi(region.entry, source) for region in regions]
        dataset.ROIContourSequence = [_contours(region, by_slice) for region in regions]
        dataset.RTROIObservationsSequence = [_observation(region.entry) for region in regions]
        dataset.ApprovalStatus = "UNAPPROVED"
    return file_bytes(dataset)


def _item(**values: Any) -> Any:
    item = library("pydicom").Dataset()
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def _head(source: SourceImages, version: str, seed: str) -> Any:
    """The data set with file meta information, patient, study, series, equipment and the names of the whole."""
    meta = library("pydicom.dataset").FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = _STRUCTURE_SET, derived_uid(seed, "instance")
    meta.TransferSyntaxUID, meta.ImplementationClassUID = _IMPLICIT, _IMPLEMENTATION
    meta.ImplementationVersionName = "ACCELSURF"
    dataset = _item(SpecificCharacterSet="ISO_IR 192", **source.patient)
    dataset.file_meta, dataset.preamble = meta, b"\0" * 128
    dataset.SOPClassUID, dataset.SOPInstanceUID = _STRUCTURE_SET, meta.MediaStorageSOPInstanceUID
    dataset.StudyInstanceUID, dataset.SeriesInstanceUID = source.study_uid, derived_uid(seed, "series")
    dataset.FrameOfReferenceUID = source.frame_of_reference
    dataset.Modality, dataset.SeriesNumber = "RTSTRUCT", source.series_number * 100 + 3
    dataset.SeriesDescription, dataset.OperatorsName, dataset.InstanceNumber = "accelsurf contours", "", 1
    dataset.Manufacturer = dataset.ManufacturerModelName = "accelsurf"
    dataset.SoftwareVersions = short_text(version)
    dataset.StructureSetLabel = short_text("accelsurf", SH)
    dataset.StructureSetDescription = "Holes are contours of their own: exclusive or"
    for what in ("InstanceCreation", "Series", "StructureSet"):
        setattr(dataset, f"{what}Date", source.date)
        setattr(dataset, f"{what}Time", source.time)
    return dataset


def _frame_of_reference(source: SourceImages) -> Any:
    """The world of the contours, and the images that lie in it."""
    images = [
        _item(ReferencedSOPClassUID=sop_class, ReferencedSOPInstanceUID=instance)
        for sop_class, instance in source.instances
    ]
    series = _item(SeriesInstanceUID=source.series_uid, ContourImageSequence=images)
    study = _item(
        ReferencedSOPClassUID=_STUDY, ReferencedSOPInstanceUID=source.study_uid, RTReferencedSeriesSequence=[series]
    )
    return _item(FrameOfReferenceUID=source.frame_of_reference, RTReferencedStudySequence=[study])


def _roi(entry: LabelEntry, source: SourceImages) -> Any:
    return _item(
        ROINumber=entry.id,
        ReferencedFrameOfReferenceUID=source.frame_of_reference,
        ROIName=short_text(entry.name) or f"label {entry.id}",
        ROIGenerationAlgorithm="SEMIAUTOMATIC",
    )


def _observation(entry: LabelEntry) -> Any:
    return _item(
        ObservationNumber=entry.id, ReferencedROINumber=entry.id, RTROIInterpretedType="", ROIInterpreter=""
    )


def _contours(region: Region, by_slice: Sequence[Sequence[Frame]]) -> Any:
    items: list[Any] = []
    for k in sorted(region.loops):
        for loop in region.loops[k]:
            items.append(_contour(loop, by_slice[k], len(items) + 1))
    return _item(ROIDisplayColor=list(region.entry.color), ReferencedROINumber=region.entry.id, ContourSequence=items)


def _contour(loop: Floats, frames: Sequence[Frame], number: int) -> Any:
    item = _item(
        ContourGeometricType="CLOSED_PLANAR", NumberOfContourPoints=len(loop), ContourNumber=number
    )
    if frames:
        item.ContourImageSequence = [_image(frame) for frame in frames]
    # As bytes: pydicom would check each of some 100,000 numbers.
    text = "\\".join(map(_decimal, loop.ravel().tolist())).encode()
    raw, tag = library("pydicom.dataelem").RawDataElement, library("pydicom.tag").Tag("ContourData")
    item[tag] = raw(tag, "DS", len(text) + len(text) % 2, text + b" " * (len(text) % 2), 0, True, True)
    return item


def _image(frame: Frame) -> Any:
    item = _item(ReferencedSOPClassUID=frame.labels["class"], ReferencedSOPInstanceUID=frame.uids[2])
    if frame.frames > 1:
        item.ReferencedFrameNumber = frame.number + 1
    return item


def _decimal(value: float) -> str:
    """A coordinate as DICOM's decimal string: at most 16 characters.

    Examples
    --------
    >>> _decimal(-12.3456789), _decimal(-0.0000001), len(_decimal(-123456789012.3))
    ('-12.345679', '0.000000', 16)
    """
    text = f"{value:.{_DIGITS}f}"
    if len(text) > 16:
        text = text[:16]
    return "0.000000" if text == "-0.000000" else text
