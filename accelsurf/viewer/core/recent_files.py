"""Notes in the user's own folder: the images that were opened last, and that hints are not wanted."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

from platformdirs import user_state_path

from accelsurf.viewer.core.notes import read_note, write_note
from accelsurf.viewer.core.unsaved import UnsavedSessions

#: Largest number of images that are listed.
MAX_RECENT = 12
#: Letters of a path.
_MAX_LETTERS = 4096


class Recent(NamedTuple):
    """An image that was opened: its ``path``, and whether it ``exists`` now."""

    path: Path
    exists: bool


class RecentFiles:
    """The list of the images that were opened last, the newest first.

    A fault of its file is no error: the list is empty then, or is not written.

    Parameters
    ----------
    file : Path or None
        Where it is stored; None lists and stores nothing.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file

    @property
    def hints(self) -> Hints:
        """Return the hints that are noted beside the list."""
        return Hints(None if self._file is None else self._file.with_name("hints_unwanted"))

    @property
    def unsaved(self) -> UnsavedSessions:
        """Return the sessions that were not saved, which are noted beside the list."""
        return UnsavedSessions(None if self._file is None else self._file.with_name("unsaved"))

    def entries(self) -> list[Recent]:
        """Return the images opened last, the newest first."""
        # os.path alone takes a name that is too long for a file as one that is not there.
        return [Recent(Path(name), os.path.exists(name)) for name in self._read()]

    def add(self, path: Path) -> None:
        """Put an image at the top of the list; images that another window has added meanwhile stay in it."""
        if self._file is None:
            return
        name = str(path.absolute())
        names = [name, *(known for known in self._read() if known != name)]
        with contextlib.suppress(OSError, UnicodeError):
            write_note(self._file, names[:MAX_RECENT])

    def _read(self) -> list[str]:
        found = None if self._file is None else read_note(self._file)
        names = found if isinstance(found, list) else []
        fit = (
            item
            for item in names
            if isinstance(item, str) and 0 < len(item) <= _MAX_LETTERS and item.isprintable()
        )
        return list(dict.fromkeys(fit))[:MAX_RECENT]


class Hints:
    """Lines about the first steps, until a person wants to see them no more.

    Parameters
    ----------
    file : Path or None
        Exists when they are not wanted; None shows none.
    """

    TEXTS = (
        "1  Press in the object and drag until the outline fits.",
        "2  Where it is wrong: Inside on what is missing, Outside on what is too much.",
        "3  Save: labels, mesh, report.",
        "Wheel: slices. Right button: grey values. Ctrl and wheel: zoom.",
    )

    def __init__(self, file: Path | None) -> None:
        self._file, self._are_unwanted = file, file is None or file.exists()

    @property
    def lines(self) -> list[str]:
        """Return the lines to show; none when they are not wanted."""
        return [] if self._are_unwanted else list(self.TEXTS)

    def turn_off(self) -> None:
        """Show them no more; in this session alone where that cannot be noted."""
        self._are_unwanted = True
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                self._file.touch()


def recent_file() -> Path:
    """Return the path of the list: in this system's folder for the state of programs.

    ``XDG_STATE_HOME`` is used where it is set.
    """
    return user_state_path("accelsurf", appauthor=False) / "recent.json"
