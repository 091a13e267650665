"""Journals of sets of files that this user's processes are writing: in the user's state folder, nowhere else.

What lies in an output folder may have come with somebody's data, so nothing there can order a move or a deletion. A
journal is tied to the output folder by device and inode, and to the staging folder in it by a name that nobody can
guess. A lock of the operating system beside the journal ends with the process: who gets the lock of a journal that is
there already knows that its writer is dead.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

#: First and last characters of the name of a staging folder.
PREFIX, SUFFIX = ".", ".accelsurf"
_JOURNAL, _LOCK, _UNFINISHED = ".json", ".lock", ".draft"
#: Journals of killed runs whose folders nobody has written to since are forgotten after so long.
_FORGOTTEN_DAYS = 90
_STAGING = re.compile(r"\..+\.[0-9a-f]{16}\.accelsurf", re.DOTALL)
#: Bytes of a file's name that file systems allow, and of a journal: the names of many frames are in it.
_MAX_FILE_NAME, _MAX_JOURNAL = 255, 1 << 26
#: Longest name of a set that is repeated in the name of its staging folder, bytes: file systems allow 255.
_MAX_NAME_BYTES = 200
#: Lists of names in `Moves`.
_LISTS = ("files", "remove")
#: Only the user may write these, on systems that say who may.
_OTHERS_MAY_WRITE = 0o022
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
#: A pipe in the place of a journal is not waited for.
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)


@dataclass(frozen=True)
class Moves:
    """Moves of a set: ``files`` in their order, then ``last``; ``remove`` are old files; ``undo`` moves all back."""

    files: Sequence[str]
    remove: Sequence[str]
    last: str | None
    undo: bool = False


class Journal:
    """The journal of one set, locked by this process.

    Attributes
    ----------
    staging : Path
        The folder beside the outputs in which new files lie until they are complete.
    moves : Moves or None
        None as long as files are being written.
    reason : str
        Why it is in no file.
    """

    def __init__(
        self,
        path: Path | None,
        lock: int,
        staging: Path,
        moves: Moves | None = None,
        reason: str = "",
    ) -> None:
        self._path, self._lock = path, lock
        self.staging, self.moves, self.reason = staging, moves, reason

    @property
    def has_file(self) -> bool:
        """True if it is in a file, so that another process finds it after a kill."""
        return self._path is not None

    def write(self, moves: Moves | None) -> None:
        """Say what is to be moved; it is on the disk afterwards.

        Raises
        ------
        OSError
            When it cannot be written.
        """
        if self._path is not None:
            content = {
                "staging": self.staging.name,
                "moves": None if moves is None else asdict(moves),
            }
            unfinished = self._path.with_suffix(_UNFINISHED)
            unfinished.unlink(missing_ok=True)
            with open(
                os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600),
                "w",
                encoding="utf-8",
            ) as file:
                file.write(json.dumps(content))  # names that are no UTF-8 are escaped
                if moves is not None:
                    file.flush()
                    os.fsync(file.fileno())
            os.replace(unfinished, self._path)
            if moves is not None:
                sync_folder(self._path.parent)
        self.moves = moves

    def keep_in_memory(self, moves: Moves, error: OSError) -> None:
        """Go on without a file, which would say that the staging folder may go."""
        self.end()
        self._path, self.moves, self.reason = None, moves, error.strerror or str(error)

    def clear(self) -> None:
        """Say that nothing is to be moved any more."""
        try:
            self.write(None)
        except OSError:  # a full disk
            if self._path is not None:
                _unlink(self._path)
        self.moves = None

    def end(self) -> None:
        """Remove it, and free the lock; more than once does nothing."""
        if self._path is not None and self._lock >= 0:
            _unlink(self._path.with_suffix(_UNFINISHED))
            _unlink(self._path)
            _free(self._lock, self._path.with_suffix(_LOCK))
        self._lock = -1

    def release(self) -> None:
        """Free the lock and leave the journal, for another process to deal with."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def state_folder() -> Path:
    """Folder of the journals, made if it is not there.

    Raises
    ------
    OSError
        When nothing can be written there, or others than the user can write there, too.
    """
    from platformdirs import user_state_path

    try:
        folder = user_state_path("accelsurf", appauthor=False) / "sets"
    except RuntimeError as error:
        raise OSError(errno.ENOENT, str(error)) from error
    if not folder.is_absolute():  # older versions say so in this way
        raise OSError(errno.ENOENT, "the user has no home folder")
    there = next(parent for parent in folder.parents if parent.exists())
    if (
        os.name == "posix" and os.geteuid() == 0 and there.stat().st_uid != 0
    ):  # sudo: these would not be the user's
        raise PermissionError(errno.EACCES, "it is the folder of another user", str(folder))
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for part in (folder.parent, folder):
        found = part.lstat()
        if not is_private(found) or not stat.S_ISDIR(found.st_mode):
            raise PermissionError(errno.EACCES, "others than the user may write there", str(part))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, "Permission denied", str(folder))
    return folder


def begin_journal(folder: Path, name: str, unique: bool) -> Journal | None:
    """Return the locked journal of a new set of files; None where another process writes a set of this name there.

    Parameters
    ----------
    folder : Path
        Where the files will be; it exists.
    name : str
        Of the set.
    unique : bool
        Whether others may write one of this name at the same time.

    Raises
    ------
    OSError
        When the folder cannot be looked at.
    """
    token = secrets.token_hex(8)
    staging = folder / staging_name(name, token)
    if is_staging(folder):  # its own journal says that all in it is of this user
        return Journal(None, -1, staging)
    try:
        state = state_folder()
    except OSError as error:
        return Journal(None, -1, staging, reason=error.strerror or str(error))
    _forget_old(state)
    word = token if unique else hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
    path = state / f"{_identity(folder)}-{word}{_JOURNAL}"
    try:
        lock = _locked(path)
    except OSError as error:
        _unlink(path.with_suffix(_LOCK))
        return Journal(None, -1, staging, reason=error.strerror or str(error))
    if lock is None:
        return None
    if path.is_dir():
        _free(lock, path.with_suffix(_LOCK))
        return Journal(None, -1, staging, reason=f"{path} is a folder")
    if path.exists():  # its writer has died since the folder was recovered
        os.close(lock)
        return None
    journal = Journal(path, lock, staging)
    try:
        journal.write(None)
    except OSError as error:
        journal.end()
        return Journal(None, -1, staging, reason=error.strerror or str(error))
    except BaseException:
        journal.end()
        raise
    return journal


def journals_of_the_dead(folder: Path) -> Iterator[Journal]:
    """Journals of sets in a folder whose writers are dead, each locked; of those that live none.

    Parameters
    ----------
    folder : Path
    """
    for path in _journals(folder):
        try:
            lock = _locked(path)
        except OSError:  # one cannot know whether its writer lives
            continue
        if lock is None:
            continue
        content = _content(path)
        if content is None:
            Journal(path, lock, folder).end()
        else:
            moves = content["moves"]
            yield Journal(
                path, lock, folder / content["staging"], None if moves is None else Moves(**moves)
            )


def recorded_staging(folder: Path) -> set[str]:
    """Names of the staging folders in a folder that journals of this user name."""
    contents = (_content(path) for path in _journals(folder))
    return {content["staging"] for content in contents if content is not None}


def staging_name(name: str, token: str) -> str:
    """Name of the staging folder of a set; short enough for any file system.

    Examples
    --------
    >>> staging_name("scan", "0123"), len(staging_name("x" * 255, "0123"))
    ('.scan.0123.accelsurf', 73)
    """
    if len(os.fsencode(name)) > _MAX_NAME_BYTES:
        name = f"{name[:40]}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:16]}"
    return f"{PREFIX}{name}.{token}{SUFFIX}"


def belongs_to(staging: Path, name: str) -> bool:
    """Test if a staging folder is of a set of this name."""
    token = staging.name.removesuffix(SUFFIX).rpartition(".")[2]
    return staging.name == staging_name(name, token)


def is_staging(folder: Path) -> bool:
    """Test if a folder is, or lies in, a staging folder.

    Examples
    --------
    >>> is_staging(Path("out/.scan.0123456789abcdef.accelsurf/new")), is_staging(Path("out/new"))
    (True, False)
    """
    return any(_STAGING.fullmatch(part) for part in folder.parts)


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can say so."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError:
        pass  # some network file systems refuse it for folders
    finally:
        os.close(number)


def _identity(folder: Path) -> str:
    found = folder.stat()
    return f"{found.st_dev:x}-{found.st_ino:x}"


def _journals(folder: Path) -> list[Path]:
    try:
        return _paths(state_folder(), f"{_identity(folder)}-*")
    except OSError:
        return []


def _paths(state: Path, pattern: str) -> list[Path]:
    """Paths of journals; a process may have been killed when there was no more than a lock."""
    return sorted({path.with_suffix(_JOURNAL) for path in state.glob(pattern)})


def _forget_old(state: Path) -> None:
    """Remove what runs that were killed long ago have left in the state folder."""
    for path in _paths(state, "*"):
        try:
            newest = max(file.lstat().st_mtime for file in state.glob(f"{path.stem}.*"))
        except (OSError, ValueError):  # it has just ended
            continue
        if time.time() - newest > 86400 * _FORGOTTEN_DAYS:
            with suppress(OSError):
                if (lock := _locked(path)) is not None:
                    Journal(path, lock, state).end()


def _content(path: Path) -> dict[str, Any] | None:
    """Read a journal; None where it is gone, is not this user's alone, or is none."""
    try:
        with open(os.open(path, os.O_RDONLY | _NO_LINK | _NO_WAIT), "rb") as file:
            found = os.fstat(file.fileno())
            is_journal = stat.S_ISREG(found.st_mode) and found.st_size <= _MAX_JOURNAL
            if not (is_journal and is_private(found)):
                return None
            content = json.loads(file.read())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or content.keys() != {"staging", "moves"}:
        return None
    staging, moves = content["staging"], content["moves"]
    if not _is_name(staging) or not _STAGING.fullmatch(staging):
        return None
    return content if moves is None or _are_moves(moves) else None


def _are_moves(moves: object) -> bool:
    """Test if a value from a journal is that of `Moves`; a file may hold anything."""
    if not isinstance(moves, dict) or moves.keys() != {"files", "remove", "last", "undo"}:
        return False
    last = moves["last"]
    return (
        all(isinstance(moves[key], list) and all(map(_is_name, moves[key])) for key in _LISTS)
        and (last is None or _is_name(last))
        and isinstance(moves["undo"], bool)
    )


def _is_name(name: object) -> bool:
    """Test if a value is the name of a file in a folder, which leads nowhere else."""
    if not isinstance(name, str) or name in ("", ".", "..") or os.path.basename(name) != name:
        return False
    try:
        return "\0" not in name and len(os.fsencode(name)) <= _MAX_FILE_NAME
    except UnicodeEncodeError:
        return False


def is_private(found: os.stat_result) -> bool:
    """Test if a file is this user's, and nobody else may write it."""
    if os.name != "posix":
        return True
    return found.st_uid == os.geteuid() and not found.st_mode & _OTHERS_MAY_WRITE


def _locked(journal: Path) -> int | None:
    """An open file that this process has locked for a journal; None where another process has."""
    path = journal.with_suffix(_LOCK)
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o600)
        try:
            got = _try_lock(lock)
            if got and _is_file(lock, path):
                return lock
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
        if not got:
            return None


def _free(lock: int, path: Path) -> None:
    if sys.platform == "win32":
        os.close(lock)  # an open file cannot be removed there
        _unlink(path)
    else:
        _unlink(path)
        os.close(lock)


def _unlink(path: Path) -> None:
    try:
        path.unlink()
    except OSError:
        pass


def _is_file(lock: int, path: Path) -> bool:
    """Test if an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(lock), path.lstat())
    except OSError:
        return False


def _try_lock(lock: int) -> bool:
    """Lock an open file without waiting; an OSError where the file system has no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True
