"""NIfTI volumes: ITK writes them, and places those of version 1 in the world; the voxels are read here.

ITK turns NaN and infinity into 0 without a word, ignores small slopes, and reads voxels from places in the header.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.files import reserve
from accelsurf.io.formats import itk_volumes, nifti, nifti_grid
from accelsurf.io.formats.deflate import gzip_file
from accelsurf.io.formats.nifti_boxes import NiftiBoxes
from accelsurf.io.formats.nifti_labels import put_labels
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels
from accelsurf.io.lazy_volume import LazyVolume, Opening
from accelsurf.io.memory import check_memory
from accelsurf.io.metadata import LABELS_KEY, WARNING_KEY
from accelsurf.settings.labels import LabelTable

#: Bytes before the voxels of a file that ITK writes.
_MAX_HEADER_BYTES = 352


def read(path: Path, header: nifti.NiftiFile, available: int) -> Volume:
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
    nifti.check_single(header.nifti)
    if header.nifti.version == 2:
        return _read_all(path, header, available)[0]
    fields = header.nifti
    scaled = (fields.slope, fields.intercept) != (1.0, 0.0) or not fields.voxel_type.isnative
    check_memory(fields.size, fields.voxel_type.itemsize + (8 if scaled else 0), available)
    header.check_complete()
    geometry = itk.geometry_of(itk.open_reader(path, header.itk_name))
    return Volume(nifti.read_channels(header)[0], geometry, _metadata(header, geometry), path)


def read_channels(path: Path, header: nifti.NiftiFile, available: int) -> list[Volume]:
    """Read the volumes of a file, which follow one another in it.

    Raises
    ------
    InputError
        As `read`, and for more than `accelsurf.io.formats.itk_volumes.MAX_CHANNELS` of them.
    """
    if header.nifti.channels == 1 or len(header.nifti.size) > 5:
        return [read(path, header, available)]
    itk_volumes.check_channels(header.nifti.channels)
    return _read_all(path, header, available)


def open_lazily(path: Path, header: nifti.NiftiFile, opening: Opening) -> LazyVolume:
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
        As `read`.
    """
    fields = header.nifti
    nifti.check_single(fields)
    nx, ny, nz = fields.size
    voxels = RawVoxels(RawLayout(path, fields.data_offset, fields.voxel_type, (nz, ny, nx)), fields.values)
    geometry = fields.grid.geometry() if fields.version == 2 else itk.geometry_of(itk.open_reader(path, nifti.ITK_NAME))
    return LazyVolume(voxels, geometry, _metadata(header, geometry), path)


def write(volume: Volume, path: Path) -> None:
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
    write(volume, plain)
    gzip_file(plain, path)
    plain.unlink()


def store(
    path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str], source: str | None
) -> NiftiBoxes:
    """Begin a file that is written box by box; a NIfTI has no place for the name of its source."""
    return NiftiBoxes(path, geometry, dtype, metadata)


def _read_all(path: Path, header: nifti.NiftiFile, available: int) -> list[Volume]:
    """Read the volumes of a file that ITK does not read: one of version 2, or several one after the other."""
    fields = header.nifti
    # The voxels as they are stored and as they are given are in memory at the same time.
    voxel_bytes = fields.voxel_type.itemsize + fields.value_type.itemsize
    check_memory(fields.size[:3], fields.channels * voxel_bytes, available)
    header.check_complete()
    geometry = fields.grid.geometry()
    metadata = _metadata(header, geometry)
    return [Volume(array, geometry, dict(metadata), path) for array in nifti.read_channels(header)]


def _metadata(header: nifti.NiftiFile, geometry: Geometry) -> dict[str, str]:
    """The metadata of a volume: fields of its header, and a warning when qform and sform disagree."""
    warning = header.nifti.grid.check_agreement(geometry)
    return header.metadata | ({WARNING_KEY: warning} if warning else {})
