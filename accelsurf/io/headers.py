"""Headers of images: the format of a file, by its name or its content, and the claims of its header, without voxels.

A header may name files in its own folder only. Metadata have the keys given here. Times of
frames are a step and its unit, or where these cannot say them, a line of text (`FrameTimes.text`).
"""

from __future__ import annotations

import errno
import math
import os
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from accelsurf.errors import InputError, UsageError
from accelsurf.image import volume
from accelsurf.image.sequence import check_times
from accelsurf.io.format_functions import functions_of
from accelsurf.settings import budgets
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_format, image_suffixes
from accelsurf.settings.reading import AS_IT_IS, ReadOptions, Spacing, check_readable

TimeUnit = Literal["s", "frame"]
#: Under which name files hold the line of text of `FrameTimes.text`.
TIMES_KEY = "accelsurf_frame_times"
_NUMBER = r"-?[0-9]{1,20}(?:\.[0-9]{1,20})?(?:e[-+]?[0-9]{1,3})?"
_TEXT = re.compile(rf"(s|frame)((?: {_NUMBER})+)\s*")
WARNING_KEY = "warning"
"""A warning about the file that was read; absent when there is none."""
LABELS_KEY = "labels"
"""Names and colours of a label map, from `accelsurf.settings.labels.LabelTable.to_json`; absent where none are known.
"""
DICOM_KEY = "dicom_series"
"""The UID of the series that an image was read from; absent where it was no DICOM."""
ZERO_BEYOND_KEY = "zero_beyond"
"""There where a label map's format stores only voxels near labels, as a DICOM segmentation: all beyond them are 0."""
VALUE_UNIT_KEY = "value_unit"
"""The unit of the values, as HU, where the file says it."""
NIFTI_KEY = "nifti_grid"
"""The fields of a NIFTI header that place the grid, in hexadecimal digits, as `NiftiGrid.fields` gives them."""
NRRD_KEY = "nrrd_space"
"""The lines of an NRRD header that place the grid."""
MGH_KEY = "mgh"
"""Present where the image was MGH or MGZ."""
ORIENTED_KEY = "ome_oriented"
"""Present where the axes of an OME-Zarr were given an anatomical orientation."""
UNIT_KEY = volume.UNIT_KEY
"""The unit in which the file gives lengths, nm or um, or in which they were given; absent where the file's is mm, or
none. All lengths here are mm."""
FRAME_KEY = "frame_seconds"
"""Seconds from one time point of a sequence to the next; absent where the file does not say them."""


def parse_header(path: Path, options: ReadOptions = AS_IT_IS) -> tuple[ImageFormat, Any]:
    """Read the header of a file without its voxels; return its format and the claims of the header.

    Parameters
    ----------
    path : Path
        A file, or a folder that is an image.
    options : ReadOptions, optional
        Requested options.

    Raises
    ------
    UsageError
        When the format does not have a requested option.
    InputError
        When the file does not exist, no format has its ending, or it is empty, is not of that format, is damaged, or
        points to a data file that does not exist, or outside of its folder; GeometryError when its header does not
        describe a grid.
    """
    form = format_of(path)
    header = _header(form, path, options)
    if not path.is_file():  # a folder, or a pattern
        return form, header
    data = getattr(header, "data", path)
    if data != path:
        _check_data_folder(path, data)
    if hasattr(header, "check_claims"):
        header.check_claims()
    return form, header


def _header(form: ImageFormat, path: Path, options: ReadOptions) -> Any:
    """Claims of a header."""
    # The first of one is harmless to ask for, and the level that fits.
    unknown = [
        n for n in options.given if n not in form.options and getattr(options, n) not in (0, "auto")
    ]
    if unknown:
        name, value = unknown[0].replace("_", "-"), getattr(options, unknown[0])
        raise UsageError(
            f"{name}: {value} was given, and {kind_of(form)} has no such choice", "leave it out"
        )
    parse_header = functions_of(form).parse
    return parse_header(path, options) if form.options else parse_header(path)


def format_of(path: Path) -> ImageFormat:
    """The format of a file or folder, of slices by a pattern: by name, else by content.

    Raises
    ------
    InputError
        When the file does not exist, is empty, or of no known format.
    """
    check_name(path)
    if path.is_dir():
        form = _folder_format(path)
        if form is None:
            raise InputError(
                "this is a folder, an image file expected",
                "give an image file, or a folder of DICOM",
            )
        return form
    if not path.exists():
        if is_pattern(path):
            return IMAGE_FORMATS["slices"]
        raise InputError("there is no such file", hint="check the path")
    form = image_format(split_name(path)[1])
    if form is None and path.is_file():
        form = next((kind for kind in IMAGE_FORMATS.values() if _holds(kind, path)), None)
        if form is None and zipfile.is_zipfile(path):
            raise InputError("zip archives are not read", "unpack it, and give what is in it")
    if form is None:
        raise InputError(
            f"unknown file type, one of {', '.join(image_suffixes())} expected",
            hint="convert the image to one of them first",
        )
    check_readable(path)
    if path.stat().st_size == 0:
        raise InputError("the file is empty", hint="copy or export it again")
    return form


def _folder_format(path: Path) -> ImageFormat | None:
    """The format of a folder; None where it is none, or holds no image."""
    if not os.path.isdir(path):  # Path raises an error for a name that is too long
        return None
    named = image_format(split_name(path)[1])
    for form in IMAGE_FORMATS.values():
        if form.folder_marks and (
            form is named or any((path / mark).is_file() for mark in form.folder_marks)
        ):
            return form
    for form in IMAGE_FORMATS.values():
        is_folder = functions_of(form).is_folder
        if is_folder is not None and is_folder(path):
            return form
    return None


def _holds(form: ImageFormat, path: Path) -> bool:
    is_file = functions_of(form).is_file
    return is_file is not None and is_file(path)


def kind_of(form: ImageFormat) -> str:
    """Name of an image of a format in messages.

    Examples
    --------
    >>> kind_of(IMAGE_FORMATS["nii"]), kind_of(IMAGE_FORMATS["slices"])
    ('a .nii', 'a folder of slices')
    """
    return f"a {form.suffixes[0]}" if form.suffixes else f"a folder of {form.name}"


def options_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Names of the options of reading that the format of a file has; none where it is not known by its name.

    Examples
    --------
    >>> options_of("cells.ome.zarr")
    ('level', 'channel_index', 'time_index', 'channels_from_time')
    """
    path = Path(path)
    if is_pattern(path):
        return IMAGE_FORMATS["slices"].options
    form = image_format(split_name(path)[1]) or _folder_format(path)
    return () if form is None else form.options


def header_counts(path: Path, options: ReadOptions = AS_IT_IS) -> tuple[int, int]:
    """Count the channels and time points of an image, by its header alone.

    Raises
    ------
    InputError
        As `parse_header`.
    """
    _, header = parse_header(path, options)
    return int(getattr(header, "channels", 1)), int(getattr(header, "time_points", 1))


def is_stored(path: Path) -> bool:
    """Test if a path names a file, or a folder that is an image.

    Examples
    --------
    >>> is_stored(Path("absent.ome.zarr"))
    False
    """
    marks = {mark for form in IMAGE_FORMATS.values() for mark in form.folder_marks}
    # os.path: of a name that is too long for the system Path says so by an error.
    return os.path.isfile(path) or any(os.path.isfile(path / mark) for mark in marks)


def is_store(path: Path) -> bool:
    """Test if a path is the folder of an image that may have any size, and is opened rather than read."""
    stores = [form for form in IMAGE_FORMATS.values() if form.has_levels]
    return any(os.path.isfile(path / mark) for form in stores for mark in form.folder_marks)


def is_pattern(path: Path) -> bool:
    """Test if a path names files by a pattern, and no file itself.

    Examples
    --------
    >>> is_pattern(Path("slices/a*.tif")), is_pattern(Path("scan.nii"))
    (True, False)
    """
    # os.path's answer is False for a name that no file can have.
    return any(sign in path.name for sign in "*?") and not os.path.exists(path)


def image_name(path: Path) -> str:
    """The name of an image without folder and suffix, which its outputs have; of a pattern that of the folder.

    Examples
    --------
    >>> image_name(Path("scans/head.nii.gz")), image_name(Path("scans/slices/*.tif"))
    ('head', 'slices')
    """
    whole = path.absolute()
    return split_name(whole.parent if is_pattern(path) else whole)[0]


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


def check_name(path: Path) -> None:
    """Refuse a name that libraries and reports cannot carry: one that is not text in UTF-8, or has a zero byte.

    Raises
    ------
    InputError
        With advice.
    """
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        message = "the name of the file or of its folder is not valid UTF-8"
        raise InputError(message, "rename it, or link to it") from None
    if "\0" in name:
        raise InputError("the name of the file has a zero byte", "correct the name")
    try:
        os.lstat(path)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InputError("the name of the file is too long", "correct the name") from None


def check_data_file(path: Path, data: Path) -> None:
    """Refuse a further file that a header names where it is missing, or lies in another folder than its header.

    Raises
    ------
    InputError
        With advice.
    """
    _check_data_folder(path, data)
    if not data.is_file():
        raise InputError(
            f"the header names the file {data.name}, which is missing",
            f"copy {data.name} into the same folder",
        )


def _check_data_folder(path: Path, data: Path) -> None:
    """Refuse a data file that lies, with links followed, in another folder than its header.

    A header comes from elsewhere more often than a data file does: it could name any file of the computer, whose bytes
    would then be shown as an image.
    """
    folders = {path.parent.resolve(), path.resolve().parent}
    if not any(data.resolve().is_relative_to(folder) for folder in folders):
        raise InputError(
            f"the header names the data file {data}, outside of its own folder",
            "copy it into the folder of the header",
        )


def check_within_store(store: Path, path: Path) -> None:
    """Refuse a file or folder of a store that lies, with links followed, outside of the store.

    Raises
    ------
    InputError
    """
    if not path.resolve().is_relative_to(store.resolve()):
        name = path.relative_to(store).as_posix()
        raise InputError(
            f"{name} is a link to a place outside of the store",
            "copy the store with its links: cp -rL",
        )


def is_anatomical(metadata: Mapping[str, str]) -> bool:
    """Test if a header says that the world axes are a patient's: a NIfTI transform code, or an NRRD space by name.

    Parameters
    ----------
    metadata : mapping of str to str
        As in `Volume.metadata`.
    """
    # Bytes 17 to 20 of these fields are the codes of qform and sform; both 0 means that the world is not known.
    codes = bytes.fromhex(metadata.get(NIFTI_KEY, ""))[17:21]
    is_named = "space: left-" in metadata.get(NRRD_KEY, "")
    return (
        any(codes) or is_named or any(key in metadata for key in (ORIENTED_KEY, DICOM_KEY, MGH_KEY))
    )


def shows_patient(image: volume.Volume) -> bool:
    """Test if an image is a patient's, whose planes and directions have names.

    Writers of NIfTI and NRRD say of every image that its axes are a patient's, of a plant and of a cell, too. Nothing
    is known of an image in um or nm, and of one that no scanner has placed: along the axes, with its first voxel or its
    middle at the world's origin, as programs place arrays.
    """
    metadata, geometry = image.metadata, image.geometry
    if not is_anatomical(metadata) or geometry.unit != "mm":
        return False
    if DICOM_KEY in metadata or ORIENTED_KEY in metadata:
        return True
    at = geometry.world_to_index((0.0, 0.0, 0.0))
    middle = 0.5 * (np.array(geometry.shape) - 1)
    is_default = np.abs(at).max() < 1e-3 or np.abs(at - middle).max() <= 1.0
    return not (is_default and np.array_equal(np.abs(geometry.direction), np.eye(3)))


def size_question(image: volume.Volume, path: Path) -> str:
    """Ask about an image that is too large for lengths in mm: they may be in um. Empty where it is not.

    A patient is up to 3 m long; any other image in mm is asked about from 1 m, or 300 l, on.
    """
    metadata, geometry = image.metadata, image.geometry
    longest, litres = max(geometry.extent_mm), math.prod(geometry.extent_mm) / 1e6
    is_patient = shows_patient(image)
    if (
        UNIT_KEY in metadata
        or geometry.unit != "mm"
        or longest <= (3000.0 if is_patient else 1000.0)
        and (is_patient or litres < 300.0 or geometry.slice_axis is not None)
    ):
        return ""
    sizes = ",".join(f"{size:.4g}" for size in geometry.spacing_xyz)
    way = (
        f"--spacing {sizes}um says otherwise"
        if "spacing" in options_of(path)
        else "correct the unit in the file if it is another"
    )
    return f"lengths are read as mm, and the image is {longest / 1e3:.3g} m wide: is that so? {way}"


def with_warnings(metadata: Mapping[str, str], *notes: str) -> dict[str, str]:
    """The metadata with further warnings.

    Examples
    --------
    >>> with_warnings({"warning": "a"}, "b", "")
    {'warning': 'a; b'}
    """
    said = "; ".join(note for note in (metadata.get(WARNING_KEY, ""), *notes) if note)
    return {**metadata, WARNING_KEY: said} if said else dict(metadata)


def with_given_unit(metadata: Mapping[str, str], options: ReadOptions) -> dict[str, str]:
    """The metadata with the unit in which a size of the voxels was given, in place of that of the file.

    Examples
    --------
    >>> with_given_unit({}, ReadOptions(spacing=Spacing((2e-4, 2e-4, 1e-3), "um")))
    {'spatial_unit': 'um'}
    """
    if not isinstance(options.spacing, Spacing) or not options.spacing.unit:
        return dict(metadata)
    return {**metadata, UNIT_KEY: options.spacing.unit}


@dataclass(frozen=True)
class FrameTimes:
    """When the frames of a sequence are.

    Attributes
    ----------
    values : tuple of float
        Rising, one for each frame.
    unit : {"s", "frame"}

    Examples
    --------
    >>> FrameTimes.regular(3, 0.5), FrameTimes((0.0, 1.0, 3.0), "frame").step
    (FrameTimes(values=(0.0, 0.5, 1.0), unit='s'), None)
    """

    values: tuple[float, ...]
    unit: TimeUnit = "frame"

    @classmethod
    def checked(cls, values: Sequence[float], unit: str) -> FrameTimes:
        """Times that were given, checked.

        Raises
        ------
        UsageError
            When there is none, or the unit is no unit; InputError when they do not rise.
        """
        if unit not in ("s", "frame"):
            raise UsageError(f"time unit {unit!r} given, s or frame expected")
        numbers = tuple(float(value) for value in values)
        if not numbers or not all(map(math.isfinite, numbers)):
            raise UsageError(
                f"{len(numbers)} times given, finite numbers for one frame or more expected"
            )
        check_times(numbers)
        return cls(numbers, cast(TimeUnit, unit))

    @classmethod
    def regular(cls, count: int, seconds: float | None) -> FrameTimes:
        """Frames from time 0 on, ``seconds`` apart; or where that is None, counted.

        Raises
        ------
        InputError
            When there are more than an axis of time may have.
        """
        budgets.AXIS.check(count, "the time points of the sequence")
        if seconds is None:
            return cls(tuple(float(n) for n in range(count)))
        return cls(tuple(n * seconds for n in range(count)), "s")

    @classmethod
    def from_text(cls, text: str, count: int) -> FrameTimes:
        """Read the output of `text` for a number of frames; one number for several frames is the step between them.

        Raises
        ------
        InputError
            When it is damaged, or of another number of frames.
        """
        found = _TEXT.fullmatch(text.strip())
        values = tuple(float(word) for word in found.group(2).split()) if found else ()
        if (
            found is not None
            and len(values) == 1 < count
            and values[0] > 0
            and found.group(1) == "s"
        ):
            return cls.regular(count, values[0])
        if found is None or len(values) != count or not all(map(math.isfinite, values)):
            raise InputError(
                f"the times of {count} frames expected, found {text[:60]!r}",
                "correct or take them out",
            )
        check_times(values)
        return cls(values, cast(TimeUnit, found.group(1)))

    @property
    def step(self) -> float | None:
        """From one frame to the next, where the first is at 0 and all are equally far apart; else None."""
        if self.values[0] != 0.0:
            return None
        step = self.values[1] if len(self.values) > 1 else 1.0
        return step if all(value == n * step for n, value in enumerate(self.values)) else None

    @property
    def seconds(self) -> float | None:
        """The step in seconds; None where there is none, or the unit is another."""
        return self.step if self.unit == "s" else None

    @property
    def is_count(self) -> bool:
        """True if the frames are counted: 0, 1, 2, ..."""
        return self.unit == "frame" and self.step == 1.0

    @property
    def mean_step(self) -> float:
        """From one frame to the next on average, for fields of headers that hold one number."""
        if len(self.values) == 1:
            return 1.0
        return self.step or (self.values[-1] - self.values[0]) / (len(self.values) - 1)

    @property
    def text(self) -> str:
        """Unit and times as a line of text; the numbers are exact."""
        return " ".join([self.unit, *(repr(value) for value in self.values)])


def single_precision(value: float) -> float:
    """The shortest number that has the same single precision: the intended one where a header holds 0.0399999991.

    Examples
    --------
    >>> single_precision(0.03999999910593033)
    0.04
    """
    with np.errstate(over="ignore"):
        return float(str(np.float32(value)))
