"""Check that a path names what can be read: pipes would be waited for, and devices do not end."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from accelsurf.errors import AccelsurfError, InputError


def check_readable(path: str | Path, name: str = "", kind: type[AccelsurfError] = InputError) -> None:
    """Refuse a pipe, a device or a socket; what does not exist, and a folder, is left to who reads it.

    Parameters
    ----------
    path : str or Path
        What will be opened, links followed.
    name : str
        The beginning of the message.
    kind : type
        Of the error.

    Raises
    ------
    AccelsurfError
        Of that kind.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # it is not there, or no file can have the name
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        message = f"{name}this is no file but a pipe, a device or a socket"
        raise kind(message, "write what it holds into a file, and give that")
