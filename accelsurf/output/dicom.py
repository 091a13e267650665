"""The DICOM outputs of a run: segmentations, and RT Structure Sets with contours at sub-voxel positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.io import (
    DICOM_KEY,
    Algorithm,
    DicomHeader,
    Region,
    SourceImages,
    label_type,
    naming,
    parse_dicom,
    read_source_images,
    segmentation_bytes,
    structure_set_bytes,
    write_bytes,
)
from accelsurf.measure import in_slices
from accelsurf.run import Result, SegmentedObject, digest_of
from accelsurf.settings.catalogue import entry
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.labels import LabelTable
from accelsurf.settings.run_config import RunConfig
from accelsurf.version import __version__

#: Settings that change no voxel, beside the settings of output files.
_FREE = ("threads", "reproducible")


def write_segmentation(result: Result, table: LabelTable, path: Path) -> None:
    """Write the objects as the segments of a binary DICOM Segmentation.

    Parameters
    ----------
    result : Result
        Of an image that was read from DICOM.
    table : LabelTable
        Names and colours of the segments.
    path : Path
        The file; an existing one is replaced.

    Raises
    ------
    UsageError
        When the image was not read from DICOM, no object is left, or a package is missing.
    InputError
        When the slices cannot be read any more, or have no identifiers.
    OutputError
        When the file cannot be written.
    """
    _write(result, table, path, as_labelmap=False)


def write_labelmap(result: Result, table: LabelTable, path: Path) -> None:
    """Write the objects as a compressed DICOM Label Map Segmentation, else as `write_segmentation`."""
    _write(result, table, path, as_labelmap=True)


def _write(result: Result, table: LabelTable, path: Path, as_labelmap: bool) -> None:
    source = source_of(result)
    parameters = {"energy": result.config.energy, "flow": result.resolved_settings["flow"]}
    seed = seed_of("labelmap" if as_labelmap else "segmentation", result, table, source)
    content = segmentation_bytes(
        _labels_of(result),
        result.geometry,
        source,
        [table[segmented.id] for segmented in objects_of(result)],
        Algorithm(__version__, parameters),
        seed,
        as_labelmap,
    )
    write_bytes(path, content)


def _labels_of(result: Result) -> NDArray[np.unsignedinteger[Any]]:
    """The label map of the objects alone: other labels of a map that was mended are of whoever made it."""
    largest = max((segmented.id for segmented in result.objects), default=1)
    labels = result.labels
    if result.other_labels is not None:
        labels = np.where(result.other_labels > 0, 0, labels)
    return labels.astype(label_type(largest))


def source_of(result: Result) -> SourceImages:
    """The headers of the slices that the image of a run was read from.

    Raises
    ------
    UsageError
        When the image was not read from DICOM files.
    InputError
        When the slices cannot be read any more, have no identifiers, or a package is missing.
    """
    path = result.volume.source
    if path is None or DICOM_KEY not in result.volume.metadata:
        raise UsageError(
            "the image was not read from DICOM, whose slices DICOM outputs refer to",
            "give a DICOM series as the image",
        )
    with naming(path):
        header = parse_dicom(path, result.config.reading)
        if not isinstance(header, DicomHeader):
            raise UsageError(
                "the image is a DICOM segmentation, and DICOM outputs refer to the slices of a scan",
                "give the scan",
            )
        return read_source_images(header.slices.frames)


def objects_of(result: Result) -> list[SegmentedObject]:
    """The objects that have voxels, in the order of their ids."""
    return sorted(
        (found for found in result.objects if found.labels.any()), key=lambda found: found.id
    )


def seed_of(kind: str, result: Result, table: LabelTable, source: SourceImages) -> str:
    """Return the text that the identifiers of an output are made from: version, source, settings, names, voxels."""
    names = [table[segmented.id] for segmented in objects_of(result)]
    arrays = {"image": result.volume.array, "labels": result.labels}
    files = [key for key in RunConfig.model_fields if entry(key).group is SettingGroup.FILES]
    settings = result.config.model_dump_json(exclude={*files, *_FREE})
    return "\n".join(
        [
            kind,
            __version__,
            source.study_uid,
            *map(repr, source.instances),
            settings,
            repr(names),
            digest_of(arrays),
        ]
    )


def write_structure_set(result: Result, table: LabelTable, path: Path) -> None:
    """Write the contours of the objects as the regions of a DICOM RT Structure Set.

    Parameters
    ----------
    result : Result
        Of an image that was read from DICOM.
    table : LabelTable
        Names and colours of the regions.
    path : Path
        The file; an existing one is replaced.

    Raises
    ------
    UsageError
        When the image was not read from DICOM, no object is left, or a package is missing.
    InputError
        When the slices cannot be read any more, have no identifiers, or are not parallel to the grid's.
    OutputError
        When the file cannot be written.
    """
    source = source_of(result)
    regions = [Region(table[segmented.id], loops_of(segmented)) for segmented in objects_of(result)]
    seed = seed_of("structure set", result, table, source)
    write_bytes(path, structure_set_bytes(regions, result.geometry, source, __version__, seed))


def loops_of(segmented: SegmentedObject) -> dict[int, tuple[NDArray[np.float64], ...]]:
    """Closed contours of an object in world mm, LPS, by the index of the slice in the whole grid."""
    first = segmented.box[0].start or 0
    return {
        first + k: found.loops for k, found in in_slices(segmented.psi, segmented.geometry).items()
    }
