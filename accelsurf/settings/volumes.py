"""Volumes as they are typed: a number and a unit."""

from __future__ import annotations

import re

from accelsurf.errors import UsageError
from accelsurf.settings.wording import shown

#: mm3 of each unit.
UNITS = {
    "l": 1e6, "ml": 1e3, "ul": 1.0, "cm3": 1e3, "cc": 1e3, "mm3": 1.0, "um3": 1e-9, "nm3": 1e-18,
}
#: A volume as it is written.
VOLUME = rf"^([0-9]{{1,9}}(\.[0-9]{{0,20}})?|\.[0-9]{{1,20}})({'|'.join(UNITS)})$"
VOLUME_FORM = re.compile(VOLUME)


def volume_mm3(text: str) -> float:
    """Return a volume in mm3.

    Parameters
    ----------
    text : str
        A number followed by one of `UNITS`.

    Raises
    ------
    UsageError
        When it is not of this form, or is 0.

    Examples
    --------
    >>> volume_mm3("250ml"), volume_mm3("3cm3"), volume_mm3("0.5mm3")
    (250000.0, 3000.0, 0.5)
    """
    found = VOLUME_FORM.fullmatch(text)
    if found is None or float(found[1]) == 0:
        raise UsageError(
            f"size: {shown(text)} was given, expected a volume above 0 with its unit",
            f"as in 250ml or 4000um3; the units are {', '.join(UNITS)}",
        )
    return float(found[1]) * UNITS[found[3]]
