"""Numbers of places as people write them: a unit, ``vox`` or ``grid`` at the end, and RAS in place of LPS."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation, index_of_scales, scales_of

#: mm in a unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}
_SUFFIX = re.compile(rf"(?s)(.*?)(vox|({'|'.join(UNITS_MM)})?(ras|lps|grid)?)")
#: Valid ends of a place, for messages.
SUFFIXES = "a unit (mm, cm, um, nm), ras for RAS, vox for voxel indices, or grid for the scales of pictures"


#: Endings of files of points that other programs write.
POINT_FILES = (".mrk.json", ".fcsv", ".csv", ".txt")
#: Kinds of places with a file, whose names may end so, too.
_FILE_KINDS = ("label", "mesh", "stroke")


#: Meaning of the numbers of a place: voxel indices; mm along the scales of pictures, or there in the unit of the image;
#: else mm, LPS.
System = Literal["", "vox", "grid", "shown"]


class Suffix(NamedTuple):
    """The end of a place: its ``system``, the ``unit`` of its numbers in mm, and ``ras`` for RAS."""

    system: System = ""
    unit: float = 1.0
    ras: bool = False

    def coordinates(self, numbers: Sequence[float]) -> Coordinates:
        """Return x, y, z and further lengths in mm (LPS where the system is the world's); voxel indices as they are.

        Examples
        --------
        >>> Suffix(unit=10.0, ras=True).coordinates([1.0, -2.0, 3.0, 0.5]).numbers
        (-10.0, 20.0, 30.0, 5.0)
        """
        signs = (-1.0, -1.0) if self.ras else (1.0, 1.0)
        return Coordinates(
            tuple(
                number * self.unit * (signs[place] if place < 2 else 1.0)
                for place, number in enumerate(numbers)
            ),
            self.system,
        )


class Coordinates(NamedTuple):
    """Numbers in mm (LPS), or in another ``system``: x, y, z, also with a radius, or the two corners of a box."""

    numbers: tuple[float, ...]
    system: System = ""

    @property
    def vox(self) -> bool:
        """Test if they are voxels; for places on a scale `on` comes first."""
        assert self.system in ("", "vox")
        return self.system == "vox"

    def on(self, geometry: Geometry) -> Coordinates:
        """Return the same in mm (LPS), or in voxels: places on the scales of pictures become indices.

        Examples
        --------
        >>> grid = Geometry((9, 9, 9), (2.0, 1.0, 1.0), (5.0, 5.0, 5.0))
        >>> Coordinates((7.0, 8.0, 9.0, 1.0), "grid").on(grid)
        Coordinates(numbers=(2.0, 3.0, 2.0, 1.0), system='vox')
        """
        if self.system in ("", "vox"):
            return self
        mm = UNITS_MM[geometry.unit] if self.system == "shown" else 1.0
        numbers = [number * mm for number in self.numbers]
        places = [
            index_of_scales(geometry, numbers[at : at + 3])[::-1]
            for at in range(0, len(numbers) - 2, 3)
        ]
        if (
            len(places) == 2
        ):  # the lower end along a scale is the higher one along an axis that runs the other way
            ends = list(zip(*places, strict=True))
            places = [tuple(map(min, ends)), tuple(map(max, ends))]
        radius = [number / min(geometry.steps) for number in numbers[3 * len(places) :]]
        return Coordinates((*(v for place in places for v in place), *radius), "vox")


def split_suffix(text: str) -> tuple[str, Suffix]:
    """Return a text of places without its end, and the meaning of that end.

    Examples
    --------
    >>> split_suffix("1,2,3"), split_suffix("4,5,6vox"), split_suffix("1,2,3cmras")
    (('1,2,3', Suffix(system='', unit=1.0, ras=False)), ('4,5,6', Suffix(system='vox', unit=1.0, ras=False)), \
('1,2,3', Suffix(system='', unit=10.0, ras=True)))
    """
    found = _SUFFIX.fullmatch(text.strip())
    assert found is not None  # the end may be empty
    body, end, unit, system = found.groups()
    mm = UNITS_MM.get(unit or "mm", 1.0)
    if system == "grid":
        return body, Suffix("grid" if unit else "shown", mm)
    return body, Suffix("vox" if end == "vox" else "", mm, system == "ras")


def coordinates_of(text: str) -> Coordinates | None:
    """Return the numbers of a place X,Y,Z, or of a ball X,Y,Z,R; None where a part is no number.

    Examples
    --------
    >>> coordinates_of("1,2,3,500um"), coordinates_of("1,2,3ras").numbers, coordinates_of("1,b")
    (Coordinates(numbers=(0.001, 0.002, 0.003, 0.5), system=''), (-1.0, -2.0, 3.0), None)
    """
    body, suffix = split_suffix(text)
    try:
        return suffix.coordinates([float(part) for part in body.split(",")])
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
    if suffix.ras and len(first) == len(second) == 3:  # lower along x and y is now higher
        first, second = (*second[:2], first[2]), (*first[:2], second[2])
    return Coordinates((*first, *second), suffix.system)


def suffix_of(geometry: Geometry) -> str:
    """Return the end of a place that was read off the scales of a picture; empty for mm in the world.

    Examples
    --------
    >>> suffix_of(Geometry((9, 9, 9), (1.0, 1.0, 1.0))), suffix_of(Geometry((9, 9, 9), (1.0, 1.0, 1.0), unit="um"))
    ('', 'um')
    """
    unit = "" if geometry.unit == "mm" else geometry.unit
    return unit if DisplayOrientation.of(geometry).is_parallel else f"{unit}grid"


def place_text(place: Sequence[float], geometry: Geometry, radius: float | None = None) -> str:
    """Return a place as pictures show it and options take it, to a part of a voxel: with the end that it needs.

    Parameters
    ----------
    place : (float, float, float)
        World place (x, y, z), mm, LPS.
    geometry : Geometry
        Grid of the image, in whose unit and along whose scales it is written.
    radius : float, optional
        Of a ball there, mm.

    Examples
    --------
    >>> place_text((1.26, -3, 40.5), Geometry((9, 9, 9), (1.0, 1.0, 1.0)))
    '1.3,-3.0,40.5'
    >>> place_text((0.01234, 0, 0.001), Geometry((9, 9, 9), (0.001, 0.0002, 0.0002), unit="um"), 0.0005)
    '12.34,0.00,1.00,0.5um'
    """
    mm = UNITS_MM[geometry.unit]
    shown = place
    if not DisplayOrientation.of(geometry).is_parallel:
        z, y, x = geometry.world_to_index(place).tolist()
        shown = scales_of(geometry, (z, y, x))
    digits = digits_of([step / mm for step in geometry.spacing])
    numbers = [f"{round(value / mm, digits) + 0.0:.{digits}f}" for value in shown]
    if radius is not None:
        numbers.append(f"{radius / mm:.2g}")
    return ",".join(numbers) + suffix_of(geometry)


def digits_of(steps: Sequence[float]) -> int:
    """Return how many decimals a coordinate needs, so that it is right to a tenth of a voxel, by the voxels' distances.

    Examples
    --------
    >>> digits_of([1.0, 2.0]), digits_of([0.2, 1.0]), digits_of([0.0305])
    (1, 2, 3)
    """
    return max(1, math.ceil(-math.log10(0.2 * min(steps)) - 1e-9))


def is_point_file(text: str) -> bool:
    """Return True if a place is written as the name of a file of points.

    Examples
    --------
    >>> is_point_file("F.mrk.json"), is_point_file("stroke:a.csv"), is_point_file("1,2,3")
    (True, False, False)
    """
    return bool(file_in(text)) and text.strip().partition(":")[0] not in _FILE_KINDS


def file_in(text: str) -> str:
    """Return the name of the file that the text of a click or a start names; empty where it names none.

    Examples
    --------
    >>> file_in("stroke:a.csv"), file_in("F.mrk.json"), file_in("ball:1,2,3,4")
    ('a.csv', 'F.mrk.json', '')
    """
    kind, _, name = text.strip().partition(":")
    if kind in _FILE_KINDS:
        return name
    return text.strip() if text.strip().lower().endswith(POINT_FILES) else ""
