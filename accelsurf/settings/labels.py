"""Names and colours of labels, as files and people give them."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator
from dataclasses import dataclass, field

Color = tuple[int, int, int]
_GOLDEN = 0.618033988749895


@dataclass(frozen=True)
class LabelEntry:
    """What is said of one label.

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


@dataclass(frozen=True)
class LabelTable:
    """Labels by their id; those that nothing was said of have a name and a colour made from the id.

    Attributes
    ----------
    entries : dict of int to LabelEntry
    """

    entries: dict[int, LabelEntry] = field(default_factory=dict)

    def __getitem__(self, label: int) -> LabelEntry:
        """What is known of a label.

        Examples
        --------
        >>> table = LabelTable({1: LabelEntry(1, "liver", (200, 60, 60))})
        >>> table[1].name, table[7].name
        ('liver', 'label 7')
        """
        known = self.entries.get(label)
        return LabelEntry(label, f"label {label}", default_color(label)) if known is None else known

    def __iter__(self) -> Iterator[LabelEntry]:
        return iter(self.entries[label] for label in sorted(self.entries))


def default_color(label: int) -> Color:
    """A colour for a label that has none: hues a golden angle apart, so that neighbours in number differ.

    Examples
    --------
    >>> default_color(1) != default_color(2)
    True
    """
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(label * _GOLDEN % 1.0, 0.75, 1.0))
    return red, green, blue
