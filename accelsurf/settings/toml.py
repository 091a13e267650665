"""Configuration files: TOML read with an error that helps, and written without loss.

Written by hand and not by tomli-w: its lists take a line for each item, and it may put tables of edits on one line.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.input_file import check_readable


def read(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as a dictionary.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    UsageError
        When the file is missing, unreadable or not TOML.
    """
    try:
        check_readable(path, f"{path}: the configuration: ", UsageError)
        with open(path, "rb") as file:
            content = file.read(budgets.CONFIG.limit + 1)
        budgets.CONFIG.check(len(content), f"{path}: the configuration", kind=UsageError)
        return tomllib.loads(content.decode())
    except OSError as error:
        raise UsageError(
            f"{path}: the configuration cannot be read ({error.strerror or error})",
            "accelsurf segment INPUT -o DIR --dump-config prints one to start from",
        ) from None
    except RecursionError:
        hint = "a configuration has at most one list in another"
        raise UsageError(f"{path}: lists or tables nested too deeply", hint) from None
    except ValueError as error:  # not TOML, not UTF-8, a path with a zero byte
        if "integer string conversion" in str(error):
            raise UsageError(f"{path}: a whole number of thousands of digits in it", "is it the right file?") from None
        raise UsageError(
            f"{path}: not a TOML file: {error}", "write one setting per line, e.g.: smoothness = 0.5"
        ) from None


def written(values: Mapping[str, Any], tables: Sequence[str]) -> str:
    """Return values as TOML: a line for each but those that are None, and a table for each item of some of them.

    Parameters
    ----------
    values : mapping
        Of str, bool, int, finite float, None, or tuples of them.
    tables : sequence of str
        Keys of the values that are sequences of mappings.

    Examples
    --------
    >>> print(written({"cfl": 0.5, "mask": None, "edit": [{"step": 3}]}, tables=["edit"]), end="")
    cfl = 0.5
    <BLANKLINE>
    [[edit]]
    step = 3
    """
    lines = [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None and key not in tables]
    for name in tables:
        for table in values[name]:
            lines += ["", f"[[{name}]]", *(f"{key} = {_toml(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """Return one value as TOML. Only the types of RunConfig: str, bool, int, finite float, tuple."""
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        # A JSON string is a TOML string but for DEL, which TOML wants escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)
