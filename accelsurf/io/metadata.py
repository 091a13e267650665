"""Keys of `Volume.metadata` that do not belong to one format."""

from collections.abc import Mapping

WARNING_KEY = "warning"
"""A warning about the file that was read; absent when there is none."""

LABELS_KEY = "labels"
"""Names and colours of a label map, from `accelsurf.settings.labels.LabelTable.to_json`; absent where none are known.
"""

DICOM_KEY = "dicom_series"
"""The UID of the series that an image was read from; absent where it was no DICOM."""

ZERO_BEYOND_KEY = "zero_beyond"
"""There where a label map's format stores only voxels near labels, as a DICOM segmentation: all beyond them are 0."""

VALUE_UNIT_KEY = "value_unit"
"""The unit of the values, as HU, where the file says it."""

ORIENTED_KEY = "ome_oriented"
"""Present where the axes of an OME-Zarr were given an anatomical orientation."""

UNIT_KEY = "spatial_unit"
"""The unit in which the file gives lengths: nm or um; absent where it is mm, or none. All lengths here are mm."""
FRAME_KEY = "frame_seconds"
"""Seconds from one time point of a sequence to the next; absent where the file does not say them."""


def with_warnings(metadata: Mapping[str, str], *notes: str) -> dict[str, str]:
    """The metadata with further warnings.

    Examples
    --------
    >>> with_warnings({"warning": "a"}, "b", "")
    {'warning': 'a; b'}
    """
    said = "; ".join(note for note in (metadata.get(WARNING_KEY, ""), *notes) if note)
    return {**metadata, WARNING_KEY: said} if said else dict(metadata)
