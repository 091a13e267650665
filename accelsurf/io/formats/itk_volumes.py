"""NRRD and MetaImage: ITK places and writes them, their voxels are read here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import itk
from accelsurf.io.formats.nrrd_metaimage import (
    METAIMAGE_ITK_NAME,
    NRRD_ITK_NAME,
    NRRD_KEY,
    put_nrrd_space,
)
from accelsurf.io.formats.raw_header import ListedHeader, RawHeader
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels, native
from accelsurf.io.headers import FRAME_KEY
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import check_memory

_HEADER_SAMPLE = 1 << 14  # bytes, more than any header written here has


class _Grid(NamedTuple):
    """The grid of a volume, and the type of the values in the file."""

    geometry: Geometry
    stored: np.dtype[Any]


def read_by_itk(path: Path, header: RawHeader, available: int) -> Volume:
    """Read a volume.

    Parameters
    ----------
    path : Path
        The file.
    header : RawHeader
        What its header claims.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file is no 3D image of real numbers, incomplete or larger than the memory; GeometryError when its
        header does not describe a grid of perpendicular axes.
    """
    grid = _grid(path, header)  # which says what kind of image it is
    return _read(path, header, grid, [header.single()], available)[0]


def read_channels_by_itk(path: Path, header: RawHeader, available: int) -> list[Volume]:
    """Read the components of an image of vectors, or volumes of a sequence; one volume of an ordinary image.

    Raises
    ------
    InputError
        As `read_by_itk`, and for more than `accelsurf.io.channels.MAX_CHANNELS` components.
    """
    return _read(path, header, _grid(path, header), header.selected(), available)


def _read(
    path: Path, header: RawHeader, grid: _Grid, numbers: Sequence[int], available: int
) -> list[Volume]:
    """Read some of the components or volumes."""
    geometry, stored = grid
    span = header.channels if header.is_interleaved else max(numbers) - min(numbers) + 1
    check_memory(
        geometry.size,
        stored.itemsize * (span + len(numbers) * (span > 1 or not stored.isnative)),
        available,
    )
    arrays = header.volumes(stored, geometry.shape, numbers)
    metadata = header.metadata if header.seconds is None else {FRAME_KEY: repr(header.seconds)}
    return [
        Volume(np.ascontiguousarray(native(array)), geometry, dict(metadata), path)
        for array in arrays
    ]


def _grid(path: Path, header: RawHeader) -> _Grid:
    """The grid of a volume by ITK, and the type of the values in the file."""
    reader, count = itk.open_reader(path, header.itk_name), header.channels * header.time_points
    itk.check_kind(reader, count)
    geometry, stored = itk.geometry_of(reader), itk.voxel_type(reader).newbyteorder(header.order)
    needed = math.prod(geometry.shape) * stored.itemsize * count
    if needed != header.claimed_bytes:
        raise InputError(
            f"the header announces {header.claimed_bytes} bytes of voxels, its grid has {needed}",
            "save it again",
        )
    return _Grid(geometry, stored)


def open_raw(path: Path, header: RawHeader, opening: Opening) -> LazyVolume:
    """Open a volume whose voxels are stored as they are, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : RawHeader
        What its header claims.
    opening : Opening
        Has no more to say here.

    Raises
    ------
    InputError
        When the voxels are packed, or as `read_by_itk`.
    """
    number = header.single()
    if header.encoding != "raw" or header.is_interleaved or isinstance(header, ListedHeader):
        raise InputError(
            "the voxels are packed, in several files, or have several values: a box of them cannot be read by itself",
            "convert the image to OME-Zarr, or save it uncompressed",
        )
    geometry, stored = _grid(path, header)
    begin = header.offset + number * math.prod(geometry.shape) * stored.itemsize
    voxels = RawVoxels(RawLayout(header.data, begin, stored, geometry.shape))
    layout = StoreLayout((geometry,), None, 1, header.time_points)
    return LazyVolume(voxels, geometry, dict(header.metadata), path, layout)


def write_nrrd(volume: Volume, path: Path) -> None:
    """Write an NRRD, compressed, with the lines that placed the volume when it was read."""
    itk.save(volume, path, NRRD_ITK_NAME, compress=True)
    if (lines := volume.metadata.get(NRRD_KEY)) is not None:
        # The header alone is tried first: metadata may have come from another grid than the volume has now.
        trial = path.with_name("trial.nrrd")
        with path.open("rb") as file:
            trial.write_bytes(file.read(_HEADER_SAMPLE))
        put_nrrd_space(trial, lines)
        grid = itk.geometry_of(itk.open_reader(trial, NRRD_ITK_NAME))
        trial.unlink()
        if grid.matches(volume.geometry):
            put_nrrd_space(path, lines)


def write_metaimage(volume: Volume, path: Path) -> None:
    """Write a MetaImage, compressed; for .mhd the voxels go to a .zraw file beside it."""
    itk.save(volume, path, METAIMAGE_ITK_NAME, compress=True)
