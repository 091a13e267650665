"""Pairs of label maps that are compared: two files, two folders with the same names, or the rows of a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelsurf.batch.case_table import read_rows
from accelsurf.errors import InputError, UsageError
from accelsurf.io import is_stored, naming, split_name
from accelsurf.settings.file_formats import image_suffixes
from accelsurf.settings.labels import IdRanges, parse_ids
from accelsurf.settings.wording import shown

#: Columns of a table.
PRED = "pred"
REF = "ref"
CASE = "case"


@dataclass(frozen=True)
class LabelFile:
    """A label map, and which of its labels count: all if ``ids`` is empty."""

    path: Path
    ids: IdRanges = ()


@dataclass(frozen=True)
class Pair:
    """A label map and its reference; one of them is None where there is no file of this name.

    Attributes
    ----------
    case : str
        Its name in tables.
    pred, ref : LabelFile or None
    """

    case: str
    pred: LabelFile | None
    ref: LabelFile | None


def label_file(text: str, base: Path | None = None) -> LabelFile:
    """Read FILE, or FILE@IDS; the name itself may have an @.

    Parameters
    ----------
    text : str
    base : Path, optional
        The folder that a relative path begins in; the present one by default.

    Raises
    ------
    UsageError
        When the text after the @ is no list of labels.

    Examples
    --------
    >>> label_file("liver.nii.gz@2,5-9")
    LabelFile(path=PosixPath('liver.nii.gz'), ids=((2, 2), (5, 9)))
    """
    file, _, tail = text.rpartition("@")
    if not file or split_name(text)[1] or (base or Path()).joinpath(text).exists():
        return LabelFile(Path(text) if base is None else base / text)
    ids = parse_ids(tail, shown(text), "FILE@2,41,251-255")
    return LabelFile(Path(file) if base is None else base / file, ids)


def is_folder_of_maps(path: Path) -> bool:
    """Return True if a path is a folder, and no image that is stored as one."""
    return path.is_dir() and not is_stored(path)


def in_folders(pred: LabelFile, ref: LabelFile) -> list[Pair]:
    """Return a pair for each name of a label map that one of two folders has, folders in them included.

    A name counts without its suffix: ``a.nii.gz`` and ``a.nrrd`` are a pair. Hidden files and folders are left out.

    Raises
    ------
    InputError
        When neither folder has a label map, or two files of one folder have the same name.
    """
    sides = [_by_name(side.path) for side in (pred, ref)]
    names = sorted({*sides[0], *sides[1]})
    if not names:
        raise InputError(
            f"{pred.path}, {ref.path}: no label map in these folders",
            f"files end in {', '.join(image_suffixes())}",
        )
    pairs = []
    for name in names:
        files = [
            LabelFile(side[name], given.ids) if name in side else None
            for side, given in zip(sides, (pred, ref), strict=True)
        ]
        pairs.append(Pair(name, *files))
    return pairs


def _by_name(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in _maps(folder):
        name = (path.relative_to(folder).parent / split_name(path)[0]).as_posix()
        if name in found:
            raise InputError(
                f"{found[name]}, {path}: two files of one name", "leave one of them out"
            )
        found[name] = path
    return found


def _maps(folder: Path) -> Iterator[Path]:
    with naming(folder):
        entries = sorted(folder.iterdir())
    for path in entries:
        if path.name.startswith("."):
            continue
        if is_folder_of_maps(path):
            if not path.is_symlink():
                yield from _maps(path)
        elif split_name(path)[1] and is_stored(path):
            yield path


def in_table(path: Path) -> list[Pair]:
    """Read a table of pairs: CSV with the columns ``pred``, ``ref`` and, if wanted, ``case``.

    A cell may be FILE@IDS. Paths are relative to the folder of the table. A case without a name is called as its
    ``pred``, without folder and suffix.

    Raises
    ------
    InputError
        With the line and the fault in it.
    """
    base = path.parent.absolute()

    def pairs(header: list[str], lines: Any) -> list[Pair]:
        columns = _columns(header)
        return [
            _pair_of(columns, cells, lines.line_num, base)
            for cells in lines
            if any(map(str.strip, cells))
        ]

    return read_rows(path, "pair", pairs)


def _columns(header: list[str]) -> list[str]:
    names = [name.strip().lower() for name in header]
    if (
        not {PRED, REF} <= set(names)
        or not set(names) <= {PRED, REF, CASE}
        or len(set(names)) < len(names)
    ):
        given = shown(", ".join(header))
        raise InputError(
            f"the columns are {given}; {PRED}, {REF} and perhaps {CASE} expected",
            "write them in line 1",
        )
    return names


def _pair_of(columns: list[str], cells: list[str], line: int, base: Path) -> Pair:
    given = {name: cell.strip() for name, cell in zip(columns, cells, strict=False) if cell.strip()}
    if len(cells) > len(columns) or not {PRED, REF} <= set(given):
        raise InputError(
            f"line {line}: not a {PRED} and a {REF}", "put a name with a comma in double quotes"
        )
    try:
        pred, ref = label_file(given[PRED], base), label_file(given[REF], base)
    except UsageError as error:
        raise InputError(f"line {line}: {error.message}", error.hint) from None
    return Pair(given.get(CASE, split_name(pred.path)[0]), pred, ref)
