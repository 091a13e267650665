"""Hidden folders beside outputs, in which drafts lie until they are complete: each belongs to a living process.

A folder ``.NAME.accelsurf`` is claimed by a lock of the operating system on a file in it. The system frees the lock
when the process ends, however it ends. So who gets the lock of a folder that is there already knows that its owner is
dead.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

SUFFIX = ".accelsurf"
_LOCK = "lock"
#: Longest name of a file that is repeated in the name of its folder, bytes: file systems allow 255.
_MAX_NAME_BYTES = 200
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP}


class Claim:
    """A hidden folder that this process owns.

    Attributes
    ----------
    folder : Path
    """

    def __init__(self, folder: Path, lock: int) -> None:
        self.folder, self._lock = folder, lock

    def remove(self) -> None:
        """Remove the folder with all that is in it, and free the lock; more than once does nothing."""
        if self._lock < 0:
            return
        lock, self._lock = self._lock, -1
        for entry in os.scandir(self.folder) if self.folder.is_dir() else ():
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != _LOCK:
                _unlink(Path(entry.path))
        self._free(lock)

    def release(self) -> None:
        """Free the lock and leave the folder as it is, for another process to deal with."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def _free(self, lock: int) -> None:
        if sys.platform == "win32":
            os.close(lock)  # an open file cannot be removed there
            _unlink(self.folder / _LOCK)
        else:
            _unlink(self.folder / _LOCK)
            os.close(lock)
        try:
            self.folder.rmdir()
        except OSError:  # somebody claims it at this moment
            pass


def hidden_name(name: str) -> str:
    """Name of the hidden folder for a set or a file; short enough for any file system.

    Examples
    --------
    >>> hidden_name("scan"), len(hidden_name("x" * 255))
    ('.scan.accelsurf', 68)
    """
    if len(os.fsencode(name)) > _MAX_NAME_BYTES:
        name = f"{name[:40]}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:16]}"
    return f".{name}{SUFFIX}"


def claim(folder: Path, made: bool = False) -> Claim | None:
    """Make a hidden folder, or inherit that of a dead process with what is in it; None where its owner lives.

    Parameters
    ----------
    folder : Path
    made : bool
        Whether this process has just made it: it owns it then also where the file system has no locks.

    Raises
    ------
    OSError
        When nothing can be written there.
    """
    while True:
        new = _make(folder)
        try:
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:
            continue  # its owner removed it meanwhile
        try:
            owned = _try_lock(lock, new or made)
            if owned and _is_file(lock, folder / _LOCK):
                return Claim(folder, lock)
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
        if not owned:
            return None


def hidden_folders(parent: Path) -> Iterator[Path]:
    """The hidden folders in a folder, whoever owns them."""
    try:
        with os.scandir(parent) as entries:
            found = [entry.name for entry in entries if _looks_hidden(entry)]
    except OSError:
        return
    for name in sorted(found):
        folder = parent / name
        # One that has no lock is ours if nothing else is in it: its owner died right after making it.
        # Folders of other users that may not be looked into are theirs.
        if os.path.isfile(folder / _LOCK) or _is_empty(folder):
            yield folder


def _looks_hidden(entry: os.DirEntry[str]) -> bool:
    return entry.name.startswith(".") and entry.name.endswith(SUFFIX) and entry.is_dir(follow_symlinks=False)


def _is_empty(folder: Path) -> bool:
    try:
        return not any(folder.iterdir())
    except OSError:
        return False


def _make(folder: Path) -> bool:
    try:
        folder.mkdir()
    except FileExistsError:
        return False
    return True


def _unlink(path: Path) -> None:
    try:
        path.unlink()
    except OSError:
        pass


def _is_file(lock: int, path: Path) -> bool:
    """Whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(lock), path.stat())
    except OSError:
        return False


def _try_lock(lock: int, new: bool) -> bool:
    """Lock an open file without waiting. Where the file system has no locks, whoever made the folder owns it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return new
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True
