"""A folder in which a page may choose images: nothing outside of it is named or opened."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.io.headers import check_name, format_of, split_name

#: So many names of a folder are listed.
MAX_ENTRIES = 500


class Entry(NamedTuple):
    """A name in a folder, and whether it is an ``image`` or a ``folder``; a folder may be both."""

    name: str
    is_image: bool
    is_folder: bool


class ServedFolder:
    """A folder, and what is in it and in its folders; without hidden names, and without links that lead out.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def resolve(self, text: str) -> Path:
        """Return the path that a page names: from the folder on, or whole.

        The message is the same whether there is such a file or not.

        Raises
        ------
        UsageError
            When it is not in the folder, links followed.
        """
        refused = UsageError(f"{text[:80]}: is not in the folder {self.root.name or self.root}", "give a path in it")
        path = Path(text)
        try:
            check_name(path)
            # An array in an archive is named behind the archive, NAME.npz@ARRAY: its folder decides all the same.
            found = (self.root / path).resolve()
        except (AccelsurfError, OSError, ValueError, RuntimeError):
            raise refused from None
        if ".." in path.parts or not found.is_relative_to(self.root):
            raise refused
        if any(part.startswith(".") for part in found.relative_to(self.root).parts):
            raise refused
        return found

    def shown(self, path: Path) -> str:
        """Return the name of a path of the folder, from the folder on; empty for the folder itself."""
        inner = path.relative_to(self.root).as_posix()
        return "" if inner == "." else inner

    def entries(self, folder: Path) -> tuple[list[Entry], int]:
        """Return what can be chosen in a folder, folders first, and how many further names are not listed.

        Raises
        ------
        UsageError
            When the folder cannot be read.
        """
        try:
            found = [each for each in os.scandir(folder) if not each.name.startswith(".") and each.name.isprintable()]
        except OSError as error:
            raise UsageError(f"{self.shown(folder)}: {error.strerror or error}", "choose another folder") from None
        listed = [entry for entry in (self._entry(Path(each.path)) for each in found) if entry is not None]
        listed.sort(key=lambda entry: (not entry.is_folder, entry.name.casefold(), entry.name))
        return listed[:MAX_ENTRIES], max(len(listed) - MAX_ENTRIES, 0)

    def _entry(self, path: Path) -> Entry | None:
        """Return the entry of a name; None for what is no image, or leads out of the folder."""
        try:
            if not path.resolve().is_relative_to(self.root):
                return None
            is_named = bool(split_name(path)[1])
            if path.is_dir():
                return Entry(path.name, is_named, not is_named)
            return Entry(path.name, True, False) if is_named and path.is_file() else None
        except (OSError, RuntimeError):
            return None

    def is_image(self, folder: Path) -> bool:
        """Return True if a folder is an image itself: a scan in DICOM, or slices."""
        try:
            return bool(format_of(folder).name)
        except (AccelsurfError, OSError):
            return False
