"""Tables that people write, as CSV: a row for each case, a column for each setting."""

from __future__ import annotations

import csv
import io
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from accelsurf.batch.case import Case, check_id
from accelsurf.errors import InputError
from accelsurf.io import image_name, naming, split_name
from accelsurf.output import PLACES
from accelsurf.settings import budgets
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.track_config import FRAME_SETTINGS, setting_entry
from accelsurf.settings.track_fields import TrackFields
from accelsurf.settings.wording import did_you_mean, shown
from accelsurf.text.coordinates import file_in

T = TypeVar("T")
IMAGE = "image"
ID = "id"
REFERENCE = "reference"
#: Setting of tracking whose words may name files.
CORRECTIONS = "correct"
#: Endings of tables.
SUFFIXES = (".csv", ".tsv")
_FILES = ("mask", "objects", "labels", "channel")


def read_rows(path: Path, what: str, parse: Callable[[list[str], Any], list[T]]) -> list[T]:
    """Read a table that a person has written: CSV with a header, cells separated by commas, or by tabs in a .tsv file.

    Parameters
    ----------
    path : Path
    what : str
        The noun for a row in messages.
    parse : callable
        Of the cells of the first line and a reader of the others, returns the content of the rows.

    Raises
    ------
    InputError
        With the file, the line and the fault in it.
    """
    with naming(path):
        budgets.CASES.check(path.stat().st_size, "the table")
        try:
            text = path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            raise InputError("the table is not text in UTF-8", "save it as CSV UTF-8") from None
        lines = csv.reader(
            io.StringIO(text), delimiter="\t" if path.suffix.lower() == ".tsv" else ",", strict=True
        )
        try:
            rows = parse(next(lines, []), lines)
        except csv.Error as error:
            message = f"line {lines.line_num}: not a line of a CSV file ({error})"
            raise InputError(message, "is a quote missing?") from None
        if not rows:
            raise InputError(
                "the table has no row below its header", f"write a row for each {what}"
            )
    return rows


def read_cases(path: Path, tracking: bool = False) -> list[Case]:
    """Read a table of cases.

    The columns are ``image``, ``id`` (by default the name of the image), ``reference``, and any setting of a run;
    an empty cell leaves the setting as it is for all. Several values of a cell, for example clicks, are separated by a
    semicolon. Paths are relative to the folder of the table.

    Parameters
    ----------
    path : Path
        A file that ends in one of `SUFFIXES`: cells separated by commas, or by tabs.
    tracking : bool
        Whether the images are sequences. Then the settings are tracking's and the ones of the run on each frame, and
        there is no ``reference``.

    Raises
    ------
    InputError
        With the line and the fault in it.
    """

    def cases(header: list[str], lines: Iterator[list[str]]) -> list[Case]:
        return list(_cases(path, _columns(header, tracking), lines, tracking))

    return read_rows(path, "sequence" if tracking else "image", cases)


def _columns(header: list[str], tracking: bool) -> list[str]:
    """Names of the columns, as settings are called."""
    names = [name.strip().lower().replace("-", "_") for name in header]
    of_images = (REFERENCE, *SettingFields.model_fields)
    followed = (*FRAME_SETTINGS, *TrackFields.model_fields)
    known = (IMAGE, ID, *(followed if tracking else of_images))
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        raise InputError(
            "columns separated by commas expected",
            "separate them by commas, or by tabs in a .tsv file",
        )
    for name, given in zip(names, header, strict=True):
        if name not in known:
            if name in (of_images if tracking else followed):
                raise _of_the_others(name, tracking)
            raise InputError(
                f"{shown(given)}: there is no such column, {IMAGE}, {ID}{'' if tracking else f', {REFERENCE}'} or a "
                "setting expected",
                f"{did_you_mean(name, known)}leave out columns that are no settings",
            )
        if names.count(name) > 1:
            raise InputError(f"the column {name} is given twice", "leave one of them out")
    if IMAGE not in names:
        raise InputError(f"no column {IMAGE}", f"name the column of the files {IMAGE}")
    return names


def _of_the_others(name: str, tracking: bool) -> InputError:
    """The error of a column of images among sequences, or the other way round."""
    if not tracking:
        return InputError(
            f"the column {name} is a setting of tracking", "add --track, or leave the column out"
        )
    hint = (
        "accelsurf evaluate --tracks compares tracks with a reference; "
        if name == REFERENCE
        else ""
    )
    return InputError(
        f"the column {name} is of single images, --track was given", f"{hint}leave the column out"
    )


def _cases(
    path: Path, columns: list[str], lines: Iterator[list[str]], tracking: bool
) -> Iterator[Case]:
    number = 1
    for cells in lines:
        number += 1
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) > len(columns):
            raise InputError(
                f"row {number}: {len(cells)} cells, {len(columns)} columns expected",
                'put cells with a comma in double quotes, such as "point:1,2,3"',
            )
        given = {
            name: cell.strip() for name, cell in zip(columns, cells, strict=False) if cell.strip()
        }
        yield _case(path, given, number, tracking)


def _case(path: Path, given: Mapping[str, str], number: int, tracking: bool) -> Case:
    if IMAGE not in given:
        raise InputError(f"row {number}: no {IMAGE}", "each row needs one")
    base = path.parent.absolute()
    image = base / given[IMAGE]
    reference = base / given[REFERENCE] if REFERENCE in given else None
    settings = {
        key: _value(key, text, base)
        for key, text in given.items()
        if key not in (IMAGE, ID, REFERENCE)
    }
    name = (
        image_name(image) if tracking else split_name(image)[0]
    )  # a sequence may be a pattern of its frames
    case = Case(given.get(ID, name), image, settings, reference, f"{path}, row {number}")
    return check_id(case) if ID in given else case


def _value(key: str, text: str, base: Path) -> str | tuple[str, ...]:
    """The value of a cell: several where the setting may be repeated, with paths from the folder of the table."""
    parts = [part.strip() for part in text.split(";")] if setting_entry(key).repeated else [text]
    values = tuple(_with_paths(key, part, base) for part in parts if part)
    return values if setting_entry(key).repeated else values[0]


def _with_paths(key: str, text: str, base: Path) -> str:
    """A value whose file, if it names one, is looked for in the folder of the table."""
    if key in _FILES:
        return str(base / text)
    if key == CORRECTIONS:
        return _correction(text, base)
    name = file_in(text) if key in PLACES else ""
    return text.strip().removesuffix(name) + str(base / name) if name else text


def _correction(text: str, base: Path) -> str:
    """A correction of a frame, the files of its clicks looked for in the folder of the table."""
    try:
        words = shlex.split(text)
    except ValueError:  # a quote is missing: the setting's error names the form
        return text
    parts = (word.partition("=") for word in words)
    found = (
        (key, sign, _with_paths(key, value, base) if key in PLACES else value)
        for key, sign, value in parts
    )
    return shlex.join("".join(part) for part in found)
