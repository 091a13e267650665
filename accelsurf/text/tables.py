"""Tables of places as people write them in CSV: in world mm, in voxels, or on the scales of pictures."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO, TypeVar

from accelsurf.errors import InputError
from accelsurf.io import naming
from accelsurf.settings import budgets
from accelsurf.text.coordinates import System

Row = TypeVar("Row")


@contextmanager
def open_table(file: str) -> Iterator[TextIO]:
    """Open a table of text; errors within the block name the file.

    Raises
    ------
    InputError
        When it cannot be read or is too large.
    """
    with naming(Path(file)), open(file, encoding="utf-8-sig", newline="") as stream:
        budgets.TABLE.check(os.fstat(stream.fileno()).st_size)
        yield stream


def columns_in(system: System, world: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a table of places in a system, by the columns of a table in world mm.

    Examples
    --------
    >>> columns_in("vox", ("id", "x", "r")), columns_in("shown", ("x", "y"))
    (('id', 'x_vox', 'r_vox'), ('x_grid', 'y_grid'))
    """
    end = {"": "", "vox": "_vox"}.get(system, "_grid")
    return tuple(f"{name}{end}" if name in ("x", "y", "z", "r") else name for name in world)


def read_table(
    file: str,
    world: Sequence[str],
    form: str,
    read_row: Callable[[dict[str, str], int, System], Row],
) -> list[Row]:
    """Read a CSV table of places in world mm, in voxels, or on the scales of pictures; lines with # first are left out.

    Parameters
    ----------
    file : str
    world : sequence of str
        Columns that a table has; see `columns_in` for the other systems.
    form : str
        The expected form, for messages.
    read_row : callable
        Called with the values of a row by column, its line number, and the system of places.

    Raises
    ------
    InputError
        When it is no table of this form; the message names the file.
    """
    with open_table(file) as stream:
        try:
            table = csv.reader(
                (line for line in stream if not line.startswith("#")), skipinitialspace=True
            )
            columns = [name.strip() for name in next(table, [])]
            known: tuple[System, ...] = ("vox", "shown", "")
            systems = [s for s in known if set(columns_in(s, world)) <= set(columns)]
            if not systems:
                given = ",".join(columns) or "no line"
                raise InputError(
                    f"{given} was given as the first line, expected {form}",
                    f"as in {','.join(world)}",
                )
            return [
                read_row(dict(zip(columns, row, strict=False)), table.line_num, systems[0])
                for row in table
                if row
            ]
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"not a table of text ({error})", f"expected {form}") from None
