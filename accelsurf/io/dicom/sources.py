"""The DICOM files of a path: of a folder and those in it, of an archive, or of the series of one file."""

from __future__ import annotations

import lzma
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from accelsurf.errors import InputError
from accelsurf.settings import budgets

SUFFIXES, ARCHIVE = (".dcm", ".ima", ".dicom"), ".zip"
#: Files that are looked at; a folder of more is another kind of folder.
MAX_FILES = 200_000
#: Files that are looked at to see whether a folder holds DICOM.
_TRIED = 64
_MARK, _MARK_AT = b"DICM", 128
#: First elements of files that have no mark: groups 0002 and 0008, in either byte order.
_FIRST_GROUPS = (b"\x02\x00", b"\x08\x00", b"\x00\x08")
_HINT = "unpack it, and give the folder"
#: Bytes of a damaged member that are looked at, and of one read of them.
_MAX_REMAINS, _BLOCK = 1 << 16, 1 << 10


@dataclass(frozen=True, eq=False)
class Member:
    """A file of a zip archive. It is read into memory; nothing is unpacked onto the disk.

    Attributes
    ----------
    archive : ZipFile
    info : ZipInfo
    """

    archive: zipfile.ZipFile
    info: zipfile.ZipInfo

    @property
    def name(self) -> str:
        """The last part of its name."""
        return PurePosixPath(self.shown).name

    @property
    def shown(self) -> str:
        """Its name in the archive, for messages."""
        return self.info.filename.replace("\\", "/")[-80:]

    def __str__(self) -> str:
        return f"{self.info.header_offset:020d}"

    def first_bytes(self, count: int) -> bytes:
        """Return its first bytes.

        Raises
        ------
        InputError
            When they cannot be unpacked.
        """
        return self._unpacked(count)

    def content(self) -> bytes:
        """Return its bytes, no more than the archive claims.

        Raises
        ------
        InputError
            When they cannot be unpacked, or are more.
        """
        found = self._unpacked(self.info.file_size + 1)
        if len(found) != self.info.file_size:
            raise InputError(f"{self.name}: its size is not what the archive claims", "pack it again")
        return found

    def remains(self) -> bytes:
        """Return what can be unpacked of its beginning, whatever is wrong with the rest."""
        found = b""
        try:
            with self.archive.open(self.info) as packed:
                while len(found) < _MAX_REMAINS and (block := packed.read(_BLOCK)):
                    found += block
        except _ZIP_ERRORS:
            pass
        return found

    def _unpacked(self, count: int) -> bytes:
        try:
            with self.archive.open(self.info) as packed:
                return packed.read(count)
        except _ZIP_ERRORS as error:
            raise InputError(f"{self.name}: damaged in the archive, or locked ({error})", _HINT) from error


_ZIP_ERRORS = (
    zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, OSError, zlib.error, lzma.LZMAError, ValueError
)
#: A file on the disk or in an archive.
DicomFile = Path | Member


@dataclass(frozen=True, eq=False)
class SourceFiles:
    """Files that may be DICOM.

    Attributes
    ----------
    root : Path
        The folder that messages name them from, or the archive.
    paths : tuple of Path or Member
        In the order of their names.
    strays : tuple of Path or Member
        Files that have names as those and are no DICOM; archives.
    is_archive : bool
    """

    root: Path
    paths: tuple[DicomFile, ...]
    strays: tuple[DicomFile, ...] = ()
    is_archive: bool = False


def is_dicom(path: DicomFile) -> bool:
    """Test if a file begins as a DICOM does."""
    count = _MARK_AT + len(_MARK)
    try:
        if isinstance(path, Member):
            begin = path.first_bytes(count)
        else:
            with path.open("rb") as file:
                begin = file.read(count)
    except (OSError, InputError):
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


def files_of(path: Path, available: int) -> SourceFiles:
    """Find the files of a folder with its folders, of a zip archive, or beside a file of a series.

    Parameters
    ----------
    path : Path
    available : int
        Bytes that a member of an archive may unpack to.

    Raises
    ------
    InputError
        When there are none, too many, or the archive is damaged.
    """
    if path.is_dir():
        paths = []
        for found in _walk(path):
            paths.append(found)
            if len(paths) > MAX_FILES:
                raise InputError(f"a folder of more than {MAX_FILES} files given", "give the folder of one study")
        return _sorted_out(path, sorted(paths), f"none of {len(paths)} files in this folder is DICOM")
    if not is_dicom(path):
        if zipfile.is_zipfile(path):
            return _of_archive(path, available)
        raise InputError("this is not a DICOM file or an archive of them", "is it the right one?")
    beside = (other for other in path.parent.iterdir() if other.is_file() and not other.is_symlink())
    return _sorted_out(path.parent, sorted({path, *beside}), "")


def _sorted_out(root: Path, paths: Iterable[DicomFile], nothing: str, is_archive: bool = False) -> SourceFiles:
    """Part files into DICOM and those that only have names as they have."""
    found: list[DicomFile] = []
    others: list[DicomFile] = []
    for path in paths:
        (found if is_dicom(path) else others).append(path)
    if not found:
        raise InputError(nothing, "give the folder of the scan")
    suffixes = {_suffix(path) for path in found}
    suffixes |= {*SUFFIXES, ARCHIVE}
    # Slices without an ending have numbers in their names; README has none.
    strays = tuple(
        path for path in others if (suffix := _suffix(path)) in suffixes and (suffix or re.search("[0-9]", path.name))
    )
    return SourceFiles(root, tuple(found), strays, is_archive)


def _suffix(path: DicomFile) -> str:
    """The ending of a name; none where it is a number, as the last part of an identifier."""
    suffix = PurePosixPath(path.name).suffix.lower()
    return "" if suffix[1:].isdigit() else suffix


def _walk(folder: Path) -> Iterator[Path]:
    """Files in a folder and those in it, in a fixed order; links are not followed."""
    for place, folders, names in os.walk(folder, followlinks=False):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            if not name.startswith(".") and name.upper() != "DICOMDIR" and not path.is_symlink() and path.is_file():
                yield path


def _of_archive(path: Path, available: int) -> SourceFiles:
    """The members of an archive, after it is clear what they cost."""
    try:
        archive = zipfile.ZipFile(path)
    except _ZIP_ERRORS as error:
        raise InputError(f"the archive is damaged ({error})", _HINT) from error
    infos = [info for info in archive.infolist() if not info.is_dir()]
    budgets.DICOM_ARCHIVE_FILES.check(len(infos))
    for info in infos:
        if stat.S_ISLNK(info.external_attr >> 16):
            raise InputError(f"the archive has a link, {info.filename[:80]}", _HINT)
    claimed, stored = sum(info.file_size for info in infos), path.stat().st_size
    budgets.DICOM_ARCHIVE_BYTES.check(claimed)
    budgets.DICOM_ARCHIVE.check(claimed, factor=stored + (1 << 20))
    largest = max((info.file_size for info in infos), default=0)
    if largest > available:
        raise InputError(f"a file of {largest} bytes in the archive, {available} are available", _HINT)
    members = [Member(archive, info) for info in infos if _is_seen(info)]
    return _sorted_out(path, members, "no DICOM file is in the archive", True)


def _is_seen(info: zipfile.ZipInfo) -> bool:
    """Test if a member is looked at, as files in a folder are."""
    parts = PurePosixPath(info.filename.replace("\\", "/")).parts
    return bool(parts) and not any(p.startswith(".") and p not in ("..", ".") for p in parts[-1:]) and (
        parts[-1].upper() != "DICOMDIR" and parts[0] != "__MACOSX"
    )
