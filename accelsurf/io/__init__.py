"""Files in and out: images in every format that can be read or written, meshes, and writing that is all or nothing."""

from accelsurf.io import format_table  # noqa: F401 (enters the functions of the formats)
from accelsurf.io.files import sha256
from accelsurf.io.headers import WARNING_KEY, is_stored, split_name
from accelsurf.io.images import label_type, read, read_labels
from accelsurf.io.label_store import LabelStore, on_grid, on_one_grid
from accelsurf.io.lazy_volume import LazyVolume, open_volume
from accelsurf.io.memory import available_memory
from accelsurf.io.sequences.reading import read_sequence
from accelsurf.io.sequences.writing import SequenceWriter
from accelsurf.io.writing import write, write_labels
from accelsurf.settings.file_formats import image_suffixes, written_suffixes

__all__ = [
    "LabelStore",
    "LazyVolume",
    "SequenceWriter",
    "WARNING_KEY",
    "available_memory",
    "image_suffixes",
    "is_stored",
    "label_type",
    "on_grid",
    "on_one_grid",
    "open_volume",
    "read",
    "read_labels",
    "read_sequence",
    "sha256",
    "split_name",
    "write",
    "write_labels",
    "written_suffixes",
]
