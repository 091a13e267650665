"""Tables that studies write into pages of docs, between two comments that name the study."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

END = "<!-- end of the table -->"


def put_table(page: Path, study: str, text: str, command: str = "scripts/study") -> None:
    """Put what a study found in place of what stands between its comments."""
    begin = f"<!-- {command} {study} writes this table -->"
    before, rest = page.read_text().split(begin)
    page.write_text(f"{before}{begin}\n\n{text}\n{END}{rest.split(END, 1)[1]}")


def row_of(cells: Iterable[str]) -> str:
    """A row of a table in Markdown.

    Examples
    --------
    >>> row_of(["a", "b"])
    '| a | b |'
    """
    return f"| {' | '.join(cells)} |"


def head_of(columns: tuple[str, ...]) -> list[str]:
    """The rows above a table's own."""
    return [row_of(columns), "|" + "---|" * len(columns)]
