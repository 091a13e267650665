"""Configuration files in TOML, and the values of settings as people write them: volumes, times, lengths, bounds, lists.

Files are read with errors that help, and written without loss: by hand and not by tomli-w, whose lists take a line for
each item, and which may put tables of corrections on one line.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.reading import check_readable
from accelsurf.settings.wording import shown

#: mm3 of each unit of volume, and seconds of each unit of time.
_MM3 = {
    "l": 1e6,
    "ml": 1e3,
    "ul": 1.0,
    "cm3": 1e3,
    "cc": 1e3,
    "mm3": 1.0,
    "um3": 1e-9,
    "nm3": 1e-18,
}
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
#: Patterns of a length in voxels, a volume and an interval.
VOXELS = r"^([0-9]{1,9}(\.[0-9]{0,20})?|\.[0-9]{1,20})vox$"
VOLUME = rf"^([0-9]{{1,9}}(\.[0-9]{{0,20}})?|\.[0-9]{{1,20}})({'|'.join(_MM3)})$"
INTERVAL = rf"^([0-9]{{1,9}}|[0-9]{{1,9}}(\.[0-9]{{1,9}})?({'|'.join(_SECONDS)}))$"
_NUMBER = r"[-+]?(?:[0-9]{1,20}(?:\.[0-9]{0,20})?|\.[0-9]{1,20})(?:[eE][-+]?[0-9]{1,2})?"
_BOUNDS = re.compile(rf"({_NUMBER})?,({_NUMBER})?")


def read_toml(path: str | Path) -> dict[str, Any]:
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
            raise UsageError(
                f"{path}: a whole number of thousands of digits in it", "is it the right file?"
            ) from None
        raise UsageError(
            f"{path}: not a TOML file: {error}",
            "write one setting per line, e.g.: smoothness = 0.5",
        ) from None


def toml_text(values: Mapping[str, Any], tables: Sequence[str]) -> str:
    """Return values as TOML: a line for each but those that are None, and a table for each item of some of them.

    Parameters
    ----------
    values : mapping
        Of str, bool, int, finite float, None, or tuples of them.
    tables : sequence of str
        Keys of the values that are sequences of mappings.

    Examples
    --------
    >>> print(toml_text({"cfl": 0.5, "mask": None, "edit": [{"step": 3}]}, tables=["edit"]), end="")
    cfl = 0.5
    <BLANKLINE>
    [[edit]]
    step = 3
    """
    lines = [
        f"{key} = {_toml(value)}"
        for key, value in values.items()
        if value is not None and key not in tables
    ]
    for name in tables:
        for table in values[name]:
            lines += [
                "",
                f"[[{name}]]",
                *(f"{key} = {_toml(value)}" for key, value in table.items()),
            ]
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


def volume_mm3(text: str) -> float:
    """Return a volume, a number followed by its unit, in mm3.

    Raises
    ------
    UsageError
        When it is not of this form, or is 0.

    Examples
    --------
    >>> volume_mm3("250ml"), volume_mm3("3cm3"), volume_mm3("0.5mm3")
    (250000.0, 3000.0, 0.5)
    """
    found = re.fullmatch(VOLUME, text)
    if found is None or float(found[1]) == 0:
        raise UsageError(
            f"size: {shown(text)} was given, expected a volume above 0 with its unit",
            f"as in 250ml or 4000um3; the units are {', '.join(_MM3)}",
        )
    return float(found[1]) * _MM3[found[3]]


class Interval(NamedTuple):
    """An interval of ``steps``, or of ``seconds``; the other is None."""

    steps: int | None
    seconds: float | None

    def is_over(self, steps: int, seconds: float) -> bool:
        """Test if these steps and seconds are an interval or more.

        Examples
        --------
        >>> Interval(5, None).is_over(5, 0.0), Interval(None, 30.0).is_over(1000, 29.0)
        (True, False)
        """
        return steps >= self.steps if self.steps is not None else seconds >= (self.seconds or 0.0)


def interval_of(text: str) -> Interval:
    """Return an interval: a whole number of steps, or a time with its unit.

    Raises
    ------
    UsageError
        When it is not of this form, or is 0.

    Examples
    --------
    >>> interval_of("50"), interval_of("1.5min")
    (Interval(steps=50, seconds=None), Interval(steps=None, seconds=90.0))
    """
    found = re.fullmatch(INTERVAL, text)
    unit = None if found is None else found[3]
    number = 0.0 if found is None else float(text.removesuffix(unit or ""))
    if number == 0:
        raise UsageError(
            f"checkpoint: {shown(text)} was given, expected a number of steps or a time, above 0",
            f"as in 50, 30s or 5min; the units of time are {', '.join(_SECONDS)}",
        )
    return Interval(int(number), None) if unit is None else Interval(None, number * _SECONDS[unit])


def bounds_of(text: str | None) -> tuple[float, float]:
    """Return the bounds LOW,HIGH of values, infinite where one is left out.

    Raises
    ------
    UsageError
        When it is written in another way, or the first is not below the second.

    Examples
    --------
    >>> bounds_of(",250"), bounds_of("-100,250")
    ((-inf, 250.0), (-100.0, 250.0))
    """
    if text is None:
        return -math.inf, math.inf
    found = _BOUNDS.fullmatch(text.replace(" ", ""))
    if found is None or found[0] == ",":
        raise UsageError(
            f"clip: {shown(text)} was given, expected LOW,HIGH, one of which may be left out",
            "as --clip ,250",
        )
    low = -math.inf if found[1] is None else float(found[1])
    high = math.inf if found[2] is None else float(found[2])
    if not low < high:
        raise UsageError(
            f"clip: {shown(text)} was given, expected LOW below HIGH", "as --clip -100,250"
        )
    return low, high


def checked(
    parse: Callable[[str], Any],
    pattern: str | None = None,
    numbers: type | tuple[type, ...] = (),
    joined: bool = False,
) -> Callable[[Any], Any]:
    """Return a validator of a text, by a function that raises UsageError.

    Parameters
    ----------
    parse : callable
    pattern : str, optional
        Only texts of this form are parsed: the type of the setting refuses the others.
    numbers : type or tuple of type
        Kinds of numbers that become their text.
    joined : bool
        Whether a list becomes its text, with commas.
    """

    def check(value: Any) -> Any:
        if joined and isinstance(value, (list, tuple)):
            value = ",".join(str(item) for item in value)
        elif isinstance(value, numbers) and not isinstance(value, bool):
            value = str(value)
        if isinstance(value, str) and (pattern is None or re.fullmatch(pattern, value)):
            parse(value)
        return value

    return check


checked_volume = checked(volume_mm3, VOLUME)


def checked_bounds(value: Any) -> Any:
    """Check bounds; a pair of numbers, one of which may be None, becomes its text."""
    if isinstance(value, (list, tuple)) and len(value) == 2:
        value = ",".join("" if number is None else repr(float(number)) for number in value)
    return checked(bounds_of)(value)


def one_or_many(value: Any) -> Any:
    """Turn a single text into a tuple of one."""
    return (value,) if isinstance(value, str) else value


def all_split(value: Any) -> Any:
    """Split several texts at their commas, as `split_commas`."""
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        value = ",".join(value) if value else ()
    return split_commas(value)


def split_commas(value: Any) -> Any:
    """Turn ``"ply,stl"`` into ``("ply", "stl")``; names given twice count once."""
    if value == "auto":
        return value
    if isinstance(value, str):
        value = value.split(",")
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        return tuple(dict.fromkeys(item.strip().lower() for item in value))
    return value
