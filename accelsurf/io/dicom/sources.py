"""The DICOM files of a path, one of them read, and its elements as texts and numbers.

A path is a folder, or one file of a series. Somebody may have cut, damaged or made up a file: no read asks for more
bytes than there are, a file whose elements are deflated is refused, and an element may hold anything. Objects that are
no slices of a volume are named by their kind. The packages pydicom and highdicom are an extra, and imported when they
are needed.
"""

from __future__ import annotations

import io
import logging
import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

from accelsurf.errors import InputError
from accelsurf.io.files import library_named

HEADER_HINT = "the header is damaged: copy the file again, or export it again"

#: Those that send lines to stderr where nobody asked for logs.
_LOGGERS = ("pydicom", "highdicom")
_DEFLATED = b"1.2.840.10008.1.2.1.99"
_SERIES_UID = 0x0020_000E
_PIXELS = (0x7FE0_0008, 0x7FE0_0009, 0x7FE0_0010)
_UNDEFINED = 0xFFFF_FFFF
_ITEM = (0xFFFE, 0xE000)
_END = (0xFFFE, 0xE0DD)
#: A read of more bytes is compared with the rest of the file before they are allocated.
_LARGE = 1 << 16
#: Pieces of packed pixels that are counted.
_MAX_PIECES = 1 << 20
SUFFIXES = (".dcm", ".ima", ".dicom")
#: Files that are looked at; a folder of more is another kind of folder.
MAX_FILES = 200_000
#: Files that are looked at to see whether a folder holds DICOM.
_TRIED = 64
_MARK = b"DICM"
_MARK_AT = 128
#: First elements of files that have no mark: groups 0002 and 0008, in either byte order.
_FIRST_GROUPS = (b"\x02\x00", b"\x08\x00", b"\x00\x08")
SEGMENTATION = "segmentation"
WHOLE_SLIDE = "whole-slide image"
PROJECTION = "projection of a tomograph"
MOSAIC = "mosaic of slices"
#: Elements that tell the kind of image, beside class, modality and type of image.
TAGS = ("TotalPixelMatrixRows", "TotalPixelMatrixColumns", "DimensionOrganizationType")
_CLASSES = {
    "1.2.840.10008.5.1.4.1.1.66.4": SEGMENTATION,
    "1.2.840.10008.5.1.4.1.1.66.7": SEGMENTATION,
    "1.2.840.10008.5.1.4.1.1.481.2": "dose",
    "1.2.840.10008.5.1.4.1.1.77.1.6": WHOLE_SLIDE,
}
_MODALITIES = {
    "SR": "report",
    "DOC": "report",
    "PR": "display state",
    "KO": "selection",
    "RTSTRUCT": "structure set",
    "RTPLAN": "plan",
    "RTDOSE": "dose",
    "SEG": SEGMENTATION,
    "REG": "registration",
    "FID": "fiducials",
    "SM": WHOLE_SLIDE,
}
#: Remedies for kinds that somebody may take for a volume.
HINTS = {
    WHOLE_SLIDE: "its frames are tiles of one plane: export a region as TIFF or OME-Zarr, by Bio-Formats or QuPath",
    PROJECTION: "its frames are views from several sides: give the reconstructed series",
    MOSAIC: "its slices lie side by side in one picture: convert it by dcm2niix",
}


@dataclass(frozen=True, eq=False)
class SourceFiles:
    """Files that may be DICOM.

    Attributes
    ----------
    root : Path
        The folder that messages name them from.
    paths : tuple of Path
        In the order of their names.
    strays : tuple of Path
        Files that have names as those and are no DICOM.
    """

    root: Path
    paths: tuple[Path, ...]
    strays: tuple[Path, ...] = ()


def is_dicom(path: Path) -> bool:
    """Test if a file begins as a DICOM does."""
    try:
        with path.open("rb") as file:
            begin = file.read(_MARK_AT + len(_MARK))
    except OSError:
        return False
    if begin[_MARK_AT:] == _MARK:
        return True
    return _suffix(path) in SUFFIXES and begin[:2] in _FIRST_GROUPS


def holds_dicom(folder: Path) -> bool:
    """Test if one of the first files in a folder is DICOM."""
    for number, path in enumerate(_walk(folder)):
        if number >= _TRIED:
            return False
        if is_dicom(path):
            return True
    return False


def files_of(path: Path) -> SourceFiles:
    """Find the files of a folder with its folders, or beside a file of a series.

    Raises
    ------
    InputError
        When there are none, or too many.
    """
    if path.is_dir():
        paths = []
        for found in _walk(path):
            paths.append(found)
            if len(paths) > MAX_FILES:
                raise InputError(
                    f"a folder of more than {MAX_FILES} files given", "give the folder of one study"
                )
        return _sorted_out(
            path, sorted(paths), f"none of {len(paths)} files in this folder is DICOM"
        )
    if not is_dicom(path):
        raise InputError("this is not a DICOM file", "is it the right one?")
    beside = (
        other for other in path.parent.iterdir() if other.is_file() and not other.is_symlink()
    )
    return _sorted_out(path.parent, sorted({path, *beside}), "")


def _sorted_out(root: Path, paths: Iterable[Path], nothing: str) -> SourceFiles:
    """Part files into DICOM and those that only have names as they have."""
    found: list[Path] = []
    others: list[Path] = []
    for path in paths:
        (found if is_dicom(path) else others).append(path)
    if not found:
        raise InputError(nothing, "give the folder of the scan")
    suffixes = {*SUFFIXES, *map(_suffix, found)}
    # Slices without an ending have numbers in their names; README has none.
    strays = tuple(
        path
        for path in others
        if (suffix := _suffix(path)) in suffixes and (suffix or re.search("[0-9]", path.name))
    )
    return SourceFiles(root, tuple(found), strays)


def _suffix(path: Path) -> str:
    """The ending of a name; none where it is a number, as the last part of an identifier."""
    suffix = path.suffix.lower()
    return "" if suffix[1:].isdigit() else suffix


def _walk(folder: Path) -> Iterator[Path]:
    """Files in a folder and those in it, in a fixed order; links are not followed."""
    for place, folders, names in os.walk(folder, followlinks=False):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            if (
                not name.startswith(".")
                and name.upper() != "DICOMDIR"
                and not path.is_symlink()
                and path.is_file()
            ):
                yield path


def dicom_library(name: str = "pydicom") -> ModuleType:
    """One of the packages, or a module of it.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        with quiet():
            return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise InputError(
            f"DICOM needs the package {package}", 'install it: pip install "accelsurf[dicom]"'
        ) from error


@contextmanager
def quiet() -> Iterator[None]:
    """Silence warnings and log lines of the packages on values that break the standard: our checks tell the faults."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.setLevel(logging.CRITICAL + 1)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


@contextmanager
def damage_of(file: Path, what: str) -> Iterator[None]:
    """Turn errors of any type that the packages raise about damaged files into an InputError.

    Parameters
    ----------
    file : Path or Member
    what : str
        The fault, as "the header is damaged".
    """
    with quiet(), library_named(f"{file.name}: {what}", "copy it again"):
        yield


@dataclass(frozen=True)
class PixelBytes:
    """The pixels of a file, as far as its lengths tell of them.

    Attributes
    ----------
    announced : int or None
        Bytes; None where they are packed, piece by piece.
    present : int
        Bytes that the file has of them.
    pieces : int
        Of packed pixels, without the table of offsets.
    is_whole : bool
        Whether packed pixels end as they should.
    """

    announced: int | None
    present: int
    pieces: int = 0
    is_whole: bool = True


def read_dataset(file: Path, tags: Sequence[str | int] | None = None) -> Any:
    """Read a file: with ``tags`` those elements alone and no pixels, else all.

    Raises
    ------
    InputError
        When it is no DICOM, or damaged.
    """
    return _read(file, tags, _PIXELS if tags is not None else ())[0]


def read_header(file: Path, tags: Sequence[str | int]) -> tuple[Any, PixelBytes | None]:
    """Read elements of a file, and find how much of its pixels is there; None: it has none.

    Raises
    ------
    InputError
        When it is no DICOM, or damaged.
    """
    return _read(file, tags, _PIXELS)


def series_of(file: Path) -> tuple[str, bool]:
    """The UID of the series that a damaged file says it is of, and whether the file ends within it.

    Empty where it cannot be read.
    """
    try:
        found = _read(file, ["SeriesInstanceUID"], (_SERIES_UID + 1,))[0].get_item(_SERIES_UID)
        return found.value.decode("ascii").strip("\0 "), len(found.value) < found.length
    except Exception:  # it is damaged, in whatever way
        return "", False


def _read(
    file: Path, tags: Sequence[str | int] | None, stops: tuple[int, ...]
) -> tuple[Any, PixelBytes | None]:
    """Read the elements before the first tag in ``stops`` (with a single stop: at or beyond it); return also the extent
    of the pixels, if reading stopped there.
    """
    pydicom = dicom_library()
    seen: list[tuple[int, int]] = []

    def stop(tag: int, vr: str | None, length: int) -> bool:
        if tag in stops or (len(stops) == 1 and tag >= stops[0]):
            seen.append((length, data.tell()))
            return True
        return False

    wanted = None if tags is None else [pydicom.tag.Tag(tag) for tag in tags]
    with damage_of(file, "no DICOM, or damaged"), _Bounded(file) as data:
        if _DEFLATED in data.read(_LARGE):  # without a limit to the unpacked size
            what = f"{file.name}: its elements are deflated"
            raise InputError(what, "unpack it first, as dcmconv --write-xfer-little IN OUT does")
        data.seek(0)
        dataset = pydicom.filereader.read_partial(
            data, stop if stops else None, force=True, specific_tags=wanted
        )
        return dataset, _pixel_bytes(data, *seen[0]) if seen else None


class _Bounded(io.BufferedReader):
    """A file of which no more is asked for than there is: bytes are allocated before they are read."""

    def __init__(self, path: os.PathLike[str]) -> None:
        super().__init__(io.FileIO(path))
        self._end = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _LARGE:
            size = min(size, max(self._end - self.tell(), 0))
        return super().read(size)


def _pixel_bytes(data: BinaryIO, length: int, start: int) -> PixelBytes:
    """Describe the pixels that begin at a byte of a file."""
    end = data.seek(0, os.SEEK_END)
    if length != _UNDEFINED:
        return PixelBytes(length, min(length, end - start))
    place, pieces = start, -1  # the first item has the offsets
    while place + 8 <= end and pieces < _MAX_PIECES:
        data.seek(place)
        head = data.read(8)
        tag, size = (
            (int.from_bytes(head[:2], "little"), int.from_bytes(head[2:4], "little")),
            int.from_bytes(head[4:], "little"),
        )
        if tag == _END:
            return PixelBytes(None, place - start, max(pieces, 0))
        if tag != _ITEM:
            break
        pieces, place = pieces + 1, place + 8 + size
    return PixelBytes(None, min(place, end) - start, max(pieces, 0), False)


class Elements:
    """A data set whose elements are looked up once: every frame asks for the same ones.

    Parameters
    ----------
    dataset : pydicom.Dataset
    """

    def __init__(self, dataset: Any) -> None:
        self.dataset = dataset
        self._known: dict[str, Any] = {}

    def get(self, name: str) -> Any:
        """Return a value by its keyword; None where there is none."""
        if name not in self._known:
            self._known[name] = self.dataset.get(name)
        return self._known[name]


def text(dataset: Any, name: str) -> str:
    """An element as text; empty where there is none."""
    value = dataset.get(name)
    return "" if value is None else " ".join(str(value).split())[:120]


def numbers_of(dataset: Any, name: str, count: int) -> tuple[float, ...] | None:
    """Read a number of finite numbers; None where the element has others."""
    value = None if dataset is None else dataset.get(name)
    if value is None or value == "":
        return None
    parts = [value] if isinstance(value, (int, float, str)) else list(value)
    found = tuple(float(part) for part in parts if part is not None)
    return found if len(found) == count and all(map(math.isfinite, found)) else None


def number_of(dataset: Any, name: str) -> float | None:
    """A finite number; None where the element has none."""
    found = numbers_of(dataset, name, 1)
    return None if found is None else found[0]


def listed(value: Any) -> list[str]:
    """The parts of an element in capitals."""
    parts = [] if value is None else [value] if isinstance(value, str) else list(value)
    return [str(part).upper() for part in parts]


def kind_of(dataset: Any) -> str:
    """Name the kind; empty for an image that may be a slice of a volume, and where nothing is said."""
    known = _CLASSES.get(text(dataset, "SOPClassUID")) or _MODALITIES.get(text(dataset, "Modality"))
    if known is not None:
        return known
    whole, part = (
        [int(dataset.get(name) or 0) for name in names]
        for names in (("TotalPixelMatrixRows", "TotalPixelMatrixColumns"), ("Rows", "Columns"))
    )
    if (
        text(dataset, "DimensionOrganizationType").startswith("TILED")
        or whole[0] > part[0]
        or whole[1] > part[1]
    ):
        return WHOLE_SLIDE
    image_type = listed(dataset.get("ImageType"))
    if "LOCALIZER" in image_type:
        return "localizer"
    if "MOSAIC" in image_type:
        return MOSAIC
    return (
        PROJECTION
        if text(dataset, "Modality") == "NM" and {"TOMO", "GATED TOMO"} & set(image_type)
        else ""
    )


def is_image(dataset: Any) -> bool:
    """Test if it is of a class of images; where it does not say its class, of a modality of them."""
    uid = text(dataset, "SOPClassUID")
    if not uid:
        return text(dataset, "Modality") in ("CT", "MR", "PT", "NM", "US", "XA")
    name = str(dicom_library("pydicom.uid").UID(uid).name)
    return "Image Storage" in name and "Non-Image" not in name
