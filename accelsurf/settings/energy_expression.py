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
from accelsurf.settings import budgets
from accelsurf.settings.energy_terms import HALF, TERMS, Number, Value, Word, image_terms
from accelsurf.settings.wording import did_you_mean, shown

#: Sizes of numbers that settings and weights may have: beyond them squares leave the range of 32-bit floats.
MAGNITUDES = (1e-18, 1e12)
#: The same for the values of terms, which may be of the image.
_VALUES = (1e-30, 1e30)
MAX_TERMS = 32
EXAMPLE = "local-region:R=8 + 0.3*geodesic + 0.1*area"
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


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
    budgets.EXPRESSION.check(len(text), "energy", kind=UsageError)
    parts = re.split(r" ([+-]) ", " ".join(text.split()))
    if len(parts) > 2 * MAX_TERMS:
        raise _error(text, f"at most {MAX_TERMS} terms")
    items = [_item(text, parts[0], 1.0)]
    for sign, part in zip(parts[1::2], parts[2::2], strict=True):
        items.append(_item(text, part, -1.0 if sign == "-" else 1.0))
    if not any(TERMS[term.name].sees_image for term in items):
        raise _error(text, f"a term that sees the image: {', '.join(image_terms())}")
    return tuple(items)


def written(terms: Sequence[Term]) -> str:
    """Write terms as an expression; settings that are empty words are left out.

    Examples
    --------
    >>> written(parse("threshold:-50,auto - 0.1*balloon"))
    'threshold:LO=-50,HI=auto - 0.1*balloon'
    """
    text = ""
    for term in terms:
        weight = abs(term.weight) if text else term.weight
        text += (" - " if term.weight < 0 else " + ") if text else ""
        values = ",".join(
            f"{key}={_number(value)}" for key, value in term.settings.items() if value != ""
        )
        text += (
            ("" if weight == 1 else f"{_number(weight)}*")
            + term.name
            + (f":{values}" if values else "")
        )
    return text


def _number(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"


def with_setting(text: str, place: int, key: str, value: str) -> str:
    """Return an expression with another value of a setting of the term at a place, counted from 0; "" leaves it out.

    Raises
    ------
    UsageError
        When there is no such term or setting, or the value is not valid.

    Examples
    --------
    >>> with_setting("threshold:auto + geodesic", 0, "HI", "250")
    'threshold:LO=auto,HI=250 + geodesic'
    """
    terms = list(parse(text))
    if not 0 <= place < len(terms):
        raise _error(text, f"a term number {place + 1}")
    term = terms[place]
    known = TERMS[term.name].settings
    if key not in known:
        raise _error(text, f"one of {_known(term.name)} in place of '{shown(key)}'")
    settings = {name: v for name, v in term.settings.items() if name != key or value.strip()}
    if value.strip():
        settings[key] = _value(text, f"{key} of {term.name}", known[key], value.strip())
    terms[place] = term._replace(settings=settings)
    changed = written(terms)
    parse(changed)
    return changed


def learns(term: Term) -> bool:
    """Return True if a term learns once from the start, unless it is given something else to learn from."""
    return TERMS[term.name].learns(term.settings)


def parts_space(text: str) -> bool:
    """Return True if objects part the space between them at edges."""
    return any(term.name == "partition" for term in parse(text))


def uses_model(text: str) -> bool:
    """Return True if a term of an energy is of the model that learns from clicks."""
    return any(TERMS[term.name].uses_model for term in parse(text))


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
            raise _error(
                str(table), "a table with a term, such as {term = 'geodesic', weight = 0.3}"
            )
        weight = table.get("weight", 1)
        if isinstance(weight, bool) or not isinstance(weight, (int, float)):
            raise _error(str(table), "a weight that is a number")
        settings = {key: value for key, value in table.items() if key not in ("term", "weight")}
        for key, value in settings.items():
            if not isinstance(value, (int, float, str)) or isinstance(value, bool):
                raise _error(str(table), f"a number or a word for {shown(key)}")
        values = ",".join(f"{key}={value}" for key, value in settings.items())
        factor = "" if weight == 1 else f"{weight!r}*"
        items.append(f"{factor}{table['term']}" + (f":{values}" if values else ""))
    return " + ".join(items)


def _error(text: str, expected: str, guess: str = "") -> UsageError:
    given = shown(text.strip()) if text.strip() else "nothing"
    return UsageError(
        f"energy: {given} was given, expected {expected}", f"{guess}as in {EXAMPLE!r}"
    )


def _item(text: str, item: str, sign: float) -> Term:
    factor, star, rest = item.partition("*")
    weight = 1.0
    if star:
        if not _NUMBER.fullmatch(factor.strip()):
            raise _error(text, f"a number before the * in '{shown(item)}'")
        weight, item = float(factor.strip()), rest.strip()
    name, colon, values = item.partition(":")
    name = name.strip()
    if name not in TERMS:
        near = " with a blank on either side of + and -" if re.search(r"[+\s]", name) else ""
        wanted = (
            f"{', '.join(list(TERMS)[:-1])} or {list(TERMS)[-1]}{near} in place of '{shown(name)}'"
        )
        raise _error(text, wanted, did_you_mean(name, TERMS))
    if colon and not values.strip():
        raise _error(text, f"values after the colon of {name}, of {_known(name)}")
    settings = _settings(text, name, values) if colon else {}
    if wanted := TERMS[name].check(settings):
        raise _error(text, wanted)
    weight *= sign
    if not math.isfinite(weight) or weight == 0 or (weight < 0 and not TERMS[name].signed):
        raise _error(
            text,
            f"a weight {'other than 0' if TERMS[name].signed else 'greater than 0'} for {name}",
        )
    if not MAGNITUDES[0] <= abs(weight) <= MAGNITUDES[1]:
        raise _error(text, f"a weight of size {MAGNITUDES[0]:g} to {MAGNITUDES[1]:g} for {name}")
    return Term(name, weight, settings)


def _known(name: str) -> str:
    return ", ".join(TERMS[name].settings) or "none: it has no settings"


def _settings(text: str, name: str, values: str) -> dict[str, Value]:
    known = TERMS[name].settings
    found: dict[str, Value] = {}
    for place, part in enumerate(values.split(",")):
        key, equals, value = part.partition("=")
        if not equals:
            key, value = (list(known)[place] if place < len(known) else ""), part
        key, value = key.strip(), value.strip()
        if key not in known:
            wanted = f"one of {_known(name)} in place of '{shown(part.strip())}'"
            raise _error(text, wanted, did_you_mean(key if equals else part, known))
        if key in found:
            raise _error(text, f"{key} of {name} once")
        found[key] = _value(text, f"{key} of {name}", known[key], value)
    return found


def _value(text: str, what: str, kind: Number | Word, value: str) -> Value:
    if value in kind.words:
        return value
    if isinstance(kind, Word):
        raise _error(
            text,
            f"{kind.expected} for {what}, not '{shown(value)}'",
            did_you_mean(value, kind.words),
        )
    percent = kind.percent and value.endswith("%")
    half = kind.percent and value.startswith(HALF)
    digits = value.removesuffix("%") if percent else value.removeprefix(HALF) if half else value
    number = float(digits) if _NUMBER.fullmatch(digits) else math.nan
    low, high = (0.0, 100.0) if percent else (kind.low, kind.high)
    if not (
        low < number < high or (number == low and kind.low_too) or number == high
    ) or not math.isfinite(number):
        guess = did_you_mean(value, kind.words)
        raise _error(text, f"{kind.expected} for {what}, not '{shown(value or 'nothing')}'", guess)
    if number != 0 and not _VALUES[0] <= abs(number) <= _VALUES[1]:
        raise _error(text, f"0 or a number of size {_VALUES[0]:g} to {_VALUES[1]:g} for {what}")
    return value if percent or half else number
