"""Seals of files that this user's runs have written: a report of somebody else cannot have them.

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
from contextlib import suppress
from pathlib import Path

from accelsurf.io.set_journals import is_private, state_folder

_KEY, _KEY_BYTES = "seal.key", 32
#: A link is not followed, and a pipe not waited for.
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def seal(name: str, checksum: str) -> str:
    """Return the seal of a file that this process has written; empty where the user's state folder has no key.

    Parameters
    ----------
    name : str
        Of the file, without its folder: results are moved together.
    checksum : str
        SHA-256 of its content.
    """
    key = _key()
    return "" if key is None else _sealed(key, name, checksum)


def is_sealed(name: str, checksum: str, given: object) -> bool:
    """Test if a run of this user has written a file of this name and content.

    Parameters
    ----------
    name, checksum : str
        As for `seal`.
    given : object
        The seal, as it is read from a report: it may be anything.
    """
    key = _key()
    return (
        key is not None
        and isinstance(given, str)
        and hmac.compare_digest(
            _sealed(key, name, checksum).encode(), given.encode(errors="replace")
        )
    )


def _sealed(key: bytes, name: str, checksum: str) -> str:
    return hmac.new(key, os.fsencode(name) + b"\0" + checksum.encode(), hashlib.sha256).hexdigest()


def _key() -> bytes | None:
    """The user's key, made when it is first asked for; None where none can be kept."""
    try:
        path = state_folder().parent / _KEY
        with suppress(FileNotFoundError):
            return _read(path)
        _make(path)
        return _read(path)
    except OSError:
        return None


def _read(path: Path) -> bytes:
    with open(os.open(path, os.O_RDONLY | _PLAIN), "rb") as file:
        if not is_private(os.fstat(file.fileno())):
            raise PermissionError(errno.EACCES, "others than the user may write it", str(path))
        key = file.read(_KEY_BYTES + 1)
    if len(key) != _KEY_BYTES:
        raise OSError(errno.EINVAL, "is no key", str(path))
    return key


def _make(path: Path) -> None:
    """Write a new key, all of it at once; where another process was faster, its key counts."""
    draft = path.with_name(f"{_KEY}.{secrets.token_hex(8)}")
    try:
        with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(secrets.token_bytes(_KEY_BYTES))
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileExistsError):
            os.link(draft, path)
    finally:
        draft.unlink(missing_ok=True)
