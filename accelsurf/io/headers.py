"""Which format a file has, by the ending of its name, and what its header says."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_format, image_suffixes
from accelsurf.settings.registry import load


def parse(path: Path) -> tuple[ImageFormat, Any]:
    """Read the header of a file without its voxels; return its format and what the header claims.

    Raises
    ------
    InputError
        When there is no such file, no format has its ending, or it is empty, is not of that format, is damaged, or
        points to a data file that does not exist; GeometryError when its header does not describe a grid.
    """
    if path.is_dir():
        raise InputError("this is a folder, an image file expected", hint="give one file; convert a DICOM series first")
    if not path.exists():
        raise InputError("there is no such file", hint="check the path")
    form = image_format(split_name(path)[1])
    if form is None:
        raise InputError(
            f"unknown file type, one of {', '.join(image_suffixes())} expected",
            hint="convert the image to one of them first",
        )
    if path.stat().st_size == 0:
        raise InputError("the file is empty", hint="copy or export it again")
    return form, load(form.parse)(path)


def split_name(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Name of a file without its folder and suffix, and the suffix in lower case (empty when no image format has it).

    Examples
    --------
    >>> split_name("scans/head.v2.nii.gz"), split_name("photo.jpg")
    (('head.v2', '.nii.gz'), ('photo', ''))
    """
    name = Path(path).name
    for suffix in image_suffixes():
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
    said = (form.is_anatomical for form in IMAGE_FORMATS.values())
    return any(load(asked)(metadata) for asked in said if asked is not None)
