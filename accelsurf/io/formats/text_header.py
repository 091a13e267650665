"""Text headers of NRRD and MetaImage: their lines, the data file they name, and their units."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO

from accelsurf.errors import InputError
from accelsurf.settings import budgets

#: Words of a header for mm, and for nothing.
_MILLIMETRES = frozenset(
    ("", "mm", "millimeter", "millimeters", "millimetre", "millimetres", "???", "?")
)


def header_lines(file: BinaryIO, last: Callable[[str], bool]) -> list[str]:
    """Lines of a text header up to and including the one that ends it (or the end of the file)."""
    lines: list[str] = []
    most = budgets.TEXT_HEADER.limit
    while (left := most - file.tell()) > 0 and (raw := file.readline(left)):
        lines.append(raw.decode("utf-8", errors="replace").rstrip("\r\n"))
        if last(lines[-1]):
            break
    return lines


def data_file(path: Path, name: str) -> Path:
    """Return the data file that a header names, relative to the header.

    Raises
    ------
    InputError
        When it is missing, or there are several.
    """
    if name.upper().startswith("LIST ") or name.upper() == "LIST" or "%" in name:
        raise InputError(
            f"the voxels are spread over several files ({name})",
            hint="save the image as one file first",
        )
    data = path.parent / name
    if "\0" in name or not data.is_file():
        raise InputError(
            f"the header names the data file {name}, which is missing",
            hint=f"copy {name} into the same folder, under that name",
        )
    return data


def check_units(units: Iterable[str]) -> None:
    """Refuse another unit of length than mm, for which other programs take it.

    Raises
    ------
    InputError
        With the unit.
    """
    for unit in units:
        if unit.lower() not in _MILLIMETRES:
            raise InputError(
                f"the header gives lengths in {unit}, mm expected",
                hint="convert spacing and origin to mm in the header, or take out the unit to have them read as mm",
            )
