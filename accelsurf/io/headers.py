"""The image formats: for each how its header is read, which class of ITK reads the voxels, what is written back.

A format is one entry of `FORMATS`; everything else in `accelsurf.io` asks this table.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats import nifti, nifti_grid, nrrd_metaimage, png, tiff
from accelsurf.io.formats.raster import RasterHeader
from accelsurf.io.formats.raw_header import RawHeader

Header = RawHeader | RasterHeader


@dataclass(frozen=True)
class ImageFormat:
    """What there is to know about a file format.

    Attributes
    ----------
    itk_name : str
        The class of ITK that reads and writes it.
    parse : callable
        Reads the header of a file without its voxels; raises InputError or GeometryError.
    metadata_key : str
        Where `Volume.metadata` keeps the header fields that place the grid; empty where the format has none.
    put_grid : callable or None
        Puts them back into a file that was written.
    encode : callable or None
        Array and spacing to the bytes of a file, where it is not ITK that writes.
    """

    itk_name: str
    parse: Callable[[Path], Header]
    metadata_key: str = ""
    put_grid: Callable[[Path, str], None] | None = None
    encode: Callable[[NDArray[Any], tuple[float, float, float]], bytes] | None = None


_NIFTI = partial(ImageFormat, "NiftiImageIO", metadata_key=nifti_grid.METADATA_KEY, put_grid=nifti_grid.put_grid)
_METAIMAGE = ImageFormat("MetaImageIO", nrrd_metaimage.parse_metaimage)
_TIFF = ImageFormat("TIFFImageIO", tiff.parse, encode=tiff.encode)

FORMATS: dict[str, ImageFormat] = {
    ".nii.gz": _NIFTI(parse=partial(nifti.read_header, compressed=True)),
    ".nii": _NIFTI(parse=partial(nifti.read_header, compressed=False)),
    ".nrrd": ImageFormat(
        "NrrdImageIO", nrrd_metaimage.parse_nrrd, nrrd_metaimage.NRRD_KEY, nrrd_metaimage.put_nrrd_space
    ),
    ".mha": _METAIMAGE,
    ".mhd": _METAIMAGE,
    ".png": ImageFormat("PNGImageIO", png.parse, encode=png.encode),
    ".tif": _TIFF,
    ".tiff": _TIFF,
}
"""Formats by the ending of a file's name; longer endings come first."""

SUFFIXES: tuple[str, ...] = tuple(FORMATS)
"""File name endings that can be read and written."""


def input_suffix(path: Path) -> str:
    """The ending of a file that is to be read, one of `SUFFIXES`.

    Raises
    ------
    InputError
        When there is no such file, or no format has this ending.
    """
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


def parse(path: Path, suffix: str) -> Header:
    """Read the header of a file of one of the supported kinds, without its voxels.

    Raises
    ------
    InputError
        When it is empty, is not of that kind, is damaged, or points to a data file that does not exist.
    """
    if path.stat().st_size == 0:
        raise InputError("the file is empty", hint="copy or export it again")
    return FORMATS[suffix].parse(path)


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


def is_anatomical(metadata: Mapping[str, str]) -> bool:
    """Whether a header said that the world axes are a patient's: a NIfTI transform code, or an NRRD space by name.

    Parameters
    ----------
    metadata : mapping of str to str
        As in `Volume.metadata`.
    """
    # Bytes 17 to 20 of these fields are the codes of qform and sform; both 0 means that the world is not known.
    coded = any(bytes.fromhex(metadata.get(nifti_grid.METADATA_KEY, ""))[17:21])
    return coded or "space: left-" in metadata.get(nrrd_metaimage.NRRD_KEY, "")
