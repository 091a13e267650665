"""Which format a file has, by the ending of its name, and what its header says."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError, UsageError
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_format, image_suffixes
from accelsurf.settings.reading import AS_IT_IS, ReadOptions
from accelsurf.settings.registry import load

_OUTSIDE_DATA = ContextVar("outside data", default=False)


@contextmanager
def outside_data_allowed(allowed: bool = True) -> Iterator[None]:
    """While it lasts, a header may name a data file in another folder than its own.

    A header comes from elsewhere more often than a data file does: it could name any file of the computer, whose bytes
    would then be shown as an image.

    Parameters
    ----------
    allowed : bool
        False leaves it as it is.
    """
    before = _OUTSIDE_DATA.set(allowed or _OUTSIDE_DATA.get())
    try:
        yield
    finally:
        _OUTSIDE_DATA.reset(before)


def parse(path: Path, options: ReadOptions = AS_IT_IS) -> tuple[ImageFormat, Any]:
    """Read the header of a file without its voxels; return its format and what the header claims.

    Parameters
    ----------
    path : Path
        A file, or a folder that is an image.
    options : ReadOptions, optional
        What is asked for beside.

    Raises
    ------
    UsageError
        When the format has not what is asked for.
    InputError
        When there is no such file, no format has its ending, or it is empty, is not of that format, is damaged, or
        points to a data file that does not exist, or outside of its folder; GeometryError when its header does not
        describe a grid.
    """
    form = format_of(path)
    header = _header(form, path, options)
    if path.is_dir():
        return form, header
    data = getattr(header, "data", path)
    if data != path and not _OUTSIDE_DATA.get():
        _check_data_folder(path, data)
    return form, header


def _header(form: ImageFormat, path: Path, options: ReadOptions) -> Any:
    """What a header claims."""
    unknown = [name for name in options.given if name not in form.options]
    if unknown:
        name, value = unknown[0].replace("_", "-"), getattr(options, unknown[0])
        raise UsageError(f"{name}: {value} was given, and a {form.suffixes[0]} has no such choice", "leave it out")
    return load(form.parse)(path, options) if form.options else load(form.parse)(path)


def format_of(path: Path) -> ImageFormat:
    """The format of a file or folder that is there: by its name, else by what is in it.

    Raises
    ------
    InputError
        When there is no such file, it is empty, or of no known format.
    """
    check_name(path)
    if path.is_dir():
        return _format_of_folder(path)
    if not path.exists():
        raise InputError("there is no such file", hint="check the path")
    form = image_format(split_name(path)[1])
    if form is None and path.is_file():
        form = next((one for one in IMAGE_FORMATS.values() if one.is_file and load(one.is_file)(path)), None)
    if form is None:
        raise InputError(
            f"unknown file type, one of {', '.join(image_suffixes())} expected",
            hint="convert the image to one of them first",
        )
    if not path.is_file():
        raise InputError("this is no file but a pipe or a device", hint="give an image file")
    if path.stat().st_size == 0:
        raise InputError("the file is empty", hint="copy or export it again")
    return form


def _format_of_folder(path: Path) -> ImageFormat:
    """As `format_of`, of a folder: one whose name says that it is an image, or in which the files of such one are."""
    named = image_format(split_name(path)[1])
    for form in IMAGE_FORMATS.values():
        if form.folder_marks and (form is named or any((path / mark).is_file() for mark in form.folder_marks)):
            return form
    for form in IMAGE_FORMATS.values():
        if form.is_folder is not None and load(form.is_folder)(path):
            return form
    raise InputError("this is a folder, an image file expected", hint="give an image file, or a folder of DICOM")


def is_stored(path: Path) -> bool:
    """Whether a path names a file, or a folder that is an image.

    Examples
    --------
    >>> is_stored(Path("absent.ome.zarr"))
    False
    """
    marks = {mark for form in IMAGE_FORMATS.values() for mark in form.folder_marks}
    return path.is_file() or any((path / mark).is_file() for mark in marks)


def is_store(path: Path) -> bool:
    """Whether a path is the folder of an image that may have any size, and is opened rather than read."""
    stores = [form for form in IMAGE_FORMATS.values() if form.has_levels]
    return any((path / mark).is_file() for form in stores for mark in form.folder_marks)


def count_values(path: Path, options: ReadOptions = AS_IT_IS) -> int:
    """How many values an image has, those of all channels together, by its header alone.

    Raises
    ------
    InputError
        As `parse`, without the name of the file.

    Examples
    --------
    >>> count_values(Path("absent.nii"))
    Traceback (most recent call last):
    ...
    accelsurf.errors.InputError: there is no such file
    hint: check the path
    """
    _, header = parse(path, options)
    return int(header.values)


def options_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Names of the options of reading that the format of a file has; none where it is not known by its name.

    Examples
    --------
    >>> options_of("cells.ome.zarr")
    ('level', 'channel_index', 'time_index')
    """
    form = image_format(split_name(path)[1])
    return () if form is None else form.options


def is_outside_data_allowed() -> bool:
    """Whether a header may name a data file in another folder now; for processes that go on with this work."""
    return _OUTSIDE_DATA.get()


def _check_data_folder(path: Path, data: Path) -> None:
    """Refuse a data file that lies, with links followed, in another folder than its header."""
    folders = {path.parent.resolve(), path.resolve().parent}
    if not any(data.resolve().is_relative_to(folder) for folder in folders):
        raise _outside(f"the header names the data file {data}, outside of its own folder")


def check_within_store(store: Path, path: Path) -> None:
    """Refuse a file or folder of a store that lies, with links followed, outside of the store, if it is not allowed.

    Raises
    ------
    InputError
    """
    if not _OUTSIDE_DATA.get() and not path.resolve().is_relative_to(store.resolve()):
        raise _outside(f"{path.relative_to(store).as_posix()} is a link to a place outside of the store")


def _outside(message: str) -> InputError:
    return InputError(
        message,
        "copy it into the folder of the header; or, if you trust the header, add --allow-outside-data "
        "(in Python: accelsurf.read(path, outside_data=True))",
    )


def check_name(path: Path) -> None:
    """Refuse a name that libraries and reports cannot carry: one that is not text in UTF-8, or has a zero byte.

    Raises
    ------
    InputError
        With what to do.
    """
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        message = "the name of the file or of its folder is not valid UTF-8"
        raise InputError(message, "rename it, or link to it") from None
    if "\0" in name:
        raise InputError("the name of the file has a zero byte", "correct the name")


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
