"""The DICOM files of a path: of a folder and those in it, of an archive, or of the series of one file."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import weakref
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from accelsurf.errors import InputError
from accelsurf.io.files import library_named

SUFFIXES = (".dcm", ".ima", ".dicom")
#: Files that are looked at; a folder of more is another kind of folder.
MAX_FILES = 200_000
#: Files that are looked at to see whether a folder holds DICOM.
_TRIED = 64
_MARK, _MARK_AT = b"DICM", 128
#: First elements of files that have no mark: groups 0002 and 0008, in either byte order.
_FIRST_GROUPS = (b"\x02\x00", b"\x08\x00", b"\x00\x08")


@dataclass(frozen=True, eq=False)
class SourceFiles:
    """Files that may be DICOM.

    Attributes
    ----------
    root : Path
        The folder that messages name them from.
    paths : tuple of Path
        In the order of their names.
    unpacked : bool
        Whether they were unpacked there; then the folder goes with this record.
    """

    root: Path
    paths: tuple[Path, ...]
    unpacked: bool = False


def is_dicom(path: Path) -> bool:
    """Whether a file begins as a DICOM does."""
    try:
        with path.open("rb") as file:
            begin = file.read(_MARK_AT + len(_MARK))
    except OSError:
        return False
    if begin[_MARK_AT:] == _MARK:
        return True
    return path.suffix.lower() in SUFFIXES and begin[:2] in _FIRST_GROUPS


def holds_dicom(folder: Path) -> bool:
    """Whether one of the first files in a folder is DICOM."""
    for number, path in enumerate(_walk(folder)):
        if number >= _TRIED:
            return False
        if is_dicom(path):
            return True
    return False


def files_of(path: Path, available: int) -> SourceFiles:
    """Find the files of a folder with its folders, of a zip archive, or beside a file of a series.

    Parameters
    ----------
    path : Path
    available : int
        Bytes that an archive may unpack to.

    Raises
    ------
    InputError
        When there are none, too many, or the archive cannot be unpacked.
    """
    if path.is_dir():
        return SourceFiles(path, _dicom_files(path))
    if zipfile.is_zipfile(path):
        return _unpacked(path, available)
    if not is_dicom(path):
        raise InputError("this is not a DICOM file or an archive of them", "is it the right one?")
    beside = (one for one in path.parent.iterdir() if one.is_file() and not one.is_symlink() and is_dicom(one))
    return SourceFiles(path.parent, tuple(sorted({path, *beside})))


def _dicom_files(folder: Path) -> tuple[Path, ...]:
    paths = []
    for path in _walk(folder):
        paths.append(path)
        if len(paths) > MAX_FILES:
            raise InputError(f"a folder of more than {MAX_FILES} files given", "give the folder of one study")
    found = tuple(sorted(path for path in paths if is_dicom(path)))
    if not found:
        raise InputError(f"none of {len(paths)} files in this folder is DICOM", "give the folder of the scan")
    return found


def _walk(folder: Path) -> Iterator[Path]:
    """Files in a folder and those in it, in a fixed order; links are not followed."""
    for place, folders, names in os.walk(folder, followlinks=False):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            if not name.startswith(".") and name.upper() != "DICOMDIR" and not path.is_symlink() and path.is_file():
                yield path


def _unpacked(path: Path, available: int) -> SourceFiles:
    """Unpack an archive into a folder of its own that goes when nobody needs it."""
    root = Path(tempfile.mkdtemp(prefix="accelsurf-dicom-"))
    try:
        _unpack_all(path, root, available)
        found = tuple(one for one in sorted(root.rglob("*")) if one.is_file() and is_dicom(one))
        if not found:
            raise InputError("no DICOM file is in the archive", "is it the right one?")
    except BaseException:
        shutil.rmtree(root, ignore_errors=True)
        raise
    files = SourceFiles(root, found, True)
    weakref.finalize(files, shutil.rmtree, root, True)
    return files


def _unpack_all(path: Path, root: Path, available: int) -> None:
    limit = min(available, shutil.disk_usage(root).free // 2)
    with library_named("the archive is damaged or locked", "unpack it, and give the folder"):
        with zipfile.ZipFile(path) as archive:
            members = [one for one in archive.infolist() if not one.is_dir()]
            claimed = sum(one.file_size for one in members)
            if len(members) > MAX_FILES or claimed > limit:
                raise InputError(
                    f"an archive of {len(members)} files and {claimed / 1e9:.3g} GB given, at most {MAX_FILES} and "
                    f"{limit / 1e9:.3g} GB expected",
                    "unpack it, and give the folder of the scan",
                )
            for number, member in enumerate(members):
                _unpack(archive, member, root / f"{number:06d}" / _safe_name(member))


def _safe_name(member: zipfile.ZipInfo) -> str:
    """The last part of a member's name: whatever it says, its file lies in the folder made for it."""
    if stat.S_ISLNK(member.external_attr >> 16):
        raise InputError(f"the archive has a link, {member.filename[:80]}", "unpack it, and give the folder")
    name = PurePosixPath(member.filename.replace("\\", "/")).name
    return name if name not in ("", ".", "..") else "file"


def _unpack(archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path) -> None:
    """Unpack a member, no more of it than the archive claims."""
    target.parent.mkdir()
    with archive.open(member) as packed, target.open("wb") as file:
        left = member.file_size
        while block := packed.read(min(1 << 20, left + 1)):
            left -= len(block)
            if left < 0:
                raise InputError(f"{member.filename[:80]} is larger than the archive claims", "pack it again")
            file.write(block)
