"""Files in and out: images in every format that can be read or written, meshes, and writing that is all or nothing."""

from accelsurf.io.files import sha256
from accelsurf.io.headers import SUFFIXES, split_name
from accelsurf.io.images import WARNING_KEY, label_type, read, read_labels, write, write_labels
from accelsurf.io.memory import available_memory

__all__ = [
    "SUFFIXES",
    "WARNING_KEY",
    "available_memory",
    "label_type",
    "read",
    "read_labels",
    "sha256",
    "split_name",
    "write",
    "write_labels",
]
