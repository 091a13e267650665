"""Tables that people write: CSV with a header, cells separated by commas, or by tabs in a .tsv file."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from accelsurf.errors import InputError
from accelsurf.io.files import naming
from accelsurf.settings import budgets

T = TypeVar("T")


def read(path: Path, what: str, parse: Callable[[list[str], Any], list[T]]) -> list[T]:
    """Read a table.

    Parameters
    ----------
    path : Path
    what : str
        What a row stands for, for messages.
    parse : callable
        Of the cells of the first line and a reader of the others, returns what the rows say.

    Raises
    ------
    InputError
        With the file, the line and what is wrong in it.
    """
    with naming(path):
        budgets.CASES.check(path.stat().st_size, "the table")
        try:
            text = path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            raise InputError("the table is not text in UTF-8", "save it as CSV UTF-8") from None
        lines = csv.reader(io.StringIO(text), delimiter="\t" if path.suffix.lower() == ".tsv" else ",", strict=True)
        try:
            rows = parse(next(lines, []), lines)
        except csv.Error as error:
            message = f"line {lines.line_num}: not a line of a CSV file ({error})"
            raise InputError(message, "is a quote missing?") from None
        if not rows:
            raise InputError("the table has no row below its header", f"write a row for each {what}")
    return rows
