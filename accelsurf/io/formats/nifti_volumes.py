"""NIfTI volumes: read, opened, written whole or box by box, with names and colours of labels.

ITK writes them, and places those of version 1 in the world; the voxels are read here, since ITK turns NaN and infinity
into 0 without a word, ignores small slopes, and reads voxels from places in the header. Box by box a plain NIfTI is
written into a file that is sparse where nothing was written; it is a NIfTI-2 where an axis has more than 32767 voxels.
Names and colours are in an extension of the header with the code 30 (CARET), as XML of Connectome Workbench; programs
that do not know it read the file as any other.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import itk
from accelsurf.io.files import reserve
from accelsurf.io.formats import itk_volumes, nifti, nifti_grid
from accelsurf.io.formats.deflate import gzip_file
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels, write_box
from accelsurf.io.headers import FRAME_KEY, LABELS_KEY, UNIT_KEY, with_warnings
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import check_memory
from accelsurf.settings.labels import LabelTable

#: Voxels along an axis of a NIfTI-1: its sizes are 16-bit numbers.
MAX_AXIS = 2**15 - 1
_DIM_OFFSET = 40
_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_CODE = 30
_HEADER, _FIRST = 348, 352
_OFFSET_PLACE = 108
#: Bytes before the voxels of a file that ITK writes.
_MAX_HEADER_BYTES = 352
#: The code of a unit of length in a header.
_MICRON = 3


def read_nifti(path: Path, header: nifti.NiftiFile, available: int) -> Volume:
    """Read a file of one volume.

    Parameters
    ----------
    path : Path
        The file.
    header : NiftiFile
        What its header claims.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file holds several volumes, is incomplete or larger than the memory; GeometryError when its header
        contradicts itself.
    """
    fields, number = header.nifti, header.single()
    if fields.version == 2 or fields.volumes > 1:
        return _read_some(path, header, [number], available)[0]
    scaled = (fields.slope, fields.intercept) != (1.0, 0.0) or not fields.voxel_type.isnative
    check_memory(fields.size, fields.voxel_type.itemsize + (8 if scaled else 0), available)
    # Packed voxels are counted, and their checksum verified, while they are read.
    geometry = itk.geometry_of(itk.open_reader(path, header.itk_name))
    return Volume(nifti.read_volumes(header, [0])[0], geometry, _metadata(header, geometry), path)


def read_nifti_channels(path: Path, header: nifti.NiftiFile, available: int) -> list[Volume]:
    """Read the volumes of a file, which follow one another in it.

    Raises
    ------
    InputError
        As `read_nifti`, and for more than `accelsurf.io.channels.MAX_CHANNELS` of them.
    """
    if header.nifti.volumes == 1:
        return [read_nifti(path, header, available)]
    return _read_some(path, header, header.selected(), available)


def _read_some(path: Path, header: nifti.NiftiFile, numbers: Sequence[int], available: int) -> list[Volume]:
    """Read volumes of a file that ITK does not read: one of version 2, or several one after the other."""
    fields = header.nifti
    # The voxels as they are stored and as they are given are in memory at the same time.
    span = max(numbers) - min(numbers) + 1
    needed = span * fields.voxel_type.itemsize + len(numbers) * fields.value_type.itemsize
    check_memory(fields.size[:3], needed, available)
    header.check_complete()
    geometry = fields.grid.geometry()
    metadata = _metadata(header, geometry)
    return [Volume(array, geometry, dict(metadata), path) for array in nifti.read_volumes(header, numbers)]


def _metadata(header: nifti.NiftiFile, geometry: Geometry) -> dict[str, str]:
    """The metadata of a volume: fields of its header, and a warning when qform and sform disagree."""
    fields, notes = header.nifti, [header.nifti.grid.check_agreement(geometry)]
    if fields.are_channels_guessed and header.asked.channel_index is None:
        notes.append(
            f"the {fields.volumes} volumes of the file are taken for channels: its header says nothing of time or "
            "vectors; --channel-index N takes one of them"
        )
    said = with_warnings(header.metadata, *notes)
    if fields.grid.units & 7 == _MICRON:
        said[UNIT_KEY] = "um"
    return said | {FRAME_KEY: repr(fields.seconds)} if fields.seconds and fields.time_points > 1 else said


def open_nifti(path: Path, header: nifti.NiftiFile, opening: Opening) -> LazyVolume:
    """Open an uncompressed file of one volume, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : NiftiFile
        What its header claims.
    opening : Opening
        Has no more to say here.

    Raises
    ------
    InputError
        As `read_nifti`.
    """
    fields = header.nifti
    number, (nx, ny, nz) = header.single(), fields.size[:3]
    offset = fields.data_offset + number * nx * ny * nz * fields.voxel_type.itemsize
    voxels = RawVoxels(RawLayout(path, offset, fields.voxel_type, (nz, ny, nx)), fields.values)
    by_itk = fields.version == 1 and fields.volumes == 1
    geometry = itk.geometry_of(itk.open_reader(path, nifti.ITK_NAME)) if by_itk else fields.grid.geometry()
    layout = StoreLayout((geometry,), None, fields.channels, fields.time_points)
    return LazyVolume(voxels, geometry, _metadata(header, geometry), path, layout)


def write_nifti(volume: Volume, path: Path) -> None:
    """Write NIfTI-1, with the numbers and codes that placed the volume when it was read."""
    reserve(path, volume.array.nbytes + _MAX_HEADER_BYTES)
    itk.save(volume, path, nifti.ITK_NAME, compress=False)
    if (fields := volume.metadata.get(nifti_grid.METADATA_KEY)) is not None:
        itk_volumes.restore_grid(path, volume.geometry, nifti.ITK_NAME, lambda file: nifti_grid.put_grid(file, fields))
    if (labels := volume.metadata.get(LABELS_KEY)) is not None:
        put_labels(path, LabelTable.from_json(labels))


def write_compressed(volume: Volume, path: Path) -> None:
    """Write NIfTI-1, compressed, the same bytes for the same volume."""
    plain = path.with_suffix("")  # ends in .nii
    write_nifti(volume, plain)
    gzip_file(plain, path)
    plain.unlink()


def store_nifti(
    path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str], source: str | None
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

    def __init__(self, path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str]) -> None:
        if max(geometry.shape) > MAX_AXIS:
            _write_second_header(path, geometry, dtype)
        else:
            _write_first_header(path, geometry, dtype, metadata)
        offset = path.stat().st_size
        self._layout = RawLayout(path, offset, dtype.newbyteorder("<"), geometry.shape)
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


def _write_first_header(path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str]) -> None:
    """Write a NIfTI-1 without voxels."""
    voxel = Geometry((1, 1, 1), geometry.spacing, geometry.origin, geometry.direction)
    itk.save(Volume(np.zeros((1, 1, 1), dtype), voxel), path, nifti.ITK_NAME, compress=False)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - dtype.itemsize)
        file.seek(_DIM_OFFSET)
        file.write(struct.pack("<8h", 3, *geometry.size, 1, 1, 1, 1))
    if (fields := metadata.get(nifti_grid.METADATA_KEY)) is not None:
        itk_volumes.restore_grid(path, geometry, nifti.ITK_NAME, lambda file: nifti_grid.put_grid(file, fields))


def _write_second_header(path: Path, geometry: Geometry, dtype: np.dtype[Any]) -> None:
    """Write a NIfTI-2 without voxels, its place as sform and qform."""
    from nibabel.nifti2 import Nifti2Header

    affine = np.eye(4)
    affine[:3, :3] = geometry.direction * geometry.spacing_xyz
    affine[:3, 3] = geometry.origin
    affine = _RAS @ affine
    header = Nifti2Header(endianness="<")
    header.set_data_dtype(dtype)
    header.set_data_shape(geometry.size)
    header.set_qform(affine, code=1)
    header.set_sform(affine, code=1)
    header.set_xyzt_units("mm")
    header["magic"] = b"n+2"
    header["vox_offset"] = nifti.HEADER_BYTES[2] + 4
    path.write_bytes(header.binaryblock + b"\0" * 4)


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
    ).encode()
    size = -(-(len(text) + 8) // 16) * 16
    return struct.pack("<2i", size, _CODE) + text.ljust(size - 8, b"\0")


def put_labels(path: Path, table: LabelTable) -> None:
    """Put the extension into an uncompressed little-endian NIfTI-1 file that has none."""
    extension = extension_of(table)
    extended = path.with_name("extended.nii")
    with path.open("rb") as old, extended.open("wb") as new:
        header = bytearray(old.read(_FIRST))
        struct.pack_into("<f", header, _OFFSET_PLACE, float(_FIRST + len(extension)))
        header[_HEADER] = 1
        new.write(header)
        new.write(extension)
        while block := old.read(1 << 22):
            new.write(block)
    os.replace(extended, path)
