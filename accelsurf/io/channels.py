"""Images of several channels: each comes out as a volume of its own, all on one grid."""

from __future__ import annotations

import os
from pathlib import Path

import SimpleITK as sitk

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.volume import Volume
from accelsurf.io import headers, images, itk
from accelsurf.io.files import naming
from accelsurf.io.formats import nifti
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.memory import available_memory, check_memory

#: More volumes along the fourth axis than this are a time series, not channels.
MAX_CHANNELS = 16


def read(path: str | os.PathLike[str]) -> list[Volume]:
    """Read an image of one or more channels.

    Parameters
    ----------
    path : path-like
        As for `accelsurf.io.read`; also a NIfTI of vectors or with a few volumes along its fourth axis, or an NRRD or
        MetaImage of vectors.

    Returns
    -------
    list of Volume
        The channels in their order; one for an ordinary image.

    Raises
    ------
    InputError
        As `accelsurf.io.read`, and for more than `MAX_CHANNELS` channels.
    """
    path = Path(path)
    with naming(path):
        suffix = headers.input_suffix(path)
        header = headers.parse(path, suffix)
        if isinstance(header, nifti.NiftiFile):
            volumes = _nifti_volumes(path, header)
        else:
            volumes = _components(path, suffix, header) if isinstance(header, RawHeader) else []
    return volumes or [images.read(path)]


def read_further(paths: tuple[str, ...]) -> list[Volume]:
    """Read the files that add channels, in order.

    Raises
    ------
    UsageError
        When a path is empty.
    """
    if any(not path for path in paths):
        raise UsageError("channel: nothing was given, expected a file", "write --channel FILE")
    return [volume for path in paths for volume in read(path)]


def _check_count(count: int) -> None:
    if count > MAX_CHANNELS:
        raise InputError(
            f"{count} channels or time points, expected at most {MAX_CHANNELS}", "extract one of them first"
        )


def _nifti_volumes(path: Path, header: nifti.NiftiFile) -> list[Volume]:
    """The volumes of a NIfTI file, which follow one another in it; none for an ordinary image."""
    if header.nifti.channels == 1 or len(header.nifti.size) > 5:
        return []
    _check_count(header.nifti.channels)
    return images.read_nifti(path, header, available_memory())


def _components(path: Path, suffix: str, header: RawHeader) -> list[Volume]:
    """The components of an NRRD or MetaImage of vectors; none for an ordinary image."""
    reader = itk.open_reader(path, headers.FORMATS[suffix].itk_name)
    count = reader.GetNumberOfComponents()
    if count < 2 or reader.GetDimension() != 3 or "complex" in sitk.GetPixelIDValueAsString(reader.GetPixelIDValue()):
        return []
    _check_count(count)
    check_memory(reader.GetSize(), 4 * count, available_memory())
    header.check_complete()
    image = itk.execute(reader)
    parts = (sitk.VectorIndexSelectionCast(image, i) for i in range(count))
    return [Volume(sitk.GetArrayFromImage(part), itk.geometry_of(part), {}, path) for part in parts]
