"""Cases in a table: a CSV file with a row for each, and a column for what is particular about it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from accelsurf.batch import csv_table
from accelsurf.batch.case import FILE_KINDS, PLACES, Case
from accelsurf.errors import InputError
from accelsurf.io import split_name
from accelsurf.settings.catalogue import entry
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.wording import did_you_mean, shown

IMAGE, ID, REFERENCE = "image", "id", "reference"
#: Endings of tables.
SUFFIXES = (".csv", ".tsv")

_FILES = ("mask", "objects", "channel")


def read(path: Path) -> list[Case]:
    """Read a table of cases.

    The columns are ``image``, ``id`` (by default the name of the image), ``reference``, and any setting of a run;
    an empty cell leaves the setting as it is for all. Several values of a cell, such as clicks, are separated by a
    semicolon. Paths are relative to the folder of the table.

    Parameters
    ----------
    path : Path
        A file that ends in one of `SUFFIXES`: cells separated by commas, or by tabs.

    Raises
    ------
    InputError
        With the line and what is wrong in it.
    """
    return csv_table.read(path, "image", lambda header, lines: list(_cases(path, _columns(header), lines)))


def _columns(header: list[str]) -> list[str]:
    """Names of the columns, as settings are called."""
    names = [name.strip().lower().replace("-", "_") for name in header]
    known = (IMAGE, ID, REFERENCE, *SettingFields.model_fields)
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        raise InputError("columns separated by commas expected", "separate them by commas, or by tabs in a .tsv file")
    for name, given in zip(names, header, strict=True):
        if name not in known:
            guess = did_you_mean(name.replace("_", "-"), [one.replace("_", "-") for one in known])
            raise InputError(
                f"{shown(given)}: there is no such column, {IMAGE}, {ID}, {REFERENCE} or a setting expected",
                f"{guess.replace('-', '_')}leave out columns that are none",
            )
        if names.count(name) > 1:
            raise InputError(f"the column {name} is given twice", "leave one of them out")
    if IMAGE not in names:
        raise InputError(f"no column {IMAGE}", f"name the column of the files {IMAGE}")
    return names


def _cases(path: Path, columns: list[str], lines: Iterator[list[str]]) -> Iterator[Case]:
    number = 1
    for cells in lines:
        number += 1
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) > len(columns):
            raise InputError(
                f"row {number}: {len(cells)} cells, {len(columns)} columns expected",
                "put cells with a comma in double quotes, such as \"point:1,2,3\"",
            )
        given = {name: cell.strip() for name, cell in zip(columns, cells, strict=False) if cell.strip()}
        yield _case(path, f"{path}, row {number}", given, number)


def _case(path: Path, place: str, given: Mapping[str, str], number: int) -> Case:
    if IMAGE not in given:
        raise InputError(f"row {number}: no {IMAGE}", "each row needs one")
    base = path.parent.absolute()
    image = base / given[IMAGE]
    reference = base / given[REFERENCE] if REFERENCE in given else None
    settings = {key: _value(key, text, base) for key, text in given.items() if key not in (IMAGE, ID, REFERENCE)}
    return Case(given.get(ID, split_name(image)[0]), image, settings, reference, place)


def _value(key: str, text: str, base: Path) -> str | tuple[str, ...]:
    """The value of a cell: several where the setting may be repeated, with paths from the folder of the table."""
    parts = [part.strip() for part in text.split(";")] if entry(key).repeated else [text]
    values = tuple(_with_paths(key, part, base) for part in parts if part)
    return values if entry(key).repeated else values[0]


def _with_paths(key: str, text: str, base: Path) -> str:
    """A value whose file, if it names one, is looked for in the folder of the table."""
    if key in _FILES:
        return str(base / text)
    kind, colon, name = text.partition(":")
    return f"{kind}:{base / name}" if key in PLACES and colon and kind in FILE_KINDS else text
