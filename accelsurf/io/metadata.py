"""Keys of `Volume.metadata` that do not belong to one format."""

WARNING_KEY = "warning"
"""A warning about the file that was read; absent when there is none."""

LABELS_KEY = "labels"
"""Names and colours of a label map, from `accelsurf.settings.labels.LabelTable.to_json`; absent where none are known.
"""

DICOM_KEY = "dicom_series"
"""The UID of the series that an image was read from; absent where it was no DICOM."""

VALUE_UNIT_KEY = "value_unit"
"""The unit of the values, as HU, where the file says it."""
