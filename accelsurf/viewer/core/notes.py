"""Files of JSON in the user's own folder: read whatever stands there, written complete or not at all."""

from __future__ import annotations

import json
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

#: A pipe does not wait for a writer; bytes are not changed. Neither is on every system.
_FLAGS = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def read_note(file: Path, max_bytes: int) -> Any:
    """Return the content of a JSON file in the user's own folder; None where it cannot be read, for whatever reason.

    A pipe or a device in its place is not read, and does not hold up the start; nor is a file that is too long.
    """
    try:
        handle = os.open(file, os.O_RDONLY | _FLAGS)
        with os.fdopen(handle, "rb") as opened:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                return None
            content = opened.read(max_bytes + 1)
        return json.loads(content) if len(content) <= max_bytes else None
    except (OSError, ValueError, RecursionError):
        return None


def write_note(file: Path, content: Any) -> None:
    """Write JSON into a file in the user's own folder, for this user alone: complete, or not at all.

    Raises
    ------
    OSError
        When it cannot be written.
    """
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    handle, staged = tempfile.mkstemp(dir=file.parent, prefix=file.name)  # for this user alone
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as opened:
            json.dump(content, opened)
        os.replace(staged, file)
    except BaseException:
        os.unlink(staged)
        raise
