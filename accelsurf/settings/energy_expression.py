"""Energies as they are written: names with settings, each times a weight, added.

    expression = item { (" + " | " - ") item }
    item       = [NUMBER "*"] NAME [":" setting { "," setting }]

A sign between two items has a blank on either side, so that numbers like ``-50`` and ``1e-3`` need no quotes. In a
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
from accelsurf.settings.energy_terms import TERMS, image_terms
from accelsurf.settings.expression import MAGNITUDES, NUMBER, Named, Reader, Value, Written, text_of
from accelsurf.settings.wording import shown

MAX_TERMS = 32
READER = Reader("energy", "local-region:R=8 + 0.3*geodesic + 0.1*area", TERMS)


class Term(NamedTuple):
    """One item of an expression: ``name``, ``weight``, and ``settings`` by key (numbers, or words)."""

    name: str
    weight: float
    settings: Mapping[str, Value]


class EnergyText(Written):
    """An energy as it is written, and its terms.

    Parameters
    ----------
    text : str
        As on the command line.

    Attributes
    ----------
    terms : tuple of Term

    Raises
    ------
    UsageError
        When it is no expression, names something unknown, or a value is out of bounds.

    Examples
    --------
    >>> EnergyText("local-region:R=8 + 0.3*geodesic").terms
    (Term(name='local-region', weight=1.0, settings={'R': 8.0}), Term(name='geodesic', weight=0.3, settings={}))
    >>> EnergyText("threshold:-50,auto - 0.1*balloon").terms[1].weight
    -0.1
    """

    terms: tuple[Term, ...]

    def _read(self) -> None:
        budgets.EXPRESSION.check(len(self), "energy", kind=UsageError)
        parts = re.split(r" ([+-]) ", str(self))
        if len(parts) > 2 * MAX_TERMS:
            raise READER.error(self, f"at most {MAX_TERMS} terms")
        items = [_item(self, parts[0], 1.0)]
        for sign, part in zip(parts[1::2], parts[2::2], strict=True):
            items.append(_item(self, part, -1.0 if sign == "-" else 1.0))
        if not any(TERMS[term.name].sees_image for term in items):
            raise READER.error(self, f"a term that sees the image: {', '.join(image_terms())}")
        self.terms = tuple(items)

    @classmethod
    def _as_text(cls, value: Any) -> Any:
        return from_tables(value) if isinstance(value, (list, tuple)) else value

    @property
    def parts_space(self) -> bool:
        """True if objects part the space between them at edges."""
        return any(term.name == "partition" for term in self.terms)

    @property
    def uses_model(self) -> bool:
        """True if a term is of the model that learns from clicks."""
        return any(TERMS[term.name].uses_model for term in self.terms)

    @property
    def learns(self) -> bool:
        """True if a term learns once from the start, unless it is given something else to learn from."""
        return any(TERMS[term.name].learns(term.settings) for term in self.terms)

    def with_setting(self, place: int, key: str, value: str) -> EnergyText:
        """Return the energy with another value of a setting of the term at a place, from 0; "" leaves it out.

        Raises
        ------
        UsageError
            When the term or the setting does not exist, or the value is not valid.

        Examples
        --------
        >>> EnergyText("threshold:auto + geodesic").with_setting(0, "HI", "250")
        'threshold:LO=auto,HI=250 + geodesic'
        """
        if not 0 <= place < len(self.terms):
            raise READER.error(self, f"a term number {place + 1}")
        terms = list(self.terms)
        named = READER.changed(self, Named(terms[place].name, terms[place].settings), key, value)
        terms[place] = terms[place]._replace(settings=named.settings)
        return EnergyText(written(terms))


def written(terms: Sequence[Term]) -> str:
    """Write terms as an expression; settings that are empty words are left out.

    Examples
    --------
    >>> written(EnergyText("threshold:-50,auto - 0.1*balloon").terms)
    'threshold:LO=-50,HI=auto - 0.1*balloon'
    """
    text = ""
    for term in terms:
        weight = abs(term.weight) if text else term.weight
        text += (" - " if term.weight < 0 else " + ") if text else ""
        text += "" if weight == 1 else f"{text_of(weight)}*"
        text += str(Named(term.name, term.settings))
    return text


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
            raise READER.error(
                str(table), "a table with a term, such as {term = 'geodesic', weight = 0.3}"
            )
        weight = table.get("weight", 1)
        if isinstance(weight, bool) or not isinstance(weight, (int, float)):
            raise READER.error(str(table), "a weight that is a number")
        settings = {key: value for key, value in table.items() if key not in ("term", "weight")}
        for key, value in settings.items():
            if not isinstance(value, (int, float, str)) or isinstance(value, bool):
                raise READER.error(str(table), f"a number or a word for {shown(key)}")
        values = ",".join(f"{key}={value}" for key, value in settings.items())
        factor = "" if weight == 1 else f"{weight!r}*"
        items.append(f"{factor}{table['term']}" + (f":{values}" if values else ""))
    return " + ".join(items)


def _item(text: str, item: str, sign: float) -> Term:
    factor, star, rest = item.partition("*")
    weight = 1.0
    if star:
        if not NUMBER.fullmatch(factor.strip()):
            raise READER.error(text, f"a number before the * in '{shown(item)}'")
        weight, item = float(factor.strip()), rest.strip()
    name, settings = READER.read(text, item)
    weight *= sign
    signed = TERMS[name].signed
    if not math.isfinite(weight) or weight == 0 or (weight < 0 and not signed):
        raise READER.error(
            text, f"a weight {'other than 0' if signed else 'greater than 0'} for {name}"
        )
    if not MAGNITUDES[0] <= abs(weight) <= MAGNITUDES[1]:
        raise READER.error(
            text, f"a weight of size {MAGNITUDES[0]:g} to {MAGNITUDES[1]:g} for {name}"
        )
    return Term(name, weight, settings)
