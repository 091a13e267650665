"""Numbers of places as people write them: a unit or ``vox`` at the end, and RAS in place of LPS."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

#: mm in a unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}
_SUFFIX = re.compile(rf"(?s)(.*?)(vox|({'|'.join(UNITS_MM)})?(ras|lps)?)")
#: What may stand at the end of a place, for messages.
SUFFIXES = "a unit (mm, cm, um, nm), ras for RAS, or vox for voxel indices"


#: Endings of files of points that other programs write.
POINT_FILES = (".mrk.json", ".fcsv", ".csv", ".txt")
#: Kinds of places with a file, whose names may end so, too.
_FILE_KINDS = ("label", "mesh", "stroke")


class Suffix(NamedTuple):
    """The end of a place: ``vox`` for voxel indices, else the ``unit`` in mm, and ``ras`` for RAS."""

    vox: bool = False
    unit: float = 1.0
    ras: bool = False

    def in_lps(self, numbers: Sequence[float]) -> tuple[float, ...]:
        """Return x, y, z and further lengths in mm, LPS; voxel indices as they are.

        Examples
        --------
        >>> Suffix(unit=10.0, ras=True).in_lps([1.0, -2.0, 3.0, 0.5])
        (-10.0, 20.0, 30.0, 5.0)
        """
        signs = (-1.0, -1.0) if self.ras else (1.0, 1.0)
        return tuple(
            number * (1.0 if self.vox else self.unit) * (signs[place] if place < 2 else 1.0)
            for place, number in enumerate(numbers)
        )


class Coordinates(NamedTuple):
    """Numbers in mm (LPS), or in voxels where ``vox``."""

    numbers: tuple[float, ...]
    vox: bool = False


def split_suffix(text: str) -> tuple[str, Suffix]:
    """Return a text of places without its end, and what that says.

    Examples
    --------
    >>> split_suffix("1,2,3"), split_suffix("4,5,6vox"), split_suffix("1,2,3cmras")
    (('1,2,3', Suffix(vox=False, unit=1.0, ras=False)), ('4,5,6', Suffix(vox=True, unit=1.0, ras=False)), \
('1,2,3', Suffix(vox=False, unit=10.0, ras=True)))
    """
    found = _SUFFIX.fullmatch(text.strip())
    assert found is not None  # the end may be empty
    body, end, unit, system = found.groups()
    return body, Suffix(end == "vox", UNITS_MM.get(unit or "mm", 1.0), system == "ras")


def coordinates_of(text: str) -> Coordinates | None:
    """Return the numbers of a place X,Y,Z, or of a ball X,Y,Z,R; None where a part is no number.

    Examples
    --------
    >>> coordinates_of("1,2,3,500um"), coordinates_of("1,2,3ras").numbers, coordinates_of("1,b")
    (Coordinates(numbers=(0.001, 0.002, 0.003, 0.5), vox=False), (-1.0, -2.0, 3.0), None)
    """
    body, suffix = split_suffix(text)
    try:
        return Coordinates(suffix.in_lps([float(part) for part in body.split(",")]), suffix.vox)
    except ValueError:
        return None


def box_of(text: str) -> Coordinates | None:
    """Return the corners X0,Y0,Z0,X1,Y1,Z1 of a box, the lower first where they were given so; None for no numbers."""
    body, suffix = split_suffix(text)
    parts = body.split(",")
    corners = [
        coordinates_of(",".join(part) + text.strip()[len(body) :])
        for part in (parts[:3], parts[3:])
    ]
    if corners[0] is None or corners[1] is None:
        return None
    first, second = corners[0].numbers, corners[1].numbers
    if suffix.ras and len(first) == len(second) == 3:  # what was lower along x and y is higher
        first, second = (*second[:2], first[2]), (*first[:2], second[2])
    return Coordinates((*first, *second), suffix.vox)


def is_point_file(text: str) -> bool:
    """Return True if a place is written as the name of a file of points.

    Examples
    --------
    >>> is_point_file("F.mrk.json"), is_point_file("stroke:a.csv"), is_point_file("1,2,3")
    (True, False, False)
    """
    return (
        text.strip().lower().endswith(POINT_FILES)
        and text.strip().partition(":")[0] not in _FILE_KINDS
    )
