"""Cases of a batch: files, folders, tables and patterns that a person names, and the part that one machine does."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from accelsurf.batch import case_table, layouts
from accelsurf.batch.case import Case, checked_ids
from accelsurf.batch.layouts import Layout
from accelsurf.errors import InputError, UsageError
from accelsurf.io import is_stored, split_name
from accelsurf.settings.file_formats import input_help

T = TypeVar("T")

#: Characters that make a name a pattern.
_PATTERN = re.compile(r"[*?\[]")
_SHARD = re.compile(r"([0-9]{1,6})/([0-9]{1,6})")
#: Set in each task of an array of jobs of SLURM.
_TASK, _COUNT, _MIN, _STEP = (f"SLURM_ARRAY_TASK_{name}" for name in ("ID", "COUNT", "MIN", "STEP"))


class Shard(NamedTuple):
    """One of ``total`` parts of a batch; ``number`` is from 1 on."""

    number: int
    total: int

    def __str__(self) -> str:
        return f"{self.number}/{self.total}"

    def part_of(self, items: Sequence[T]) -> list[T]:
        """Return its part: every ``total``-th.

        Examples
        --------
        >>> Shard(2, 3).part_of("abcdefgh")
        ['b', 'e', 'h']
        """
        return list(items[self.number - 1 :: self.total])


def read_cases(
    given: Sequence[str], layout: Layout = "auto", tracking: bool = False
) -> tuple[list[Case], str]:
    """Return the cases that are named, in a fixed order, and their source in words.

    Parameters
    ----------
    given : sequence of str
        A folder, a pattern, a table (.csv, .tsv), or files.
    layout : {"auto", "folder", "nnunet", "bids"}
        Of a folder.
    tracking : bool
        Whether the cases are sequences.

    Raises
    ------
    InputError
        When there is none, an id is given twice or is no name, or a reference is missing; UsageError when the
        meaning cannot be decided.
    """
    if not given:
        raise UsageError(
            "CASES is missing", "name a folder of images, a pattern in quotes, or a CSV table"
        )
    cases, words = _read(given, layout, tracking)
    return checked_cases(cases), words


def checked_cases(cases: Sequence[Case]) -> list[Case]:
    """Return cases with ids that are names, each once, and references that are there; see `checked_ids`.

    Raises
    ------
    InputError
        With the place of the case.
    """
    cases = checked_ids(cases)
    for case in cases:
        if case.reference is not None and not is_stored(case.reference):
            raise InputError(
                f"{case.place}: the reference {case.reference} is missing", "check its path"
            )
    return list(cases)


def _read(given: Sequence[str], layout: Layout, tracking: bool) -> tuple[list[Case], str]:
    path, alone = Path(given[0]), len(given) == 1
    if alone and path.is_dir() and not is_stored(path):
        return _sequences_in(path) if tracking else layouts.in_folder(path, layout)
    if layout != "auto":
        raise UsageError(
            f"--layout {layout} was given, but {given[0]} is no folder",
            "name the folder of the images",
        )
    if alone and path.suffix.lower() in case_table.SUFFIXES:
        return case_table.read_cases(path, tracking), "a table"
    if alone and _PATTERN.search(given[0]) and not path.exists():
        return layouts.of_files(_matches(given[0], tracking)), "a pattern"
    for name in given:
        if not tracking and Path(name).is_dir() and not is_stored(Path(name)):
            raise UsageError(
                f"{name}: a folder among several CASES", "name one folder alone, or files"
            )
        if not Path(name).exists():
            raise InputError(f"{name}: there is no such file or folder", "check the path")
    return layouts.of_files([Path(name) for name in given]), "files"


def _matches(pattern: str, tracking: bool) -> list[Path]:
    """Return the images or sequences that a pattern names; ``**`` stands for folders at any depth."""
    paths = [Path(name) for name in glob.glob(pattern, recursive=True)]
    if tracking:
        kind = "sequence"
        found = _sequences(paths)
        hint = "is the pattern in quotes?"
    else:
        kind = "image"
        found = layouts.images_among(paths)
        hint = f"is it in quotes? images are {input_help()}"
    if not found:
        raise InputError(f"{pattern}: no {kind} has a name like this", hint)
    return found


def _sequences_in(folder: Path) -> tuple[list[Case], str]:
    found = _sequences(folder.iterdir())
    if not found:
        raise InputError(
            f"{folder}: no sequence in this folder, files with time ({input_help()}) or folders of frames expected",
            "for sequences in folders below write a pattern in quotes, such as 'cells/*/frames'",
        )
    return layouts.of_files(found), "a folder of sequences"


def _sequences(paths: Iterable[Path]) -> list[Path]:
    """Return the files with names of images and the folders with images, in order, without hidden ones."""
    visible = [path for path in paths if not path.name.startswith(".")]
    folders = [
        path for path in visible if path.is_dir() and not is_stored(path) and _has_images(path)
    ]
    return sorted([*layouts.images_among(visible), *folders], key=str)


def _has_images(folder: Path) -> bool:
    return any(
        split_name(entry)[1] and not entry.name.startswith(".") for entry in folder.iterdir()
    )


def shard_of(text: str | None, environment: Mapping[str, str]) -> tuple[Shard | None, str]:
    """Return the shard that was asked for, or that an array of jobs of SLURM stands for, and a line about the latter.

    Parameters
    ----------
    text : str or None
        ``I/N``.
    environment : mapping of str to str
        Variables of the process.

    Raises
    ------
    UsageError
        When it is not of this form, or I is not from 1 to N.

    Examples
    --------
    >>> shard_of("2/8", {})[0]
    Shard(number=2, total=8)
    >>> shard_of(None, {"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_COUNT": "4", "SLURM_ARRAY_TASK_MIN": "5"})[0]
    Shard(number=3, total=4)
    """
    if text is not None:
        if (found := _SHARD.fullmatch(text.strip())) is None or not 1 <= int(found[1]) <= int(
            found[2]
        ):
            raise UsageError(
                f"--shard: {text} was given, expected I/N with I from 1 to N", "as in --shard 1/4"
            )
        return Shard(int(found[1]), int(found[2])), ""
    if _TASK not in environment or _COUNT not in environment:
        return None, ""
    try:
        task, count = int(environment[_TASK]), int(environment[_COUNT])
        first, step = int(environment.get(_MIN, "0")), max(int(environment.get(_STEP, "1")), 1)
    except ValueError:
        raise UsageError(
            f"{_TASK}, {_COUNT}: not whole numbers", "say the shard by --shard I/N"
        ) from None
    place, left = divmod(task - first, step)
    if left or not 0 <= place < count:
        raise UsageError(
            f"{_TASK} {task} is not one of the {count} tasks that begin at {first} in steps of {step}",
            "say the shard by --shard I/N",
        )
    shard = Shard(place + 1, count)
    return (
        (shard, f"shard {shard}, by {_TASK}={task}, {_COUNT}={count}, {_MIN}={first}")
        if count > 1
        else (None, "")
    )
