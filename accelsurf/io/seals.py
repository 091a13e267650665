"""Seals of files and folders that this user's runs have made: files of somebody else cannot have them.

A report lists the files of its run, and a later run removes some of these. A report that came with somebody's data may
list any file. So each entry has a seal: a keyed checksum (HMAC) of the name and the content of the file. The key lies
in the user's state folder and nowhere else, so that a report repeats nothing that helps to make another seal.
"""

from __future__ import annotations

import errno
import hashlib
import hmac
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

_KEY = "seal.key"
_KEY_BYTES = 32
#: A link is not followed, and a pipe not waited for.
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
#: Only the user may write these, on systems that say who may.
_OTHERS_MAY_WRITE = 0o022


def seal(name: str, checksum: str) -> str:
    """Return the seal of a file that this process has written; empty where the user's state folder has no key.

    Parameters
    ----------
    name : str
        Of the file, without its folder: results are moved together.
    checksum : str
        SHA-256 of its content.
    """
    return signed(os.fsencode(name), checksum.encode())


def is_sealed(name: str, checksum: str, given: object) -> bool:
    """Test if a run of this user has written a file of this name and content.

    Parameters
    ----------
    name, checksum : str
        As for `seal`.
    given : object
        The seal, as it is read from a report: it may be anything.
    """
    made = seal(name, checksum)
    return (
        bool(made)
        and isinstance(given, str)
        and hmac.compare_digest(made.encode(), given.encode(errors="replace"))
    )


def signed(*parts: bytes) -> str:
    """Return a keyed checksum of some bytes, hexadecimal; empty where the user's state folder has no key.

    Parameters
    ----------
    *parts : bytes
        Without a zero byte, which divides them.
    """
    try:
        return hmac.new(_key(), b"\0".join(parts), hashlib.sha256).hexdigest()
    except OSError:
        return ""


def unavailable() -> str:
    """Return why there is no key; empty where there is one."""
    try:
        _key()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def state_folder() -> Path:
    """Return the folder of the key, made if it is not there.

    Raises
    ------
    OSError
        When nothing can be written there, or others than the user can write there, too.
    """
    from platformdirs import user_state_path

    try:
        folder = user_state_path("accelsurf", appauthor=False)
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
    found = folder.lstat()
    if not _is_private(found) or not stat.S_ISDIR(found.st_mode):
        raise PermissionError(errno.EACCES, "others than the user may write there", str(folder))
    return folder


def _is_private(found: os.stat_result) -> bool:
    """Test if a file is this user's, and nobody else may write it."""
    if os.name != "posix":
        return True
    return found.st_uid == os.geteuid() and not found.st_mode & _OTHERS_MAY_WRITE


def _key() -> bytes:
    """The user's key, made when it is first asked for; an OSError where none can be kept."""
    path = state_folder() / _KEY
    with suppress(FileNotFoundError):
        return _read(path)
    _make(path)
    return _read(path)


def _read(path: Path) -> bytes:
    with open(os.open(path, os.O_RDONLY | _PLAIN), "rb") as file:
        if not _is_private(os.fstat(file.fileno())):
            raise PermissionError(errno.EACCES, "others than the user may write it", str(path))
        key = file.read(_KEY_BYTES + 1)
    if len(key) != _KEY_BYTES:
        raise OSError(errno.EINVAL, "is no key", str(path))
    return key


def _make(path: Path) -> None:
    """Write a new key, all of it at once; where another process was faster, its key counts."""
    staged = path.with_name(f"{_KEY}.{secrets.token_hex(8)}")
    try:
        with open(os.open(staged, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(secrets.token_bytes(_KEY_BYTES))
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileExistsError):
            os.link(staged, path)
    finally:
        staged.unlink(missing_ok=True)
