"""Cases that are sequences: files with time and folders of frames, in a folder, by a pattern, in a table."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Sequence
from pathlib import Path

from accelsurf.batch import case_table, layouts
from accelsurf.batch.case import Case
from accelsurf.errors import InputError
from accelsurf.io import is_stored, split_name
from accelsurf.settings.file_formats import input_help


def read(given: Sequence[str]) -> tuple[list[Case], str]:
    """Return the sequences that are named, and what they were read from in words.

    Parameters
    ----------
    given : sequence of str
        A folder of sequences, a pattern, a table, or several files and folders of frames.

    Raises
    ------
    InputError
        When there is none.
    """
    path = Path(given[0])
    if len(given) == 1 and path.is_dir() and not is_stored(path):
        found = _sequences(path.iterdir())
        if not found:
            raise InputError(
                f"{path}: no sequence in this folder, files with time ({input_help()}) or folders of frames expected",
                "for sequences in folders below write a pattern in quotes, such as 'cells/*/frames'",
            )
        return layouts.of_files(found), "a folder of sequences"
    if len(given) == 1 and path.suffix.lower() in case_table.SUFFIXES:
        return case_table.read(path, tracking=True), "a table"
    if len(given) == 1 and layouts.PATTERN.search(given[0]) and not path.exists():
        found = _sequences(Path(one) for one in glob.glob(given[0], recursive=True))
        if not found:
            raise InputError(f"{given[0]}: no sequence has a name like this", "is the pattern in quotes?")
        return layouts.of_files(found), "a pattern"
    for one in given:
        if not Path(one).exists():
            raise InputError(f"{one}: there is no such file or folder", "check the path")
    return layouts.of_files([Path(one) for one in given]), "files"


def _sequences(paths: Iterable[Path]) -> list[Path]:
    """The files that are images by their names and the folders with images, in order; hidden ones are none."""
    every = [path for path in paths if not path.name.startswith(".")]
    folders = [path for path in every if path.is_dir() and not is_stored(path) and _has_images(path)]
    return sorted([*layouts.images_among(every), *folders], key=str)


def _has_images(folder: Path) -> bool:
    return any(split_name(entry)[1] and not entry.name.startswith(".") for entry in folder.iterdir())
