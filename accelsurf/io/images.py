"""Read and write volumes: NIfTI, NRRD, MetaImage, PNG, TIFF.

What is read is checked before it is believed: the header is parsed first (`accelsurf.io.headers`), then the memory that
the volume needs is compared with what there is, then the voxels are counted, and only then are they read. What is
written appears whole or not at all, on exactly the grid it was read with.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import headers, itk
from accelsurf.io.files import naming, staging
from accelsurf.io.formats import nifti, raster
from accelsurf.io.formats.deflate import gzip_file
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.headers import FORMATS, SUFFIXES, split_name
from accelsurf.io.memory import available_memory, check_memory

WARNING_KEY = "warning"
"""Where `Volume.metadata` keeps a warning about the file that was read; absent when there is none."""

_HEADER_SAMPLE = 1 << 14  # bytes, more than any header written here has


def read(path: str | os.PathLike[str], *, memory_bytes: int | None = None) -> Volume:
    """Read a 3D image, or a 2D one as a volume of one slice.

    Parameters
    ----------
    path : path-like
        A file that ends in one of `SUFFIXES`.
    memory_bytes : int, optional
        Memory to plan with; by default what the machine has available now.

    Returns
    -------
    Volume
        Voxels in their own type (as float when the header scales them), on a grid in mm, LPS; ``metadata`` holds what
        `write` needs to give the same header back, and under "warning" what the user should know about the file.

    Raises
    ------
    InputError
        When the file is missing, damaged, incomplete, not a 3D image of real numbers, or larger than the memory;
        GeometryError when its header does not describe a grid of perpendicular axes.

    Notes
    -----
    NIfTI places an image twice, by qform and sform. As in ITK-SNAP and 3D Slicer, the sform is used when it refers to
    the scanner (code 1) or is the only one, else the qform, and with neither the image starts at the world's origin; a
    sheared sform is refused rather than straightened. Metres and micrometres are converted to mm.

    A PNG is one slice; so is each page of a TIFF. They start at the world's origin. A pixel is 1 mm, unless a TIFF
    gives its resolution per cm or in the words of ImageJ or OME, or a PNG its scale as ITK writes it; dots per inch
    are a printer's and not used. Colours become their luminance, with a warning; grey saved as colour is grey again.
    """
    path = Path(path)
    with naming(path):
        suffix = headers.input_suffix(path)
        header = headers.parse(path, suffix)
        available = available_memory() if memory_bytes is None else memory_bytes
        if isinstance(header, raster.RasterHeader):
            return _read_raster(path, suffix, header, available)
        if isinstance(header, nifti.NiftiFile):
            nifti.check_single(header.nifti)
            if header.nifti.version == 2:
                return read_nifti(path, header, available)[0]
        reader = itk.open_reader(path, FORMATS[suffix].itk_name)
        itk.check_kind(reader)
        check_memory(reader.GetSize(), itk.voxel_bytes(reader), available)
        header.check_complete()
        image = itk.execute(reader)
        geometry = itk.geometry_of(image)
        return Volume(sitk.GetArrayFromImage(image), geometry, _metadata(header, geometry), path)


def read_nifti(path: Path, header: nifti.NiftiFile, available: int) -> list[Volume]:
    """Read the volumes of a NIfTI file that ITK does not read: one of version 2, or several one after the other.

    Parameters
    ----------
    path : Path
        The file.
    header : NiftiFile
        Its header.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file is incomplete or larger than the memory; GeometryError when its header contradicts itself.
    """
    fields = header.nifti
    # The voxels as they are stored and as they are given are in memory at the same time.
    voxel_bytes = fields.voxel_type.itemsize + fields.value_type.itemsize
    check_memory(fields.size[:3], fields.channels * voxel_bytes, available)
    header.check_complete()
    geometry = fields.grid.geometry()
    metadata = _metadata(header, geometry)
    return [Volume(array, geometry, dict(metadata), path) for array in nifti.read_channels(header)]


def _metadata(header: RawHeader, geometry: Geometry) -> dict[str, str]:
    """The metadata of a volume: fields of its header, and a warning when qform and sform disagree."""
    warning = header.nifti.grid.check_agreement(geometry) if isinstance(header, nifti.NiftiFile) else ""
    return header.metadata | ({WARNING_KEY: warning} if warning else {})


def read_labels(path: str | os.PathLike[str], *, memory_bytes: int | None = None) -> Volume:
    """Read a label map: as `read`, with values of an integer type.

    Raises
    ------
    InputError
        As `read`, and when a value is not a whole number.
    """
    volume = read(path, memory_bytes=memory_bytes)
    with naming(Path(path)):
        return Volume(_as_integers(volume.array), volume.geometry, volume.metadata, volume.source)


def write(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Write a volume; the suffix decides the format, and all but plain .nii are compressed.

    The file is written under a temporary name in the same folder and then renamed, so that a file of this name is
    never half written; an existing one is replaced. The grid is the volume's; from NIfTI to NIfTI and from NRRD to
    NRRD also the numbers and codes of the header that place it. A PNG holds one slice, a TIFF one or more; of the grid
    they keep the size of a voxel (a PNG not the slice's thickness), no place. The same volume gives the same bytes.

    Parameters
    ----------
    volume : Volume
        Booleans are written as uint8, half precision as float32.
    path : path-like
        A file name that ends in one of `SUFFIXES`; for .mhd the voxels go to a .zraw file beside it.

    Raises
    ------
    UsageError
        When the suffix is none of them, or a PNG or TIFF cannot hold the volume.
    OutputError
        When the file cannot be written there.
    """
    path = Path(path)
    stem, suffix = split_name(path)
    if not suffix:
        raise UsageError(f"{path}: unknown file type, one of {', '.join(SUFFIXES)} expected")
    volume = volume.with_array(_storable(volume.array))
    if suffix in raster.SUFFIXES:
        raster.check_writable(volume.array, suffix)
    with staging(path) as folder:
        target = folder / (stem + suffix)  # in lower case, as ITK insists on
        draft = target.with_name(stem + ".nii") if suffix == ".nii.gz" else target
        _save(volume, draft, suffix)
        _restore_grid(draft, suffix, volume)
        if suffix == ".nii.gz":
            gzip_file(draft, target)
            draft.unlink()
        for file in folder.iterdir():  # the data file of an .mhd first: a header never names what is not there
            if file != target:
                os.replace(file, path.parent / file.name)
        os.replace(target, path)


def write_labels(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Write a label map: as `write`, with values as uint8, uint16 or uint32, as small as they fit.

    In a PNG or TIFF a map of 0 and 1 is written as 0 and 255, which is black and white in every viewer.

    Raises
    ------
    InputError
        When a value is not a whole number from 0 to 4294967295; else as `write`.
    """
    values = _as_integers(volume.array)
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > 2**32 - 1:
        raise InputError(f"labels from {low} to {high} given, 0 to {2**32 - 1} expected", hint="renumber the labels")
    values = values.astype(label_type(high))
    if high == 1 and split_name(path)[1] in raster.SUFFIXES:
        values *= 255
    write(volume.with_array(values), path)


def label_type(largest: int) -> np.dtype[Any]:
    """Smallest unsigned type that holds labels up to ``largest``."""
    return np.dtype(np.uint8 if largest <= 255 else np.uint16 if largest <= 65535 else np.uint32)


def _read_raster(path: Path, suffix: str, header: raster.RasterHeader, available: int) -> Volume:
    """Read a PNG or TIFF. ITK opens it last, because it prints messages about damaged files."""
    check_memory(header.shape[::-1], header.pixel_bytes, available)
    header.check_complete()
    image = itk.execute(itk.open_reader(path, FORMATS[suffix].itk_name))
    array = sitk.GetArrayFromImage(image)
    note = ""
    if image.GetNumberOfComponentsPerPixel() > 1:
        array, note = raster.to_grey(array)
    if array.size != np.prod(header.shape):
        size = " x ".join(map(str, reversed(header.shape)))
        raise InputError(
            f"the header announces {size} pixels, ITK reads {image.GetSize()}", hint="save it as a plain TIFF or PNG"
        )
    spacing = header.spacing or (1.0, *image.GetSpacing()[1::-1])
    metadata = {WARNING_KEY: note} if note else {}
    return Volume(array.reshape(header.shape), Geometry(header.shape, spacing), metadata, path)


def _storable(array: NDArray[Any]) -> NDArray[Any]:
    """The same values in a type that file formats know, in this machine's byte order."""
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    elif array.dtype.kind == "f" and array.dtype.itemsize not in (4, 8):
        array = array.astype(np.float32 if array.dtype.itemsize < 4 else np.float64)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def _save(volume: Volume, path: Path, suffix: str) -> None:
    form = FORMATS[suffix]
    if form.encode:
        path.write_bytes(form.encode(volume.array, volume.geometry.spacing))
    else:
        itk.save(volume, path, form.itk_name, compress=not suffix.startswith(".nii"))


def _restore_grid(path: Path, suffix: str, volume: Volume) -> None:
    """Give a file the header fields that placed the volume when it was read, where they still place it there."""
    form = FORMATS[suffix]
    fields = volume.metadata.get(form.metadata_key)
    if form.put_grid is None or fields is None:
        return
    # The header alone is tried first: metadata may have come from another grid than the volume has now.
    trial = path.with_name("trial" + path.name)
    with path.open("rb") as file:
        trial.write_bytes(file.read(_HEADER_SAMPLE))
    form.put_grid(trial, fields)
    grid = itk.geometry_of(itk.open_reader(trial, form.itk_name))
    trial.unlink()
    if grid.matches(volume.geometry):
        form.put_grid(path, fields)


def _as_integers(array: NDArray[Any]) -> NDArray[Any]:
    """The same values in an integer type."""
    if array.dtype.kind in "ui":
        return array
    if array.dtype.kind == "b":
        return array.astype(np.uint8)
    whole = np.isfinite(array) & (array == np.floor(array)) & (np.abs(array) < 2.0**31)
    if not whole.all():
        value = array[~whole].flat[0]
        raise InputError(
            f"labels must be whole numbers, {int((~whole).sum())} voxels are not (the first is {value:g})",
            hint="is this an image, or a label map resampled with interpolation? resample with nearest neighbour",
        )
    return array.astype(np.int32)
