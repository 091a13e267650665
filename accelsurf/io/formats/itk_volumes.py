"""Volumes whose voxels ITK reads and writes: all of NRRD and MetaImage, and the plain ones of NIfTI."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import SimpleITK as sitk

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import itk
from accelsurf.io.formats.nrrd_metaimage import METAIMAGE_ITK_NAME, NRRD_ITK_NAME, NRRD_KEY, put_nrrd_space
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels
from accelsurf.io.headers import FRAME_KEY
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import check_memory

_HEADER_SAMPLE = 1 << 14  # bytes, more than any header written here has


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
    numbers = header.selected()
    if len(numbers) > 1:
        itk.check_kind(itk.open_reader(path, header.itk_name))
    return _read_some(path, header, numbers, available)[0]


def read_channels_by_itk(path: Path, header: RawHeader, available: int) -> list[Volume]:
    """Read the components of an image of vectors, or volumes of a sequence; one volume of an ordinary image.

    Raises
    ------
    InputError
        As `read_by_itk`, and for more than `accelsurf.io.channels.MAX_CHANNELS` components.
    """
    return _read_some(path, header, header.selected(), available)


def _read_some(path: Path, header: RawHeader, numbers: Sequence[int], available: int) -> list[Volume]:
    """Read some of the components or volumes."""
    reader, count = itk.open_reader(path, header.itk_name), header.channels * header.time_points
    by_voxel = is_by_voxel(reader, header)
    itk.check_kind(reader, count, by_voxel)
    needed = itk.voxel_type(reader).itemsize + 4 * len(numbers) * (count > 1)
    check_memory(reader.GetSize(), needed * (count if by_voxel else 1), available)
    header.check_complete()
    image = itk.execute(reader)
    geometry = itk.geometry_of(image)
    if header.encoding == "text":
        header.check_text(sitk.GetArrayViewFromImage(image).ravel())
    if count == 1:
        return [Volume(sitk.GetArrayFromImage(image), geometry, header.metadata, path)]
    metadata = {} if header.seconds is None else {FRAME_KEY: repr(header.seconds)}
    if by_voxel:
        arrays = (sitk.GetArrayFromImage(sitk.VectorIndexSelectionCast(image, n)) for n in numbers)
    else:
        every = sitk.GetArrayViewFromImage(image)
        arrays = (every[n].copy() for n in numbers)
    return [Volume(array, geometry, dict(metadata), path) for array in arrays]


def is_by_voxel(reader: sitk.ImageFileReader, header: RawHeader) -> bool:
    """True if ITK gives volumes as values of a voxel: those of an axis of NRRD without a direction also at its end."""
    return header.is_interleaved or (header.time_points + header.channels > 2 and reader.GetNumberOfComponents() > 1)


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
        When the voxels are packed or are text, or as `read_by_itk`.
    """
    reader = itk.open_reader(path, header.itk_name)
    numbers = header.selected()
    count = header.channels * header.time_points if len(numbers) == 1 else 1
    itk.check_kind(reader, count, is_by_voxel(reader, header))
    if header.position is None or not header.order or header.is_interleaved:
        raise InputError(
            "the voxels are packed, are text, have several values, or begin after lines to skip: a box of them cannot "
            "be read by itself",
            "convert the image to OME-Zarr, or save it uncompressed",
        )
    geometry, stored = itk.geometry_of(reader), itk.voxel_type(reader).newbyteorder(header.order)
    volume_bytes = math.prod(geometry.shape) * stored.itemsize
    needed = volume_bytes * header.channels * header.time_points
    if needed != header.claimed_bytes:
        raise InputError(
            f"the header announces {header.claimed_bytes} bytes of voxels, its grid has {needed}", "save it again"
        )
    position = header.position if header.position >= 0 else max(header.data.stat().st_size - needed, 0)
    voxels = RawVoxels(RawLayout(header.data, position + numbers[0] * volume_bytes, stored, geometry.shape))
    layout = StoreLayout((geometry,), None, 1, header.time_points)
    return LazyVolume(voxels, geometry, dict(header.metadata), path, layout)


def write_nrrd(volume: Volume, path: Path) -> None:
    """Write an NRRD, compressed, with the lines that placed the volume when it was read."""
    itk.save(volume, path, NRRD_ITK_NAME, compress=True)
    if (lines := volume.metadata.get(NRRD_KEY)) is not None:
        restore_grid(path, volume.geometry, NRRD_ITK_NAME, lambda file: put_nrrd_space(file, lines))


def write_metaimage(volume: Volume, path: Path) -> None:
    """Write a MetaImage, compressed; for .mhd the voxels go to a .zraw file beside it."""
    itk.save(volume, path, METAIMAGE_ITK_NAME, compress=True)


def restore_grid(path: Path, geometry: Geometry, itk_name: str, put_grid: Callable[[Path], None]) -> None:
    """Give a file the header fields that placed the volume when it was read, where they still place it there.

    Parameters
    ----------
    path : Path
        The file.
    geometry : Geometry
        Where it places what it holds.
    itk_name : str
        The format, as ITK names the class that reads it.
    put_grid : callable
        Puts the fields into a file.
    """
    # The header alone is tried first: metadata may have come from another grid than the volume has now.
    trial = path.with_name("trial" + "".join(path.suffixes[-1:]))  # no longer than the name itself
    with path.open("rb") as file:
        trial.write_bytes(file.read(_HEADER_SAMPLE))
    put_grid(trial)
    grid = itk.geometry_of(itk.open_reader(trial, itk_name))
    trial.unlink()
    if grid.matches(geometry):
        put_grid(path)
