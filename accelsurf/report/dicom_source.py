"""What the DICOM outputs of a run have in common: its slices, its objects, what identifiers follow from."""

from __future__ import annotations

from accelsurf import __version__
from accelsurf.errors import UsageError
from accelsurf.io.dicom.source_images import SourceImages, read_source_images
from accelsurf.io.files import naming
from accelsurf.io.formats import dicom
from accelsurf.io.headers import DICOM_KEY
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run_checkpoint import digest_of
from accelsurf.settings.catalogue import entry
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.labels import LabelTable
from accelsurf.settings.run_config import RunConfig

#: Settings that change no voxel, beside those of the files that are written.
_FREE = ("threads", "reproducible")


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
            "the image was not read from DICOM, whose slices DICOM outputs refer to", "give a DICOM series as the image"
        )
    with naming(path):
        header = dicom.parse_dicom(path, result.config.reading)
        if not isinstance(header, dicom.DicomHeader):
            raise UsageError(
                "the image is a DICOM segmentation, and DICOM outputs refer to the slices of a scan", "give the scan"
            )
        return read_source_images(header.slices.frames)


def objects_of(result: Result) -> list[SegmentedObject]:
    """The objects that have voxels, in the order of their ids."""
    return sorted((one for one in result.objects if one.labels.any()), key=lambda one: one.id)


def seed_of(kind: str, result: Result, table: LabelTable, source: SourceImages) -> str:
    """What the identifiers of an output follow from: version, source, image, settings, names and voxels."""
    names = [table[one.id] for one in objects_of(result)]
    arrays = {"image": result.volume.array, "labels": result.labels}
    files = [key for key in RunConfig.model_fields if entry(key).group is SettingGroup.FILES]
    settings = result.config.model_dump_json(exclude={*files, *_FREE})
    return "\n".join(
        [kind, __version__, source.study_uid, *map(repr, source.instances), settings, repr(names), digest_of(arrays)]
    )
