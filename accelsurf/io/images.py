"""Read and write volumes: NIfTI, NRRD, MetaImage, PNG, TIFF. The only place that imports SimpleITK.

What is read is checked before it is believed: the header is parsed first (`accelsurf.io.headers`), then the memory that
the volume needs is compared with what there is, then the voxels are counted, and only then are they read. What is
written appears whole or not at all, on exactly the grid it was read with.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import naming, staging
from accelsurf.io.formats import nifti, png, raster, tiff

_READERS = {
    ".nii.gz": "NiftiImageIO",
    ".nii": "NiftiImageIO",
    ".nrrd": "NrrdImageIO",
    ".mha": "MetaImageIO",
    ".mhd": "MetaImageIO",
    ".png": "PNGImageIO",
    ".tif": "TIFFImageIO",
    ".tiff": "TIFFImageIO",
}
SUFFIXES: tuple[str, ...] = tuple(_READERS)
"""File name endings that can be read and written."""

WARNING_KEY = "warning"
"""Where `Volume.metadata` keeps what a person should hear about the file that was read; absent when all is well."""

_SOLVER_BYTES_PER_VOXEL = 12  # image and psi as float32, and an index of the band
_HEADER_SAMPLE = 1 << 14  # bytes, more than any header written here has
_GIB = 2.0**30


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
        `write` needs to give the same header back, and under "warning" what a person should know about the file.

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
        suffix = _input_suffix(path)
        header = headers.parse(path, suffix)
        available = available_memory() if memory_bytes is None else memory_bytes
        if header.picture is not None:
            return _read_picture(path, suffix, header, available)
        reader = _reader(path, suffix)
        _check_sort(reader)
        item = sitk.GetArrayFromImage(sitk.Image(1, 1, reader.GetPixelIDValue())).itemsize
        _check_memory(reader.GetSize(), item, available)
        headers.check_complete(header)
        with _quiet():
            image = reader.Execute()
        if image.GetDimension() == 4:
            image = image[:, :, :, 0]
        geometry = _geometry_of(image)
        metadata = dict(header.metadata)
        if header.nifti and (warning := nifti.check_agreement(header.nifti, geometry)):
            metadata[WARNING_KEY] = warning
        return Volume(sitk.GetArrayFromImage(image), geometry, metadata, path)


def components(path: str | os.PathLike[str]) -> list[Volume]:
    """Components of an NRRD or MetaImage of vectors as volumes of their own; none for an ordinary image.

    Raises
    ------
    InputError
        When the file is damaged or larger than the memory; GeometryError when its grid is none.
    """
    path = Path(path)
    with naming(path):
        suffix = _input_suffix(path)
        reader = _reader(path, suffix)
        count = reader.GetNumberOfComponents()
        kind = sitk.GetPixelIDValueAsString(reader.GetPixelIDValue())
        if count < 2 or reader.GetDimension() != 3 or "complex" in kind:
            return []
        _check_memory(reader.GetSize(), 4 * count, available_memory())
        headers.check_complete(headers.parse(path, suffix))
        with _quiet():
            image = reader.Execute()
        parts = (sitk.VectorIndexSelectionCast(image, i) for i in range(count))
        return [Volume(sitk.GetArrayFromImage(part), _geometry_of(part), {}, path) for part in parts]


def read_labels(path: str | os.PathLike[str], *, memory_bytes: int | None = None) -> Volume:
    """Read a label map: as `read`, with values of an integer type.

    Raises
    ------
    InputError
        As `read`, and when a value is not a whole number.
    """
    volume = read(path, memory_bytes=memory_bytes)
    with naming(Path(path)):
        return Volume(_whole(volume.array), volume.geometry, volume.metadata, volume.source)


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
        whole = folder / (stem + suffix)  # in lower case, as ITK insists on
        draft = whole.with_name(stem + ".nii") if suffix == ".nii.gz" else whole
        _save(volume, draft, suffix)
        _restore_grid(draft, suffix, volume)
        if suffix == ".nii.gz":
            headers.gzip_file(draft, whole)
            draft.unlink()
        for file in folder.iterdir():  # the data file of an .mhd first: a header never names what is not there
            if file != whole:
                os.replace(file, path.parent / file.name)
        os.replace(whole, path)


def write_labels(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Write a label map: as `write`, with values as uint8, uint16 or uint32, as small as they fit.

    In a PNG or TIFF a map of 0 and 1 is written as 0 and 255, which is black and white in every viewer.

    Raises
    ------
    InputError
        When a value is not a whole number from 0 to 4294967295; else as `write`.
    """
    values = _whole(volume.array)
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


def split_name(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Name of a file without its folder and suffix, and the suffix in lower case (empty when it is none of `SUFFIXES`).

    Examples
    --------
    >>> split_name("scans/head.v2.nii.gz"), split_name("photo.jpg")
    (('head.v2', '.nii.gz'), ('photo', ''))
    """
    name = Path(path).name
    for suffix in SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)], suffix
    return Path(name).stem, ""


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, hexadecimal, read piece by piece.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    with naming(Path(path)), Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def available_memory() -> int:
    """Bytes that can be allocated without swapping: MemAvailable on Linux, else all physical memory."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass  # not Linux
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _input_suffix(path: Path) -> str:
    if path.is_dir():
        raise InputError("this is a folder, an image file expected", hint="give one file; convert a DICOM series first")
    if not path.exists():
        raise InputError("there is no such file", hint="check the path")
    suffix = split_name(path)[1]
    if not suffix:
        raise InputError(
            f"unknown file type, one of {', '.join(SUFFIXES)} expected", hint="convert the image to one of them first"
        )
    return suffix


def _reader(path: Path, suffix: str) -> sitk.ImageFileReader:
    reader = sitk.ImageFileReader()
    reader.SetImageIO(_READERS[suffix])
    reader.SetFileName(str(path))
    with _quiet():
        reader.ReadImageInformation()
    return reader


def _check_sort(reader: sitk.ImageFileReader) -> None:
    """Refuse by name what is not a 3D image of real numbers (NIfTI was refused from its raw header already)."""
    size, components = reader.GetSize(), reader.GetNumberOfComponents()
    text = " x ".join(map(str, size))
    kind = sitk.GetPixelIDValueAsString(reader.GetPixelIDValue())
    if "complex" in kind:
        raise InputError("a complex image given, one real number per voxel expected", hint="take the magnitude first")
    if components > 1:
        sort = "colour (RGB) or vector" if components in (3, 4) and "unsigned" in kind else "vector"
        raise InputError(
            f"a {sort} image ({text}, {components} components per voxel) given, one number per voxel expected",
            hint="extract one channel, or the magnitude, first",
        )
    if len(size) < 3:
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected",
            hint="add a slice axis of size 1, or use Volume.from_array in Python",
        )
    if len(size) > 4 or (len(size) == 4 and size[3] > 1):
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected", hint="extract one time point or channel first"
        )


def _check_memory(size_xyz: Sequence[int], voxel_bytes: int, available: int) -> None:
    needed = math.prod(size_xyz) * (voxel_bytes + _SOLVER_BYTES_PER_VOXEL)
    if needed > available:
        size = " x ".join(map(str, size_xyz))
        raise InputError(
            f"an image of {size} voxels needs about {needed / _GIB:.2f} GiB of memory, "
            f"{available / _GIB:.2f} GiB are available",
            hint="crop or downsample the image, or use a machine with more memory",
        )


def _read_picture(path: Path, suffix: str, raw: headers.RawHeader, available: int) -> Volume:
    """Read a PNG or TIFF. ITK opens it last: it prints about damaged ones."""
    header = raw.picture
    assert header is not None
    _check_memory(header.shape[::-1], header.pixel_bytes, available)
    headers.check_complete(raw)
    reader = _reader(path, suffix)
    with _quiet():
        image = reader.Execute()
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


def _geometry_of(image: sitk.Image | sitk.ImageFileReader) -> Geometry:
    direction = np.array(image.GetDirection()).reshape(3, 3)
    return Geometry(image.GetSize()[::-1], image.GetSpacing()[::-1], image.GetOrigin(), direction)


def _storable(array: NDArray[Any]) -> NDArray[Any]:
    """The same values in a type that file formats know, in this machine's byte order."""
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    elif array.dtype.kind == "f" and array.dtype.itemsize not in (4, 8):
        array = array.astype(np.float32 if array.dtype.itemsize < 4 else np.float64)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def _to_sitk(volume: Volume) -> sitk.Image:
    image = sitk.GetImageFromArray(volume.array)
    image.SetSpacing(volume.geometry.spacing_xyz)
    image.SetOrigin(volume.geometry.origin)
    image.SetDirection(volume.geometry.direction.ravel().tolist())
    return image


def _save(volume: Volume, path: Path, suffix: str) -> None:
    if suffix in raster.SUFFIXES:
        encode = png.encode if suffix == ".png" else tiff.encode
        path.write_bytes(encode(volume.array, volume.geometry.spacing))
        return
    writer = sitk.ImageFileWriter()
    writer.SetImageIO(_READERS[suffix])
    writer.SetFileName(str(path))
    writer.SetUseCompression(not suffix.startswith(".nii"))
    with _quiet():
        writer.Execute(_to_sitk(volume))


def _restore_grid(path: Path, suffix: str, volume: Volume) -> None:
    """Give a file the header fields that placed the volume when it was read, where they still place it there."""
    put = {".nii": nifti.put_grid, ".nii.gz": nifti.put_grid, ".nrrd": headers.put_nrrd_space}.get(suffix)
    kept = volume.metadata.get(headers.NRRD_KEY if suffix == ".nrrd" else nifti.METADATA_KEY)
    if put is None or kept is None:
        return
    # The header alone is tried first: metadata may have come from another grid than the volume has now.
    trial = path.with_name("trial" + path.name)
    with path.open("rb") as file:
        trial.write_bytes(file.read(_HEADER_SAMPLE))
    put(trial, kept)
    reader = _reader(trial, ".nii" if suffix == ".nii.gz" else suffix)
    trial.unlink()
    if _geometry_of(reader).matches(volume.geometry):
        put(path, kept)


def _whole(array: NDArray[Any]) -> NDArray[Any]:
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


@contextmanager
def _quiet() -> Iterator[None]:
    """ITK's warnings off for a moment: what matters is checked here and said in one line."""
    before = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        yield
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(before)
