"""Names with settings after a colon, as energies and flows are written: ``local-region:R=8``, ``sobolev:length=5``.

    item    = NAME [":" setting { "," setting }]
    setting = KEY "=" VALUE | VALUE

They are read once, when the settings of a run are validated; from then on a run has values, not texts.
"""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from accelsurf.errors import UsageError
from accelsurf.settings import budgets
from accelsurf.settings.wording import did_you_mean, shown

Value = float | str
Values = Mapping[str, Value]
#: Prefix of a value to which a bound lies half-way.
HALF = "half:"
#: Sizes of numbers that settings and weights may have: beyond them squares leave the range of 32-bit floats.
MAGNITUDES = (1e-18, 1e12)
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class Number(NamedTuple):
    """A setting that is a number: its bounds, whether the bounds themselves are allowed, other words."""

    low: float = -math.inf
    high: float = math.inf
    low_too: bool = True
    words: tuple[str, ...] = ()
    percent: bool = False
    help: str = ""

    @property
    def expected(self) -> str:
        """The values that it takes, in words.

        Examples
        --------
        >>> Number(0.0, 2.5).expected
        'a number at least 0 and at most 2.5'
        """
        bounds = ""
        if self.low > -math.inf:
            bounds = f" at least {self.low:g}" if self.low_too else f" above {self.low:g}"
        if self.high < math.inf:
            bounds += f" and at most {self.high:g}"
        words = [f"a number{bounds}", *(word for word in self.words if word)]
        if self.percent:
            words += ["a percentile such as 80%", f"{HALF}V (half-way from V to the start's mean)"]
        return " or ".join(words)


class Word(NamedTuple):
    """A setting that is one of some words."""

    words: tuple[str, ...]
    help: str = ""

    @property
    def expected(self) -> str:
        """The words."""
        return " or ".join(self.words)


@dataclass(frozen=True)
class Spec:
    """The entry of a term or a flow, as far as it is read and made.

    Attributes
    ----------
    name : str
        As it is written.
    help : str
        Description in a few words.
    settings : mapping of str to Number or Word
        Its settings after the colon, in the order in which values without a key are assigned.
    uses : tuple of str
        Settings of the run that it uses: a term where its own are not given, a flow besides the settings of all flows.
    check : callable
        Of the settings: the expected values where they contradict each other, else an empty text.
    """

    name: str
    help: str
    settings: Mapping[str, Number | Word] = field(default_factory=dict)
    uses: tuple[str, ...] = ()
    check: Callable[[Values], str] = lambda settings: ""


class Named(NamedTuple):
    """A ``name`` and its ``settings`` by key, numbers or words."""

    name: str
    settings: Values

    def __str__(self) -> str:
        values = ",".join(f"{key}={text_of(v)}" for key, v in self.settings.items() if v != "")
        return self.name + (f":{values}" if values else "")


class Reader(NamedTuple):
    """Reader of names with settings: the ``setting`` of the run that they are of, an ``example``, the ``entries``,
    and the ``smallest`` and ``largest`` size of a number; values of terms may be of the image.
    """

    setting: str
    example: str
    entries: Mapping[str, Spec]
    smallest: float = 1e-30
    largest: float = 1e30

    def error(self, text: str, expected: str, guess: str = "") -> UsageError:
        """Return the error about a text that is not as expected."""
        given = shown(text.strip()) if text.strip() else "nothing"
        return UsageError(
            f"{self.setting}: {given} was given, expected {expected}",
            f"{guess}as in {self.example!r}",
        )

    def read(self, text: str, item: str) -> Named:
        """Return an item of a text as a value.

        Raises
        ------
        UsageError
            When it names something unknown, or a value is out of bounds.
        """
        budgets.EXPRESSION.check(len(text), self.setting, kind=UsageError)
        name, colon, values = item.partition(":")
        name = name.strip()
        if name not in self.entries:
            near = " with a blank on either side of + and -" if re.search(r"[+\s]", name) else ""
            names = list(self.entries)
            wanted = f"{', '.join(names[:-1])} or {names[-1]}{near} in place of '{shown(name)}'"
            raise self.error(text, wanted, did_you_mean(name, names))
        if colon and not values.strip():
            raise self.error(text, f"values after the colon of {name}, of {self.known(name)}")
        return self.checked(text, Named(name, self._settings(text, name, values) if colon else {}))

    def changed(self, text: str, named: Named, key: str, value: str) -> Named:
        """Return a name with another value of a setting; "" leaves the setting out."""
        known = self.entries[named.name].settings
        if key not in known:
            raise self.error(text, f"one of {self.known(named.name)} in place of '{shown(key)}'")
        settings = {name: v for name, v in named.settings.items() if name != key or value.strip()}
        if value.strip():
            settings[key] = self._value(text, f"{key} of {named.name}", known[key], value.strip())
        return self.checked(text, named._replace(settings=settings))

    def checked(self, text: str, named: Named) -> Named:
        """Return the value, whose settings do not contradict each other."""
        if wanted := self.entries[named.name].check(named.settings):
            raise self.error(text, wanted)
        return named

    def known(self, name: str) -> str:
        """Return the names of the settings, in words."""
        return ", ".join(self.entries[name].settings) or "none: it has no settings"

    def _settings(self, text: str, name: str, values: str) -> dict[str, Value]:
        known = self.entries[name].settings
        found: dict[str, Value] = {}
        for place, part in enumerate(values.split(",")):
            key, equals, value = part.partition("=")
            if not equals:
                key, value = (list(known)[place] if place < len(known) else ""), part
            key, value = key.strip(), value.strip()
            if key not in known:
                wanted = f"one of {self.known(name)} in place of '{shown(part.strip())}'"
                raise self.error(text, wanted, did_you_mean(key if equals else part, known))
            if key in found:
                raise self.error(text, f"{key} of {name} once")
            found[key] = self._value(text, f"{key} of {name}", known[key], value)
        return found

    def _value(self, text: str, subject: str, kind: Number | Word, value: str) -> Value:
        if value in kind.words:
            return value
        if isinstance(kind, Word):
            raise self.error(
                text,
                f"{kind.expected} for {subject}, not '{shown(value)}'",
                did_you_mean(value, kind.words),
            )
        percent = kind.percent and value.endswith("%")
        half = kind.percent and value.startswith(HALF)
        digits = value.removesuffix("%") if percent else value.removeprefix(HALF) if half else value
        number = float(digits) if NUMBER.fullmatch(digits) else math.nan
        low, high = (0.0, 100.0) if percent else (kind.low, kind.high)
        if not (
            low < number < high or (number == low and kind.low_too) or number == high
        ) or not math.isfinite(number):
            guess = did_you_mean(value, kind.words)
            raise self.error(
                text, f"{kind.expected} for {subject}, not '{shown(value or 'nothing')}'", guess
            )
        if number != 0 and not self.smallest <= abs(number) <= self.largest:
            raise self.error(
                text, f"0 or a number of size {self.smallest:g} to {self.largest:g} for {subject}"
            )
        return value if percent or half else number


def text_of(value: Value) -> str:
    """Return a value as it is written: with nine digits, or with as many as say it exactly.

    Examples
    --------
    >>> text_of(8.0), text_of(1 / 3), text_of("auto")
    ('8', '0.3333333333333333', 'auto')
    """
    if isinstance(value, str):
        return value
    short = f"{value:.9g}"
    return short if float(short) == value else repr(value)


class Written(str):
    """A text of a setting that also has the values that it says: it is read when a setting is validated, and once.

    It equals its text, and is written to files and reports as its text.
    """

    def __new__(cls, text: str) -> Self:
        """Read a text; blanks count once."""
        made = super().__new__(cls, " ".join(text.split()))
        made._read()
        return made

    @abstractmethod
    def _read(self) -> None:
        """Set the attributes from the text, or raise UsageError."""

    @classmethod
    def _as_text(cls, value: Any) -> Any:
        """Return a value of a setting as text, where it may be something else."""
        return value

    @classmethod
    def _validated(cls, value: Any, handler: Any) -> Self:
        return value if isinstance(value, cls) else cls(handler(cls._as_text(value)))

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            cls._validated,
            core_schema.str_schema(),
            serialization=core_schema.plain_serializer_function_ser_schema(str),
        )
