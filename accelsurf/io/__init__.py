"""Files in and out: images in every format that can be read or written, meshes, and writing that is all or nothing."""

from accelsurf.io.images import (
    SUFFIXES,
    WARNING_KEY,
    available_memory,
    components,
    label_type,
    read,
    read_labels,
    sha256,
    split_name,
    write,
    write_labels,
)

__all__ = [
    "SUFFIXES",
    "WARNING_KEY",
    "available_memory",
    "components",
    "label_type",
    "read",
    "read_labels",
    "sha256",
    "split_name",
    "write",
    "write_labels",
]
