"""Sessions that were not saved: settings and clicks, kept in the user's own folder, to go on with at the next start."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume, voxels_sha256
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.notes import read_note, write_note

#: Largest number of sessions that are kept; the oldest goes first.
MAX_NOTES = 20
#: Files that are looked at, and letters of a path.
_MAX_FILES = 1000
_MAX_LETTERS = 4096
_NAME = re.compile(r"[0-9a-f]{16}\.json")
#: Version of their form.
_VERSION = 2


class Unsaved(NamedTuple):
    """A session that was not saved.

    Attributes
    ----------
    file : Path
        Where it is kept.
    image : str
        `fingerprint` of its image.
    name : str
        First part of the names of files.
    path : Path or None
        The file of the image; None where none has it alone.
    config : RunConfig
        Settings, edits and corrections.
    step : int
        Steps that were made; -1 for a run that had ended.
    when : datetime
        When it was kept last.
    """

    file: Path
    image: str
    name: str
    path: Path | None
    config: RunConfig
    step: int
    when: datetime

    @property
    def line(self) -> str:
        """Name, number of clicks and age, in one line."""
        clicks = sum(len(each.inside) + len(each.outside) for each in self.config.refine)
        clicks += len(self.config.inside) + len(self.config.outside)
        what = f"{clicks} click{'s' * (clicks != 1)}" if clicks else "a run"
        when = f"{self.when.day} {self.when:%B %Y, %H:%M}"
        return f"{self.name}: {what} of {when} {'were' if clicks > 1 else 'was'} not saved"


class UnsavedSessions:
    """The sessions that were not saved.

    A faulty file is no error: it is passed over.

    Parameters
    ----------
    folder : Path or None
        Where they are kept; None keeps and lists nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    @property
    def keeps(self) -> bool:
        """True if anything is kept."""
        return self._folder is not None

    def entries(self) -> Iterator[Unsaved]:
        """Return the sessions of programs that have ended, the newest first."""
        for _, path in self._files():
            found = _parsed(path, read_note(path))
            if found is not None:
                yield found

    def of_image(self, image: str) -> Unsaved | None:
        """Return the newest one of an image, by its fingerprint."""
        return next((each for each in self.entries() if each.image == image), None)

    def is_empty(self) -> bool:
        """Test if there is none, of whatever image."""
        return next(self.entries(), None) is None

    def new_file(self) -> Path:
        """Return where another session is kept.

        Raises
        ------
        OSError
            When nothing is kept.
        """
        if self._folder is None:
            raise OSError("nothing is kept")
        return self._folder / f"{secrets.token_hex(8)}.json"

    def store(
        self, file: Path, image: str, name: str, path: Path | None, config: RunConfig, step: int
    ) -> None:
        """Keep a session of this program, in place of the file's content; see `Unsaved`.

        Raises
        ------
        OSError
            When it cannot be written.
        """
        process = psutil.Process()
        write_note(
            file,
            {
                "version": _VERSION,
                "process": [process.pid, process.create_time()],
                "image": image,
                "name": name,
                "path": None if path is None else str(path.absolute()),
                "step": step,
                "config": config.model_dump(mode="json", exclude_unset=True),
            },
        )
        for _, old in self._files()[MAX_NOTES:]:
            self.forget(old)

    def forget(self, file: Path) -> None:
        """Keep a session no longer."""
        with contextlib.suppress(OSError):
            file.unlink()

    def _files(self) -> list[tuple[float, Path]]:
        """Times and files, the newest first."""
        found = []
        with contextlib.suppress(OSError):
            with os.scandir(self._folder or "") as entries:
                for entry in itertools.islice(entries, _MAX_FILES):
                    if _NAME.fullmatch(entry.name):
                        with contextlib.suppress(OSError):
                            found.append((entry.stat().st_mtime, Path(entry.path)))
        return sorted(found, reverse=True)


def _parsed(file: Path, note: Any) -> Unsaved | None:
    """A session from the content of its file; None where it is none, or where its program still runs."""
    try:
        pid, began = note["process"]
        name = note["name"]
        path = note["path"]
        step = note["step"]
        image = note["image"]
        if note["version"] != _VERSION or _runs(int(pid), float(began)):
            return None
        texts = (name, image) if path is None else (name, image, path)
        if not all(
            isinstance(text, str) and 0 < len(text) <= _MAX_LETTERS and text.isprintable()
            for text in texts
        ):
            return None
        if type(step) is not int or not -1 <= step < 1 << 31:
            return None
        config = RunConfig(**note["config"])
        when = datetime.fromtimestamp(file.stat().st_mtime)
    except (AccelsurfError, LookupError, TypeError, ValueError, ArithmeticError, OSError):
        return None
    except RecursionError:
        return None
    return Unsaved(file, image, name, None if path is None else Path(path), config, step, when)


def _runs(pid: int, began: float) -> bool:
    """Test if the program with this number, that began then, still runs."""
    try:
        return abs(psutil.Process(pid).create_time() - began) < 1.0
    except (psutil.Error, ValueError, OverflowError):
        return False


def fingerprint(volume: Volume, channels: Sequence[Volume] = ()) -> str:
    """Return letters that are the same for two images with the same voxels in the same place, and for no others.

    Neither the name of a file nor how it is stored counts.
    """
    images = (volume, *channels)
    grids = [
        [grid.shape, grid.spacing, grid.origin, grid.direction.tolist()]
        for grid in (each.geometry for each in images)
    ]
    return hashlib.sha256(f"{grids} {voxels_sha256(images)}".encode()).hexdigest()
