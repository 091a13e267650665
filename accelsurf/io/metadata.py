"""Keys of `Volume.metadata` that do not belong to one format."""

WARNING_KEY = "warning"
"""A warning about the file that was read; absent when there is none."""

UNIT_KEY = "value_unit"
"""The unit of the values, as HU, where the file says it."""
