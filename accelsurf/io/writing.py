"""Writing of images and label maps: in every format that can be written, whole or not at all, and read back."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.check import as_labels
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import SPACE_HINT, naming, staging
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import split_name
from accelsurf.io.images import label_type, read
from accelsurf.io.library_images import ImageLike, as_volume
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_format, label_formats


def write(
    image: ImageLike,
    path: str | os.PathLike[str],
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
) -> None:
    """Write an image; the suffix decides the format, and all but plain .nii are compressed.

    The file is written under a temporary name in the same folder and then renamed, so that a file of this name is
    never half written; an existing one is replaced. The grid is the volume's; from NIfTI to NIfTI and from NRRD to
    NRRD also the numbers and codes of the header that place it. A PNG holds one slice, a TIFF one or more; of the grid
    they keep the size of a voxel (a PNG not the slice's thickness), no place. The same image gives the same bytes.

    Parameters
    ----------
    image : image
        As `accelsurf.segment` takes it. Booleans are written as uint8, half precision as float32.
    path : path-like
        A file name that ends in one of `accelsurf.settings.file_formats.image_suffixes`; for .mhd the voxels go to a
        .zraw file beside it.
    spacing : float, str or (hz, hy, hx), optional
        mm, of an array; 1 by default.

    Raises
    ------
    UsageError
        When the suffix is none of them, or a PNG or TIFF cannot hold the volume.
    OutputError
        When the file cannot be written there.
    InputError
        When the image cannot be used, as `accelsurf.segment`.
    """
    _write(as_volume(image, spacing), Path(path), labels=False)


def write_labels(
    image: ImageLike,
    path: str | os.PathLike[str],
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
) -> None:
    """Write a label map: as `write`, with values as uint8, uint16 or uint32, as small as they fit.

    In a PNG or TIFF a map of 0 and 1 is written as 0 and 255, which is black and white in every viewer.

    Raises
    ------
    InputError
        When a value is not a whole number from 0 to 4294967295; else as `write`.
    """
    volume = as_volume(image, spacing, "the label map")
    values = as_labels(volume.array)
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > 2**32 - 1:
        raise InputError(
            f"labels from {low} to {high} given, 0 to {2**32 - 1} expected",
            hint="renumber the labels",
        )
    values = values.astype(label_type(high))
    form = image_format(split_name(path)[1])
    if high == 1 and form is not None and form.white_labels:
        values *= 255
    _write(volume.with_array(values), Path(path), labels=True)


def _write(volume: Volume, path: Path, labels: bool) -> None:
    """Write a volume, by the format's writer of label maps if ``labels`` and if it has one."""
    with naming(path):
        headers.check_name(path)
    stem, suffix = split_name(path)
    form = image_format(suffix)
    write_volume = None if form is None else functions_of(form).write
    if form is None or write_volume is None:
        written = [IMAGE_FORMATS[name].suffixes[0] for name in label_formats()]
        what = "unknown file type" if form is None else f"a {suffix} is read only"
        raise UsageError(f"{path}: {what}, one of {', '.join(written)} expected")
    volume = volume.with_array(_storable(volume.array))
    _check_writable(volume.array, form, suffix)
    with staging(path, form.folder_marks) as files:
        target = files.staging / (stem + suffix)  # in lower case, as ITK insists on
        ((functions_of(form).write_labels if labels else None) or write_volume)(volume, target)
        _check_staged(volume, target, path.name)
        target.rename(files.staging / path.name)
        files.commit(
            last=path.name
        )  # of .mhd the data file first: a header never names an absent file


def stored_grid(geometry: Geometry, suffix: str) -> Geometry:
    """The grid that is read back from a file with a suffix, where it keeps less than all of it.

    Parameters
    ----------
    geometry : Geometry
        The grid to be written.
    suffix : str
        One of `accelsurf.settings.file_formats.image_suffixes`.
    """
    form = image_format(suffix)
    if form is None or form.keeps == "all":
        return geometry
    if form.keeps == "none":
        return Geometry(geometry.shape, (1.0, 1.0, 1.0))
    depth = 1.0 if form.keeps == "pixel" else geometry.spacing[0]
    return Geometry(geometry.shape, (depth, *geometry.spacing[1:]))


def _check_staged(volume: Volume, staged: Path, name: str) -> None:
    """Read a staging file back, and refuse one that does not hold the volume: ITK's writers say nothing of a full disk.

    Raises
    ------
    OutputError
        With the difference.
    """
    try:
        found = read(staged, memory_bytes=sys.maxsize)
        difference = stored_grid(volume.geometry, split_name(staged)[1]).difference(found.geometry)
        same = found.array.dtype == volume.array.dtype and np.array_equal(
            found.array, volume.array, equal_nan=volume.array.dtype.kind == "f"
        )
    except InputError as error:
        reason = error.message.removeprefix(f"{staged}: ")
        raise OutputError(
            f"{name}: cannot be written (what was written is damaged: {reason})", SPACE_HINT
        ) from error
    if difference or not same:
        what = difference or "other voxels are read than were written"
        raise OutputError(f"{name}: cannot be written ({what})", SPACE_HINT)


def _storable(array: NDArray[Any]) -> NDArray[Any]:
    """The same values in a type that file formats know, in this machine's byte order."""
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    elif array.dtype.kind == "f" and array.dtype.itemsize not in (4, 8):
        array = array.astype(np.float32 if array.dtype.itemsize < 4 else np.float64)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def _check_writable(array: NDArray[Any], form: ImageFormat, suffix: str) -> None:
    """Refuse an array that a format cannot hold."""
    if form.only_2d and array.shape[0] > 1:
        raise UsageError(
            f"a volume of {array.shape[0]} slices given, a {suffix} holds one",
            "write a .tif stack, or a volume format",
        )
    if form.types and array.dtype.name not in form.types:
        raise UsageError(
            f"values of type {array.dtype} given, a {suffix} holds {', '.join(form.types)}",
            "convert them first, or write a volume format",
        )
