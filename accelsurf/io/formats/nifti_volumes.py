"""NIfTI volumes: read, opened, written whole or box by box, with names and colours of labels.

nibabel makes the headers; the voxels are read here, since ITK turns NaN and infinity into 0 without a word, ignores
small slopes, and reads voxels from places in the header. Box by box a plain NIfTI is written into a file that is sparse
where nothing was written; it is a NIfTI-2 where an axis has more than 32767 voxels.
Names and colours are in an extension of the header with the code 30 (CARET), as XML of Connectome Workbench; programs
that do not know it read the file as any other.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from gzip import GzipFile
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.formats import nifti, nifti_grid
from accelsurf.io.formats.deflate import gzip_writer
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels, write_box
from accelsurf.io.headers import LABELS_KEY, NIFTI_KEY, FrameTimes
from accelsurf.settings.labels import LabelTable

#: Voxels along an axis of a NIfTI-1: its sizes are 16-bit numbers.
MAX_AXIS = 2**15 - 1
_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_CODE = 30


def write_nifti(volume: Volume, path: Path) -> None:
    """Write a NIfTI, with the numbers and codes that placed the volume when it was read; compressed if it ends in .gz.

    The same volume gives the same bytes.
    """
    labels = volume.metadata.get(LABELS_KEY)
    extension = b"" if labels is None else extension_of(LabelTable.from_json(labels))
    with opened_nifti(path) as out:
        out.write(header_of(volume.geometry, volume.array.dtype, volume.metadata, extension))
        out.write(np.ascontiguousarray(volume.array, volume.array.dtype.newbyteorder("<")).data)


def opened_nifti(path: Path) -> AbstractContextManager[BinaryIO | GzipFile]:
    """Open a file to be written; all that is written is compressed if it ends in .gz."""
    return gzip_writer(path) if path.suffix == ".gz" else path.open("wb")


def header_of(
    geometry: Geometry,
    dtype: np.dtype[Any],
    metadata: Mapping[str, str],
    extension: bytes = b"",
    times: FrameTimes | None = None,
) -> bytes:
    """All bytes before the voxels: of a NIfTI-2 where an axis is too long for a NIfTI-1."""
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    shape = geometry.size if times is None else (*geometry.size, len(times.values))
    second = max(shape) > MAX_AXIS
    header = Nifti2Header(endianness="<") if second else Nifti1Header(endianness="<")
    affine = np.eye(4)
    affine[:3, :3] = geometry.direction * geometry.spacing_xyz
    affine[:3, 3] = geometry.origin
    header.set_data_dtype(dtype)
    header.set_data_shape(shape)
    header.set_qform(_RAS @ affine, code=1)
    header.set_sform(_RAS @ affine, code=1)
    header.set_xyzt_units("mm", "sec" if times is not None and times.unit == "s" else None)
    if times is not None:
        header["pixdim"][4] = times.mean_step
    header["scl_slope"], header["magic"] = 1.0, b"n+2" if second else b"n+1"
    header["vox_offset"] = len(header.binaryblock) + 4 + len(extension)
    block, fields = bytes(header.binaryblock), metadata.get(NIFTI_KEY)
    if fields is not None and not second:
        placed = nifti_grid.put_grid(block, fields)
        # Metadata may have come from another grid than the volume has now.
        with suppress(AccelsurfError):
            block = (
                placed if nifti.parse_header(placed).grid.geometry().matches(geometry) else block
            )
    return block + (b"\1\0\0\0" if extension else bytes(4)) + extension


def store_nifti(
    path: Path,
    geometry: Geometry,
    dtype: np.dtype[Any],
    metadata: Mapping[str, str],
    source: str | None,
) -> NiftiBoxes:
    """Begin a file that is written box by box; a NIfTI has no place for the name of its source."""
    return NiftiBoxes(path, geometry, dtype, metadata)


class NiftiBoxes:
    """A NIfTI that is being written; one thread at a time.

    Parameters
    ----------
    path : Path
        The file, which is made.
    geometry : Geometry
        The whole grid.
    dtype : numpy.dtype
        Of the values.
    metadata : mapping of str to str
        As in `Volume`: where it has the numbers and codes of a NIfTI header that place this grid, they are given back
        (in a NIfTI-1).
    """

    def __init__(
        self, path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str]
    ) -> None:
        begin = header_of(geometry, dtype, metadata)
        path.write_bytes(begin)
        self._layout = RawLayout(path, len(begin), dtype.newbyteorder("<"), geometry.shape)
        with path.open("r+b") as file:
            file.truncate(self._layout.end)

    def write(self, box: Box, array: NDArray[Any]) -> None:
        """Write the voxels of a box."""
        write_box(self._layout, box, array)

    def read(self, box: Box) -> NDArray[Any]:
        """Return the voxels of a box; 0 where none were written."""
        return RawVoxels(self._layout).read(box)

    def finish(self) -> None:
        """Nothing is left to do."""


def extension_of(table: LabelTable) -> bytes:
    """The extension: its size, a multiple of 16, its code, and the XML."""
    rows = "".join(
        f'<Label Key="{label.id}" Red="{label.color[0] / 255:.6g}" Green="{label.color[1] / 255:.6g}" '
        f'Blue="{label.color[2] / 255:.6g}" Alpha="1">{escape(label.name)}</Label>\n'
        for label in table
    )
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<CaretExtension>\n<VolumeInformation Index="0">\n<LabelTable>\n'
        f'<Label Key="0" Red="0" Green="0" Blue="0" Alpha="0">background</Label>\n{rows}'
        "</LabelTable>\n<VolumeType>Label</VolumeType>\n</VolumeInformation>\n</CaretExtension>\n"
    )
    return extension_with(_CODE, text)


def extension_with(code: int, text: str) -> bytes:
    """An extension: its size, a multiple of 16, its code, and a text."""
    content = text.encode()
    size = -(-(len(content) + 8) // 16) * 16
    return struct.pack("<2i", size, code) + content.ljust(size - 8, b"\0")
