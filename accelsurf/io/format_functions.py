"""The functions that read and write a format of images, and where they are entered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from accelsurf.settings.file_formats import ImageFormat


@dataclass(frozen=True)
class FormatFunctions:
    """All that can be done with a format of images.

    Attributes
    ----------
    parse : callable
        Of a Path, and where the format has ``options`` of `accelsurf.settings.reading.ReadOptions`, returns the
        content of the header, of any type; raises InputError or GeometryError.
    read : callable
        Of a Path, that header and the memory in bytes, returns a Volume; raises as `accelsurf.io.read` does.
    write : callable, optional
        Of a Volume, whose values have one of the ``types``, and a Path, which it makes. Further files may lie beside
        it; all are in a folder of their own until they are complete. None: it is read only.
    read_channels : callable, optional
        As ``read``, returns a list of a Volume for each channel; None: the format has one channel.
    write_labels : callable, optional
        As ``write``, of a label map; None: the same.
    read_labels : callable, optional
        As ``read``, with ranges of the labels that are wanted: of a format whose labels may overlap; None: the same.
    open : callable, optional
        Of a Path, that header and an `accelsurf.io.lazy_volume.Opening`, returns a LazyVolume, which is read box by
        box; None: the format is packed as a whole.
    store : callable, optional
        Of a Path, a Geometry, a type of values, metadata and a path to the image or None, returns the writer of
        label maps box by box (``write``, ``read``, ``finish``); None: it cannot be.
    sequence : callable, optional
        Of a Path, ReadOptions and the memory in bytes or None, returns the
        `accelsurf.io.sequences.sources.FileSequence` that is in it; None: one time point is read like the other.
    write_frames : callable, optional
        Of a Path, which it makes, and an `accelsurf.io.sequences.writing.FrameStack`: writes a sequence with its times;
        None: it cannot hold one.
    is_folder : callable, optional
        Of the Path of a folder without the format's marks, returns True if its files are an image of this format.
    is_file : callable, optional
        Of the Path of a file whose name has no known ending, returns True if it is of this format.
    listing : callable, optional
        Of a Path, a dictionary for each volume that it holds, for a person to choose from.
    """

    parse: Callable[..., Any]
    read: Callable[..., Any]
    write: Callable[..., None] | None = None
    read_channels: Callable[..., Any] | None = None
    write_labels: Callable[..., None] | None = None
    read_labels: Callable[..., Any] | None = None
    open: Callable[..., Any] | None = None
    store: Callable[..., Any] | None = None
    sequence: Callable[..., Any] | None = None
    write_frames: Callable[..., None] | None = None
    is_folder: Callable[..., bool] | None = None
    is_file: Callable[..., bool] | None = None
    listing: Callable[..., list[dict[str, Any]]] | None = None


#: By the name of a format, the import of its functions; `accelsurf.io.format_table` enters them.
FORMAT_FUNCTIONS: dict[str, Callable[[], FormatFunctions]] = {}


def functions_of(form: ImageFormat) -> FormatFunctions:
    """Return the functions of a format; their modules are imported now."""
    return FORMAT_FUNCTIONS[form.name]()
