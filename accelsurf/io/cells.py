"""Tables as CSV or TSV text whose cells no spreadsheet takes for formulas.

Spreadsheets compute a cell that begins with ``=``, ``+``, ``-`` or ``@``. The name of a label, of a file or of a case
may have come with somebody's data, so a text that begins so gets an apostrophe before it, which spreadsheets take for
"a text". Numbers stay as they are. A text that has apostrophes and one of these characters gets one more: then the
text itself is known again.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

_FORMULA = re.compile(r"'*[\s\0]*[=+\-@\uff1d\uff0b\uff0d\uff20]|'*[\t\r\n]")
_END = "\r\n"
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|-|[+-]?(inf|nan)")


class _Lines(list[str]):
    """Lines that a writer of tables has written."""

    def write(self, line: str) -> None:
        """Take a line."""
        self.append(line)


def text_cell(text: str) -> str:
    """Return the cell of a text.

    Examples
    --------
    >>> text_cell("=1+1"), text_cell("'=x"), text_cell("-1.5"), text_cell("left kidney")
    ("'=1+1", "''=x", '-1.5', 'left kidney')
    """
    if _NUMBER.fullmatch(text) or not _FORMULA.match(text):
        return text
    return f"'{text}"


def text_of_cell(cell: str) -> str:
    """Return the text of a cell that `text_cell` has made, or somebody else.

    Examples
    --------
    >>> text_of_cell("'=1+1"), text_of_cell("'quoted'"), text_of_cell("=1+1")
    ('=1+1', "'quoted'", '=1+1')
    """
    text = cell[1:]
    return text if cell[:1] == "'" and text_cell(text) == cell else cell


def table_text(columns: Sequence[str], rows: Iterable[Sequence[Any]], delimiter: str = ",") -> str:
    """Return a table; True is 1, None is empty, and floats have all digits.

    Parameters
    ----------
    columns : sequence of str
    rows : iterable of sequence
    delimiter : str, optional
    """
    lines = _Lines()
    # This end of a line has cells with either of its characters put in quotes.
    writer = csv.writer(lines, delimiter=delimiter, lineterminator=_END)
    writer.writerow([text_cell(column) for column in columns])
    writer.writerows([_cell(value) for value in row] for row in rows)
    return "".join(f"{line.removesuffix(_END)}\n" for line in lines)


def _cell(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, str):
        return text_cell(value)
    if isinstance(value, bool):
        return int(value)
    return repr(value) if isinstance(value, float) else value
