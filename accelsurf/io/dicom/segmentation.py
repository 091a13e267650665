"""DICOM Segmentation objects: a label map as segments with names and colours, referring to the slices it was made of.

highdicom builds the object. It gets one source slice with clean values, and the grid's own planes: by itself it copies
values only from a source without any irregularity. The references to the source are written here, slice by slice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.source_images import SourceImages, pixel_for_pixel
from accelsurf.io.dicom.sources import dicom_library, quiet
from accelsurf.io.dicom.writing_tools import (
    data_set,
    derived_uid,
    file_bytes,
    filled,
    fix,
    image_reference,
    reference,
    short_text,
)
from accelsurf.settings.labels import LabelEntry

#: Largest number of a segment.
MAX_SEGMENT = 65535
#: Any image without frames, of which highdicom takes patient, study and frame of reference.
_SINGLE_FRAME = "1.2.840.10008.5.1.4.1.1.2"
_RLE = "1.2.840.10008.1.2.5"
_EXPLICIT = "1.2.840.10008.1.2.1"
#: Code, scheme, meaning. Slicer gives Tissue to segments that nothing is known of.
_TISSUE = ("85756007", "SCT", "Tissue")
_DEFORMABLE_MODELS = ("123111", "DCM", "Deformable Models")
_SEGMENTATION = ("113076", "DCM", "Segmentation")
_SOURCE = ("121322", "DCM", "Source image for image processing operation")


@dataclass(frozen=True)
class Algorithm:
    """The program that made the segments.

    Attributes
    ----------
    version : str
        Of accelsurf.
    parameters : dict of str to str
        Settings of the run, by name.
    """

    version: str
    parameters: dict[str, str]


def segmentation_bytes(
    labels: NDArray[np.unsignedinteger[Any]],
    geometry: Geometry,
    source: SourceImages,
    segments: Sequence[LabelEntry],
    algorithm: Algorithm,
    seed: str,
    as_labelmap: bool,
) -> bytes:
    """A DICOM Segmentation file.

    Parameters
    ----------
    labels : ndarray (nz, ny, nx)
        0 outside; every other value is the id of a segment.
    geometry : Geometry
        Its grid, with slices parallel to the source's.
    source : SourceImages
    segments : sequence of LabelEntry
        In the order of their ids. A binary object numbers them from 1 on, a label map by their ids.
    algorithm : Algorithm
    seed : str
        Text from which the identifiers are derived.
    as_labelmap : bool
        One frame a slice with the ids, compressed (RLE); else one bit a voxel, one frame a slice and segment.

    Returns
    -------
    bytes
        Frames without a voxel are left out.

    Raises
    ------
    UsageError
        Without a segment, or with an id beyond 65535 as a label map.
    InputError
        When the slices of the grid and of the source are not parallel, or a package is missing.
    """
    ids, numbers = _segment_numbers(segments, as_labelmap)
    values = _numbered(labels, ids, numbers)
    by_slice = source.in_planes(geometry)
    aligned = [
        next((f for f in found if pixel_for_pixel(f, geometry, k)), None)
        for k, found in enumerate(by_slice)
    ]
    highdicom = dicom_library("highdicom")
    dicom_library("highdicom.seg")
    with quiet():
        planes = _planes(highdicom, geometry, aligned)
        dataset = highdicom.seg.Segmentation(
            source_images=[_clean_slice(source, planes)],
            pixel_array=values,
            segmentation_type="LABELMAP" if as_labelmap else "BINARY",
            segment_descriptions=[
                _description(highdicom, entry, int(number), algorithm, seed)
                for entry, number in zip(segments, numbers, strict=True)
            ],
            **_description_of_object(source, algorithm, seed, as_labelmap),
            **planes,
        )
        _refer(dataset, geometry, source, by_slice)
        fix(dataset, seed, source.date, source.time)
    return file_bytes(dataset)


def _segment_numbers(
    segments: Sequence[LabelEntry], as_labelmap: bool
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Ids of the segments, and their numbers in the object."""
    if not segments:
        raise UsageError(
            "a DICOM Segmentation needs an object, none is left", "start closer to the objects"
        )
    ids = np.array([entry.id for entry in segments])
    if as_labelmap and ids[-1] > MAX_SEGMENT:
        raise UsageError(
            f"a DICOM label map holds ids up to {MAX_SEGMENT}, {ids[-1]} was given",
            "write dicom-seg, or other ids",
        )
    return ids, ids if as_labelmap else np.arange(1, len(ids) + 1)


def _description_of_object(
    source: SourceImages, algorithm: Algorithm, seed: str, as_labelmap: bool
) -> dict[str, Any]:
    """Identifiers, dates, and the program that made the object."""
    return dict(
        series_instance_uid=derived_uid(seed, "series"),
        series_number=source.series_number * 100 + (2 if as_labelmap else 1),
        sop_instance_uid=derived_uid(seed, "instance"),
        instance_number=1,
        manufacturer="accelsurf",
        manufacturer_model_name="accelsurf",
        software_versions=algorithm.version,
        device_serial_number="none",
        content_label="ACCELSURF",
        content_description="Objects segmented by accelsurf",
        series_description="accelsurf segmentation",
        content_date=source.date,
        content_time=source.time,
        transfer_syntax_uid=_RLE if as_labelmap else _EXPLICIT,
        omit_empty_frames=True,
    )


def _numbered(labels: NDArray[Any], ids: NDArray[Any], numbers: NDArray[Any]) -> NDArray[Any]:
    """The label map with numbers in place of ids, slice by slice: a table of all ids may be larger than the labels."""
    kind = np.uint8 if numbers[-1] <= 255 else np.uint16
    values = np.empty(labels.shape, kind)
    for k, plane in enumerate(labels):
        index = np.searchsorted(ids, plane)
        index[index == len(ids)] = 0
        values[k] = np.where(ids[index] == plane, numbers[index], 0)
    return values


def _clean_slice(source: SourceImages, planes: dict[str, Any]) -> Any:
    """A slice without pixels: patient, study and frame of reference of the source, in the first of the planes.

    highdicom takes orientation and measures from it if they nearly agree with the planes: so they are equal here.
    """
    dataset = data_set(
        **source.patient,
        SpecificCharacterSet="ISO_IR 192",
        SOPClassUID=_SINGLE_FRAME,
        SOPInstanceUID=source.instances[0][1],
        StudyInstanceUID=source.study_uid,
        SeriesInstanceUID=source.series_uid,
        FrameOfReferenceUID=source.frame_of_reference,
        Modality=source.modality,
        Rows=source.frames[0].rows,
        Columns=source.frames[0].columns,
    )
    for item in (
        planes["plane_positions"][0][0],
        planes["plane_orientation"][0],
        planes["pixel_measures"][0],
    ):
        dataset.update(item)
    return dataset


def _planes(highdicom: Any, geometry: Geometry, aligned: Sequence[Frame | None]) -> dict[str, Any]:
    """Places of the frames: as the source writes it where its pixels are the voxels, else as the grid says."""
    frames = [frame for frame in aligned if frame is not None]
    same = len(frames) == len(aligned)
    orientation = (
        frames[0].orientation if same else geometry.direction[:, :2].T.ravel().tolist()
    ) or ()
    spacing = (frames[0].spacing if same else geometry.spacing[1:]) or ()
    corners = [tuple(geometry.index_to_world((k, 0, 0)).tolist()) for k in range(geometry.shape[0])]
    positions = [frame.position or () for frame in frames] if same else corners
    height = geometry.spacing[0]
    return {
        "plane_positions": [
            highdicom.PlanePositionSequence("PATIENT", place) for place in positions
        ],
        "plane_orientation": highdicom.PlaneOrientationSequence("PATIENT", orientation),
        "pixel_measures": highdicom.PixelMeasuresSequence(
            pixel_spacing=spacing, slice_thickness=height, spacing_between_slices=height
        ),
    }


def _description(
    highdicom: Any, entry: LabelEntry, number: int, algorithm: Algorithm, seed: str
) -> Any:
    code = dicom_library("pydicom.sr.coding").Code
    return highdicom.seg.SegmentDescription(
        segment_number=number,
        segment_label=short_text(entry.name) or f"label {entry.id}",
        segmented_property_category=code(*_TISSUE),
        segmented_property_type=code(*_TISSUE),
        algorithm_type="SEMIAUTOMATIC",
        algorithm_identification=highdicom.AlgorithmIdentificationSequence(
            name="accelsurf",
            family=code(*_DEFORMABLE_MODELS),
            version=short_text(algorithm.version),
            source="accelsurf",
            parameters={key: short_text(text, 200) for key, text in algorithm.parameters.items()},
        ),
        tracking_uid=derived_uid(seed, "segment", str(entry.id)),
        tracking_id=f"label {entry.id}",
        display_color=highdicom.color.CIELabColor.from_rgb(*entry.color),
    )


def _refer(
    dataset: Any, geometry: Geometry, source: SourceImages, by_slice: Sequence[Sequence[Frame]]
) -> None:
    """Refer to all objects of the source, and from each frame to the objects in its plane."""
    every = [reference(*instance) for instance in source.instances]
    series = data_set(SeriesInstanceUID=source.series_uid, ReferencedInstanceSequence=every)
    filled(dataset, SourceImageSequence=every, ReferencedSeriesSequence=[series])
    normal = geometry.direction[:, 2]
    for group in dataset.PerFrameFunctionalGroupsSequence:
        place = np.array([float(v) for v in group.PlanePositionSequence[0].ImagePositionPatient])
        k = round(float((place - geometry.origin) @ normal) / geometry.spacing[0])
        images = [
            image_reference(
                frame,
                PurposeOfReferenceCodeSequence=[_coded(*_SOURCE)],
                SpatialLocationsPreserved="YES" if pixel_for_pixel(frame, geometry, k) else "NO",
            )
            for frame in by_slice[k]
        ]
        item = data_set(DerivationCodeSequence=[_coded(*_SEGMENTATION)], SourceImageSequence=images)
        filled(group, DerivationImageSequence=[item] if images else [])


def _coded(value: str, scheme: str, meaning: str) -> Any:
    return data_set(CodeValue=value, CodingSchemeDesignator=scheme, CodeMeaning=meaning)
