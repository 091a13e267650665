"""DICOM RT Structure Sets: regions as closed contours in the planes of the slices that they were made of.

A region with a hole has a contour for it, and points inside an odd number of contours of a plane belong to the region
(exclusive or): so nearly every program reads contours of the type CLOSED_PLANAR. The data set is written by pydicom
in implicit VR: with explicit VR a value, and so a contour, could have 65534 bytes only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.source_images import SourceImages
from accelsurf.io.dicom.sources import dicom_library, quiet
from accelsurf.io.dicom.writing_tools import (
    SH,
    data_set,
    derived_uid,
    file_bytes,
    filled,
    image_reference,
    reference,
    short_text,
)
from accelsurf.settings.labels import LabelEntry

_STRUCTURE_SET = "1.2.840.10008.5.1.4.1.1.481.3"
_IMPLICIT = "1.2.840.10008.1.2"
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
        Numbered as in the label map.
    geometry : Geometry
        The grid whose slices the contours lie in, parallel to the source's.
    source : SourceImages
    version : str
        Of accelsurf.
    seed : str
        Text from which the identifiers are derived.

    Raises
    ------
    UsageError
        Without a region, or with an id that no region can have.
    InputError
        When the slices of the grid and of the source are not parallel, or a package is missing.
    """
    if not regions:
        raise UsageError(
            "an RT Structure Set needs an object, none is left", "start closer to the objects"
        )
    largest = max(region.entry.id for region in regions)
    if largest > MAX_NUMBER:
        raise UsageError(
            f"an RT Structure Set holds ids up to {MAX_NUMBER}, {largest} was given",
            "give the objects other ids",
        )
    by_slice = source.in_planes(geometry)
    with quiet():
        dataset = filled(
            _head(source, version, seed),
            ReferencedFrameOfReferenceSequence=[_frame_of_reference(source)],
            StructureSetROISequence=[_roi(region.entry, source) for region in regions],
            ROIContourSequence=[_contours(region, by_slice) for region in regions],
            RTROIObservationsSequence=[_observation(region.entry) for region in regions],
            ApprovalStatus="UNAPPROVED",
        )
    return file_bytes(dataset)


def _head(source: SourceImages, version: str, seed: str) -> Any:
    """The data set with file meta information, patient, study, series, equipment and the names of the whole."""
    instance = derived_uid(seed, "instance")
    meta = filled(
        dicom_library("pydicom.dataset").FileMetaDataset(),
        MediaStorageSOPClassUID=_STRUCTURE_SET,
        MediaStorageSOPInstanceUID=instance,
        TransferSyntaxUID=_IMPLICIT,
        ImplementationClassUID=_IMPLEMENTATION,
        ImplementationVersionName="ACCELSURF",
    )
    times = {
        f"{what}{part}": value
        for what in ("InstanceCreation", "Series", "StructureSet")
        for part, value in (("Date", source.date), ("Time", source.time))
    }
    return data_set(
        file_meta=meta,
        preamble=b"\0" * 128,
        SpecificCharacterSet="ISO_IR 192",
        **source.patient,
        SOPClassUID=_STRUCTURE_SET,
        SOPInstanceUID=instance,
        StudyInstanceUID=source.study_uid,
        SeriesInstanceUID=derived_uid(seed, "series"),
        FrameOfReferenceUID=source.frame_of_reference,
        Modality="RTSTRUCT",
        SeriesNumber=source.series_number * 100 + 3,
        SeriesDescription="accelsurf contours",
        OperatorsName="",
        InstanceNumber=1,
        Manufacturer="accelsurf",
        ManufacturerModelName="accelsurf",
        SoftwareVersions=short_text(version),
        StructureSetLabel=short_text("accelsurf", SH),
        StructureSetDescription="Holes are contours of their own: exclusive or",
        **times,
    )


def _frame_of_reference(source: SourceImages) -> Any:
    """The world of the contours, and the images that lie in it."""
    images = [reference(*instance) for instance in source.instances]
    series = data_set(SeriesInstanceUID=source.series_uid, ContourImageSequence=images)
    study = reference(_STUDY, source.study_uid, RTReferencedSeriesSequence=[series])
    return data_set(
        FrameOfReferenceUID=source.frame_of_reference, RTReferencedStudySequence=[study]
    )


def _roi(entry: LabelEntry, source: SourceImages) -> Any:
    return data_set(
        ROINumber=entry.id,
        ReferencedFrameOfReferenceUID=source.frame_of_reference,
        ROIName=short_text(entry.name) or f"label {entry.id}",
        ROIGenerationAlgorithm="SEMIAUTOMATIC",
    )


def _observation(entry: LabelEntry) -> Any:
    return data_set(
        ObservationNumber=entry.id,
        ReferencedROINumber=entry.id,
        RTROIInterpretedType="",
        ROIInterpreter="",
    )


def _contours(region: Region, by_slice: Sequence[Sequence[Frame]]) -> Any:
    items: list[Any] = []
    for k in sorted(region.loops):
        for loop in region.loops[k]:
            items.append(_contour(loop, by_slice[k], len(items) + 1))
    return data_set(
        ROIDisplayColor=list(region.entry.color),
        ReferencedROINumber=region.entry.id,
        ContourSequence=items,
    )


def _contour(loop: Floats, frames: Sequence[Frame], number: int) -> Any:
    images = (
        {"ContourImageSequence": [image_reference(frame) for frame in frames]} if frames else {}
    )
    item = data_set(
        ContourGeometricType="CLOSED_PLANAR",
        NumberOfContourPoints=len(loop),
        ContourNumber=number,
        **images,
    )
    # As bytes: pydicom would check each of some 100,000 numbers.
    text = "\\".join(map(_decimal, loop.ravel().tolist())).encode()
    raw, tag = (
        dicom_library("pydicom.dataelem").RawDataElement,
        dicom_library("pydicom.tag").Tag("ContourData"),
    )
    item[tag] = raw(
        tag, "DS", len(text) + len(text) % 2, text + b" " * (len(text) % 2), 0, True, True
    )
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
