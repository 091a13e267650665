"""Energies as they are written: names with settings, each times a weight, added.

    expression = item { (" + " | " - ") item }
    item       = [NUMBER "*"] NAME [":" setting { "," setting }]
    setting    = KEY "=" VALUE | VALUE

A sign between two items has a blank on either side, so that numbers such as ``-50`` and ``1e-3`` need no quotes. In a
TOML file the same is a list of tables:

    energy = [{term = "local-region", R = 8}, {term = "geodesic", weight = 0.3}]
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from accelsurf.errors import UsageError


class Number(NamedTuple):
    """A setting that is a number: its bounds, whether the bounds themselves are allowed, and words besides."""

    low: float = -math.inf
    high: float = math.inf
    low_too: bool = True
    words: tuple[str, ...] = ()
    percent: bool = False


class Word(NamedTuple):
    """A setting that is one of some words."""

    words: tuple[str, ...]


POSITIVE = Number(0.0, low_too=False)
#: What stands before the value that a bound lies half-way to.
HALF = "half:"
#: A bound in the image's unit, a percentile of the image, Otsu's threshold, learned from the start's values, half-way
#: between their mean and a value, or none.
BOUND = Number(words=("auto", "learned", ""), percent=True)
CHANNEL = Number(1.0)
#: What each term may be told, in the order in which values without a key are taken.
TERMS: dict[str, dict[str, Number | Word]] = {
    "chan-vese": {"balance": POSITIVE, "epsilon": Number(0.0, 2.5), "channel": CHANNEL},
    "local-region": {"R": POSITIVE, "epsilon": Number(0.0, 2.5), "channel": CHANNEL},
    "likelihood": {
        "model": Word(("gauss", "histogram")),
        "update": Word(("yes", "no")),
        "epsilon": Number(0.0, 2.5),
        "channel": CHANNEL,
    },
    "threshold": {"LO": BOUND, "HI": BOUND, "soft": POSITIVE, "channel": CHANNEL},
    "geodesic": {"scale": POSITIVE, "contrast": POSITIVE, "balloon": Number(), "channel": CHANNEL},
    "balloon": {},
    "area": {},
}
#: Terms that say where the object is; the others need one of them beside.
IMAGE_TERMS = ("chan-vese", "local-region", "likelihood", "threshold", "geodesic")
#: One of each kind of energy that needs no more to be told: for lists to choose from.
SIMPLE = ("chan-vese", "local-region", "likelihood", "threshold:auto", "geodesic")
EXAMPLE = "local-region:R=8 + 0.3*geodesic + 0.1*area"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")

Value = float | str


class Term(NamedTuple):
    """One item of an expression: ``name``, ``weight``, and ``settings`` by key (numbers, or words)."""

    name: str
    weight: float
    settings: Mapping[str, Value]


def parse(text: str) -> tuple[Term, ...]:
    """Read an expression.

    Parameters
    ----------
    text : str
        As on the command line.

    Returns
    -------
    tuple of Term

    Raises
    ------
    UsageError
        When it is no expression, names something unknown, or a value is out of bounds.

    Examples
    --------
    >>> parse("local-region:R=8 + 0.3*geodesic")
    (Term(name='local-region', weight=1.0, settings={'R': 8.0}), Term(name='geodesic', weight=0.3, settings={}))
    >>> parse("threshold:-50,auto - 0.1*balloon")[1].weight
    -0.1
    """
    parts = re.split(r"\s+([+-])\s+", text.strip())
    items = [_item(text, parts[0], 1.0)]
    for sign, part in zip(parts[1::2], parts[2::2], strict=True):
        items.append(_item(text, part, -1.0 if sign == "-" else 1.0))
    if not any(term.name in IMAGE_TERMS for term in items):
        raise _error(text, f"a term that sees the image: {', '.join(IMAGE_TERMS)}")
    return tuple(items)


def learns(term: Term) -> bool:
    """Whether a term learns once from the start, unless it is given something else to learn from."""
    if term.name == "likelihood":
        return term.settings.get("update") == "no"
    words = [value for value in term.settings.values() if isinstance(value, str)]
    return term.name == "threshold" and any(word == "learned" or word.startswith(HALF) for word in words)


def from_tables(tables: Sequence[Any]) -> str:
    """Write a list of tables, as TOML has it, as an expression.

    Examples
    --------
    >>> from_tables([{"term": "threshold", "LO": -50, "HI": 300}, {"term": "balloon", "weight": -0.1}])
    'threshold:LO=-50,HI=300 + -0.1*balloon'
    """
    items = []
    for table in tables:
        if not isinstance(table, Mapping) or not isinstance(table.get("term"), str):
            raise _error(str(table), "a table with a term, such as {term = 'geodesic', weight = 0.3}")
        weight = table.get("weight", 1)
        if isinstance(weight, bool) or not isinstance(weight, (int, float)):
            raise _error(str(table), "a weight that is a number")
        settings = {key: value for key, value in table.items() if key not in ("term", "weight")}
        for key, value in settings.items():
            if not isinstance(value, (int, float, str)) or isinstance(value, bool):
                raise _error(str(table), f"a number or a word for {key}")
        values = ",".join(f"{key}={value}" for key, value in settings.items())
        factor = "" if weight == 1 else f"{weight!r}*"
        items.append(f"{factor}{table['term']}" + (f":{values}" if values else ""))
    return " + ".join(items)


def _error(text: str, expected: str) -> UsageError:
    return UsageError(f"energy: {text.strip() or 'nothing'} was given, expected {expected}", f"as in {EXAMPLE!r}")


def _item(text: str, item: str, sign: float) -> Term:
    factor, star, rest = item.partition("*")
    weight = 1.0
    if star:
        if not _NUMBER.fullmatch(factor.strip()):
            raise _error(text, f"a number before the * in {item!r}")
        weight, item = float(factor), rest.strip()
    name, colon, values = item.partition(":")
    name = name.strip()
    if name not in TERMS:
        near = " with a blank on either side of + and -" if re.search(r"[+\s]", name) else ""
        raise _error(text, f"{', '.join(list(TERMS)[:-1])} or {list(TERMS)[-1]}{near} in place of {name!r}")
    if colon and not values.strip():
        raise _error(text, f"values after the colon of {name}, of {_known(name)}")
    settings = _settings(text, name, values) if colon else {}
    if name == "threshold":
        _check_bounds(text, settings)
    weight *= sign
    if not math.isfinite(weight) or weight == 0 or (weight < 0 and name != "balloon"):
        raise _error(text, f"a weight {'other than 0' if name == 'balloon' else 'greater than 0'} for {name}")
    return Term(name, weight, settings)


def _known(name: str) -> str:
    return ", ".join(TERMS[name]) or "none: it has no settings"


def _settings(text: str, name: str, values: str) -> dict[str, Value]:
    known = TERMS[name]
    found: dict[str, Value] = {}
    for place, part in enumerate(values.split(",")):
        key, equals, value = part.partition("=")
        if not equals:
            key, value = (list(known)[place] if place < len(known) else ""), part
        key, value = key.strip(), value.strip()
        if key not in known:
            raise _error(text, f"one of {_known(name)} in place of {part.strip()!r}")
        if key in found:
            raise _error(text, f"{key} of {name} once")
        found[key] = _value(text, f"{key} of {name}", known[key], value)
    return found


def _value(text: str, what: str, kind: Number | Word, value: str) -> Value:
    if value in kind.words:
        return value
    if isinstance(kind, Word):
        raise _error(text, f"{' or '.join(kind.words)} for {what}, not {value!r}")
    percent = kind.percent and value.endswith("%")
    half = kind.percent and value.startswith(HALF)
    digits = value.removesuffix("%") if percent else value.removeprefix(HALF) if half else value
    number = float(digits) if _NUMBER.fullmatch(digits) else math.nan
    low, high = (0.0, 100.0) if percent else (kind.low, kind.high)
    if not (low < number < high or (number == low and kind.low_too) or number == high) or not math.isfinite(number):
        raise _error(text, f"{_in_words(kind)} for {what}, not {value or 'nothing'!r}")
    return value if percent or half else number


def _in_words(kind: Number) -> str:
    bounds = ""
    if kind.low > -math.inf:
        bounds = f" at least {kind.low:g}" if kind.low_too else f" above {kind.low:g}"
    if kind.high < math.inf:
        bounds += f" and at most {kind.high:g}"
    words = [f"a number{bounds}", *(word for word in kind.words if word)]
    if kind.percent:
        words += ["a percentile such as 80%", f"{HALF}V (half-way from V to the start's mean)"]
    return " or ".join(words)


def _check_bounds(text: str, found: Mapping[str, Value]) -> None:
    low, high = found.get("LO", ""), found.get("HI", "")
    if low == "" and high == "":
        raise _error(text, "at least one bound: threshold:LO,HI, threshold:LO, or threshold:,HI")
    if isinstance(low, float) and isinstance(high, float) and not low < high:
        raise _error(text, "a low threshold below the high one")
    if low == "auto" and high == "auto":
        raise _error(text, "auto for one of the two thresholds")
