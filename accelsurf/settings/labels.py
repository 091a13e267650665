"""Labels as files and people write them: ids and ranges of ids, names, colours."""

from __future__ import annotations

import colorsys
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings.wording import shown

Color = tuple[int, int, int]
_GOLDEN = 0.6180339887498949
_GIVEN = re.compile(r"(?:([0-9]{1,9})=)?(.+)", re.DOTALL)
_HEX = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})")
_NUMBERS = re.compile(r"([0-9]{1,3}),([0-9]{1,3}),([0-9]{1,3})")
#: Of a name; DICOM takes 64.
MAX_NAME = 64
#: First and last id of each range.
IdRanges = tuple[tuple[int, int], ...]
_LABEL = re.compile(r"[0-9]{1,18}")


@dataclass(frozen=True)
class LabelEntry:
    """Name and colour of one label.

    Attributes
    ----------
    id : int
        Its value in a label map, above 0.
    name : str
    color : tuple of int
        Red, green, blue, 0 to 255.
    """

    id: int
    name: str
    color: Color

    @property
    def hex(self) -> str:
        """The colour as ``#rrggbb``."""
        return "#{:02x}{:02x}{:02x}".format(*self.color)


@dataclass(frozen=True)
class LabelTable:
    """Labels by their id; those that nothing was said of have a name and a colour made from the id.

    Attributes
    ----------
    entries : dict of int to LabelEntry
    """

    entries: dict[int, LabelEntry] = field(default_factory=dict)

    def __getitem__(self, label: int) -> LabelEntry:
        """Return the name and colour of a label.

        Examples
        --------
        >>> table = LabelTable({1: LabelEntry(1, "liver", (200, 60, 60))})
        >>> table[1].name, table[7].name
        ('liver', 'object 7')
        """
        known = self.entries.get(label)
        return (
            LabelEntry(label, f"object {label}", default_color(label)) if known is None else known
        )

    def __iter__(self) -> Iterator[LabelEntry]:
        return iter(self.entries[label] for label in sorted(self.entries))

    def of(self, labels: Iterable[int]) -> LabelTable:
        """An entry for each of these labels, and no others.

        Examples
        --------
        >>> [one.name for one in LabelTable().of([2, 5])]
        ['object 2', 'object 5']
        """
        return LabelTable({label: self[label] for label in labels})

    def with_settings(self, names: Sequence[str], colors: Sequence[str]) -> LabelTable:
        """The same with names and colours as settings give them: ``1=liver``, ``1=#c83c3c``.

        Examples
        --------
        >>> LabelTable().with_settings(["liver"], ["1=#c83c3c"])[1]
        LabelEntry(id=1, name='liver', color=(200, 60, 60))
        """
        entries = dict(self.entries)
        for text in names:
            label, name = named(text)
            entries[label] = LabelEntry(label, name, LabelTable(entries)[label].color)
        for text in colors:
            label, color = colored(text)
            entries[label] = LabelEntry(label, LabelTable(entries)[label].name, color)
        return LabelTable(entries)

    def to_json(self) -> str:
        """Return the table as text, for the metadata of a label map.

        Examples
        --------
        >>> LabelTable.from_json(LabelTable({3: LabelEntry(3, "a", (1, 2, 3))}).to_json())[3].name
        'a'
        """
        return json.dumps([[entry.id, entry.name, *entry.color] for entry in self])

    @classmethod
    def from_json(cls, text: str) -> LabelTable:
        """Return the table of a text from `to_json`."""
        return cls(
            {
                row[0]: LabelEntry(row[0], row[1], (row[2], row[3], row[4]))
                for row in json.loads(text)
            }
        )


def named(text: str) -> tuple[int, str]:
    """A label and its name, as ``ID=NAME``; without an id it is 1.

    Raises
    ------
    UsageError
        When it is written in another way.

    Examples
    --------
    >>> named("2=left kidney"), named("liver")
    ((2, 'left kidney'), (1, 'liver'))
    """
    label, name = _parted("name", text)
    name = " ".join(name.split())
    if not name or len(name) > MAX_NAME or not name.isprintable():
        raise UsageError(
            f"name: {text[:80]} was given, expected ID=NAME of at most {MAX_NAME} letters",
            "as 1=liver",
        )
    return label, name


def colored(text: str) -> tuple[int, Color]:
    """A label and its colour, as ``ID=#rrggbb`` or ``ID=R,G,B``; without an id it is 1.

    Raises
    ------
    UsageError
        When it is written in another way.

    Examples
    --------
    >>> colored("2=#ff8000"), colored("10,20,30")
    ((2, (255, 128, 0)), (1, (10, 20, 30)))
    """
    label, color = _parted("color", text)
    if (found := _HEX.fullmatch(color)) is not None:
        red, green, blue = (int(part, 16) for part in found.groups())
    elif (found := _NUMBERS.fullmatch(color)) is not None and max(map(int, found.groups())) <= 255:
        red, green, blue = map(int, found.groups())
    else:
        raise UsageError(
            f"color: {text[:80]} was given, expected ID=#rrggbb or ID=R,G,B of 0 to 255",
            "as 1=#c83c3c",
        )
    return label, (red, green, blue)


def _parted(key: str, text: str) -> tuple[int, str]:
    found = _GIVEN.fullmatch(text.strip())
    label = int(found.group(1) or 1) if found else 0
    if found is None or not 1 <= label <= 2**32 - 1:
        raise UsageError(
            f"{key}: {text[:80]} was given, expected ID={key.upper()} with an id above 0",
            f"as 1={key}",
        )
    return label, found.group(2).strip()


def checked_names(value: Any) -> Any:
    """Check names of labels as settings give them."""
    return _checked(value, named)


def checked_colors(value: Any) -> Any:
    """Check colours of labels as settings give them."""
    return _checked(value, colored)


def _checked(value: Any, parse: Callable[[str], Any]) -> Any:
    """Return a tuple of texts, each of which can be parsed; other values are left to the type of the setting."""
    value = (value,) if isinstance(value, str) else value
    for text in value if isinstance(value, (list, tuple)) else ():
        if isinstance(text, str):
            parse(text)
    return value


def default_color(label: int) -> Color:
    """A colour for a label that has none: hues a golden angle apart, so that neighbours in number differ.

    Examples
    --------
    >>> default_color(1) != default_color(2)
    True
    """
    red, green, blue = (
        round(255 * part) for part in colorsys.hsv_to_rgb(label * _GOLDEN % 1.0, 0.75, 1.0)
    )
    return red, green, blue


def parse_ids(text: str, source: str, example: str) -> IdRanges:
    """Read ids and ranges of ids, separated by commas.

    Parameters
    ----------
    text : str
    source, example : str
        Where it was given, and a valid text, for the message.

    Raises
    ------
    UsageError
        When a part is neither a whole number nor a range of them.

    Examples
    --------
    >>> parse_ids("2,5-9", "--labels", "--labels 1,3-5")
    ((2, 2), (5, 9))
    """
    ids = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not (
            _LABEL.fullmatch(first)
            and _LABEL.fullmatch(last or first)
            and int(first) <= int(last or first)
        ):
            raise UsageError(
                f"{source}: {shown(part)!r} is no label, expected whole numbers and ranges",
                f"as in {example}",
            )
        ids.append((int(first), int(last or first)))
    return tuple(ids)


def holds(ranges: Sequence[tuple[int, int]], label: int) -> bool:
    """Return True if an id is in one of the ranges.

    Examples
    --------
    >>> holds(((2, 2), (5, 9)), 7), holds(((2, 2), (5, 9)), 3)
    (True, False)
    """
    return any(first <= label <= last for first, last in ranges)
