"""Files of JSON in the user's own folder: read whatever stands there, written complete or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError
from accelsurf.io import read_json


def read_note(file: Path) -> Any:
    """Return the content of a JSON file in the user's own folder; None where it cannot be read, for whatever reason."""
    with contextlib.suppress(InputError):
        return read_json(file)
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
