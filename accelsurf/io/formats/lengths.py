"""Lengths as ImageJ, Micro-Manager and Bio-Formats write them: numbers, and the names of their units."""

from __future__ import annotations

import math
import re

from accelsurf.errors import InputError

_MICRO = ("um", "\u00b5m", "\u03bcm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres")
_MM = {
    **dict.fromkeys(_MICRO, 1e-3), "pm": 1e-9, "\u00e5": 1e-7, "angstrom": 1e-7,
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), 1e-6),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 10.0), "dm": 100.0,
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1e3), "km": 1e6,
    **dict.fromkeys(("inch", "inches", "in", '"'), 25.4), "thou": 0.0254, "li": 25.4 / 12, "ft": 304.8, "pt": 25.4 / 72,
}  # fmt: skip
_ESCAPE = re.compile(r"\\u([0-9a-fA-F]{4})")


def mm_of(unit: str) -> float:
    r"""Millimetres of a unit of length; 0 for what is none, as pixel.

    Examples
    --------
    >>> mm_of("micron"), mm_of("\\u00B5m"), mm_of("inch"), mm_of("pixel"), mm_of("Mm")
    (0.001, 0.001, 25.4, 0.0, 0.0)
    """
    name = _ESCAPE.sub(lambda found: chr(int(found.group(1), 16)), unit).strip()
    if len(name) == 2 and name[0] in "YZEPTGM" and name[1] == "m":  # megametres, and more
        return 0.0
    return _MM.get(name.lower(), 0.0)


def number(text: str, name: str) -> float:
    """A number whose decimal mark may be a comma.

    Parameters
    ----------
    text : str
    name : str
        What it is, for the message.

    Raises
    ------
    InputError
        When it is no number.

    Examples
    --------
    >>> number(" 1,5", "spacing")
    1.5
    """
    try:
        return float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)
    except ValueError:
        raise InputError(
            f"the TIFF says {name} = {text.strip()[:40]!r}, a number expected", "export it again, or correct its header"
        ) from None


def length(value: float, mm: float) -> float:
    """A length in mm, by its number and the millimetres of its unit; 0 where either is not known.

    Examples
    --------
    >>> length(-1.5, 1e-3), length(0.0, 1.0), length(float("nan"), 1.0)
    (0.0015, 0.0, 0.0)
    """
    found = abs(value) * mm
    return found if math.isfinite(found) else 0.0


def unit_name(mm: float) -> str:
    """The unit in which lengths are shown, by the millimetres of the unit of a file.

    Examples
    --------
    >>> unit_name(1e-3), unit_name(10.0), unit_name(1e-7)
    ('um', 'mm', 'nm')
    """
    return "nm" if mm < 1e-4 else "um" if mm < 0.1 else "mm"
