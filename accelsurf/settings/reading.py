"""Options of reading an image from a file or folder that holds several, or does not say where its voxels lie.

Check that a path can be read: pipes would be waited for, and devices do not end.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.settings.wording import mm_of, unit_name

#: Units that a spacing may have.
_UNITS = ("nm", "um", "µm", "μm", "mm", "cm", "m")
_NUMBER = r"[0-9]{0,12}\.?[0-9]{0,20}(?:[eE][-+]?[0-9]{1,2})?"
_SPACING = re.compile(rf"({_NUMBER})(?:,({_NUMBER}),({_NUMBER}))? ?([a-zµμ]*)")
#: Sizes of a voxel that can be meant, mm.
_SMALLEST = 1e-9
_LARGEST = 1e6

#: A level of a pyramid, 0 the finest; "auto" is the finest whose run fits into the memory.
Level = int | Literal["auto"]


class Spacing(tuple[float, float, float]):
    """Size of a voxel (x, y, z), mm, and the ``unit`` in which it was given; empty where none was.

    Examples
    --------
    >>> Spacing((0.5, 0.5, 2.0)), Spacing((0.5, 0.5, 2.0), "um").unit
    ((0.5, 0.5, 2.0), 'um')
    """

    def __new__(cls, sizes: Iterable[float], unit: str = "") -> Spacing:
        """Make it of three sizes in mm."""
        return super().__new__(cls, sizes)

    def __init__(self, sizes: Iterable[float], unit: str = "") -> None:
        self.unit = unit


@dataclass(frozen=True)
class ReadOptions:
    """Requested options beside the name of an image.

    Attributes
    ----------
    level : int or "auto"
        Of an image that is stored as a pyramid; 0 is the finest, "auto" the finest that fits into the memory.
    channel_index, time_index : int, optional
        Which channel and time point, from 0 on.
    channels_from_time : bool
        Whether time points are channels of one image.
    series : str, optional
        Which series of a DICOM folder: its UID or its number in the list.
    spacing : Spacing, optional
        Size of a voxel (x, y, z), mm, where the file does not say it, and its unit.
    """

    level: Level = 0
    channel_index: int | None = None
    time_index: int | None = None
    channels_from_time: bool = False
    series: str | None = None
    spacing: Spacing | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the options that were given.

        Examples
        --------
        >>> ReadOptions(time_index=0, spacing=(1.0, 1.0, 2.0)).given
        ('time_index', 'spacing')
        """
        return tuple(f.name for f in fields(self) if getattr(self, f.name) != f.default)

    def restricted_to(self, names: Collection[str]) -> ReadOptions:
        """Return the options that a format has; the others as if they had not been given.

        Examples
        --------
        >>> ReadOptions(level=2, series="7").restricted_to(("level",)).given
        ('level',)
        """
        absent: dict[str, Any] = {f.name: f.default for f in fields(self) if f.name not in names}
        return replace(self, **absent)


#: Nothing asked for.
AS_IT_IS = ReadOptions()


def spacing_of(text: str) -> Spacing:
    """The size of a voxel (x, y, z) in mm, as it is written: one number or three, and a unit unless it is mm.

    Raises
    ------
    UsageError
        When it is written in another way, or no size of a voxel.

    Examples
    --------
    >>> spacing_of("0.5,0.5,2"), spacing_of("250nm")
    ((0.5, 0.5, 2.0), (0.00025, 0.00025, 0.00025))
    """
    found = _SPACING.fullmatch(text.strip())
    numbers = (
        [float(word) for word in found.groups()[:3] if word not in (None, ".", "")] if found else []
    )
    unit = found.group(4) or "mm" if found else ""
    if found is None or unit not in _UNITS or len(numbers) != (1 if found.group(2) is None else 3):
        raise UsageError(
            f"spacing: {text[:60]} was given, expected X,Y,Z or one number, in mm or with a unit",
            "as --spacing 0.5,0.5,2 or --spacing 0.2,0.2,1um",
        )
    x, y, z = (number * mm_of(unit) for number in (numbers if len(numbers) == 3 else numbers * 3))
    if not all(_SMALLEST <= size <= _LARGEST for size in (x, y, z)):
        raise UsageError(
            f"spacing: {text[:60]} was given, expected sizes of {_SMALLEST:g} to {_LARGEST:g} mm",
            "is the unit right?",
        )
    return Spacing((x, y, z), unit_name(mm_of(unit)) if found.group(4) else "")


def check_readable(
    path: str | Path, name: str = "", kind: type[AccelsurfError] = InputError
) -> None:
    """Refuse a pipe, a device or a socket; a missing file and a folder are left to the reader.

    Parameters
    ----------
    path : str or Path
        The path to open, links followed.
    name : str
        The beginning of the message.
    kind : type
        Of the error.

    Raises
    ------
    AccelsurfError
        Of that kind.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # it is not there, or no file can have the name
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        message = f"{name}this is no file but a pipe, a device or a socket"
        raise kind(message, "write what it holds into a file, and give that")
